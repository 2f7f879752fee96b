"""Hand out tasks to workers until every frame is done, or has failed for good.

The client chooses the worker of each task itself, because a frame takes a whole worker: all its threads and memory.
A connection carries the calls, and says which workers there are.
"""

from __future__ import annotations

import platform
import pydoc
import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lobewise.errors import LobewiseError
from lobewise.farm.calls import (
    Call,
    CallFailedError,
    CallLostError,
    Connection,
    ConnectionLostError,
    WorkerLostError,
)
from lobewise.farm.tasks import Assignment, Task, TaskLog, TaskResult
from lobewise.farm.worker import describe_worker, run_assignment
from lobewise.io.sequence import name_frames
from lobewise.recipes.environment import compare_environments, shorten_version
from lobewise.work.limits import check_limits

WAITING = "Waiting for workers"
MAX_RETRIES = 2
"""How often a task that failed is tried again."""
RETRY_SECONDS = 1.0
"""Pause before a task is tried again, seconds; it doubles with every try. A file server may need a moment."""
MAX_TASKS_OF_WORKER = 2
"""Tasks that a worker has at once: one runs, and the next one waits there, so that no time is lost between them."""
POLL_SECONDS = 0.5
"""Time between two looks at the workers, seconds."""
MAX_SECONDS_UNSEEN = 90.0
"""Longest time until a file that a worker has written is seen here, seconds. NFS keeps what it knows of a folder for up
to 60 s."""
FIRST_QUESTIONS: Mapping[str, tuple[Any, ...]] = {
    "Python": (platform.python_version,),
    "lobewise": (pydoc.locate, "lobewise.__version__"),
    "worker": (pydoc.locate, "lobewise.farm.worker.__name__"),
}
"""What every worker is asked. It answers in any version of Python and without lobewise. A call of a function that a
worker cannot load would end it."""
LOST = (
    "its process ended while it filtered this: memory was short, a machine stopped, or the filter crashed; give the "
    "workers more memory, or filter it without a farm to see why."
)
"""The problem of a task whose worker ended."""


@dataclass(frozen=True, kw_only=True)
class Failure:
    """A task that failed at every try.

    Parameters
    ----------
    numbers : tuple of int
        The frames of the task that are not done.
    worker : str
        Address of the worker of the last try.
    problem : str
        Why, in one sentence.
    trace : str
        The traceback, for a mistake of the program.
    """

    numbers: tuple[int, ...]
    worker: str
    problem: str
    trace: str = ""


@dataclass(kw_only=True)
class _Worker:
    """A worker that the scheduler names."""

    address: str
    questions: dict[str, Call] = field(default_factory=dict)
    """Calls that ask for its versions, by what they ask."""
    is_ready: bool = False
    process: str = ""
    """The name of its process."""
    fault: str = ""
    """Why it is not used; empty if it is."""
    last: int | None = None
    """Number of the last frame that it got."""
    calls: dict[str, tuple[Call, Task]] = field(default_factory=dict)
    """The tasks that it has, oldest first, by the key of the call."""


@dataclass(frozen=True, kw_only=True)
class Requirements:
    """What a worker must be like.

    Parameters
    ----------
    environment : mapping of str to str
        Versions by name.
    check : tuple
        Arguments of `lobewise.farm.worker.describe_worker`.
    """

    environment: Mapping[str, str]
    check: tuple[Any, ...]


@dataclass(frozen=True, kw_only=True)
class Callbacks:
    """What a run tells its user.

    Parameters
    ----------
    tell : callable
        Called with a sentence about the farm.
    log_task : callable
        Called with what filtering told about a task.
    show : callable
        Called again and again with what is waited for, "" while frames are filtered, and the tasks that workers have.
    """

    tell: Callable[[str], None]
    log_task: Callable[[TaskLog], None]
    show: Callable[[str, list[Task]], None]


class Dispatcher:
    """Hands out tasks.

    Parameters
    ----------
    connection : Connection
        The scheduler.
    requirements : Requirements
        What workers must be like.
    make_assignment : callable
        Returns the assignment for a task.
    list_missing : callable
        Returns the frames of a task that are not done on disk.
    callbacks : Callbacks
        What is told meanwhile.
    by_runs : bool
        Whether a worker gets consecutive frames where it can, because it has read sources of the next frame already.
    """

    def __init__(
        self,
        connection: Connection,
        requirements: Requirements,
        *,
        make_assignment: Callable[[Task], Assignment],
        list_missing: Callable[[Task], tuple[int, ...]],
        callbacks: Callbacks,
        by_runs: bool = False,
    ) -> None:
        self._connection = connection
        self._requirements = requirements
        self._make_assignment = make_assignment
        self._list_missing = list_missing
        self._callbacks = callbacks
        self._by_runs = by_runs
        self._workers: dict[str, _Worker] = {}
        self._todo: deque[tuple[float, Task]] = deque()
        self._unseen: list[tuple[float, Task, str]] = []
        self._tries: dict[Task, list[Failure]] = {}
        self._blamed: set[str] = set()
        self._looked = -POLL_SECONDS
        self._has_waited = self._had_good_worker = False
        self._waits_for = ""
        self.failures: list[Failure] = []

    def run(self, tasks: Sequence[Task]) -> None:
        """Do all tasks; afterwards `failures` holds those that could not be done.

        Raises LobewiseError if no worker can be used, or the scheduler is gone.
        """
        self._todo.extend((0.0, task) for task in tasks)
        while self._todo or self._unseen or self.list_running():
            check_limits()
            try:
                self._meet_workers()
                self._hand_out()
                self._collect()
            except ConnectionLostError:
                raise LobewiseError(
                    "--farm",
                    expected=f"the scheduler {self._connection.address} until the end",
                    got="no answer in the middle of the run",
                    action="start it, and give the same command again, which filters only what is missing",
                ) from None
            self._look_again()
            self._callbacks.show(self._waits_for, self.list_running())

    def list_running(self) -> list[Task]:
        """Return the tasks that workers have."""
        return [task for worker in self._workers.values() for _, task in worker.calls.values()]

    def _meet_workers(self) -> None:
        """Note which workers came and went, at most every `POLL_SECONDS`."""
        now = time.monotonic()
        if now - self._looked < POLL_SECONDS:
            return
        self._looked = now
        there = self._connection.list_workers()
        for address in set(self._workers) - set(there):
            self._lose(self._workers.pop(address))
        for address in set(there) - set(self._workers):
            self._workers[address] = worker = _Worker(address=address)
            for name, question in FIRST_QUESTIONS.items():
                worker.questions[name] = self._connection.call(address, *question)
        self._require_workers()

    def _require_workers(self) -> None:
        """Raise LobewiseError if no worker can be used; note and tell if there is none yet."""
        faults = {worker.address: worker.fault for worker in self._workers.values() if worker.fault}
        # A farm that had a good worker may get it back.
        if faults and len(faults) == len(self._workers) and not self._had_good_worker:
            reasons = "; ".join(f"{address}: {fault}" for address, fault in sorted(faults.items())[:3])
            raise LobewiseError(
                "farm", expected="a worker that can be used", got=f"none ({reasons})", action="see docs/farm.md"
            )
        self._waits_for = "" if any(worker.is_ready for worker in self._workers.values()) else WAITING
        if self._workers:
            self._has_waited = False
        elif not self._has_waited:
            self._has_waited = True
            self._callbacks.tell(f"No worker is connected to {self._connection.address}; waiting for one.")

    def _lose(self, worker: _Worker) -> None:
        """Take back the tasks of a worker that went. The oldest that is not done was running, so its try counts."""
        for call, _ in worker.calls.values():
            call.drop()
        missing = [task for _, task in worker.calls.values() if self._list_missing(task)]
        if missing:
            self._fail(missing[0], worker.address, LOST)
            self._todo.extendleft((0.0, task) for task in missing[1:])

    def _hand_out(self) -> None:
        ready = [worker for worker in self._workers.values() if worker.is_ready]
        for depth in range(MAX_TASKS_OF_WORKER):
            # Near the end a waiting task would keep another worker idle.
            if depth and len(self._todo) < len(ready):
                return
            for worker in ready:
                if len(worker.calls) == depth and (task := self._take_task(worker)) is not None:
                    call = self._connection.call(
                        worker.address, run_assignment, self._make_assignment(task), worker.process
                    )
                    worker.calls[call.key] = call, task
                    worker.last = task.numbers[-1]

    def _take_task(self, worker: _Worker) -> Task | None:
        """Return the next task for a worker among those whose time has come.

        A task that failed on a worker is left to the others: the disk of one machine may be full.
        """
        now = time.monotonic()
        ready = {each.address for each in self._workers.values() if each.is_ready}
        waiting = []
        for entry in self._todo:
            failed = {failure.worker for failure in self._tries.get(entry[1], ())}
            if entry[0] <= now and (worker.address not in failed or failed.issuperset(ready)):
                waiting.append(entry)
        if not waiting:
            return None
        entry = self._choose_in_runs(waiting, worker) if self._by_runs else waiting[0]
        self._todo.remove(entry)
        return entry[1]

    def _choose_in_runs(self, waiting: list[tuple[float, Task]], worker: _Worker) -> tuple[float, Task]:
        """Return the task that follows a worker's last one, else one in the longest run of consecutive frames.

        A run that another worker is at is shared from its middle on.
        """
        by_number = {entry[1].numbers[0]: entry for entry in waiting}
        if worker.last is not None and worker.last + 1 in by_number:
            return by_number[worker.last + 1]
        runs: list[list[int]] = []
        for number in sorted(by_number):
            if runs and number == runs[-1][-1] + 1:
                runs[-1].append(number)
            else:
                runs.append([number])
        longest = max(runs, key=len)
        is_taken = any(other.last == longest[0] - 1 for other in self._workers.values() if other is not worker)
        return by_number[longest[len(longest) // 2 if is_taken else 0]]

    def _collect(self) -> None:
        for key in self._connection.wait_for_finished(POLL_SECONDS):
            for worker in list(self._workers.values()):
                if key in worker.calls:
                    self._take_outcome(worker, key)
                elif any(call.key == key for call in worker.questions.values()):
                    self._take_answer(worker)

    def _take_answer(self, worker: _Worker) -> None:
        """Judge a worker as soon as all questions are answered."""
        answers: dict[str, Any] = {}
        for name, call in worker.questions.items():
            if not call.has_ended:
                return
            try:
                answers[name] = call.fetch()
            except CallFailedError as problem:
                answers[name] = problem
            except CallLostError:
                # The scheduler will say that the worker is gone, or that it is there again.
                self._workers.pop(worker.address, None)
                return
        worker.questions = {}
        worker.fault = self._judge_all(worker, answers["all"]) if "all" in answers else self._judge_versions(answers)
        if not worker.fault and "all" not in answers:
            worker.questions["all"] = self._connection.call(worker.address, describe_worker, *self._requirements.check)
            return
        worker.is_ready = not worker.fault
        self._had_good_worker |= worker.is_ready
        if worker.fault:
            self._callbacks.tell(f"The worker {worker.address} is not used: {worker.fault}.")

    def _judge_versions(self, answers: Mapping[str, Any]) -> str:
        """Return why a worker cannot be asked more, in a few words; empty if it can."""
        own = self._requirements.environment
        there = {"Python": shorten_version(str(answers["Python"])), "lobewise": str(answers["lobewise"] or "none")}
        first = compare_environments({name: own[name] for name in ("Python", "lobewise")}, there)
        if first:
            return f"it has {first}, which must be installed there"
        is_loaded = answers["worker"] == FIRST_QUESTIONS["worker"][1].rpartition(".")[0]
        return "" if is_loaded else f"its lobewise cannot be loaded ({answers['worker'] or 'no farm'})"

    def _judge_all(self, worker: _Worker, answer: Any) -> str:
        """Return why a worker cannot be used, in a few words; empty if it can. Note the name of its process."""
        if isinstance(answer, CallFailedError):
            return f"it cannot tell what it sees ({answer})"
        worker.process, environment, fault = answer
        difference = compare_environments(self._requirements.environment, environment)
        return f"it has {difference}, which must be installed there" if difference else fault

    def _take_outcome(self, worker: _Worker, key: str) -> None:
        before = dict(worker.calls)
        call, task = worker.calls.pop(key)
        try:
            result: TaskResult = call.fetch()
        except WorkerLostError:
            result = TaskResult(is_lost=True)
        except CallLostError:
            if self._list_missing(task):
                self._todo.appendleft((0.0, task))
            # A silent scheduler would let every other call wait as long as this one.
            self._connection.list_workers()
            return
        except CallFailedError as problem:
            self._fail(task, worker.address, f"something went wrong ({problem}).")
            return
        if result.is_lost:
            worker.calls = before
            self._lose(self._workers.pop(worker.address))
            return
        self._callbacks.log_task(result.log)
        if result.problem:
            self._fail(task, worker.address, result.problem, result.trace)
        elif self._list_missing(task):
            self._unseen.append((time.monotonic() + MAX_SECONDS_UNSEEN, task, worker.address))
        else:
            self._blame(task)

    def _blame(self, task: Task) -> None:
        """Tell why a task that is done failed on other workers before, once for each worker."""
        for failure in self._tries.get(task, ()):
            if failure.problem != LOST and failure.worker not in self._blamed:
                self._blamed.add(failure.worker)
                numbers = name_frames(failure.numbers)
                self._callbacks.tell(f"{numbers}, tried again after worker {failure.worker} failed: {failure.problem}")

    def _look_again(self) -> None:
        """Look for files that workers have written and that were not seen here."""
        for entry in list(self._unseen):
            end, task, address = entry
            if not self._list_missing(task):
                self._unseen.remove(entry)
            elif time.monotonic() >= end:
                self._unseen.remove(entry)
                self._fail(task, address, "it wrote the file, which is not seen here or has changed.")

    def _fail(self, task: Task, worker: str, problem: str, trace: str = "") -> None:
        """Try a task again later, or give it up."""
        failure = Failure(numbers=self._list_missing(task), worker=worker, problem=problem, trace=trace)
        tries = self._tries.setdefault(task, [])
        tries.append(failure)
        if len(tries) > MAX_RETRIES:
            self.failures.append(failure)
        else:
            self._todo.append((time.monotonic() + RETRY_SECONDS * 2.0 ** (len(tries) - 1), task))
