"""Hide what libraries print by themselves, and nothing else.

Standard output, standard error and their descriptors belong to all threads of a process, and to the processes that it
starts. So what other threads print passes at once. What a library prints from C is caught where the C library lets its
``stderr`` be replaced, as that of Linux does. Elsewhere descriptor 2 is redirected, in the processes of the command
alone, which call `hush_libraries`.
"""

from __future__ import annotations

import ctypes
import io
import os
import platform
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from functools import cache
from typing import Any, TextIO, cast

_lock = threading.Lock()
_one_at_a_time = threading.Lock()
_is_hushed = False


def hush_libraries() -> None:
    """Let `hide_lines` redirect descriptor 2. Only a process that does nothing but run lobewise may call this."""
    global _is_hushed
    _is_hushed = True


@contextmanager
def hide_lines(*marks: str) -> Iterator[None]:
    """Hide the lines with one of these marks that a library prints in the ``with`` block; print its others afterwards.

    Any number of threads may be in such a block at once, but one at a time where descriptor 2 is redirected.
    """
    with _catch_prints(marks), _catch_c(marks):
        yield


class _Passing:
    """Stands for standard output: what threads in `hide_lines` print is kept, what others print passes."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream
        self.kept: dict[int, io.StringIO] = {}

    def write(self, text: str) -> int:
        """Write a text, or keep it."""
        return self.kept.get(threading.get_ident(), self.stream).write(text)

    def __getattr__(self, name: str) -> Any:
        """Return what else the standard output has."""
        return getattr(self.stream, name)


@contextmanager
def _catch_prints(marks: tuple[str, ...]) -> Iterator[None]:
    """Hide lines of Python's ``print`` in this thread."""
    own = threading.get_ident()
    with _lock:
        if sys.stdout is not None and not isinstance(sys.stdout, _Passing):
            sys.stdout = cast(TextIO, _Passing(sys.stdout))
        passing = cast("_Passing | None", sys.stdout)
        if passing is not None:
            passing.kept[own] = io.StringIO()
    try:
        yield
    finally:
        if passing is not None:
            with _lock:
                printed = passing.kept.pop(own).getvalue()
                if not passing.kept and sys.stdout is cast(TextIO, passing):
                    sys.stdout = passing.stream
            _print_others(printed, marks, passing.stream)


class _Caught:
    """What is printed to the ``stderr`` of C while `hide_lines` is under way in some thread."""

    def __init__(self, library: ctypes.CDLL) -> None:
        self._stderr = ctypes.c_void_p.in_dll(library, "stderr")
        self._file, self._count, self._own = os.memfd_create("lobewise-lines"), 0, self._stderr.value
        library.fdopen.restype = ctypes.c_void_p
        library.setvbuf.argtypes = (ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int, ctypes.c_size_t)
        # The stream stays open: another thread may be writing to it when this one leaves.
        self._stream = library.fdopen(os.dup(self._file), b"a")
        library.setvbuf(self._stream, None, _UNBUFFERED, 0)

    def enter(self) -> None:
        """Catch lines from now on."""
        if self._count == 0:
            self._own, self._stderr.value = self._stderr.value, self._stream
        self._count += 1

    def leave(self) -> bytes:
        """Return the lines caught so far, when the last thread leaves."""
        self._count -= 1
        if self._count:
            return b""
        self._stderr.value = self._own
        lines = os.pread(self._file, os.fstat(self._file).st_size, 0)
        os.ftruncate(self._file, 0)
        return lines


_UNBUFFERED = 2
"""The mode ``_IONBF`` of ``setvbuf`` in glibc."""


@cache
def _open_c_stderr() -> _Caught | None:
    """Return the ``stderr`` of C, if it is a variable that may be set: that of glibc is, that of musl is not."""
    if platform.libc_ver()[0] != "glibc":
        return None
    try:
        return _Caught(ctypes.CDLL(None))
    except (OSError, ValueError):
        return None


if hasattr(os, "register_at_fork"):
    # A child has a file of its own.
    os.register_at_fork(after_in_child=_open_c_stderr.cache_clear)


@contextmanager
def _catch_c(marks: tuple[str, ...]) -> Iterator[None]:
    """Hide lines that a library prints from C."""
    caught = _open_c_stderr()
    if caught is None:
        with _redirect(marks):
            yield
        return
    with _lock:
        caught.enter()
    try:
        yield
    finally:
        with _lock:
            lines = caught.leave()
        _print_others(lines.decode("utf-8", "replace"), marks, sys.stderr)


@contextmanager
def _redirect(marks: tuple[str, ...]) -> Iterator[None]:
    """Hide lines of descriptor 2, if the process is lobewise's own."""
    if not _is_hushed:
        yield
        return
    with _one_at_a_time, ExitStack() as files:
        try:
            caught = files.enter_context(tempfile.TemporaryFile())
            saved = os.dup(2)
        except OSError:
            # The process has no standard error, or the system has no room for a file.
            yield
            return
        if sys.stderr is not None:
            sys.stderr.flush()
        try:
            os.dup2(caught.fileno(), 2)
            yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            caught.seek(0)
            _print_others(caught.read().decode("utf-8", "replace"), marks, sys.stderr)


def _print_others(text: str, marks: tuple[str, ...], stream: TextIO | None) -> None:
    """Print the lines of a text that have no mark."""
    others = [line for line in text.splitlines(keepends=True) if not any(mark in line for mark in marks)]
    if others and stream is not None:
        stream.write("".join(others))
