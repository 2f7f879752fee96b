"""How far a call is, in one record for frames, bands of rows, sequences and farms, and how its caller cancels it."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import wraps
from typing import ParamSpec, TypeVar, cast

from lobewise.errors import CancelledError, InputError

P = ParamSpec("P")
R = TypeVar("R")
MIN_SECONDS_BETWEEN = 0.05
"""Shortest time between two records of one stage, seconds."""
MAX_SHARE_BY_CLOCK = 0.95
"""Largest share of a stage that is told by the clock, before the stage has ended."""
MIN_SECONDS, MIN_SHARE = 0.5, 0.02
"""Time and share of the work after which the time left is told."""
READ, FILTER, WRITE, DONE = "reading", "filtering", "writing", "done"
"""Stages of files; the last one is that of the last record of every call."""
FRAME_COSTS = {READ: 0.1, "": 1.0, WRITE: 0.15}
"""Time of reading, filtering and writing a frame, over that of filtering it."""


@dataclass(frozen=True)
class Progress:
    """How far a call is: what a function that is given as ``progress`` is called with.

    Parameters
    ----------
    stage : str
        What is done now; "done" at the end.
    share : float
        Share of the whole call that is done, in [0, 1]. It never falls, and is 1 at the end. Within a step it goes by
        the clock, at the speed of the steps before.
    detail : str
        The step of the stage; empty for none.
    frame : str
        Name of the file that is filtered, in a sequence.
    done, frames : int
        How many frames are done, and how many there are.
    seconds_left : float or None
        Time to the end, at the speed so far; None where it is not known.
    """

    stage: str
    share: float
    detail: str = ""
    frame: str = ""
    done: int = 0
    frames: int = 1
    seconds_left: float | None = None


Watcher = Callable[[Progress], object]
"""Is called with every record. False cancels the call; other values, None among them, do not."""


@dataclass
class _Span:
    """A part of the work, from one share of the whole to another, and its stages."""

    low: float
    high: float
    costs: dict[str, float]
    passed: float = 0.0
    stage: str | None = None
    inside: tuple[float, float] = (0.0, 1.0)

    def locate(self, inside: float) -> float:
        """Return the share of the whole at a place inside of the stage."""
        total = sum(self.costs.values())
        cost = 0.0 if self.stage is None else self.costs[self.stage]
        place = (self.passed + inside * cost) / total if total else 0.0
        return self.low + min(place, 1.0) * (self.high - self.low)


@dataclass
class _Work:
    """The work of a call that is watched."""

    watcher: Watcher
    spans: list[_Span] = field(default_factory=list)
    begun: float = field(default_factory=lambda: time.monotonic())
    first: float | None = None
    """The share that was done before, by an earlier run."""
    share: float = 0.0
    entered: tuple[float, float] = (0.0, 0.0)
    """Time and share at which the current step began."""
    told: float = 0.0
    frame: str = ""
    done: int = 0
    frames: int = 1

    @property
    def has_stage(self) -> bool:
        """Whether a stage with a name has begun."""
        return any(each.stage for each in self.spans)

    def enter(self, stage: str, inside: tuple[float, float]) -> None:
        """Begin a stage of the innermost span, or a part of it."""
        span = self.spans[-1]
        if stage != span.stage:
            span.passed += 0.0 if span.stage is None else span.costs[span.stage]
            span.stage = stage
        span.inside = inside
        self.share = max(self.share, span.locate(inside[0]))
        self.entered = time.monotonic(), self.share
        if self.has_stage:
            self.tell()

    @contextmanager
    def divide(self, costs: Mapping[str, float]) -> Iterator[_Span]:
        """Give a span of what is left of the current stage, or of the call."""
        high = self.spans[-1].locate(self.spans[-1].inside[1]) if self.spans else 1.0
        span = _Span(self.share, max(high, self.share), dict(costs))
        self.spans.append(span)
        try:
            yield span
        finally:
            self.spans.pop()

    def follow(self, inside: float) -> None:
        """Tell how far the current stage is, from 0 to 1."""
        self.share = max(self.share, self.spans[-1].locate(inside))
        if time.monotonic() - self.told >= MIN_SECONDS_BETWEEN:
            self.tell()

    def tick(self) -> None:
        """Tell some times in a second how far the current step is, by the clock, once there is a stage to tell."""
        now = time.monotonic()
        if now - self.told < MIN_SECONDS_BETWEEN or not self.has_stage:
            return
        since, share = self.entered
        end = self.spans[-1].locate(self.spans[-1].inside[1])
        if since > self.begun and share > (self.first or 0.0):
            speed = (share - (self.first or 0.0)) / (since - self.begun)
            self.share = max(self.share, share + min(speed * (now - since), MAX_SHARE_BY_CLOCK * (end - share)))
        self.tell()

    def tell(self) -> None:
        """Call the watcher."""
        if self.first is None:
            self.first = self.share
        self.told = now = time.monotonic()
        gone, share = now - self.begun, self.share - self.first
        left = gone * (1.0 - self.share) / share if gone >= MIN_SECONDS and share >= MIN_SHARE else None
        stage, *details = [each.stage for each in self.spans if each.stage]
        record = Progress(stage, self.share, " ".join(details[-1:]), self.frame, self.done, self.frames, left)
        if self.watcher(record) is False:
            raise CancelledError("cancelled: the function that was given as progress has returned False.")


work_in_progress: ContextVar[_Work | None] = ContextVar("work_in_progress", default=None)
"""The work of the innermost call that is watched; None where nobody watches."""


@contextmanager
def watch_call(watcher: Watcher | None) -> Iterator[None]:
    """Call a function with the progress of what is done inside the context; None leaves an outer one watching.

    Raises
    ------
    InputError
        If the watcher cannot be called.
    CancelledError
        From calls inside, after the watcher has returned False.
    """
    if watcher is None:
        yield
        return
    if not callable(watcher):
        raise InputError("progress", expected="a function", got=type(watcher).__name__, action="leave it out")
    work = _Work(watcher)
    token = work_in_progress.set(work)
    try:
        yield
    finally:
        work_in_progress.reset(token)
    watcher(Progress(DONE, 1.0, done=work.frames, frames=work.frames, seconds_left=0.0))


def watched(function: Callable[P, R]) -> Callable[P, R]:
    """Let the keyword argument ``progress`` of a function watch its calls; see `watch_call`."""

    @wraps(function)
    def run(*arguments: P.args, **named: P.kwargs) -> R:
        with watch_call(cast("Watcher | None", named.get("progress"))):
            return function(*arguments, **named)

    return run


@contextmanager
def plan_stages(costs: Mapping[str, float]) -> Iterator[None]:
    """Divide what is left of the current stage, or of the call, into stages by their costs, in any unit.

    `enter_stage` begins each of them. The name "" is no stage of its own: the stages inside of it are told.
    """
    work = work_in_progress.get()
    if work is None:
        yield
        return
    with work.divide(costs) as span:
        yield
    work.share = span.high


@contextmanager
def follow_file(name: str) -> Iterator[None]:
    """Begin with reading a file, whose stages are those of `FRAME_COSTS`."""
    work = work_in_progress.get()
    if work is not None:
        work.frame = name
    with plan_stages({stage or FILTER: cost for stage, cost in FRAME_COSTS.items()}):
        enter_stage(READ)
        yield


@contextmanager
def follow_frame(name: str, index: int, frames: int) -> Iterator[None]:
    """Begin with reading the next frame of a sequence, whose stages are `FRAME_COSTS`; ``index`` are done."""
    work = work_in_progress.get()
    if work is None:
        yield
        return
    work.frame, work.done, work.frames = name, index, frames
    with work.divide({FILTER: 1.0, "": frames - index - 1.0}):
        enter_stage(FILTER)
        with plan_stages(FRAME_COSTS):
            enter_stage(READ)
            yield


def tell_frames(stage: str, done: int, frames: int) -> None:
    """Tell how many frames are done, where several are filtered at a time. Raises CancelledError as `enter_stage`."""
    work = work_in_progress.get()
    if work is not None:
        work.done, work.frames = done, frames
        work.spans[:] = [_Span(0.0, 1.0, {stage: 1.0}, stage=stage)]
        work.share = max(work.share, done / frames)
        work.tell()


def enter_stage(stage: str, inside: tuple[float, float] = (0.0, 1.0)) -> None:
    """Begin a planned stage, or the part of it from one share to another; other names are no stages, and do nothing.

    Raises CancelledError if the caller cancels.
    """
    work = work_in_progress.get()
    if work is not None and work.spans and stage in work.spans[-1].costs:
        work.enter(stage, inside)


def raise_cost(stage: str, cost: float) -> None:
    """Set the cost of a planned stage of the innermost plan, before its first stage begins."""
    work = work_in_progress.get()
    if work is not None and work.spans and stage in work.spans[-1].costs:
        work.spans[-1].costs[stage] = cost


def follow_stage() -> Callable[[float], None] | None:
    """Return a function that tells the share of the current stage that is done; None where nobody watches.

    The function raises CancelledError if the caller cancels.
    """
    work = work_in_progress.get()
    return work.follow if work is not None and work.has_stage else None
