"""Two runs of one sequence: runs of other frames do not meet. Without locks the later run of the same takes over."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest

from lobewise.errors import FileError
from lobewise.farm import dispatching
from lobewise.farm.running import FarmJob, FarmReport, filter_on_farm
from lobewise.farm.tasks import Task
from lobewise.io import locks
from lobewise.io.sequence import FramePattern
from lobewise.recipes.environment import describe_environment
from lobewise.recipes.ledger import Ledger, name_ledger
from tests.farm.test_dispatching import FakeFarm
from tests.mistakes import refuses


@dataclass
class Work:
    """The file of frame N is ``out.N.exr``."""

    folder: Path

    def list_sources(self, number: int, path: Path) -> Sequence[Path]:
        return [path]

    def list_outputs(self, number: int) -> Sequence[Path]:
        return [self.folder / f"out.{number}.exr"]


@pytest.fixture(autouse=True)
def _without_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("POLL_SECONDS", "RETRY_SECONDS", "MAX_SECONDS_UNSEEN"):
        monkeypatch.setattr(dispatching, name, 0.0)


def make_job(folder: Path, numbers: Sequence[int] | None = None) -> FarmJob:
    """Return the job of a sequence of two frames in a folder, or of some of them."""
    for number in (1, 2):
        (folder / f"in.{number}.exr").write_bytes(b"noisy")
    return FarmJob(
        source=FramePattern.parse(folder / "in.#.exr"),
        output=FramePattern.parse(folder / "out.#.exr"),
        work=cast(Any, Work(folder)),
        ledger=Ledger(folder=name_ledger(folder / "out.#.exr", numbers), identity=""),
        by_shot=False,
        by_runs=False,
        with_oidn=False,
        memory=None,
        numbers=numbers,
    )


def run_job(job: FarmJob, farm: FakeFarm) -> FarmReport:
    """Send a job to a farm, whose workers write nothing."""
    return filter_on_farm(job, contextlib.nullcontext(cast(Any, farm)), tell=lambda _: None, remark=lambda *_: None)


def test_the_earlier_run_ends_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(locks, "try_lock", lambda _: True)
    job = make_job(tmp_path)
    later = Ledger(folder=job.ledger.folder, identity="later")

    def begin_later_run(worker: str, task: Task) -> bool:
        later.put_token("later")
        later.record(1, "proof", [])
        return True

    farm = FakeFarm({"a": describe_environment(with_oidn=False)}, on_task=begin_later_run)
    with refuses(FileError, "records 'out.lobewise-done'"):
        run_job(job, farm)
    assert later.list_recorded() == {1}
    assert later.has_token("later")


def test_runs_of_other_frames_work_at_the_same_time(tmp_path: Path) -> None:
    environment = {"a": describe_environment(with_oidn=False)}
    other = FakeFarm(environment)

    def run_other(worker: str, task: Task) -> bool:
        if not other.ran:
            assert run_job(make_job(tmp_path, [2]), other).frames == 1
        return True

    farm = FakeFarm(environment, on_task=run_other)
    assert run_job(make_job(tmp_path, [1]), farm).frames == 1
    assert {numbers for _, numbers in farm.ran} == {(1,)}
    assert {numbers for _, numbers in other.ran} == {(2,)}
