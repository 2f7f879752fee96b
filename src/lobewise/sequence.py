"""Filter a sequence of numbered files, one frame after another; a run that was stopped goes on where it was."""

from __future__ import annotations

import hashlib
import json
import math
import time
import zipfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

import lobewise
from lobewise.errors import InputError, LobewiseError
from lobewise.io.exr.layout import name_file
from lobewise.io.files import PathLike, open_atomic, require_other_files, require_writable
from lobewise.io.sequence import FramePattern

State = dict[str, NDArray[Any]]
"""What a filter remembers."""

FrameT = TypeVar("FrameT")
ResultT = TypeVar("ResultT")
_FrameIn = TypeVar("_FrameIn", contravariant=True)
_ResultOut = TypeVar("_ResultOut", covariant=True)

CHECKPOINT_ENDING = ".lobewise-history.npz"
"""What the name of a checkpoint ends with."""

_STATE = "state/"
_MAX_HEAD = 4096
"""Bytes of the two arrays that tell whose checkpoint it is; the others are read only if it is this run's."""


class SequenceFilter(Protocol[_FrameIn, _ResultOut]):
    """A filter that remembers: `lobewise.temporal.TemporalFilter`, or anything that works as it does."""

    def add(self, frame: _FrameIn, *, cut: bool = False) -> _ResultOut:
        """Return the result of the next frame; ``cut`` says that it does not continue the one before."""

    def get_state(self) -> State:
        """Return all that it remembers, as arrays that later frames do not change."""

    def set_state(self, state: State) -> None:
        """Remember what `get_state` gave, so that every further result has the same bits."""


@dataclass(frozen=True)
class SequenceReport(Generic[ResultT]):
    """What `filter_sequence` did.

    Parameters
    ----------
    frames : int
        Frames of the sequence; all of them have their file now.
    written : int
        How many of them this run wrote.
    resumed_after : int or None
        The number of the last frame that an earlier run had finished and this one took over; None if it began anew.
    note : str
        Why an existing checkpoint was not used, in one sentence; else empty.
    last : object or None
        The result of the last frame, if this run made it.
    """

    frames: int
    written: int
    resumed_after: int | None
    note: str
    last: ResultT | None


def filter_sequence(
    source: FramePattern | PathLike,
    output: FramePattern | PathLike,
    make_filter: Callable[[], SequenceFilter[FrameT, ResultT]],
    *,
    read: Callable[[Path], FrameT],
    write: Callable[[Path, ResultT, FrameT, Path], None],
    fingerprint: str,
    progress: Callable[[str, int, int], None] | None = None,
    remark: Callable[[str], None] | None = None,
    checkpoint: PathLike | None = None,
    checkpoint_seconds: float = 20.0,
) -> SequenceReport[ResultT]:
    """Filter every file of ``source``, in the order of the numbers, into the file of ``output`` with that number.

    One frame is in memory at a time, beside what the filter remembers. Where a number is missing the next frame is
    given to the filter as a cut, as is the first.

    From time to time, and when it is interrupted, what the filter remembers is kept in a checkpoint beside the outputs.
    A run with the same sources, outputs, fingerprint and version of the library goes on after its last frame, and
    writes the same files as a run that was not stopped. A checkpoint that is damaged, or of another run, is left
    unused. At the end it is removed.

    Parameters
    ----------
    source, output : FramePattern or path
        Such as ``noisy.####.exr`` and ``clean.####.exr``.
    make_filter : callable
        Returns a new filter; see `SequenceFilter`.
    read : callable
        Returns the frame of a file.
    write : callable
        Of the output's path, the result, the frame and the source's path: writes the result, whole or not at all.
    fingerprint : str
        Everything that the results depend on beside the files: the settings, as text.
    progress : callable, optional
        Told at the start and after every frame: ("frames", how many are done, of how many).
    remark : callable, optional
        Told in one sentence, before the first frame, that a checkpoint is used, or why not.
    checkpoint : path, optional
        The file of the checkpoint, ending in ``.npz``; see `name_checkpoint` for where it is by default.
    checkpoint_seconds : float
        The least time from checkpoint to checkpoint, >= 0; with 0 each frame has one.

    Raises
    ------
    FileError
        If there is no source, one cannot be read, or an output cannot be written.
    InputError
        If a pattern is none, an output would replace its source, the checkpoint has another ending or the time is
        negative.
    """
    source, output = _parse(source), _parse(output)
    kept = name_checkpoint(output) if checkpoint is None else Path(checkpoint)
    frames = source.find()
    _check(frames, output, kept, checkpoint_seconds)
    # Not the folders: the sources prove themselves by size and time, and a project that was moved is the same one.
    names = [Path(str(pattern)).name for pattern in (source, output)]
    run = _Run(frames, output, json.dumps([fingerprint, *names, lobewise.__version__]))
    active, start, note = run.resume(kept, make_filter)
    resumed_after = frames[start - 1][0] if start else None
    if remark is not None and (start or note):
        remark(note or f"Going on after frame {resumed_after}, as the checkpoint {str(kept)!r} says.")
    tell = progress or (lambda what, done, total: None)
    tell("frames", start, len(frames))
    last: ResultT | None = None
    saved = time.monotonic()
    for index in range(start, len(frames)):
        number, path = frames[index]
        before = active.get_state() if index else {}
        try:
            frame = read(path)
            with name_file(path):
                last = active.add(frame, cut=index == 0 or number != frames[index - 1][0] + 1)
            write(output.name(number), last, frame, path)
        except KeyboardInterrupt:
            if index:
                with suppress(LobewiseError):
                    run.save(kept, before)
            raise
        # Before the next one is read: frames can be large.
        del frame
        run.mark_done()
        if index + 1 < len(frames) and time.monotonic() - saved >= checkpoint_seconds:
            run.save(kept, active.get_state())
            saved = time.monotonic()
        tell("frames", index + 1, len(frames))
    with suppress(OSError):
        kept.unlink()
    return SequenceReport(len(frames), len(frames) - start, resumed_after, note, last)


def _check(frames: list[tuple[int, Path]], output: FramePattern, kept: Path, seconds: float) -> None:
    """Raise what `filter_sequence` raises before it begins."""
    if not seconds >= 0.0:
        raise InputError("checkpoint_seconds", expected="a time >= 0", got=str(seconds), action="20 is usual")
    if kept.suffix != ".npz":
        raise InputError(
            "checkpoint", expected="a name that ends in .npz", got=repr(str(kept)), action="add the ending"
        )
    require_writable(output.name(frames[0][0]))
    require_writable(kept, what="checkpoint")
    require_other_files((output.name(number) for number, _ in frames), (path for _, path in frames))


def name_checkpoint(output: FramePattern | PathLike) -> Path:
    """Return the checkpoint of an output: ``clean.lobewise-history.npz`` beside ``clean.####.exr``."""
    pattern = _parse(output)
    stem = pattern.before + pattern.after.removesuffix(Path(f"a{pattern.after}").suffix)
    return pattern.folder / f"{stem.strip('._- ') or 'sequence'}{CHECKPOINT_ENDING}"


def _parse(pattern: FramePattern | PathLike) -> FramePattern:
    return pattern if isinstance(pattern, FramePattern) else FramePattern.parse(pattern)


class _Run:
    """The frames of a run, how many of them are done, and the proof that a checkpoint belongs to them."""

    def __init__(self, frames: list[tuple[int, Path]], output: FramePattern, identity: str) -> None:
        self._frames = frames
        self._output = output
        self._done = 0
        self._proof = hashlib.sha256(identity.encode("utf-8", "surrogateescape"))

    def mark_done(self) -> None:
        """Count the next frame, and take its file into the proof: one that changes makes a checkpoint worthless."""
        number, path = self._frames[self._done]
        self._done += 1
        # One that has gone meanwhile will not be there to go on from either.
        with suppress(OSError):
            state = path.stat()
            self._proof.update(f"{number} {state.st_size} {state.st_mtime_ns}\n".encode())

    def save(self, path: Path, state: State) -> None:
        """Write a checkpoint of all frames that are done, whole or not at all."""
        arrays: dict[str, Any] = {_STATE + name: np.asarray(value) for name, value in state.items()}
        if any(array.dtype.hasobject for array in arrays.values()):
            raise InputError(
                "state of the filter", expected="plain arrays", got="Python objects", action="give numbers or text"
            )
        with open_atomic(path, what="checkpoint") as stream:
            np.savez(stream, done=np.int64(self._done), proof=np.array(self._proof.hexdigest()), **arrays)

    def resume(
        self, path: Path, make_filter: Callable[[], SequenceFilter[FrameT, ResultT]]
    ) -> tuple[SequenceFilter[FrameT, ResultT], int, str]:
        """Return a filter, how many frames it has seen, and why an existing checkpoint was not used."""
        if not path.exists():
            return make_filter(), 0, ""
        fresh = self._proof.copy()
        reason = "it is damaged"
        # NumPy fails in many ways on a damaged file, and a filter on what another one remembered.
        with suppress(Exception), zipfile.ZipFile(path) as file:
            kept = _Checkpoint(file, path.stat().st_size)
            done, proof = int(kept.load("done", most=_MAX_HEAD)), str(kept.load("proof", most=_MAX_HEAD))
            while self._done < min(done, len(self._frames)):
                self.mark_done()
            if not 0 < self._done == done or proof != self._proof.hexdigest():
                reason = "it is of other settings or files"
            elif not all(self._output.name(number).is_file() for number, _ in self._frames[:done]):
                reason = "not all of its outputs are there"
            else:
                active = make_filter()
                active.set_state(kept.load_state())
                return active, done, ""
        self._proof, self._done = fresh, 0
        return make_filter(), 0, f"The checkpoint {str(path)!r} is not used: {reason}."


class _Checkpoint:
    """A checkpoint of whatever origin: nothing in it is taken for larger than the file itself.

    Arrays are stored as they are, one after another, as `_Run.save` writes them. Raises ValueError where they are
    packed (megabytes may then hold terabytes), there twice, or of another size than they say.
    """

    def __init__(self, file: zipfile.ZipFile, size: int) -> None:
        self._file = file
        self._members = {item.filename.removesuffix(".npy"): item for item in file.infolist()}
        stored = all(
            item.compress_type == zipfile.ZIP_STORED and item.compress_size == item.file_size
            for item in file.infolist()
        )
        total = sum(item.file_size for item in file.infolist())
        if not stored or total > size or len(self._members) < len(file.infolist()):
            raise ValueError("arrays that are not stored as they are")

    def load(self, name: str, *, most: int | None = None) -> NDArray[Any]:
        """Return an array, of at most ``most`` bytes."""
        item = self._members[name]
        if most is not None and item.file_size > most:
            raise ValueError(f"{name} of {item.file_size} bytes")
        with self._file.open(item) as stream:
            version = np.lib.format.read_magic(stream)
            if version != (1, 0):
                raise ValueError(f"version {version}")
            shape, _, kind = np.lib.format.read_array_header_1_0(stream)
            # Before it is made: the size that an array says goes into memory at once.
            if kind.kind not in "biufU" or math.prod(shape) * kind.itemsize != item.file_size - stream.tell():
                raise ValueError(f"{name} of another size than it says")
        with self._file.open(item) as stream:
            array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
            return array

    def load_state(self) -> State:
        """Return what the filter remembered."""
        return {name.removeprefix(_STATE): self.load(name) for name in self._members if name.startswith(_STATE)}
