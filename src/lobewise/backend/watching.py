"""Tells observers that a kernel is being compiled, which may take seconds."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

_watchers: list[Callable[[bool], None]] = []


@contextmanager
def watch_compiling(tell: Callable[[bool], None]) -> Iterator[None]:
    """Call ``tell(True)`` before a kernel is compiled and ``tell(False)`` after it, not for kernels that are loaded.

    ``tell`` runs in the thread that needs the kernel.
    """
    _watchers.append(tell)
    try:
        yield
    finally:
        _watchers.remove(tell)


@contextmanager
def tell_compiling() -> Iterator[None]:
    """Tell the watchers that a kernel is compiled inside this context."""
    for tell in list(_watchers):
        tell(True)
    try:
        yield
    finally:
        for tell in list(_watchers):
            tell(False)
