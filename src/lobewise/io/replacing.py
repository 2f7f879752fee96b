"""Replace files in one step, safe against killed processes and concurrent writers."""

from __future__ import annotations

import hashlib
import os
import stat
import time
import warnings
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

from lobewise.io.locks import HAS_POSIX_FILES, try_lock

MAX_NAME_BYTES = 255
"""Longest file name of usual file systems."""
MIN_SECONDS_OF_LEFTOVERS = 86400.0
"""Age from which a temporary file of lobewise's first version counts as left by a killed process."""
_OPEN = (
    os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
)
_MAX_ATTEMPTS = 100


class TargetWarning(UserWarning):
    """A file was replaced, but its owner, group or hard links could not be kept."""


def name_temporary(target: Path) -> Path:
    """Return the temporary file of a target. Every write of the target uses this one."""
    name = f".{target.name}.part"
    if len(os.fsencode(name)) > MAX_NAME_BYTES:
        name = f".{hashlib.sha256(os.fsencode(target.name)).hexdigest()[:32]}.part"
    return target.parent / name


def remove_temporary(target: Path) -> None:
    """Remove the temporary file that a killed process left for a target; keep it while another process writes it."""
    path = name_temporary(target)
    with suppress(OSError):
        with path.open("rb+") as stream:
            if not try_lock(stream.fileno()):
                return
            if HAS_POSIX_FILES:
                path.unlink()
        if not HAS_POSIX_FILES:
            path.unlink()


class Replacement:
    """The new content of ``target``, a real path; write it into ``stream``.

    The temporary file is locked while it is open; the system releases the lock when the process dies. Without `finish`
    the target stays as it was and the temporary file is removed.

    Raises
    ------
    OSError
        If another process or thread is writing the same target, or the system refuses.
    """

    def __init__(self, target: Path) -> None:
        self._target = target
        self._temporary = name_temporary(target)
        self.stream: BinaryIO = os.fdopen(_open_locked(self._temporary), "wb")
        self._is_done = False

    def __enter__(self) -> Replacement:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        if not HAS_POSIX_FILES:
            with suppress(OSError):
                self.stream.close()
        if not self._is_done:
            # Remove the file while it is locked, where the system can: afterwards another process may own it.
            with suppress(OSError):
                self._temporary.unlink()
        with suppress(OSError):
            self.stream.close()

    def finish(self) -> None:
        """Replace the target by the new content."""
        self.stream.flush()
        os.fsync(self.stream.fileno())
        told = _keep_properties(self._target, self.stream.fileno())
        if not HAS_POSIX_FILES:
            self.stream.close()
        os.replace(self._temporary, self._target)
        self._is_done = True
        _sync_folder(self._target.parent)
        _remove_leftovers(self._target)
        if told:
            warnings.warn(told, TargetWarning, stacklevel=4)


def _open_locked(path: Path) -> int:
    """Return a descriptor of a locked, empty file of this user at a path. An existing file is emptied."""
    for _ in range(_MAX_ATTEMPTS):
        if path.is_symlink():
            raise OSError(f"{str(path)!r} beside it, which is a link")
        descriptor = os.open(path, _OPEN, 0o600)
        try:
            if not try_lock(descriptor):
                raise OSError(f"another process that is writing it (it holds {str(path)!r})")
            if _is_at(descriptor, path) and _is_own(descriptor, path):
                os.ftruncate(descriptor, 0)
                return descriptor
        except BaseException:
            os.close(descriptor)
            raise
        os.close(descriptor)
    raise OSError(f"{str(path)!r}, which changes all the time")


def _is_at(descriptor: int, path: Path) -> bool:
    """Return whether an open file still has its name: another writer may have moved it to its target meanwhile."""
    try:
        return os.path.samestat(os.fstat(descriptor), path.lstat())
    except FileNotFoundError:
        return False


def _is_own(descriptor: int, path: Path) -> bool:
    """Return whether an open file belongs to this user and has one name; unlink it if not."""
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode):
        raise OSError(f"{str(path)!r} beside it, which is no regular file")
    if found.st_nlink == 1 and (not hasattr(os, "geteuid") or found.st_uid == os.geteuid()):
        return True
    path.unlink()
    return False


def _keep_properties(target: Path, descriptor: int) -> str:
    """Give a new file the permissions, owner and attributes of the old file; return a sentence about what is lost."""
    try:
        old = target.stat()
    except OSError:
        _set_mode(target, descriptor, 0o666 & ~read_mask())
        return ""
    told = []
    if hasattr(os, "fchown"):
        new = os.fstat(descriptor)
        for name, before, now in (("group", old.st_gid, new.st_gid), ("owner", old.st_uid, new.st_uid)):
            try:
                if before != now:
                    os.fchown(descriptor, before if name == "owner" else -1, before if name == "group" else -1)
            except OSError:
                told.append(f"its {name} is now {now} instead of {before}")
    if hasattr(os, "listxattr"):
        with suppress(OSError):
            for key in os.listxattr(target):
                if not key.startswith("security."):
                    os.setxattr(descriptor, key, os.getxattr(target, key))
    # Set the mode after the owner: a change of owner clears bits of the mode.
    _set_mode(target, descriptor, stat.S_IMODE(old.st_mode))
    if old.st_nlink > 1:
        told.append(f"{old.st_nlink - 1} hard link(s) to it keep the old content")
    return f"{str(target)!r} was replaced: {', '.join(told)}." if told else ""


def _set_mode(target: Path, descriptor: int, mode: int) -> None:
    if hasattr(os, "fchmod"):
        os.fchmod(descriptor, mode)
    else:
        os.chmod(name_temporary(target), mode)


def read_mask() -> int:
    """Return the umask of the process. It can only be read by setting it."""
    mask = os.umask(0)
    os.umask(mask)
    return mask


_swept: set[Path] = set()


def _remove_leftovers(target: Path) -> None:
    """Remove temporary files ``.NAME.exr.????????.part`` of killed processes of the first version, once per folder."""
    folder = target.parent
    if folder in _swept:
        return
    _swept.add(folder)
    latest = time.time() - MIN_SECONDS_OF_LEFTOVERS
    with suppress(OSError):
        for path in folder.glob(".*.????????.part"):
            found = path.lstat()
            own = not hasattr(os, "geteuid") or found.st_uid == os.geteuid()
            if own and stat.S_ISREG(found.st_mode) and found.st_mtime < latest:
                path.unlink()


def _sync_folder(folder: Path) -> None:
    """Make the new name durable. Some file systems do not support this; the data is safe without it."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
