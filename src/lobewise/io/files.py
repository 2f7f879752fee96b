"""Check the paths that users give, and write outputs whole or not at all."""

from __future__ import annotations

import os
import re
import stat
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

from lobewise.errors import FileError, InputError
from lobewise.io.replacing import Replacement, begin_temporary, name_temporary

PathLike = str | os.PathLike[str]


def as_path(path: Any, what: str) -> Path:
    """Return a text, bytes or path as a Path; raise InputError for anything else."""
    try:
        return Path(os.fsdecode(path))
    except TypeError:
        raise InputError(
            what, expected="a path", got=f"a {type(path).__name__}", action="pass a text or a pathlib.Path"
        ) from None


def anchor_name(text: str) -> str:
    """Return the absolute path of an existing file, and any other name as it is."""
    return str(Path(text).absolute()) if Path(text).is_file() else text


@contextmanager
def refusing(name: str, expected: str, action: str) -> Iterator[None]:
    """Turn an OSError in the ``with`` block into a FileError about the file called ``name``."""
    try:
        yield
    except OSError as problem:
        raise FileError(name, expected=expected, got=say_reason(problem), action=action) from problem


def require_readable(path: PathLike, *, what: str = "input", holds: str = "") -> Path:
    """Return ``path`` if it names a regular file that is not empty and can be opened.

    ``holds`` says in errors what the file should hold: by default an image for an input, else a ``what``.

    Raises FileError if the file does not exist, is a directory or a device, is empty, or may not be read.
    """
    file = as_path(path, what)
    try:
        mode = file.stat()
        if stat.S_ISDIR(mode.st_mode):
            expected, got, action = "a file", "a directory", "name a file in it"
        elif not stat.S_ISREG(mode.st_mode):
            expected, got, action = "a regular file", "a device or pipe", "copy it to a file"
        elif mode.st_size == 0:
            holds = holds or ("an image" if what == "input" else f"a {what}")
            expected, got, action = holds, "an empty file of 0 bytes", "write it again"
        else:
            with file.open("rb"):
                return file
    except FileNotFoundError:
        near = _choose_sibling(file)
        expected, got = "an existing file", "no such file"
        action = f"did you mean {near!r}?" if near else _advise(str(file))
    except (OSError, ValueError) as problem:
        expected, got, action = "a readable file", say_reason(problem), "check the path"
    raise FileError(f"{what} {str(file)!r}", expected=expected, got=got, action=action)


def read_bytes(path: PathLike, limit: int, *, holds: str) -> bytes:
    """Return at most ``limit`` bytes of a file that should hold ``holds``.

    Raises FileError as `require_readable`, or if the disk refuses.
    """
    file = require_readable(path, holds=holds)
    with refusing(f"input {str(file)!r}", "a readable file", "check the disk"), file.open("rb") as stream:
        return stream.read(limit)


def require_file_name(path: PathLike, *, what: str = "output") -> Path:
    """Return the path of an output. Raises FileError if it ends with a slash, which a Path would leave out."""
    named = as_path(path, what)
    if os.fsdecode(path).endswith((os.sep, os.altsep or os.sep)):
        raise FileError(
            f"{what} {os.fsdecode(path)!r}",
            expected="a file name",
            got="a name that ends with a slash, as those of folders do",
            action="leave the slash out, or name a file in the folder",
        )
    return named


def require_writable(path: PathLike, *, what: str = "output") -> Path:
    """Return the real path that an output may be written to; nothing is created or changed.

    A symbolic link is followed, so that writing replaces what it points at and not the link.

    Raises FileError if the path is a directory or a device, ends with a slash, is a loop of links or an open file
    without a name, or if its folder does not exist or may not be written to.
    """
    named = require_file_name(path, what=what)
    try:
        target = Path(os.path.realpath(named))
        folder = target.parent
        expected = "a path that can be written"
        if target.is_dir():
            expected, got, action = "a file name", "a directory", "name a file in it"
        elif named.exists() and not named.is_file():
            expected, got, action = "a regular file", "a device or pipe", "name a file that can be replaced"
        elif target.is_symlink():
            got, action = "a loop of links, which names no file", "remove the link, or choose another name"
        elif target.name.endswith(" (deleted)") and named.exists() and named.stat().st_nlink == 0:
            # The links of /proc/self/fd lead to open files. Linux adds this word to the path of a deleted file.
            got, action = "an open file that was deleted, which has no name", "name a file"
        elif target.exists() and _is_read_only(target):
            mode = stat.S_IMODE(target.stat().st_mode)
            expected, got = "a file that can be replaced", f"a read-only file (mode {mode:04o})"
            action = "make it writable, or choose another name"
        elif not folder.exists():
            got, action = f"no folder {str(folder)!r}", "create it first"
        elif not folder.is_dir():
            got, action = f"{str(folder)!r}, which is not a folder", "choose another folder"
        elif not os.access(folder, os.W_OK | os.X_OK):
            got, action = f"the folder {str(folder)!r}, which is read-only", "choose another folder"
        else:
            return target
    except (OSError, ValueError) as problem:
        expected, got, action = "a path that can be written", say_reason(problem), "choose another path"
    raise FileError(f"{what} {str(path)!r}", expected=expected, got=got, action=action)


def require_other_files(
    outputs: Iterable[PathLike],
    inputs: Iterable[PathLike],
    *,
    what: str = "output",
    action: str = "choose another name",
) -> None:
    """Raise InputError if an output is one of the inputs, also by another name: a hard or symbolic link.

    Inputs that do not exist are ignored.
    """
    known = {place: path for path in inputs if (place := _identify_file(path)) is not None}
    for path in outputs:
        place = _identify_file(path)
        if place in known:
            read = known[place]
            by = "" if str(read) == str(path) else f" {str(read)!r}"
            raise InputError(
                f"{what} {str(path)!r}",
                expected="a file that is not read, as its content would be lost",
                got=f"the input{by}",
                action=action,
            )


def _identify_file(path: PathLike) -> tuple[int, int] | None:
    """Return the device and inode of a file, which identify it under any name; None if it does not exist."""
    try:
        status = os.stat(path)
    except (OSError, ValueError):
        return None
    return status.st_dev, status.st_ino


_WILD = re.compile(r"[*?]")
EXR_NAMES = (".exr", ".sxr", ".mxr", "")


def require_exr_name(path: PathLike) -> None:
    """Raise InputError if an output's name has no ending, or that of another format than EXR."""
    kind = as_path(path, "output").suffix
    # What exists without an ending is a folder, device or pipe, or a file that the user named so before.
    is_new = not kind and not os.path.lexists(path)
    if is_new or (kind.lower() not in EXR_NAMES and not kind[1:].isdecimal()):
        raise InputError(
            "output",
            expected="a name that ends in .exr, as EXR is what is written",
            got=repr(str(path)),
            action=f"name it {str(Path(path).with_suffix('.exr'))!r}",
        )


def make_folder(path: PathLike, *, what: str = "output") -> Path:
    """Return the folder ``path``, created if it does not exist.

    Raises FileError if it cannot be created or written to.
    """
    folder = as_path(path, what)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, ValueError) as problem:
        raise FileError(
            f"{what} {str(path)!r}",
            expected="a folder that can be made",
            got=say_reason(problem),
            action="choose another folder",
        ) from None
    require_writable(folder / "file", what=what)
    return folder


@contextmanager
def open_atomic(path: PathLike, *, what: str = "output") -> Iterator[BinaryIO]:
    """Open a temporary file beside ``path``; on success it replaces ``path`` in one step, on failure it is removed.

    A reader sees the old file or the whole new one, never a part. An existing target keeps its permissions, its owner
    and its extended attributes; a `lobewise.io.replacing.TargetWarning` tells which of these could not be kept. What
    killed processes left for this target is removed. Of several writers the last one to finish wins.

    Raises FileError if the path cannot be written, or the disk refuses, for example because it is full.
    """
    target = require_writable(path, what=what)
    with (
        refusing(f"{what} {str(path)!r}", "a path that can be written", "choose another path or make room"),
        Replacement(target) as replacement,
    ):
        yield replacement.stream
        replacement.finish()


@contextmanager
def open_record(path: PathLike, *, what: str) -> Iterator[BinaryIO]:
    """Open a new file that takes the place of ``path`` in one step on success; on failure it is removed.

    For files that the program keeps for itself: a link that somebody put at ``path`` is replaced, not followed. Nothing
    waits for the disk, as a record that a power cut damaged only costs its frame.

    Raises FileError if the file cannot be written.
    """
    made = name_temporary(Path(path))
    with refusing(f"{what} {str(path)!r}", "a folder that can be written to", "check its permissions and room"):
        try:
            with made.open("xb") as stream:
                yield stream
            os.replace(made, path)
        finally:
            made.unlink(missing_ok=True)


@contextmanager
def open_spool(path: PathLike, *, what: str = "output") -> Iterator[BinaryIO]:
    """Open a temporary file without a name on the disk of ``path``. It disappears when it is closed.

    Raises FileError as `open_atomic`.
    """
    target = require_writable(path, what=what)
    with (
        refusing(f"{what} {str(path)!r}", "a path that can be written", "choose another path or make room"),
        tempfile.TemporaryFile(prefix=begin_temporary(target), suffix=".part", dir=target.parent) as stream,
    ):
        yield stream


def write_text(path: PathLike, text: str, *, what: str = "output") -> None:
    """Write ``text`` as UTF-8, whole or not at all. Bytes that were not UTF-8, as in file names, become escapes.

    Raises FileError if the path cannot be written.
    """
    with open_atomic(path, what=what) as stream:
        stream.write(text.encode("utf-8", "backslashreplace"))


def _choose_sibling(file: Path) -> str | None:
    """Return the file in the folder whose name is most similar; None if no name is similar."""
    import difflib

    try:
        names = [entry.name for entry in file.parent.iterdir()]
    except (OSError, ValueError):
        return None
    near = difflib.get_close_matches(file.name, names, n=1, cutoff=0.8)
    return str(file.parent / near[0]) if near and not _WILD.search(file.name) else None


def _advise(path: str) -> str:
    """Return what to do about a path of no file: a shell may not have replaced what it replaces outside quotes."""
    if path.startswith("~") or "$" in path:
        return "write out the folder, or leave the quotes out, so that the shell does"
    if _WILD.search(path):
        return "name files, a folder, or a sequence with # for the number"
    if "\\" in path and os.sep == "/":
        return "write / between folders, and the path that this machine has"
    return "leave the quotation marks out" if path[:1] in "'\"" else "check the path"


def say_reason(problem: OSError | ValueError) -> str:
    """Return the system's message, beginning with a small letter."""
    reason = getattr(problem, "strerror", None) or str(problem)
    return reason[:1].lower() + reason[1:]


def _is_read_only(target: Path) -> bool:
    """Return whether a file may not be written. Its mode counts for root too, who could write it."""
    return not target.stat().st_mode & 0o222 or not os.access(target, os.W_OK)
