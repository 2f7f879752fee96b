"""Locks on open files, which the system releases when the process ends."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

try:
    import fcntl
except ImportError:
    fcntl = None  # type: ignore[assignment]
try:
    import msvcrt
except ImportError:
    msvcrt = None  # type: ignore[assignment]

_LOCKED_BYTE = 1 << 40
"""Place of the byte that is locked on Windows, far beyond the end: there nobody may write or read a locked byte."""


def lock_file(path: Path) -> int | None:
    """Return the descriptor of a file that is locked until it is closed; None if another process has locked it.

    The file is made where there is none, and no file is changed. On file systems without locks nothing is locked.

    Raises OSError if it cannot be opened, as where it is a link.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    if try_lock(descriptor):
        return descriptor
    os.close(descriptor)
    return None


def try_lock(descriptor: int) -> bool:
    """Lock an open file until it is closed; return False if another process or another open file holds the lock.

    On file systems without locks nothing is locked, and the result is True.
    """
    if fcntl is not None:
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return False
        except OSError:
            return True
    elif msvcrt is not None:
        place = os.lseek(descriptor, 0, os.SEEK_CUR)
        try:
            os.lseek(descriptor, _LOCKED_BYTE, os.SEEK_SET)
            msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)  # type: ignore[attr-defined,unused-ignore]
        except PermissionError:
            return False
        except OSError:
            return True
        finally:
            with suppress(OSError):
                os.lseek(descriptor, place, os.SEEK_SET)
    return True
