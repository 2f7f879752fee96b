"""Cache of compiled kernels on disk: object files in the user's cache folder, named by what they were made from.

The environment variable ``LOBEWISE_CACHE`` names another folder, or is ``off``. Kernels are machine code that this
process runs, so files are read only from folders that nobody else can write to (`lobewise.backend.trust`).
"""

from __future__ import annotations

import hashlib
import json
import os
import secrets
import sys
import time
import warnings
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import platformdirs

from lobewise.backend.objects import is_object
from lobewise.backend.trust import describe_folder_problem, read_trusted

MAX_KERNEL_FILES = 4000
"""Largest number of kernels in the folder. Beyond it those not used for longest are removed, down to half."""
MAX_FILE_BYTES = 2**26
"""Largest file that is read, bytes."""
MAX_TEMPORARY_SECONDS = 3600.0
"""Age above which a temporary file counts as left behind by a killed process, seconds."""
_TEMPORARY = ".lobewise-"
"""Prefix of the names of temporary files."""


class CacheWarning(UserWarning):
    """Compiled kernels are not cached, or a cached one is not used. Results are not affected."""


def locate_cache_folder() -> Path | None:
    """Return the folder of compiled kernels; None if the cache is off or the user has no folder."""
    named = os.environ.get("LOBEWISE_CACHE", "")
    if named == "off":
        return None
    if named:
        return Path(os.path.abspath(named))
    return _locate_user_folder()


def _locate_user_folder() -> Path | None:
    """Return the user's cache folder; None if the user has no home.

    An empty ``HOME`` counts as no home: otherwise caches would land in the root of the file system.
    """
    if os.name == "posix" and not os.environ.get("HOME") and not os.environ.get("XDG_CACHE_HOME"):
        import pwd

        try:
            home = pwd.getpwuid(os.getuid()).pw_dir
        except KeyError:
            return None
        folder = "Library/Caches" if sys.platform == "darwin" else ".cache"
        return Path(home, folder, "lobewise")
    try:
        cache_folder = platformdirs.user_cache_path("lobewise", appauthor=False)
    except RuntimeError:
        # The home is not an absolute path.
        return None
    return cache_folder if cache_folder.is_absolute() else None


def locate_trusted_folder() -> Path | None:
    """Return the folder of compiled kernels; if others can write to it, warn and return None."""
    folder = locate_cache_folder()
    if folder is None:
        return None
    problem = describe_folder_problem(folder)
    if problem:
        _warn(
            f"Compiled kernels are not kept in {str(folder)!r}, because {problem}: make it a folder that only you can "
            "write to (chmod go-w), or let LOBEWISE_CACHE name another one."
        )
    return None if problem else folder


def fetch_object(
    known: str | None, make: Callable[[], tuple[bytes, dict[str, Any]]], *, symbol: str = ""
) -> tuple[bytes, dict[str, Any]]:
    """Return an object file and its description, from disk if it is cached, else from ``make``.

    ``known`` describes what the object is made from; None disables the cache. A file that cannot be read, is not whole,
    does not contain ``symbol``, or (with a warning) can be written by others is made again. If writing fails, the
    program continues without the cache.
    """
    folder = locate_trusted_folder()
    if known is None or folder is None:
        return make()
    path = folder / (hashlib.sha256(known.encode()).hexdigest()[:40] + ".kernel")
    with suppress(OSError, ValueError, KeyError, TypeError, RecursionError):
        whole, problem = read_trusted(path, MAX_FILE_BYTES)
        if problem:
            _warn(f"The compiled kernel {str(path)!r} {problem}: it is not used, and compiled anew.")
        else:
            line, content = whole.split(b"\n", 1)
            head = json.loads(line)
            if head["digest"] == _digest(known, head["told"], content) and is_object(content, symbol):
                # A cache in a read-only folder is used as well; only the time of its last use is not kept.
                with suppress(OSError):
                    os.utime(path)
                return content, head["told"]
    content, facts = make()
    head = {"digest": _digest(known, facts, content), "told": facts}
    problem = write_whole(path, json.dumps(head).encode() + b"\n" + content)
    if problem:
        _warn(
            f"Compiled kernels cannot be kept in {str(folder)!r} ({problem}), so every run compiles them again; let "
            "LOBEWISE_CACHE name a folder that can be written to, or set it to off."
        )
    else:
        _remove_old(folder)
    return content, facts


def _digest(known: str, facts: dict[str, Any], content: bytes) -> str:
    """Return a checksum of a file's contents and of its key, so that a file renamed to another key is refused."""
    head = json.dumps([known, facts, hashlib.sha256(content).hexdigest()], sort_keys=True)
    return hashlib.sha256(head.encode()).hexdigest()


def write_whole(path: Path, content: bytes) -> str:
    """Write a file atomically, readable by this user only; return why it failed, or an empty text."""
    temporary = path.parent / f"{_TEMPORARY}{os.getpid()}-{secrets.token_hex(6)}"
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        try:
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_BINARY", 0)
            with os.fdopen(os.open(temporary, flags, 0o600), "wb") as file:
                file.write(content)
            os.replace(temporary, path)
        finally:
            with suppress(OSError):
                temporary.unlink()
    except OSError as problem:
        # Windows replaces no file that somebody reads. Another process then has written the same kernel.
        is_there = os.name == "nt" and isinstance(problem, PermissionError) and path.is_file()
        return "" if is_there else (problem.strerror or str(problem)).lower()
    return ""


def _remove_old(folder: Path) -> None:
    """Remove temporary files of killed processes, and the kernels not used for longest if there are too many."""
    files: list[tuple[float, Path]] = []
    latest = time.time() - MAX_TEMPORARY_SECONDS
    for path in folder.iterdir():
        with suppress(OSError):
            changed = path.lstat().st_mtime
            # Earlier versions named temporary files "tmp...".
            is_temporary = path.name.startswith(_TEMPORARY) or (path.name.startswith("tmp") and not path.suffix)
            if is_temporary and changed < latest:
                path.unlink()
            elif path.suffix == ".kernel":
                files.append((changed, path))
    if len(files) > MAX_KERNEL_FILES:
        for _, path in sorted(files)[: len(files) - MAX_KERNEL_FILES // 2]:
            path.unlink(missing_ok=True)


_told: set[str] = set()


def _warn(text: str) -> None:
    """Warn once in a process."""
    if text not in _told:
        _told.add(text)
        warnings.warn(text, CacheWarning, stacklevel=2)
