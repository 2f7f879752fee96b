"""Checks that a file of machine code comes from this user or root and that nobody else can change it.

ssh asks the same of its keys. A checksum in the file would not help: whoever can write the file can write the checksum
too. So the checks look at the owner of a file or folder and at its permissions. Windows has no such permissions: there
everything passes.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

WRITABLE_BY_GROUP, WRITABLE_BY_OTHERS = stat.S_IWGRP, stat.S_IWOTH


def describe_folder_problem(folder: Path) -> str:
    """Return why files in a folder cannot be trusted, or an empty text. The folder need not exist yet.

    The folder and all folders above it must belong to this user or root, and nobody else may write to them. A folder
    above may be writable by all if it is sticky like ``/tmp``: there only owners can rename their files.
    """
    if os.name != "posix":
        return ""
    real = Path(os.path.realpath(folder))
    for part in (real, *real.parents):
        try:
            status = part.lstat()
        except FileNotFoundError:
            continue
        except OSError as problem:
            return f"{str(part)!r} cannot be examined ({problem.strerror})"
        if not stat.S_ISDIR(status.st_mode):
            return f"{str(part)!r} is not a folder"
        problem_of_part = describe_problem(status)
        is_sticky = part != real and bool(status.st_mode & stat.S_ISVTX) and _is_own(status)
        if problem_of_part and not is_sticky:
            return f"{str(part)!r} {problem_of_part}"
    return ""


def describe_problem(status: os.stat_result) -> str:
    """Return why a file or folder of this status cannot be trusted, or an empty text."""
    if os.name != "posix":
        return ""
    if not _is_own(status):
        return f"belongs to another user (number {status.st_uid})"
    if status.st_mode & WRITABLE_BY_OTHERS:
        return "can be written by every user"
    if status.st_mode & WRITABLE_BY_GROUP and not _is_private_group(status.st_gid):
        return "can be written by a group of users"
    return ""


def read_trusted(path: Path, limit: int) -> tuple[bytes, str]:
    """Return the content of a file and an empty text, or no content and why the file cannot be trusted.

    The open file is examined, so that nobody can replace it between check and reading. Links are not followed.

    Raises
    ------
    OSError
        If the file does not exist, is a link or not a regular file, has more than ``limit`` bytes, or cannot be read.
    """
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, flags)
    with os.fdopen(descriptor, "rb") as file:
        status = os.fstat(file.fileno())
        if not stat.S_ISREG(status.st_mode) or status.st_size > limit:
            raise OSError(f"{path} is no file of at most {limit} bytes")
        problem = describe_problem(status)
        return (b"", problem) if problem else (file.read(limit + 1), "")


def _is_own(status: os.stat_result) -> bool:
    return status.st_uid in (0, os.geteuid())


def _is_private_group(group: int) -> bool:
    """Return whether a group is the user's private group, named like the user and without other members."""
    import grp
    import pwd

    try:
        user, group_entry = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return user.pw_gid == group and user.pw_name == group_entry.gr_name and set(group_entry.gr_mem) <= {user.pw_name}
