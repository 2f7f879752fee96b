"""Filter a sequence on a farm: what is left to do, the run, and what is left behind."""

from __future__ import annotations

import os
import uuid
from collections.abc import Callable, Collection, Iterable
from contextlib import AbstractContextManager
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

from lobewise.errors import FileError, InputError
from lobewise.farm.calls import Connection
from lobewise.farm.dispatching import WAITING, Callbacks, Dispatcher, Failure, Requirements
from lobewise.farm.tasks import Assignment, Task, TaskLog, Work, cut_tasks
from lobewise.io.replacing import remove_leftovers
from lobewise.io.sequence import FramePattern
from lobewise.recipes.environment import describe_environment
from lobewise.recipes.ledger import Ledger, Numbered, refresh_folders
from lobewise.recipes.sequence import require_frames
from lobewise.work.progress import FILTER, Watcher, tell_frames, watched


@dataclass(frozen=True, kw_only=True)
class FarmJob:
    """A sequence, and how its frames are filtered.

    Parameters
    ----------
    source, output : FramePattern
        Two patterns. Workers must see both folders by these paths.
    work : Work
        How frames are filtered.
    ledger : Ledger
        The records of what is done.
    by_shot : bool
        Whether a frame uses the frames before it, so that one worker filters a whole shot.
    by_runs : bool
        Whether a frame reads the sources of its neighbours, so that workers get consecutive frames where they can.
    with_oidn : bool
        Whether results depend on Open Image Denoise.
    memory : float or None
        GiB that a worker may take; None for the limit that it was started with.
    numbers : collection of int or None
        The frames to filter; None for all.
    """

    source: FramePattern
    output: FramePattern
    work: Work
    ledger: Ledger
    by_shot: bool
    by_runs: bool
    with_oidn: bool
    memory: float | None
    numbers: Collection[int] | None = None


@dataclass(frozen=True, kw_only=True)
class FarmReport:
    """What a run on a farm did.

    Parameters
    ----------
    frames : int
        Frames of the sequence.
    written : int
        Frames that this run wrote.
    failures : tuple of Failure
        What could not be done.
    last : TaskLog
        What was told about the last result.
    """

    frames: int
    written: int
    failures: tuple[Failure, ...]
    last: TaskLog


@watched
def filter_on_farm(
    job: FarmJob,
    open_connection: AbstractContextManager[Connection],
    *,
    tell: Callable[[str], None],
    remark: Callable[[str, str], None],
    progress: Watcher | None = None,
) -> FarmReport:
    """Filter every frame of a sequence on the workers of a scheduler, into the files that one process would write.

    A frame that is done is not made again: its files are whole, and were made from these sources with these settings by
    this version. A task that fails is tried `lobewise.farm.dispatching.MAX_RETRIES` times again. After a stop the same
    call goes on.

    Parameters
    ----------
    job : FarmJob
        What to do.
    open_connection : context manager
        See `lobewise.farm.connection` and `lobewise.farm.processes`.
    tell : callable
        Called with sentences about the farm.
    remark : callable
        Called with remarks on frames and their keys: remarks with one key differ in figures alone.
    progress : callable, optional
        Called with the `lobewise.Progress` of the sequence; the stage says what is waited for.

    Raises
    ------
    FileError
        If there is no source, an output cannot be written, or another run writes this sequence.
    InputError
        If an output would replace a source.
    MissingDependencyError
        If Dask is not installed.
    LobewiseError
        If the scheduler does not answer, or no worker can be used.
    """
    frames = _list_frames(job)
    run = _Run(job, frames, remark)
    with run.ledger.lock():
        try:
            run.ledger.put_token(run.token)
            done = run.list_done()
            if note := run.ledger.describe_done(len(done), len(frames)):
                tell(note)
            if job.by_shot and len(run.tasks) == 1:
                tell("The sequence is one shot, and one worker filters a shot, because frames use those before them.")
            if len(done) < len(frames):
                tell_frames(WAITING, len(done), len(frames))
                with open_connection as connection:
                    run.do_tasks(connection, tell)
        finally:
            # By now the workers of a local farm have ended.
            run.clean_up()
    written = len(run.done) - len(done)
    return FarmReport(frames=len(frames), written=written, failures=run.failures, last=run.last)


def _list_frames(job: FarmJob) -> list[Numbered]:
    """Return the frames of a sequence with absolute paths: workers run in other folders."""
    if not job.source.folder.is_absolute() or not job.output.folder.is_absolute():
        raise InputError(
            "source and output", expected="absolute paths", got="relative ones", action="pass Path.absolute()"
        )
    frames = job.source.find(job.numbers)
    require_frames(frames, job.output)
    return frames


class _Run:
    """The state of a run."""

    def __init__(self, job: FarmJob, frames: list[Numbered], remark: Callable[[str, str], None]) -> None:
        self._job = job
        self._frames = frames
        self._remark = remark
        self._environment = describe_environment(with_oidn=job.with_oidn)
        self.ledger = job.ledger
        self.tasks = cut_tasks(frames, by_shot=job.by_shot)
        self.token = uuid.uuid4().hex
        self.done: set[int] = set()
        self._begun: set[int] = set()
        self._dispatcher: Dispatcher | None = None
        self._proofs: dict[tuple[int, ...], dict[int, str]] = {}
        self.last = TaskLog()

    def list_done(self) -> frozenset[int]:
        """Return the frames that are done already."""
        recorded = self.ledger.list_recorded()
        for task in self.tasks:
            if recorded.issuperset(task.numbers[:1]):
                self.list_missing(task)
        return frozenset(self.done)

    def list_missing(self, task: Task) -> tuple[int, ...]:
        """Return the frames of a task that are not done on disk, and note those that are.

        Raises FileError if a later run has taken over, which the lock does not prevent on disks without locks.
        """
        if not self.ledger.has_token(self.token):
            raise FileError(
                f"records {str(self.ledger.folder)!r}",
                expected="no other run that writes this sequence",
                got="one that began later",
                action="let it end, and give the command again",
            )
        refresh_folders(self.ledger.folder, self._job.output.folder)
        proofs = self.ledger.prove(task.frames, self._job.work.list_sources)
        outputs = self._job.work.list_outputs
        missing = tuple(
            number for number in task.numbers if not self.ledger.is_done(number, proofs[number], outputs(number))
        )
        self.done.difference_update(missing)
        self.done.update(set(task.numbers) - set(missing))
        return missing

    def do_tasks(self, connection: Connection, tell: Callable[[str], None]) -> None:
        """Do all tasks that are not done."""
        source = self._frames[0][1]
        check = (self.ledger.folder, self.token, source, source.stat().st_size, self._job.with_oidn)
        self._dispatcher = dispatcher = Dispatcher(
            connection,
            Requirements(environment=self._environment, check=check),
            make_assignment=self._make_assignment,
            list_missing=self.list_missing,
            callbacks=Callbacks(tell=tell, log_task=self._log_task, show=self._show),
            by_runs=self._job.by_runs,
        )
        todo = [task for task in self.tasks if not self.done.issuperset(task.numbers)]
        dispatcher.run(todo)

    @property
    def failures(self) -> tuple[Failure, ...]:
        """What could not be done."""
        return () if self._dispatcher is None else tuple(self._dispatcher.failures)

    def clean_up(self) -> None:
        """Remove what killed workers have half written, and the records where they are of no use any more."""
        for number in self._begun - self.done:
            for path in self._job.work.list_outputs(number):
                remove_leftovers(Path(os.path.realpath(path)))
        is_over = len(self.done) == len(self._frames) or not self.ledger.list_recorded()
        if is_over and self.ledger.has_token(self.token):
            self.ledger.remove()

    def _make_assignment(self, task: Task) -> Assignment:
        self._begun.update(task.numbers)
        return Assignment(work=self._job.work, task=task, ledger=self.ledger, memory=self._job.memory)

    def _log_task(self, log: TaskLog) -> None:
        for key, text in log.remarks:
            self._remark(text, key)
        if log.last:
            self.last = log

    def _show(self, waits_for: str, running: Iterable[Task]) -> None:
        count = len(self.done) + sum(map(self._count_begun, running))
        tell_frames(waits_for or FILTER, count, len(self._frames))

    def _count_begun(self, task: Task) -> int:
        """Return how many frames of a shot are done while a worker is at it."""
        if len(task.frames) == 1:
            return 0
        # Sources are not looked at again for a figure on the terminal.
        if task.numbers not in self._proofs:
            self._proofs[task.numbers] = self.ledger.prove(task.frames, self._job.work.list_sources)
        proofs = self._proofs[task.numbers]
        todo = (number for number in task.numbers if number not in self.done)
        outputs = self._job.work.list_outputs
        return sum(1 for _ in takewhile(lambda each: self.ledger.is_done(each, proofs[each], outputs(each)), todo))
