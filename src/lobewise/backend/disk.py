"""Compiled kernels on disk: object files by what they were made from, in the user's folder for caches.

The environment variable ``LOBEWISE_CACHE`` names another folder, or is ``off``.
"""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import platformdirs

OLD_FILES = 4000
"""Files in the folder above which those that were not used for longest go."""


def find_cache_folder() -> Path | None:
    """Return where compiled kernels are kept; None where nowhere."""
    named = os.environ.get("LOBEWISE_CACHE", "")
    if named == "off":
        return None
    return Path(named) if named else platformdirs.user_cache_path("lobewise", appauthor=False)


def fetch_object(known: str | None, make: Callable[[], tuple[bytes, dict[str, Any]]]) -> tuple[bytes, dict[str, Any]]:
    """Return an object file and what goes with it, from disk where it is there; ``known`` tells what it is made from.

    A file that cannot be read, or is not whole, is made again; one that cannot be written is done without.
    """
    folder = find_cache_folder()
    if known is None or folder is None:
        return make()
    path = folder / (hashlib.sha256(known.encode()).hexdigest()[:40] + ".kernel")
    with suppress(OSError, ValueError, KeyError, TypeError):
        line, content = path.read_bytes().split(b"\n", 1)
        head = json.loads(line)
        if head["sha256"] == hashlib.sha256(content).hexdigest():
            os.utime(path)
            return content, head
    content, head = make()
    head = {**head, "sha256": hashlib.sha256(content).hexdigest()}
    if write_whole(path, json.dumps(head).encode() + b"\n" + content):
        _remove_old(folder)
    return content, head


def write_whole(path: Path, content: bytes) -> bool:
    """Write a file at once or not at all, and return whether that could be done."""
    with suppress(OSError):
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, name = tempfile.mkstemp(dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            file.write(content)
        os.replace(name, path)
        return True
    return False


def _remove_old(folder: Path) -> None:
    """Remove the files that were not used for longest, where there are too many."""
    files = list(folder.glob("*.kernel"))
    if len(files) > OLD_FILES:
        for path in sorted(files, key=lambda path: path.stat().st_mtime)[: len(files) - OLD_FILES // 2]:
            path.unlink(missing_ok=True)
