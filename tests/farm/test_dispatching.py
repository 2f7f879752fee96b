"""Handing out tasks: with workers that are lost, refused, slow to show their files, or wrong; without Dask."""

import os
import platform
import pydoc
from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Future
from dataclasses import dataclass, field
from itertools import count, pairwise
from pathlib import Path
from typing import Any, cast

import pytest

from lobewise.errors import LobewiseError
from lobewise.farm import dispatching, processes
from lobewise.farm.calls import CallFailedError, CallLostError, Connection, ConnectionLostError, WorkerLostError
from lobewise.farm.dispatching import Callbacks, Dispatcher, Failure, Requirements
from lobewise.farm.tasks import Assignment, Task, TaskLog, TaskResult, cut_tasks
from lobewise.farm.worker import describe_worker
from tests.mistakes import refuses

ENVIRONMENT = {"lobewise": "1.0", "Python": ".".join(platform.python_version_tuple()[:2]), "NumPy": "2.0"}


@dataclass(eq=False)
class FakeCall:
    """A call whose answer is known when it is made."""

    worker: str
    key: str
    answer: Callable[[], Any]
    has_ended: bool = True
    is_dropped: bool = False

    def fetch(self) -> Any:
        return self.answer()

    def drop(self) -> None:
        self.is_dropped = True


@dataclass
class FakeFarm:
    """A scheduler in one process. Calls end when the client waits for them, one at a time on each worker."""

    workers: dict[str, dict[str, str]]
    """Versions of each worker by its address."""
    faults: dict[str, str] = field(default_factory=dict)
    modules: dict[str, Any] = field(default_factory=dict)
    """What workers answer that cannot load lobewise, by address."""
    done: set[int] = field(default_factory=set)
    problems: dict[int, list[str]] = field(default_factory=dict)
    """What goes wrong with a frame, one entry for each try."""
    waiting: list[tuple[FakeCall, Callable[[], None]]] = field(default_factory=list)
    ran: list[tuple[str, tuple[int, ...]]] = field(default_factory=list)
    asked: list[str] = field(default_factory=list)
    """Workers that were sent a function of lobewise. Dask ends a worker that cannot load it."""
    on_task: Callable[[str, Task], bool] = lambda worker, task: True
    """Called before a task runs; returns whether it runs."""
    restarts: dict[str, int] = field(default_factory=dict)
    """How often a worker was started again at its address."""
    is_gone: bool = False
    address: str = "tcp://fake:8786"
    keys: Iterator[int] = field(default_factory=count)

    def list_workers(self) -> dict[str, int]:
        if self.is_gone:
            raise ConnectionLostError
        return dict.fromkeys(self.workers, 1)

    def call(self, worker: str, function: Any, *arguments: Any) -> FakeCall:
        key = str(next(self.keys))
        if function is platform.python_version:
            answer: Any = lambda: self.workers[worker]["Python"] + ".7"  # noqa: E731 - reads the version when asked
        elif function is pydoc.locate:
            name, _, what = arguments[0].rpartition(".")
            found = self.workers[worker]["lobewise"] if what == "__version__" else self.modules.get(worker, name)
            answer = lambda: found  # noqa: E731
        elif function is describe_worker:
            self.asked.append(worker)
            answer = lambda: (self._name_process(worker), self.workers[worker], self.faults.get(worker, ""))  # noqa: E731
        else:
            return self._take_assignment(worker, key, *arguments)
        call = FakeCall(worker, key, answer)
        self.waiting.append((call, lambda: None))
        return call

    def _name_process(self, worker: str) -> str:
        return f"{worker}{self.restarts.get(worker, 0)}"

    def _take_assignment(self, worker: str, key: str, assignment: Assignment, process: str) -> FakeCall:
        found: list[Any] = []

        def answer() -> Any:
            if isinstance(found[0], Exception):
                raise found[0]
            return found[0]

        call = FakeCall(worker, key, answer)

        def run() -> None:
            if process != self._name_process(worker):
                found.append(TaskResult(is_lost=True))
                return
            if not self.on_task(worker, assignment.task):
                if process == self._name_process(worker):
                    found.append(CallLostError())
                else:
                    # Dask gives the new process what the old one had, in any order.
                    self.waiting.append((call, run))
                return
            self.ran.append((worker, assignment.task.numbers))
            left = self.problems.get(assignment.task.numbers[0], [])
            told = TaskLog(remarks=(("key", f"about {assignment.task.numbers[0]}"),))
            problem = left.pop(0) if left else ""
            if problem == "raise":
                found.append(CallFailedError("TypeError: odd"))
                return
            if not problem:
                self.done.update(assignment.task.numbers)
            found.append(TaskResult(log=told, problem=problem))

        self.waiting.append((call, run))
        return call

    def wait_for_finished(self, seconds: float) -> list[str]:
        if not self.waiting:
            return []
        call, run = self.waiting.pop(0)
        if call.is_dropped or call.worker not in self.workers:
            return []
        run()
        # Dask says nothing of a call whose worker is gone, or that runs again.
        is_told = call.worker in self.workers and all(other is not call for other, _ in self.waiting)
        return [call.key] if is_told else []


@pytest.fixture(autouse=True)
def _no_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    """Look at the workers in every round, and wait for nothing."""
    monkeypatch.setattr(dispatching, "POLL_SECONDS", 0.0)
    monkeypatch.setattr(dispatching, "RETRY_SECONDS", 0.0)


def make_farm(**options: Any) -> FakeFarm:
    return FakeFarm({"a": dict(ENVIRONMENT), "b": dict(ENVIRONMENT)}, **options)


def run(
    farm: FakeFarm, tasks: list[Task], *, by_runs: bool = False, show: Callable[..., None] = lambda *_: None
) -> tuple[list[Failure], list[str]]:
    """Do tasks; return the failures and what was told. ``show`` is called with the state of the work."""
    told: list[str] = []
    dispatcher = Dispatcher(
        cast(Connection, farm),
        Requirements(environment=ENVIRONMENT, check=()),
        make_assignment=lambda task: cast(Assignment, _Assignment(task)),
        list_missing=lambda task: tuple(number for number in task.numbers if number not in farm.done),
        callbacks=Callbacks(tell=told.append, log_task=lambda _: None, show=show),
        by_runs=by_runs,
    )
    dispatcher.run(tasks)
    assert dispatcher.list_running() == []
    return dispatcher.failures, told


@dataclass
class _Assignment:
    task: Task


def make_tasks(*numbers: int) -> list[Task]:
    return cut_tasks([(number, Path(f"in.{number}")) for number in numbers], by_shot=False)


def test_every_frame_is_filtered_once_by_both_workers() -> None:
    farm = make_farm()
    assert run(farm, make_tasks(*range(20))) == ([], [])
    assert sorted(numbers for _, numbers in farm.ran) == [(number,) for number in range(20)]
    assert {worker for worker, _ in farm.ran} == {"a", "b"}


def test_a_worker_has_one_frame_waiting_but_not_at_the_end() -> None:
    farm = make_farm()
    most: list[int] = []

    def look(worker: str, task: Task) -> bool:
        most.append(1 + sum(call.worker == worker for call, _ in farm.waiting))
        return True

    farm.on_task = look
    run(farm, make_tasks(*range(8)))
    assert max(most) == dispatching.MAX_TASKS_OF_WORKER
    assert most[-2:] == [1, 1]


@pytest.mark.parametrize("workers", ["a", "ab", "abcd"])
def test_workers_get_consecutive_frames_where_windows_need_them(workers: str) -> None:
    farm = FakeFarm({name: dict(ENVIRONMENT) for name in workers}, problems={7: ["once"]})
    assert run(farm, make_tasks(*range(40), *range(60, 80)), by_runs=True)[0] == []
    assert farm.done == {*range(40), *range(60, 80)}
    jumps = 0
    for name in workers:
        numbers = [found[0] for worker, found in farm.ran if worker == name]
        jumps += sum(after != before + 1 for before, after in pairwise(numbers))
        # The work is shared evenly.
        assert abs(len(numbers) - 61 / len(workers)) <= 6
    # The missing numbers, the frame that is tried again, and what is shared near the end.
    assert jumps <= 4 + 4 * len(workers)


def test_a_frame_that_fails_is_tried_twice_more_and_then_told() -> None:
    farm = make_farm(problems={3: ["once", "twice", "for good"], 4: ["once", "twice"], 5: ["raise"]})
    failures, _ = run(farm, make_tasks(*range(8)))
    assert [(failure.numbers, failure.problem) for failure in failures] == [((3,), "for good")]
    tries = [numbers[0] for _, numbers in farm.ran]
    assert [tries.count(number) for number in range(8)] == [1, 1, 1, 3, 3, 2, 1, 1]
    assert farm.done == {0, 1, 2, 4, 5, 6, 7}


def test_a_shot_that_fails_names_the_frames_that_are_not_done() -> None:
    farm = make_farm(problems={1: ["no"] * 3}, done={1, 2})
    task = cut_tasks([(number, Path(str(number))) for number in (1, 2, 3, 4)], by_shot=True)
    failures, _ = run(farm, task)
    assert failures[0].numbers == (3, 4)


def test_a_lost_worker_loses_no_frame_and_a_frame_that_loses_workers_fails() -> None:
    farm = make_farm()
    names = iter("cdefgh")

    def lose(worker: str, task: Task) -> bool:
        if task.numbers == (2,):
            del farm.workers[worker]
            farm.workers[next(names)] = dict(ENVIRONMENT)
            return False
        return True

    farm.on_task = lose
    failures, _ = run(farm, make_tasks(*range(6)))
    assert [failure.numbers for failure in failures] == [(2,)]
    assert failures[0].problem == dispatching.LOST
    assert failures[0].worker in {"a", "b", "c", "d"}
    assert farm.done == {0, 1, 3, 4, 5}
    # The frames that waited on lost workers have lost no try.
    assert next(names) == "f"


def test_a_frame_that_waited_on_a_lost_worker_has_lost_no_try() -> None:
    farm = FakeFarm({"a": dict(ENVIRONMENT)}, problems={3: ["once", "twice"]})

    def lose(worker: str, task: Task) -> bool:
        if task.numbers == (2,) and worker == "a":
            farm.workers = {"b": dict(ENVIRONMENT)}
            return False
        return True

    farm.on_task = lose
    told = ["Frame 3, tried again after worker b failed: once"]
    assert run(farm, make_tasks(2, 3)) == ([], told)
    assert farm.done == {2, 3}


def test_a_frame_that_runs_on_a_lost_worker_has_lost_a_try() -> None:
    """Frame 1 is done when the worker is lost, so that frame 2 was running there."""
    farm = FakeFarm({"a": dict(ENVIRONMENT)}, problems={2: ["once", "twice"]})

    def lose(worker: str, task: Task) -> bool:
        if worker == "a":
            farm.done.update({1})
            farm.workers = {"b": dict(ENVIRONMENT)}
            return False
        return True

    farm.on_task = lose
    failures, _ = run(farm, make_tasks(1, 2))
    assert [failure.numbers for failure in failures] == [(2,)]


def test_a_frame_that_ends_a_worker_which_comes_back_at_its_address_fails() -> None:
    farm = FakeFarm({"a": dict(ENVIRONMENT)})

    def restart(worker: str, task: Task) -> bool:
        if task.numbers == (2,):
            farm.restarts[worker] = farm.restarts.get(worker, 0) + 1
            return False
        return True

    farm.on_task = restart
    failures, _ = run(farm, make_tasks(*range(6)))
    assert [(failure.numbers, failure.problem) for failure in failures] == [((2,), dispatching.LOST)]
    assert farm.done == {0, 1, 3, 4, 5}
    assert farm.restarts == {"a": 3}


def test_a_frame_that_failed_is_left_to_another_worker() -> None:
    farm = make_farm()
    full: list[int] = []

    def fill(worker: str, task: Task) -> bool:
        farm.problems = {}
        if worker == "a":
            full.append(task.numbers[0])
            farm.problems = {task.numbers[0]: ["no room"]}
        return True

    farm.on_task = fill
    assert run(farm, make_tasks(*range(8))) == ([], [f"Frame {full[0]}, tried again after worker a failed: no room"])
    assert farm.done == set(range(8))
    assert len(set(full)) == len(full)


@pytest.mark.parametrize(
    ("name", "version", "told"),
    [
        ("lobewise", "0.9", "it has lobewise 0.9 instead of 1.0"),
        ("lobewise", None, "it has lobewise none instead of 1.0"),
        ("Python", "2.7", f"it has Python 2.7 instead of {ENVIRONMENT['Python']}"),
        ("NumPy", "1.26", "it has NumPy 1.26 instead of 2.0"),
    ],
)
def test_a_worker_of_another_version_is_not_used(name: str, version: str, told: str) -> None:
    farm = make_farm()
    farm.workers["b"][name] = version
    assert run(farm, make_tasks(*range(6))) == (
        [],
        [f"The worker b is not used: {told}, which must be installed there."],
    )
    assert {worker for worker, _ in farm.ran} == {"a"}
    assert set(farm.asked) == ({"a", "b"} if name == "NumPy" else {"a"})


def test_a_worker_that_cannot_load_lobewise_is_not_used() -> None:
    farm = make_farm(modules={"a": None, "b": CallFailedError("ImportError: no Halide")})
    with pytest.raises(LobewiseError) as problem:
        run(farm, make_tasks(1))
    assert "(a: its lobewise cannot be loaded (no farm); b: its lobewise cannot be loaded (ImportError: no" in str(
        problem.value
    )
    assert farm.asked == []


def test_without_any_good_worker_the_run_ends_with_the_reasons() -> None:
    farm = make_farm(faults={"a": "it does not see the folder '/x'", "b": "it sees another folder as '/x'"})
    with pytest.raises(LobewiseError) as problem:
        run(farm, make_tasks(1))
    assert str(problem.value) == (
        "farm: expected a worker that can be used, got none (a: it does not see the folder '/x'; b: it sees another "
        "folder as '/x'); see docs/farm.md."
    )


def test_a_good_worker_that_went_is_waited_for() -> None:
    farm = make_farm(faults={"b": "no"})
    rounds = 0

    def show(*_: Any) -> None:
        nonlocal rounds
        rounds += 1
        if rounds == 10:
            del farm.workers["a"]
        if rounds == 16:
            farm.workers["c"] = dict(ENVIRONMENT)

    run(farm, make_tasks(*range(20)), show=show)
    assert farm.done == set(range(20))
    assert {worker for worker, _ in farm.ran} == {"a", "c"}


def test_without_workers_the_run_says_so_once_and_waits() -> None:
    farm = FakeFarm({})
    shown: list[str] = []

    def show(waits_for: str, _: list[Task]) -> None:
        shown.append(waits_for)
        if len(shown) == 3:
            farm.workers["late"] = dict(ENVIRONMENT)

    _, told = run(farm, make_tasks(1), show=show)
    assert told == ["No worker is connected to tcp://fake:8786; waiting for one."]
    assert shown[:3] == ["Waiting for workers"] * 3
    assert shown[-1] == ""


def test_a_lost_scheduler_ends_the_run() -> None:
    farm = make_farm()

    def break_off(worker: str, task: Task) -> bool:
        farm.is_gone = task.numbers == (3,)
        return not farm.is_gone

    farm.on_task = break_off
    with refuses(LobewiseError, "--farm", expected="the scheduler tcp://fake:8786 until the end"):
        run(farm, make_tasks(*range(8)))
    assert farm.done < set(range(8))


def test_a_file_that_is_never_seen_here_counts_as_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dispatching, "MAX_SECONDS_UNSEEN", 0.0)
    farm = make_farm()
    hidden = farm.done = _Forgetful()
    failures, _ = run(farm, make_tasks(1, 2))
    assert hidden == {1}
    assert [failure.numbers for failure in failures] == [(2,)]
    assert "it wrote the file, which is not seen here" in failures[0].problem


class _Forgetful(set[int]):
    """A folder on which file 2 never appears."""

    def update(self, *others: Any) -> None:
        super().update(set().union(*others) - {2})


def test_shots_end_where_numbers_are_missing() -> None:
    frames = [(number, Path(str(number))) for number in (1, 2, 3, 7, 9, 10)]
    assert [task.numbers for task in cut_tasks(frames, by_shot=True)] == [(1, 2, 3), (7,), (9, 10)]
    assert [task.numbers for task in cut_tasks(frames, by_shot=False)] == [(1,), (2,), (3,), (7,), (9,), (10,)]


def test_false_starts_count_since_the_last_answer(monkeypatch: pytest.MonkeyPatch) -> None:
    """Memory is short now and then: processes end while they start, and between these another one answers."""
    answers: list[Future[int]] = []

    class Pool:
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def submit(self, *_: object) -> Future[int]:
            answers.append(Future())
            return answers[-1]

        def shutdown(self, **_: object) -> None:
            pass

    monkeypatch.setattr(processes, "ProcessPoolExecutor", Pool)
    found = processes.Processes(2)
    first, _ = found.list_workers()
    for _ in range(2):
        for _ in range(processes.MAX_FALSE_STARTS - 1):
            other = next(name for name in found.list_workers() if name != first)
            call = found.call(other, os.getpid)
            answers[-1].set_exception(BrokenExecutor())
            with pytest.raises(WorkerLostError):
                call.fetch()
        found.call(first, os.getpid)
        answers[-1].set_result(1)
    assert len(found.list_workers()) == 2
