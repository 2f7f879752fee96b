"""Filter a sequence of numbered files frame by frame; what is done already is not made again."""

from __future__ import annotations

import time
from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import islice, pairwise
from pathlib import Path
from typing import Generic, NamedTuple, Protocol, TypeVar

from lobewise.errors import (
    CancelledError,
    DeviceError,
    InputError,
    LobewiseError,
    MissingDependencyError,
    TimeLimitError,
    hide_numbers,
)
from lobewise.io.exr.layout import name_file
from lobewise.io.files import PathLike, make_folder, require_other_files, require_writable
from lobewise.io.sequence import FramePattern, name_frames
from lobewise.recipes.ledger import Ledger, Numbered
from lobewise.recipes.states import State, load_state, save_state
from lobewise.work.limits import has_memory, set_aside
from lobewise.work.overlap import Overlap
from lobewise.work.progress import FILTER, WRITE, Watcher, enter_stage, follow_frame, watched

FrameT = TypeVar("FrameT")
ResultT = TypeVar("ResultT")
_FrameIn = TypeVar("_FrameIn", contravariant=True)
_ResultOut = TypeVar("_ResultOut", covariant=True)

OF_ALL_FRAMES = (CancelledError, DeviceError, MissingDependencyError, TimeLimitError)
"""Errors that the next frame would have as well."""


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


class Need(NamedTuple):
    """Memory that a file takes, bytes."""

    held: float = 0.0
    """While it is read, kept or written."""
    work: float = 0.0
    """Beside this, while it is filtered."""


@dataclass(frozen=True, kw_only=True)
class FrameFailure:
    """A frame that could not be filtered.

    Parameters
    ----------
    number : int
        Its number.
    problem : LobewiseError
        Why.
    """

    number: int
    problem: LobewiseError


@dataclass(frozen=True, kw_only=True)
class SequenceReport(Generic[ResultT]):
    """What `filter_sequence` did.

    Parameters
    ----------
    frames : int
        Frames of the sequence.
    written : int
        Frames that this run wrote.
    failures : tuple of FrameFailure
        Frames that could not be filtered. All others have an output file now.
    last : object or None
        The result of the last frame, if this run made it.
    stage_seconds : mapping of str to float
        Time of "reading", "filtering" and "writing", each by itself, seconds. They overlap: together they may be more
        than the time of the run.
    """

    frames: int
    written: int
    failures: tuple[FrameFailure, ...] = ()
    last: ResultT | None = None
    stage_seconds: Mapping[str, float] = field(default_factory=dict)

    def require_all(self) -> None:
        """Raise LobewiseError if a frame could not be filtered; where all fail alike, the error of the first."""
        if problem := self.common_problem:
            raise problem
        if self.failures:
            numbers = [failure.number for failure in self.failures]
            raise LobewiseError(describe_failures(numbers, self.frames, str(self.failures[0].problem)))

    @property
    def common_problem(self) -> LobewiseError | None:
        """The problem of the first frame, where every frame has it; None where frames differ."""
        kinds = {hide_numbers(str(failure.problem)) for failure in self.failures}
        return self.failures[0].problem if len(self.failures) == self.frames and len(kinds) == 1 else None


def describe_failures(numbers: Sequence[int], frames: int, first: str = "") -> str:
    """Return the sentence that ends a run in which frames failed; ``first`` is the reason of the first of them."""
    why = f": {first.removesuffix('.')}; then" if first else "; mend what is said above and"
    counted = f"{len(numbers)} of {frames} frames could not be filtered ({name_frames(numbers).lower()})"
    return f"{counted}{why} give the same command again, which filters only these."


@watched
def filter_sequence(
    source: FramePattern | PathLike,
    output: FramePattern | PathLike,
    make_filter: Callable[[], SequenceFilter[FrameT, ResultT]],
    *,
    read: Callable[[Path], FrameT],
    write: Callable[[Path, ResultT, FrameT, Path], None],
    ledger: Ledger,
    remembers: bool = True,
    list_sources: Callable[[int, Path], Iterable[Path]] = lambda _, path: [path],
    list_outputs: Callable[[int], Iterable[Path]] | None = None,
    foretell: Callable[[Path], Need] = lambda _: Need(),
    progress: Watcher | None = None,
    remark: Callable[[str], object] | None = None,
    checkpoint_seconds: float = 20.0,
    numbers: Collection[int] | None = None,
) -> SequenceReport[ResultT]:
    """Filter every file of ``source``, in the order of the numbers, into the file of ``output`` with its number.

    While a frame is filtered, the next one is read and the one before is written, in other threads, where the memory
    for three frames is there; else one frame is in memory at a time. The first frame, and every frame after a missing
    number or a frame that cannot be filtered, is a cut. A frame that cannot be filtered does not stop the others.

    A frame that is recorded as done is not made again. The memory of the filter is recorded from time to time, and on
    an interrupt, so that the next run goes on, and writes the same files as a run that was not stopped.

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
    ledger : Ledger
        The records of what is done, whose lock is held.
    remembers : bool
        Whether the filter uses the frames before a frame.
    list_sources : callable
        Returns every file that a frame depends on, from its number and source.
    list_outputs : callable, optional
        Returns every file that is written for a number; by default that of ``output``.
    foretell : callable, optional
        Returns the memory that a source will take, or raises LobewiseError where that is unknown; by default none.
    progress : callable, optional
        Called with the `lobewise.Progress` of the sequence; False cancels it, and the next run goes on.
    remark : callable, optional
        Called before the first frame with a sentence on what is done already, if anything is.
    checkpoint_seconds : float
        Shortest time between two records of the filter's memory, seconds >= 0; with 0 every frame is followed by one.
    numbers : collection of int, optional
        Filter only the frames with these numbers; by default all.

    Raises
    ------
    FileError
        If there is no source, a number has none, or an output cannot be written.
    InputError
        If a path is no pattern, an output would replace a source, or the time is negative.
    DeviceError, MissingDependencyError, TimeLimitError
        If all frames would fail alike.
    CancelledError
        If ``progress`` has returned False.
    """
    source, output = _parse(source), _parse(output)
    frames = source.find(numbers)
    if not checkpoint_seconds >= 0.0:
        raise InputError("checkpoint_seconds", expected="a time >= 0", got=str(checkpoint_seconds), action="pass 20")
    require_frames(frames, output)
    shots = (cut_shots if remembers else cut_frames)(frames)
    run = _Run(
        shots=shots,
        output=output,
        read=read,
        write=write,
        ledger=ledger,
        list_sources=list_sources,
        list_outputs=list_outputs or (lambda number: [output.name(number)]),
        foretell=foretell,
        seconds=checkpoint_seconds,
    )
    done = sum(run.count_done(shot, run.prove(shot)) for shot in shots) if ledger.list_recorded() else 0
    if remark is not None and (note := ledger.describe_done(done, len(frames))):
        remark(note)
    run.filter_shots(make_filter if remembers else _keep(make_filter))
    return SequenceReport(
        frames=len(frames),
        written=run.written,
        failures=tuple(run.failures),
        last=run.last,
        stage_seconds=run.overlap.seconds,
    )


def _keep(make_filter: Callable[[], SequenceFilter[FrameT, ResultT]]) -> Callable[[], SequenceFilter[FrameT, ResultT]]:
    """Return a function that makes one filter, and returns it again and again."""
    made: list[SequenceFilter[FrameT, ResultT]] = []

    def make() -> SequenceFilter[FrameT, ResultT]:
        if not made:
            made.append(make_filter())
        return made[0]

    return make


def require_frames(frames: Sequence[Numbered], output: FramePattern) -> None:
    """Make the folder of the outputs of frames.

    Raises FileError or InputError if the outputs cannot be written, or would replace one of the frames.
    """
    make_folder(output.folder)
    require_writable(output.name(frames[0][0]))
    require_other_files((output.name(number) for number, _ in frames), (path for _, path in frames))


def cut_shots(frames: Sequence[Numbered]) -> list[Sequence[Numbered]]:
    """Return every run of consecutive numbers: a missing number is a cut."""
    starts = [0, *(k + 1 for k, (a, b) in enumerate(pairwise(frames)) if b[0] != a[0] + 1), len(frames)]
    return [frames[start:stop] for start, stop in pairwise(starts)]


def cut_frames(frames: Sequence[Numbered]) -> list[Sequence[Numbered]]:
    """Return every frame by itself."""
    return [[frame] for frame in frames]


def _parse(pattern: FramePattern | PathLike) -> FramePattern:
    return pattern if isinstance(pattern, FramePattern) else FramePattern.parse(pattern)


@dataclass(kw_only=True)
class _Run(Generic[FrameT, ResultT]):
    """A run over the frames of a sequence; see `filter_sequence`."""

    shots: Sequence[Sequence[Numbered]]
    output: FramePattern
    read: Callable[[Path], FrameT]
    write: Callable[[Path, ResultT, FrameT, Path], None]
    ledger: Ledger
    list_sources: Callable[[int, Path], Iterable[Path]]
    list_outputs: Callable[[int], Iterable[Path]]
    foretell: Callable[[Path], Need]
    seconds: float

    def __post_init__(self) -> None:
        self.written = self._seen = self._shot = 0
        self.failures: list[FrameFailure] = []
        self.last: ResultT | None = None
        self.overlap = Overlap()
        self._count = sum(map(len, self.shots))
        self._proofs: dict[int, dict[int, str]] = {}
        """Proofs of shots whose first frame is read ahead, by its number."""
        self._behind = 0.0
        """Memory of the frame that is written while another is filtered, bytes."""
        self._safe: Callable[[], None] | None = None
        """Saves what the filter remembers up to the last frame that is done, if the shot goes on behind this frame."""
        self._saved = time.monotonic()

    def prove(self, shot: Sequence[Numbered]) -> dict[int, str]:
        """Return what proves of each frame of a shot that it is done; see `Ledger.prove`."""
        return self.ledger.prove(shot, self.list_sources)

    def count_done(self, frames: Sequence[Numbered], proofs: dict[int, str]) -> int:
        """Return how many frames are done before the first that is not."""
        missing = (k for k, (n, _) in enumerate(frames) if not self.ledger.is_done(n, proofs[n], self.list_outputs(n)))
        return next(missing, len(frames))

    def filter_shots(self, make: Callable[[], SequenceFilter[FrameT, ResultT]]) -> None:
        """Filter the frames that are not done. Behind a frame that fails the history begins anew."""
        try:
            with self.overlap:
                for number, shot in enumerate(self.shots):
                    self._shot = number
                    # Take sizes and times before reading: a source that changes meanwhile voids the record.
                    proofs, rest = self._proofs.pop(shot[0][0], None) or self.prove(shot), shot
                    while rest:
                        rest = rest[self._filter_run(rest, proofs, make) :]
        except (KeyboardInterrupt, CancelledError):
            if self._safe is not None:
                with suppress(LobewiseError):
                    self._safe()
            raise

    def _filter_run(
        self, frames: Sequence[Numbered], proofs: dict[int, str], make: Callable[[], SequenceFilter[FrameT, ResultT]]
    ) -> int:
        """Filter frames up to the first that fails; return how many were seen."""
        done, begun = self.count_done(frames, proofs), self._seen
        self._seen += len(frames)
        if done == len(frames):
            return done
        path = self.ledger.name_state(frames[0][0])
        active, start = make(), 0
        if len(frames) > 1 and (kept := load_state(path, [proofs[number] for number, _ in frames[:done]])):
            # A filter may refuse the memory of another one.
            try:
                active.set_state(kept[1])
                start = kept[0] + 1
            except Exception:
                active = make()
        for index in range(start, len(frames)):
            number, source = frames[index]
            follows = index + 1 < len(frames)
            following = frames[index + 1][1] if follows else self._foresee()
            with follow_frame(source.name, begun + index, self._count):
                try:
                    frame = self.overlap.read(source, partial(self.read, source))
                    enter_stage("")
                    aside = self._read_ahead(source, following)
                    with self.overlap.time(FILTER), set_aside(aside or 0.0), name_file(source):
                        self.last = active.add(frame, cut=index == 0)
                except OF_ALL_FRAMES:
                    raise
                except LobewiseError as problem:
                    self.failures.append(FrameFailure(number=number, problem=problem))
                    self._seen = begun + index + 1
                    return index + 1
                save = partial(save_state, path, proofs[number], active.get_state()) if follows else None
                enter_stage(WRITE)
                self.overlap.write(
                    partial(self.write, self.output.name(number), self.last, frame, source),
                    partial(self._record, number, proofs[number], save),
                    behind=aside is not None,
                )
        return len(frames)

    def _record(self, number: int, proof: str, save: Callable[[], None] | None) -> None:
        """Record that a frame is done, and from time to time what the filter remembers."""
        self.written += 1
        self.ledger.record(number, proof, self.list_outputs(number))
        self._safe = save
        if save is not None and time.monotonic() - self._saved >= self.seconds:
            save()
            self._saved = time.monotonic()

    def _foresee(self) -> Path | None:
        """Return the source that the next shots will read first; None where there is none, or it is not known."""
        for shot in islice(self.shots, self._shot + 1, None):
            first = shot[0][0]
            self._proofs[first] = proofs = self._proofs.get(first) or self.prove(shot)
            done = self.count_done(shot, proofs)
            if done < len(shot):
                # What the filter remembers decides where a shot goes on.
                return None if done else shot[0][1]
        return None

    def _read_ahead(self, source: Path, following: Path | None) -> float | None:
        """Begin to read the ``following`` frame while that of ``source`` is filtered, where there is memory for both.

        Return the memory of the frames beside that of ``source``, bytes. Where there is too little, return None when
        the frame before is written.
        """
        if following is not None:
            with suppress(LobewiseError):
                own, other = self.foretell(source), self.foretell(following)
                aside = self._behind + other.held
                if has_memory(aside + own.held + own.work):
                    self.overlap.read_ahead(following, partial(self.read, following))
                    self._behind = own.held
                    return aside
        self.overlap.finish()
        self._behind = 0.0
        return None
