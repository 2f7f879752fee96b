"""The program `lobewise`. Every mistake of a user gets one sentence; heavy modules are imported only when needed."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
from collections.abc import Sequence
from contextlib import suppress
from typing import NoReturn

from lobewise.cli.terminal.interrupts import EXIT_INTERRUPTED, INTERRUPTED, interrupts

MAX_NEW_OBJECTS = 10_000
"""Objects that are made before Python looks for cycles of objects that nothing uses, among these objects alone."""
MAX_SEARCHES = 20
"""Such searches before one among older objects too. A short run makes a dozen, and its modules stay."""


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the program and exit with its exit code.

    While modules are imported and after the verb has ended, Ctrl-C ends the process at once: no file is being written,
    and Python would print a traceback.

    Parameters
    ----------
    arguments : sequence of str, optional
        Command line without the program's name; by default the command line of the process.

    Raises
    ------
    SystemExit
        Always: 0 after success, 2 for a mistake that the user can mend, 1 for an error in lobewise, 130 for Ctrl-C.
    """
    # Modules leave few cycles. With Python's 700 the search for them takes a tenth of a short run.
    gc.set_threshold(MAX_NEW_OBJECTS, MAX_SEARCHES)
    # At its end Python would search all objects. The system takes them with the process.
    atexit.register(gc.freeze)
    # NumPy's threads for products of matrices wait awake for 25 ms after each product. Let them sleep at once.
    os.environ.setdefault("OPENBLAS_THREAD_TIMEOUT", "4")
    is_ignored = signal.getsignal(signal.SIGINT) == signal.SIG_IGN
    if not is_ignored:
        _set_handler(_leave)
    from lobewise.cli.program import run
    from lobewise.cli.terminal.children import allow_children
    from lobewise.display.hushing import hush_libraries

    hush_libraries()
    allow_children()
    if not is_ignored:
        _set_handler(_interrupt)
    try:
        code = run(list(sys.argv[1:] if arguments is None else arguments))
    except KeyboardInterrupt:
        _say_interrupted()
        code = EXIT_INTERRUPTED
    if not is_ignored:
        _set_handler(_leave)
    sys.exit(code)


def _set_handler(handler: object) -> None:
    # Python refuses in any thread but the main one, and Ctrl-C only reaches the main thread.
    with suppress(ValueError):
        signal.signal(signal.SIGINT, handler)  # type: ignore[arg-type]


def _interrupt(number: int, frame: object) -> NoReturn:
    interrupts.append(number)
    raise KeyboardInterrupt


def _leave(number: int, frame: object) -> NoReturn:
    _say_interrupted()
    os._exit(EXIT_INTERRUPTED)


def _say_interrupted() -> None:
    with suppress(OSError):
        os.write(2, f"lobewise: {INTERRUPTED}\n".encode())


__all__ = ["main"]
