"""Write the folder of an export whole or not at all, and fill in its templates."""

from __future__ import annotations

import os
import re
import shutil
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from importlib.resources import files
from pathlib import Path
from string import Template

from lobewise.errors import FileError
from lobewise.io.files import PathLike, refusing
from lobewise.io.replacing import name_temporary, remove_leftovers

DOCS = "https://github.com/lobewise/lobewise/blob/main/docs/export.md"
MARK = "lobewise-export.json"
"""The file that marks a folder as an earlier export."""


def require_folder(path: PathLike, *, force: bool) -> Path:
    """Return the real path of a folder that may be created or replaced. Nothing is created or changed.

    Raises FileError if the path is a file, its parent folder cannot be written, or it is a folder with content. With
    ``force`` an earlier export counts as empty.
    """
    with refusing(f"output {str(path)!r}", "a new or empty folder", "choose another name"):
        return _check_folder(path, force)


def _check_folder(path: PathLike, force: bool) -> Path:
    target = Path(os.path.realpath(path))
    parent = target.parent
    got = ""
    if target.exists() and not target.is_dir():
        got, action = "a file", "choose another name"
    elif target.is_symlink():
        got, action = "a loop of links, which names no folder", "remove the link, or choose another name"
    elif target == Path.cwd():
        # The new folder is another one of the same name: a shell in the old one would see no files.
        got, action = "the current one", "name a new one in it"
    elif not parent.is_dir():
        got, action = f"no folder {str(parent)!r}", "create it first"
    elif not os.access(parent, os.W_OK | os.X_OK):
        got, action = f"the folder {str(parent)!r}, which is read-only", "choose another folder"
    elif target.is_dir() and not os.access(target, os.R_OK | os.W_OK | os.X_OK):
        got, action = "one that may not be changed", "choose another folder"
    elif target.is_dir() and any(target.iterdir()):
        if force and (target / MARK).is_file():
            return target
        got = "one that holds other things than an export" if force else "one that is not empty"
        action = "choose another folder" if force else "choose another, or replace an earlier export with --force"
    if got:
        raise FileError(f"output {str(path)!r}", expected="a new or empty folder", got=got, action=action)
    return target


@contextmanager
def open_folder(path: PathLike, *, force: bool = False) -> Iterator[Callable[[str], Path]]:
    """Yield a function that returns the path of a file in a temporary folder.

    On success the temporary folder replaces ``path``; on failure it is removed.

    Raises
    ------
    FileError
        As `require_folder`, or if writing fails.
    """
    target = require_folder(path, force=force)
    made: list[Path] = []
    try:
        with refusing(f"output {str(path)!r}", "a folder that can be written", "choose another or make room"):
            remove_leftovers(target)
            temporary = name_temporary(target)
            temporary.mkdir()
            made.append(temporary)
            yield lambda name: temporary / name
            if target.is_dir() and any(target.iterdir()):
                aside = temporary.with_suffix(".old")
                os.replace(target, aside)
                try:
                    os.replace(temporary, target)
                except BaseException:
                    os.replace(aside, target)
                    raise
                made[:] = [aside]
            else:
                if target.is_dir():
                    target.rmdir()
                os.replace(temporary, target)
                made.clear()
    finally:
        for folder in made:
            with suppress(OSError):
                shutil.rmtree(folder)


def write_folder(path: PathLike, texts: Mapping[str, str], *, force: bool = False) -> None:
    """Write a folder of texts by their names; see `open_folder`."""
    with open_folder(path, force=force) as place:
        for name, text in texts.items():
            place(name).write_text(text, encoding="utf-8")


def read_template(file: str) -> str:
    """Return a file of the folder ``templates``."""
    path = files("lobewise") / "exporting" / "templates" / file
    return path.read_text(encoding="utf-8")


def read_sections(file: str) -> dict[str, str]:
    """Return the parts of a file of the folder ``templates`` that begin with ``/* part: NAME */``, by name."""
    parts = re.split(r"^/\* part: (\w+) \*/\n", read_template(file), flags=re.M)
    return dict(zip(parts[1::2], parts[2::2], strict=True))


def fill_template(file: str, /, **parts: object) -> str:
    """Return a file of the folder ``templates`` with every ``${name}`` replaced."""
    return Template(read_template(file)).substitute(parts)
