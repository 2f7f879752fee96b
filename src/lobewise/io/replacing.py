"""Replace files in one step, safe against killed processes and other writers of the same file."""

from __future__ import annotations

import hashlib
import os
import re
import secrets
import shutil
import socket
import stat
import time
import warnings
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import BinaryIO

MAX_NAME_BYTES = 255
"""Longest file name of usual file systems."""
MAX_TAIL_BYTES = 40
"""Longest end of a temporary file's name, behind that of its target."""
MIN_SECONDS_OF_LEFTOVERS = 86400.0
"""Age from which a temporary file counts as left by a killed process, wherever that ran."""
MIN_SECONDS_ON_WINDOWS = 60.0
"""The same on Windows, which refuses to remove a file that is being written."""
_is_posix = os.name == "posix"
_TAIL = re.compile(r"([0-9a-f]{8})-([0-9]{1,10})-[0-9a-z_]{8}\.part")
_NEW = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)


class TargetWarning(UserWarning):
    """A file was replaced, but its owner, group or hard links could not be kept."""


def name_temporary(target: Path) -> Path:
    """Return a name beside a target that no other writer uses, ``.NAME.MACHINE-PROCESS-RANDOM.part``."""
    return target.parent / f"{begin_temporary(target)}{secrets.token_hex(4)}.part"


def begin_temporary(target: Path) -> str:
    """Return how the names of this process's temporary files for a target begin; eight letters and ``.part`` follow."""
    return f"{_begin_any(target)}{_name_machine()}-{os.getpid()}-"


def _begin_any(target: Path) -> str:
    """Return how the names of every process's temporary files for a target begin."""
    begin = f".{target.name}."
    if len(os.fsencode(begin)) + MAX_TAIL_BYTES > MAX_NAME_BYTES:
        begin = f".{hashlib.sha256(os.fsencode(target.name)).hexdigest()[:32]}."
    return begin


def _name_machine() -> str:
    """Return eight letters for all processes that this one sees: those of one boot, and of one container.

    Machines may share a name, and containers count their processes anew.
    """
    try:
        seen = Path("/proc/sys/kernel/random/boot_id").read_text() + os.readlink("/proc/self/ns/pid")
    except OSError:
        seen = socket.gethostname()
    return hashlib.sha256(seen.encode()).hexdigest()[:8]


def remove_leftovers(target: Path) -> None:
    """Remove the temporary files and folders that killed processes left for a target; keep those in use."""
    begin, machine = _begin_any(target), _name_machine()
    with suppress(OSError), os.scandir(target.parent) as entries:
        for entry in entries:
            tail = _TAIL.fullmatch(entry.name, len(begin)) if entry.name.startswith(begin) else None
            if tail is not None:
                with suppress(OSError):
                    if _is_left(entry.stat(follow_symlinks=False), tail[1] == machine, int(tail[2])):
                        shutil.rmtree(entry.path) if entry.is_dir(follow_symlinks=False) else os.unlink(entry.path)


def _is_left(status: os.stat_result, is_here: bool, process: int) -> bool:
    """Return whether nobody writes a temporary file or folder of this user any more, as far as can be known."""
    is_plain = stat.S_ISREG(status.st_mode) or stat.S_ISDIR(status.st_mode)
    if not is_plain or (hasattr(os, "geteuid") and status.st_uid != os.geteuid()):
        return False
    age = time.time() - status.st_mtime
    if not _is_posix:
        # A folder that is being written can be removed.
        return age > (MIN_SECONDS_OF_LEFTOVERS if stat.S_ISDIR(status.st_mode) else MIN_SECONDS_ON_WINDOWS)
    return age > MIN_SECONDS_OF_LEFTOVERS or (is_here and not _is_running(process))


def _is_running(process: int) -> bool:
    """Return whether there is a process with this number."""
    try:
        os.kill(process, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except OSError:
        # It belongs to another user.
        return True
    return True


class Replacement:
    """The new content of ``target``, a real path; write it into ``stream``.

    It is a file of its own until `finish` gives it the target's name. So writers of the same target do not meet: the
    last one to finish wins. Without `finish` the target stays as it was and the new file is removed.

    Raises
    ------
    OSError
        If the system refuses.
    """

    def __init__(self, target: Path) -> None:
        self._target = target
        remove_leftovers(target)
        self._before = _look_at(target)
        self._temporary = name_temporary(target)
        # The system applies the mask of the process to a new file. A file that replaces another gets its mode at last.
        mode = 0o666 if self._before is None else 0o600
        self.stream: BinaryIO = os.fdopen(os.open(self._temporary, _NEW, mode), "wb")
        self._is_done = False

    def __enter__(self) -> Replacement:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, problem: BaseException | None, trace: TracebackType | None
    ) -> None:
        # Windows neither removes nor replaces a file that is open.
        with suppress(OSError):
            self.stream.close()
        if not self._is_done:
            with suppress(OSError):
                os.unlink(self._temporary)

    def finish(self) -> None:
        """Replace the target by the new content."""
        self.stream.flush()
        os.fsync(self.stream.fileno())
        notes = self._keep_properties()
        self.stream.close()
        os.replace(self._temporary, self._target)
        self._is_done = True
        _sync_folder(self._target.parent)
        if notes:
            warnings.warn(notes, TargetWarning, stacklevel=4)

    def _keep_properties(self) -> str:
        """Give the new file permissions, owner and attributes of the old one; return a sentence about what is lost."""
        target, descriptor = self._target, self.stream.fileno()
        old = _look_at(target) or self._before
        if old is None:
            return ""
        notes = []
        if hasattr(os, "fchown"):
            new = os.fstat(descriptor)
            for name, before, now in (("group", old.st_gid, new.st_gid), ("owner", old.st_uid, new.st_uid)):
                try:
                    if before != now:
                        os.fchown(descriptor, before if name == "owner" else -1, before if name == "group" else -1)
                except OSError:
                    notes.append(f"its {name} is now {now} instead of {before}")
        if hasattr(os, "listxattr"):
            with suppress(OSError):
                for key in os.listxattr(target):
                    if not key.startswith("security."):
                        os.setxattr(descriptor, key, os.getxattr(target, key))
        # Set the mode after the owner: a change of owner clears bits of the mode.
        if hasattr(os, "fchmod"):
            os.fchmod(descriptor, stat.S_IMODE(old.st_mode))
        else:
            self._temporary.chmod(stat.S_IMODE(old.st_mode))
        if old.st_nlink > 1:
            notes.append(f"{old.st_nlink - 1} hard link(s) to it keep the old content")
        return f"{str(target)!r} was replaced: {', '.join(notes)}." if notes else ""


def _look_at(path: Path) -> os.stat_result | None:
    """Return what the system says of a file, None where it does not exist."""
    try:
        return path.stat()
    except OSError:
        return None


def _sync_folder(folder: Path) -> None:
    """Make the new name durable. Some file systems do not support this; the data is safe without it."""
    with suppress(OSError):
        descriptor = os.open(folder, os.O_RDONLY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)
