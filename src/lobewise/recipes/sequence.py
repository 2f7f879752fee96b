"""Filter a sequence of numbered files frame by frame; a run that was stopped goes on after its last frame."""

from __future__ import annotations

import hashlib
import json
import math
import time
import zipfile
from collections.abc import Callable, Collection
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Generic, Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

import lobewise
from lobewise.errors import CancelledError, InputError, LobewiseError
from lobewise.io.exr.layout import name_file
from lobewise.io.files import PathLike, open_record, require_other_files, require_writable
from lobewise.io.sequence import FramePattern
from lobewise.work.progress import WRITE, Watcher, enter_stage, follow_frame, watched

State = dict[str, NDArray[Any]]
"""The memory of a filter: arrays by name."""

FrameT = TypeVar("FrameT")
ResultT = TypeVar("ResultT")
_FrameIn = TypeVar("_FrameIn", contravariant=True)
_ResultOut = TypeVar("_ResultOut", covariant=True)

CHECKPOINT_ENDING = ".lobewise-history.npz"
"""Ending of a checkpoint's name."""

_STATE_PREFIX = "state/"
"""Beginning of the names, in a checkpoint, of the arrays that a filter remembers."""
_MAX_HEAD_BYTES = 4096
"""Size limit of each of the two arrays that identify the run; all others are read only if the run is this one."""


class SequenceFilter(Protocol[_FrameIn, _ResultOut]):
    """A filter that can remember earlier frames, such as `lobewise.recipes.temporal.TemporalFilter`."""

    def add(self, frame: _FrameIn, *, cut: bool = False) -> _ResultOut:
        """Return the result of the next frame; ``cut`` says that it does not continue the frame before."""

    def get_state(self) -> State:
        """Return everything that the filter remembers, as arrays that later frames do not change."""

    def set_state(self, state: State) -> None:
        """Restore the memory that `get_state` returned, so that every further result has the same bits."""


class FilterAlone(Generic[FrameT, ResultT]):
    """A sequence filter that filters every frame by itself."""

    def __init__(self, filter_one: Callable[[FrameT], ResultT]) -> None:
        self._filter_one = filter_one

    def add(self, frame: FrameT, *, cut: bool = False) -> ResultT:
        """Return the result of a frame."""
        return self._filter_one(frame)

    def get_state(self) -> State:
        """Return nothing: the filter remembers nothing."""
        return {}

    def set_state(self, state: State) -> None:
        """Do nothing."""


@dataclass(frozen=True)
class SequenceReport(Generic[ResultT]):
    """What `filter_sequence` did.

    Parameters
    ----------
    frames : int
        Frames of the sequence; now all of them have an output file.
    written : int
        Frames that this run wrote.
    resumed_after : int or None
        Number of the last frame that an earlier run had finished; None if this run began with the first frame.
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


@watched
def filter_sequence(
    source: FramePattern | PathLike,
    output: FramePattern | PathLike,
    make_filter: Callable[[], SequenceFilter[FrameT, ResultT]],
    *,
    read: Callable[[Path], FrameT],
    write: Callable[[Path, ResultT, FrameT, Path], None],
    fingerprint: str,
    progress: Watcher | None = None,
    remark: Callable[[str], None] | None = None,
    checkpoint: PathLike | None = None,
    checkpoint_seconds: float = 20.0,
    numbers: Collection[int] | None = None,
) -> SequenceReport[ResultT]:
    """Filter every file of ``source``, in the order of the numbers, into the file of ``output`` with its number.

    One frame is in memory at a time, beside the memory of the filter. The first frame, and every frame after a missing
    number, is a cut.

    From time to time, and on an interrupt, the memory of the filter is saved in a checkpoint beside the outputs. The
    next run with the same sources, outputs, fingerprint and version of the library goes on after the checkpoint's last
    frame, and writes the same files as a run that was not stopped. A checkpoint that is damaged, or belongs to another
    run, is not used. The checkpoint is removed at the end.

    Parameters
    ----------
    source, output : FramePattern or path
        Such as ``noisy.####.exr`` and ``clean.####.exr``.
    make_filter : callable
        Returns a new filter; see `SequenceFilter`.
    read : callable
        Returns the frame of a file.
    write : callable
        Called with output path, result, frame and source path. Writes the result whole or not at all.
    fingerprint : str
        The settings, as text: everything but the files that the results depend on.
    progress : callable, optional
        Called with the `lobewise.Progress` of the sequence; False cancels it, and the next run goes on.
    remark : callable, optional
        Called before the first frame with a sentence that a checkpoint is used, or why it is not.
    checkpoint : path, optional
        The file of the checkpoint, ending in ``.npz``; by default see `name_beside`.
    checkpoint_seconds : float
        Shortest time between checkpoints, seconds >= 0; with 0 every frame is followed by one.
    numbers : collection of int, optional
        Filter only the frames with these numbers; by default all.

    Raises
    ------
    FileError
        If there is no source, a number has none, one cannot be read, or an output cannot be written.
    InputError
        If a path is no pattern, an output would replace a source, the checkpoint has another ending, the time is
        negative, or the filter refuses a frame: the message names its file.
    CancelledError
        If ``progress`` has returned False.
    """
    source, output = _parse(source), _parse(output)
    checkpoint_path = name_checkpoint(output, numbers) if checkpoint is None else Path(checkpoint)
    frames = source.find(numbers)
    _check(frames, output, checkpoint_path, checkpoint_seconds)
    # Leave the folders out: a project may be moved. Sources are identified by size and time.
    names = [Path(str(pattern)).name for pattern in (source, output)]
    run = _Run(frames, output, json.dumps([fingerprint, *names, lobewise.__version__]))
    active, start, note = run.resume(checkpoint_path, make_filter)
    resumed_after = frames[start - 1][0] if start else None
    if remark is not None and (start or note):
        remark(note or f"Going on after frame {resumed_after}, as the checkpoint {str(checkpoint_path)!r} says.")
    last: ResultT | None = None
    saved = time.monotonic()
    for index in range(start, len(frames)):
        number, path = frames[index]
        before = active.get_state() if index else {}
        try:
            with follow_frame(path.name, index, len(frames)):
                frame = read(path)
                enter_stage("")
                with name_file(path):
                    last = active.add(frame, cut=index == 0 or number != frames[index - 1][0] + 1)
                enter_stage(WRITE)
                write(output.name(number), last, frame, path)
        except (KeyboardInterrupt, CancelledError):
            if index:
                with suppress(LobewiseError):
                    run.save(checkpoint_path, before)
            raise
        # Frames can be large: free this one before the next is read.
        del frame
        run.mark_done()
        if index + 1 < len(frames) and time.monotonic() - saved >= checkpoint_seconds:
            run.save(checkpoint_path, active.get_state())
            saved = time.monotonic()
    with suppress(OSError):
        checkpoint_path.unlink()
    return SequenceReport(len(frames), len(frames) - start, resumed_after, note, last)


def _check(frames: list[tuple[int, Path]], output: FramePattern, checkpoint_path: Path, seconds: float) -> None:
    """Raise the errors of `filter_sequence` that are known before the first frame."""
    if not seconds >= 0.0:
        raise InputError("checkpoint_seconds", expected="a time >= 0", got=str(seconds), action="20 is usual")
    if checkpoint_path.suffix != ".npz":
        raise InputError(
            "checkpoint", expected="a name that ends in .npz", got=repr(str(checkpoint_path)), action="add the ending"
        )
    require_writable(output.name(frames[0][0]))
    require_writable(checkpoint_path, what="checkpoint")
    require_other_files((output.name(number) for number, _ in frames), (path for _, path in frames))


def name_checkpoint(output: FramePattern | PathLike, numbers: Collection[int] | None = None) -> Path:
    """Return the default checkpoint of an output: ``clean.lobewise-history.npz`` beside ``clean.####.exr``."""
    return name_beside(output, CHECKPOINT_ENDING, numbers)


def name_beside(output: FramePattern | PathLike, ending: str, numbers: Collection[int] | None = None) -> Path:
    """Return a path beside the files of ``output``: their name without number and ending, then ``ending``.

    For some frames alone it also has the first and the last of ``numbers``, as in ``clean.1001-1050``: runs without a
    common frame never share it.
    """
    pattern = _parse(output)
    stem = pattern.before + pattern.after.removesuffix(Path(f"a{pattern.after}").suffix)
    part = f".{min(numbers)}-{max(numbers)}" if numbers else ""
    return pattern.folder / f"{stem.strip('._- ') or 'sequence'}{part}{ending}"


def _parse(pattern: FramePattern | PathLike) -> FramePattern:
    return pattern if isinstance(pattern, FramePattern) else FramePattern.parse(pattern)


class _Run:
    """The frames of a run, how many are done, and a hash that proves that a checkpoint belongs to them."""

    def __init__(self, frames: list[tuple[int, Path]], output: FramePattern, identity: str) -> None:
        self._frames = frames
        self._output = output
        self._done = 0
        self._proof = hashlib.sha256(identity.encode("utf-8", "surrogateescape"))

    def mark_done(self) -> None:
        """Count the next frame, and hash size and time of its file: a changed source voids the checkpoint."""
        number, path = self._frames[self._done]
        self._done += 1
        # A source that was deleted meanwhile voids the checkpoint as well: the next run will not find it.
        with suppress(OSError):
            state = path.stat()
            self._proof.update(f"{number} {state.st_size} {state.st_mtime_ns}\n".encode())

    def save(self, path: Path, state: State) -> None:
        """Write a checkpoint after the frames that are done, whole or not at all."""
        arrays: dict[str, Any] = {_STATE_PREFIX + name: np.asarray(value) for name, value in state.items()}
        if any(array.dtype.hasobject for array in arrays.values()):
            raise InputError(
                "state of the filter", expected="plain arrays", got="Python objects", action="give numbers or text"
            )
        with open_record(path, what="checkpoint") as stream:
            np.savez(stream, done=np.int64(self._done), proof=np.array(self._proof.hexdigest()), **arrays)

    def resume(
        self, path: Path, make_filter: Callable[[], SequenceFilter[FrameT, ResultT]]
    ) -> tuple[SequenceFilter[FrameT, ResultT], int, str]:
        """Return a filter, the number of frames it has seen, and why an existing checkpoint was not used."""
        if not path.exists():
            return make_filter(), 0, ""
        fresh = self._proof.copy()
        reason = "it is damaged"
        # NumPy raises many kinds of errors on a damaged file, and a filter on the memory of another filter.
        with suppress(Exception), zipfile.ZipFile(path) as file:
            state = _Checkpoint(file, path.stat().st_size)
            done, proof = (
                int(state.load("done", max_bytes=_MAX_HEAD_BYTES)),
                str(state.load("proof", max_bytes=_MAX_HEAD_BYTES)),
            )
            while self._done < min(done, len(self._frames)):
                self.mark_done()
            if not 0 < self._done == done or proof != self._proof.hexdigest():
                reason = "it is of other settings or files"
            elif not all(self._output.name(number).is_file() for number, _ in self._frames[:done]):
                reason = "not all of its outputs are there"
            else:
                active = make_filter()
                active.set_state(state.load_state())
                return active, done, ""
        self._proof, self._done = fresh, 0
        return make_filter(), 0, f"The checkpoint {str(path)!r} is not used: {reason}."


class _Checkpoint:
    """A checkpoint that may be damaged or malicious: reading it never takes more memory than the file has bytes.

    Raises ValueError unless the arrays are stored as `_Run.save` writes them: without compression (a megabyte may
    unpack to terabytes), each name once, and with the sizes that their headers say.
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

    def load(self, name: str, *, max_bytes: int | None = None) -> NDArray[Any]:
        """Return an array; raise ValueError if it has more than ``max_bytes``."""
        item = self._members[name]
        if max_bytes is not None and item.file_size > max_bytes:
            raise ValueError(f"{name} of {item.file_size} bytes")
        with self._file.open(item) as stream:
            version = np.lib.format.read_magic(stream)
            if version != (1, 0):
                raise ValueError(f"version {version}")
            shape, _, kind = np.lib.format.read_array_header_1_0(stream)
            # Check before reading: NumPy allocates the size in the header at once.
            if kind.kind not in "biufU" or math.prod(shape) * kind.itemsize != item.file_size - stream.tell():
                raise ValueError(f"{name} of another size than it says")
        with self._file.open(item) as stream:
            array: NDArray[Any] = np.lib.format.read_array(stream, allow_pickle=False)
            return array

    def load_state(self) -> State:
        """Return the memory of the filter."""
        return {
            name.removeprefix(_STATE_PREFIX): self.load(name)
            for name in self._members
            if name.startswith(_STATE_PREFIX)
        }
