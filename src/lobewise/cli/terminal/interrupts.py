"""Exit code and message of Ctrl-C, the Ctrl-C signals that the process received, and how to delay them."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

EXIT_INTERRUPTED = 130
INTERRUPTED = "interrupted; every output is whole, or as it was."

interrupts: list[int] = []
"""Numbers of the Ctrl-C signals that this process received. A library may turn KeyboardInterrupt into another error."""


@contextmanager
def hold_interrupts() -> Iterator[None]:
    """Delay Ctrl-C until the end of the ``with`` block. In other threads than the main thread it does nothing."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    signals: list[Any] = []
    before = signal.signal(signal.SIGINT, lambda *arguments: signals.append(arguments))
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
    if signals and callable(before):
        before(*signals[-1])
