"""Whom a file of machine code is trusted from: this user or root, and nobody else, as ssh asks of its keys.

A checksum in the file would not help: whoever can write the file can write the checksum too. So the check asks who
owns a file or folder and who else may write to it. Windows has no such modes: there everything passes.
"""

from __future__ import annotations

import os
import stat
from pathlib import Path

WRITABLE_BY_GROUP, WRITABLE_BY_OTHERS = stat.S_IWGRP, stat.S_IWOTH


def find_folder_problem(folder: Path) -> str:
    """Return why files in a folder cannot be trusted, empty if they can be; the folder may not exist yet.

    The folder and every folder above it must belong to this user or to root, and nobody else may write to them. A
    folder above may be writable by all if it is sticky, as ``/tmp`` is: there only owners can rename.
    """
    if os.name != "posix":
        return ""
    real = Path(os.path.realpath(folder))
    for each in (real, *real.parents):
        try:
            found = each.lstat()
        except FileNotFoundError:
            continue
        except OSError as problem:
            return f"{str(each)!r} cannot be examined ({problem.strerror})"
        if not stat.S_ISDIR(found.st_mode):
            return f"{str(each)!r} is not a folder"
        told = find_problem(found)
        is_sticky = each != real and bool(found.st_mode & stat.S_ISVTX) and _is_own(found)
        if told and not is_sticky:
            return f"{str(each)!r} {told}"
    return ""


def find_problem(found: os.stat_result) -> str:
    """Return why a file or folder of this status cannot be trusted, empty if it can be."""
    if os.name != "posix":
        return ""
    if not _is_own(found):
        return f"belongs to another user (number {found.st_uid})"
    if found.st_mode & WRITABLE_BY_OTHERS:
        return "can be written by every user"
    if found.st_mode & WRITABLE_BY_GROUP and not _is_private_group(found.st_gid):
        return "can be written by a group of users"
    return ""


def read_trusted(path: Path, limit: int) -> tuple[bytes, str]:
    """Return the content of a file and an empty text, or nothing and why the file cannot be trusted.

    What is examined is the open file, so that no other can be put in its place in between. Links are not followed.

    Raises
    ------
    OSError
        If there is no such file, it is a link or no regular file, it holds more than ``limit`` bytes, or it cannot be
        read.
    """
    flags = os.O_RDONLY | getattr(os, "O_NOFOLLOW", 0) | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
    descriptor = os.open(path, flags)
    with os.fdopen(descriptor, "rb") as file:
        found = os.fstat(file.fileno())
        if not stat.S_ISREG(found.st_mode) or found.st_size > limit:
            raise OSError(f"{path} is no file of at most {limit} bytes")
        problem = find_problem(found)
        return (b"", problem) if problem else (file.read(limit + 1), "")


def _is_own(found: os.stat_result) -> bool:
    return found.st_uid in (0, os.geteuid())


def _is_private_group(group: int) -> bool:
    """Return whether a group is this user's own and has no other member, as many systems make one for each user."""
    import grp
    import pwd

    try:
        user, found = pwd.getpwuid(os.geteuid()), grp.getgrgid(group)
    except KeyError:
        return False
    return user.pw_gid == group and user.pw_name == found.gr_name and set(found.gr_mem) <= {user.pw_name}
