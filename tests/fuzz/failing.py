"""Readers that fail in every way, to see that the watcher notices each."""

import ctypes
import time
from collections.abc import Callable
from pathlib import Path

from lobewise.errors import FileError
from tests.fuzz.readers import Reader

Answer = Callable[..., None]


def _fail(path: Path, answer: Answer) -> None:
    how = path.read_bytes()
    if how == b"refuse":
        raise FileError("file", expected="a file", got="another", action="mend it")
    if how == b"error":
        raise ZeroDivisionError("by zero")
    if how == b"warn":
        import warnings

        warnings.warn("a warning that a user would see", RuntimeWarning, stacklevel=1)
    if how == b"garble":
        raise FileError("two\nlines")
    if how == b"crash":
        ctypes.string_at(0)
    if how == b"hang":
        time.sleep(3600)
    if how == b"bomb":
        # What was made is given back at once: only the peak tells.
        len(b"x" * 1_050_000_000)
    if how == b"burst":
        len(bytes(8_000_000_000))
    if how == b"caught":
        raise FileError("file", expected="pixels", got="not enough memory", action="mend it")
    if how == b"stages":
        # All lines of an answer at once.
        for stage in ("oracle", "ours"):
            answer(stage=stage)
    if how == b"oracle":
        answer(stage="oracle")
        ctypes.string_at(0)


class _Plain(Reader):
    def prepare(self, folder: Path) -> None:
        """Do nothing: there is nothing to load."""


READERS = {"any": _Plain(".txt", _fail, "")}
