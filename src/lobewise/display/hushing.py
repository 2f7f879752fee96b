"""Hide what libraries print by themselves, in the processes of the command alone.

Standard output, standard error and their descriptors belong to all threads of a process, and to the processes that it
starts. So lobewise leaves them alone, unless `hush_libraries` was called.
"""

from __future__ import annotations

import io
import os
import sys
import tempfile
import threading
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, redirect_stdout
from typing import BinaryIO, TextIO

_one_at_a_time = threading.Lock()
_is_hushed = False


def hush_libraries() -> None:
    """Let `hide_lines` hide lines from now on. Only a process that does nothing but run lobewise may call this."""
    global _is_hushed
    _is_hushed = True


@contextmanager
def hide_lines(*marks: str) -> Iterator[None]:
    """Hide the lines with one of these marks that are printed in the ``with`` block; print all others afterwards.

    Nothing is hidden unless `hush_libraries` was called. Then one thread at a time is in such a block.
    """
    if not _is_hushed:
        yield
        return
    with _one_at_a_time, ExitStack() as files:
        try:
            caught = files.enter_context(_open_temporary())
            saved = os.dup(2)
        except OSError:
            # The process has no standard error, or the system has no room for a file.
            yield
            return
        printed = io.StringIO()
        if sys.stderr is not None:
            sys.stderr.flush()
        try:
            # Code in C writes to descriptor 2.
            os.dup2(caught.fileno(), 2)
            with redirect_stdout(printed):
                yield
        finally:
            os.dup2(saved, 2)
            os.close(saved)
            caught.seek(0)
            _print_others(printed.getvalue(), marks, sys.stdout)
            _print_others(caught.read().decode("utf-8", "replace"), marks, sys.stderr)


def _open_temporary() -> BinaryIO:
    """Return a new empty file: in memory where the system has such files, so that no folder must be writable."""
    if hasattr(os, "memfd_create"):
        return os.fdopen(os.memfd_create("lobewise-lines"), "w+b")
    return tempfile.TemporaryFile()


def _print_others(text: str, marks: tuple[str, ...], stream: TextIO | None) -> None:
    """Print the lines of a text that have no mark."""
    others = [line for line in text.splitlines(keepends=True) if not any(mark in line for mark in marks)]
    if others and stream is not None:
        stream.write("".join(others))
