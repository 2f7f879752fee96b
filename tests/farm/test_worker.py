"""What a worker is asked, and what it does with an assignment that goes wrong."""

import os
import threading
import time
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

import lobewise
from lobewise.errors import InputError
from lobewise.farm import worker as module
from lobewise.farm.tasks import Assignment, TaskLog, TaskResult, cut_tasks
from lobewise.farm.worker import GIB, describe_worker, run_assignment
from lobewise.recipes.environment import compare_environments, describe_environment
from lobewise.recipes.ledger import TOKEN, Ledger
from lobewise.recipes.sequence import FilterAlone, filter_sequence


@dataclass
class Work:
    """Filters a frame by calling a function with its number; the file of frame N is ``out.N``."""

    folder: Path
    act: Callable[[int], None] = lambda number: None
    given: float | None = None

    def list_sources(self, number: int, path: Path) -> Sequence[Path]:
        return [path]

    def list_outputs(self, number: int) -> Sequence[Path]:
        return [self.folder / f"out.{number}"]

    def filter_frames(self, numbers: Sequence[int], *, memory: float | None, ledger: Ledger) -> TaskLog:
        self.given = memory

        def read(path: Path) -> Path:
            self.act(int(path.suffix[1:]))
            return path

        report = filter_sequence(
            self.folder / "in.#",
            self.folder / "out.#",
            lambda: FilterAlone(str),
            read=read,
            write=lambda target, *_: (target.write_text("clean"), None)[1],
            ledger=ledger,
            numbers=numbers,
        )
        report.require_all()
        return TaskLog(last="the last" if report.written else "")


@pytest.fixture(autouse=True)
def dask_worker(monkeypatch: pytest.MonkeyPatch) -> SimpleNamespace:
    """Stand in for Dask's worker: three threads, 6 GiB."""
    found = SimpleNamespace(
        state=SimpleNamespace(nthreads=3), memory_manager=SimpleNamespace(memory_limit=int(6 * GIB))
    )
    monkeypatch.setattr(module, "_get_dask_worker", lambda: found)
    for name in ("HL_NUM_THREADS", "OIDN_NUM_THREADS", "OIDN_SET_AFFINITY"):
        monkeypatch.setenv(name, "x")
        monkeypatch.delenv(name)
    return found


def make_assignment(folder: Path, act: Callable[[int], None] = lambda number: None, **options: Any) -> Assignment:
    for number in (1, 2):
        (folder / f"in.{number}").write_text("noisy")
    ledger = Ledger(folder=folder / "ledger", identity="")
    with ledger.lock():
        ledger.put_token("token")
    task = cut_tasks([(1, folder / "in.1")], by_shot=False)[0]
    return Assignment(work=Work(folder, act), task=task, ledger=ledger, memory=options.get("memory"))


def do(assignment: Assignment) -> TaskResult:
    """Let this process do an assignment that is for it."""
    return run_assignment(assignment, module.PROCESS)


def is_done(assignment: Assignment) -> bool:
    proof = assignment.ledger.prove(assignment.task.frames, assignment.work.list_sources)[1]
    return assignment.ledger.is_done(1, proof, assignment.work.list_outputs(1))


def test_a_frame_is_recorded_and_then_not_filtered_again(tmp_path: Path) -> None:
    seen: list[int] = []
    assignment = make_assignment(tmp_path, seen.append)
    assert do(assignment) == TaskResult(log=TaskLog(last="the last"))
    assert is_done(assignment)
    assert do(assignment) == TaskResult()
    assert seen == [1]


def test_an_order_for_a_process_that_ended_is_not_done(tmp_path: Path) -> None:
    assignment = make_assignment(tmp_path)
    assert run_assignment(assignment, "another process") == TaskResult(is_lost=True)
    assert not is_done(assignment)


def refuse(_: int) -> None:
    raise InputError("radius", expected="less", got="more", action="pass less")


def break_down(_: int) -> None:
    raise ValueError("odd\nthing")


def test_an_error_of_a_user_is_its_sentence(tmp_path: Path) -> None:
    assignment = make_assignment(tmp_path, refuse)
    result = do(assignment)
    assert (result.problem, result.trace) == ("radius: expected less, got more; pass less.", "")
    assert not is_done(assignment)


def test_a_mistake_of_the_program_has_its_traceback(tmp_path: Path) -> None:
    result = do(make_assignment(tmp_path, break_down))
    assert result.problem == "something went wrong inside lobewise (ValueError: odd thing)."
    assert "break_down" in result.trace


@pytest.mark.filterwarnings("default")
def test_warnings_become_remarks(tmp_path: Path) -> None:
    result = do(make_assignment(tmp_path, lambda _: warnings.warn("mind this", stacklevel=1)))
    assert result.log.remarks == (("mind this", "mind this"),)


def test_a_source_that_changes_meanwhile_is_not_done(tmp_path: Path) -> None:
    assignment = make_assignment(tmp_path, lambda _: (tmp_path / "in.1").write_text("other"))
    (tmp_path / "in.1").write_text("noisy, longer")
    assert do(assignment).problem == ""
    assert not is_done(assignment)


def test_threads_and_memory_are_those_of_the_worker(tmp_path: Path) -> None:
    assignment = make_assignment(tmp_path)
    do(assignment)
    assert assignment.work.given == 6.0  # type: ignore[attr-defined]
    assert (os.environ["HL_NUM_THREADS"], os.environ["OIDN_NUM_THREADS"]) == ("3", "3")


def test_what_the_user_sets_counts_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, dask_worker: SimpleNamespace
) -> None:
    monkeypatch.setenv("HL_NUM_THREADS", "2")
    assignment = make_assignment(tmp_path, memory=4.0)
    do(assignment)
    assert assignment.work.given == 4.0  # type: ignore[attr-defined]
    assert os.environ["HL_NUM_THREADS"] == "2"
    dask_worker.memory_manager.memory_limit = 0
    (tmp_path / "out.1").unlink()
    assignment = make_assignment(tmp_path)
    do(assignment)
    assert assignment.work.given is None  # type: ignore[attr-defined]


def test_one_frame_at_a_time(tmp_path: Path) -> None:
    running: list[int] = []
    most: list[int] = []

    def act(_: int) -> None:
        running.append(1)
        most.append(len(running))
        time.sleep(0.02)
        running.pop()

    threads = []
    for number in range(3):
        (tmp_path / str(number)).mkdir()
        threads.append(threading.Thread(target=do, args=(make_assignment(tmp_path / str(number), act),)))
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert most == [1, 1, 1]


def test_what_a_worker_does_not_see(tmp_path: Path) -> None:
    assignment = make_assignment(tmp_path)
    folder, source = assignment.ledger.folder, tmp_path / "in.1"

    def describe_fault(**changes: Any) -> str:
        given = {"folder": folder, "token": "token", "source": source, "size": 5, **changes}
        return describe_worker(**given, with_oidn=False)[2]

    assert describe_fault() == ""
    assert describe_fault(source=tmp_path / "in.9") == f"it does not see the file '{tmp_path / 'in.9'}'"
    assert describe_fault(size=6) == f"it sees another file as '{source}'"
    assert describe_fault(token="other") == f"it sees another folder as '{tmp_path}'"
    (folder / TOKEN).unlink()
    assert describe_fault() == f"it does not see the folder '{tmp_path}'"


def test_versions_are_compared() -> None:
    here = describe_environment(with_oidn=False)
    assert here["lobewise"] == lobewise.__version__
    assert set(here) == {"lobewise", "Python", "NumPy", "Halide", "OpenEXR"}
    assert "none" not in here.values()
    assert set(describe_environment(with_oidn=True)) == {*here, "Open Image Denoise"}
    assert compare_environments(here, dict(here)) == ""
    assert compare_environments(here, {**here, "Halide": "1"}) == f"Halide 1 instead of {here['Halide']}"
    assert compare_environments(here, {}) == f"lobewise none instead of {lobewise.__version__}"
