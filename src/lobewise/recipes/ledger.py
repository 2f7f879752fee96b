"""Records on disk of the frames that are done: what a stopped run has finished, and what a farm still has to do.

A record stands in a folder beside the outputs. It says from which sources, with which settings and by which version a
frame was made, and size and time of its files afterwards. A frame is done if all of this is still as the record says.
Beside the records stands what filters over time remember. A run in one process and the workers of a farm write the
same records, so that each goes on where the other was stopped. The folder must be shared as the outputs are.
"""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Callable, Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from lobewise.errors import FileError, LobewiseError
from lobewise.io.documents import parse_json, read_document
from lobewise.io.files import make_folder, open_record, refusing
from lobewise.io.locks import lock_file
from lobewise.io.sequence import FramePattern

Numbered = tuple[int, Path]
"""Number and source of a frame."""
LEDGER_ENDING = ".lobewise-done"
"""Ending of the folder's name."""
TOKEN, LOCK = "token", "lock"
MAX_RECORD_BYTES = 1 << 16
MAX_CLOCK_DIFFERENCE_NS = 1_000_000
"""Largest difference of two times of one file, nanoseconds: file servers round times differently."""


@dataclass(frozen=True, kw_only=True)
class Ledger:
    """The records of a run.

    Parameters
    ----------
    folder : Path
        Where they are.
    identity : str
        Settings, names and versions of the run, as text.
    """

    folder: Path
    identity: str

    def put_token(self, token: str) -> None:
        """Put a token into the folder, by which workers prove that they see this folder.

        Raises FileError if the folder cannot be written to.
        """
        with open_record(self.folder / TOKEN, what="record") as stream:
            stream.write(token.encode())

    def has_token(self, token: str) -> bool:
        """Return whether the folder holds this token, and not that of a later run."""
        try:
            return (self.folder / TOKEN).read_text() == token
        except OSError:
            return False

    @contextmanager
    def hold(self) -> Iterator[None]:
        """Lock the records during the ``with`` block; afterwards remove their folder if nothing is recorded."""
        with self.lock():
            try:
                yield
            finally:
                if not self.list_recorded():
                    self.remove()

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Make the folder, and keep other clients from it during the ``with`` block, where the disk has locks.

        Raises FileError if another client has it, or it cannot be written to. A link is not followed: records never
        replace a file elsewhere.
        """
        name = f"records {str(self.folder)!r}"
        if self.folder.is_symlink():
            raise FileError(name, expected="a folder", got="a link to another place", action="remove the link")
        make_folder(self.folder, what="records of frames")
        with refusing(name, "a folder that can be written to", "check its permissions, and remove its links"):
            descriptor = lock_file(self.folder / LOCK)
        if descriptor is None:
            raise FileError(
                name,
                expected="no other run that writes this sequence",
                got="one that is at work",
                action="wait for it, or stop it",
            )
        try:
            yield
        finally:
            os.close(descriptor)
            # Windows removes no file that is open, so the folder may still be there.
            if os.name == "nt" and not self.list_recorded():
                self.remove()

    def prove(self, frames: Sequence[Numbered], list_sources: Callable[[int, Path], Iterable[Path]]) -> dict[int, str]:
        """Return a hash for each frame of a task: of the run, and of all sources up to the frame.

        Frames of one task may use the frames before them, so the hash covers their sources as well. A source counts by
        its size and time.
        """
        proof = hashlib.sha256(self.identity.encode("utf-8", "surrogateescape"))
        proofs = {}
        for number, path in frames:
            for source in list_sources(number, path):
                # A source that does not exist gives another hash than one that does.
                state = _measure(source) or (0, 0)
                proof.update(f"{number} {state[0]} {state[1]}\n".encode())
            proofs[number] = proof.hexdigest()
        return proofs

    def record(self, number: int, proof: str, outputs: Iterable[Path]) -> None:
        """Record that a frame is done. Raises FileError if the record cannot be written."""
        files = [_measure(path) for path in outputs]
        with open_record(self._name(number), what="record") as stream:
            stream.write(json.dumps({"proof": proof, "files": files}).encode())

    def list_recorded(self) -> set[int]:
        """Return the frames that have a record, of whichever sources and settings."""
        return {int(path.stem) for path in self.folder.glob("*.json") if path.stem.removeprefix("-").isdecimal()}

    def is_done(self, number: int, proof: str, outputs: Iterable[Path]) -> bool:
        """Return whether a frame is recorded with this proof and its files are as they were."""
        path = self._name(number)
        with suppress(LobewiseError):
            record = parse_json(read_document(path, MAX_RECORD_BYTES, what="record", holds="a record"), what="record")
            files = [_measure(each) for each in outputs]
            return (
                isinstance(record, dict)
                and record.get("proof") == proof
                and isinstance(record.get("files"), list)
                and len(record["files"]) == len(files)
                and all(map(_is_same, record["files"], files))
            )
        return False

    def describe_done(self, done: int, frames: int) -> str:
        """Return a sentence on frames that are done already, or are recorded and made again; empty where none is."""
        if done:
            return f"Going on: {done} of {frames} frames are done, as {str(self.folder)!r} says."
        if self.list_recorded():
            return f"Other settings or files than those of {str(self.folder)!r}: every frame is made again."
        return ""

    def name_state(self, number: int) -> Path:
        """Return the file of what a filter remembers in the shot that begins with a frame."""
        return self.folder / f"shot-{number}.npz"

    def remove(self) -> None:
        """Remove the records: every frame is done."""
        _remove_known(self.folder)

    def _name(self, number: int) -> Path:
        return self.folder / f"{number}.json"


def refresh_folders(*folders: Path) -> None:
    """Open folders, so that a network drive asks its server what they hold now."""
    for folder in folders:
        with suppress(OSError), os.scandir(folder) as entries:
            next(entries, None)


def open_ledger(
    source: FramePattern, output: FramePattern, numbers: Collection[int] | None, settings: object
) -> Ledger:
    """Return the records of a run; ``settings`` is all but the sources that results depend on, as plain data."""
    # Leave the folders out: a project may be moved.
    names = [Path(str(pattern)).name for pattern in (source, output)]
    return Ledger(folder=name_ledger(output, numbers), identity=json.dumps([settings, *names]))


def measure_all(paths: Iterable[Path]) -> list[tuple[int, int] | None]:
    """Return size and time of files, None for those that do not exist."""
    return [_measure(path) for path in paths]


def name_ledger(output: FramePattern | Path, numbers: Collection[int] | None = None) -> Path:
    """Return the folder of records of an output: ``clean.lobewise-done`` beside ``clean.####.exr``.

    It is named as the files of the output, without number and ending. For some frames alone the name also has the first
    and the last of ``numbers``, as in ``clean.1001-1050``: runs without a common frame never share it.
    """
    pattern = output if isinstance(output, FramePattern) else FramePattern.parse(output)
    stem = pattern.before + pattern.after.removesuffix(Path(f"a{pattern.after}").suffix)
    part = f".{min(numbers)}-{max(numbers)}" if numbers else ""
    return pattern.folder / f"{stem.strip('._- ') or 'sequence'}{part}{LEDGER_ENDING}"


def _remove_known(folder: Path) -> None:
    """Remove a folder of records, unless somebody put other files there."""
    with suppress(OSError):
        for path in folder.iterdir():
            if path.name in (TOKEN, LOCK) or path.suffix in (".json", ".npz", ".part"):
                path.unlink()
        folder.rmdir()


def _measure(path: Path) -> tuple[int, int] | None:
    """Return size and time of a file, None where it does not exist."""
    try:
        state = path.stat()
    except OSError:
        return None
    return state.st_size, state.st_mtime_ns


def _is_same(recorded: Any, measured: tuple[int, int] | None) -> bool:
    """Return whether a file has the size and time of its record, which may be damaged."""
    if measured is None or not isinstance(recorded, list) or not all(type(each) is int for each in recorded):
        return False
    return (
        len(recorded) == 2 and recorded[0] == measured[0] and abs(recorded[1] - measured[1]) <= MAX_CLOCK_DIFFERENCE_NS
    )
