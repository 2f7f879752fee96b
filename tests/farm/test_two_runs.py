"""Two runs of one sequence on a disk without locks: the later one takes over, and keeps its records."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import pytest

from lobewise.errors import FileError
from lobewise.farm import dispatching, ledger
from lobewise.farm.environment import describe_environment
from lobewise.farm.ledger import Ledger, name_ledger
from lobewise.farm.running import FarmJob, filter_on_farm
from lobewise.farm.tasks import Task
from lobewise.io.sequence import FramePattern
from tests.farm.test_dispatching import FakeFarm


@dataclass
class Work:
    """The file of frame N is ``out.N.exr``."""

    folder: Path

    def list_sources(self, number: int, path: Path) -> Sequence[Path]:
        return [path]

    def list_outputs(self, number: int) -> Sequence[Path]:
        return [self.folder / f"out.{number}.exr"]


def make_job(folder: Path) -> FarmJob:
    """Return the job of a sequence of two frames in a folder."""
    for number in (1, 2):
        (folder / f"in.{number}.exr").write_bytes(b"noisy")
    return FarmJob(
        source=FramePattern.parse(folder / "in.#.exr"),
        output=FramePattern.parse(folder / "out.#.exr"),
        work=cast(Any, Work(folder)),
        fingerprint="",
        by_shot=False,
        follows_first=False,
        by_runs=False,
        with_oidn=False,
        memory=None,
    )


def test_the_earlier_run_ends_with_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(ledger, "try_lock", lambda _: True)
    for name in ("POLL_SECONDS", "RETRY_SECONDS", "MAX_SECONDS_UNSEEN"):
        monkeypatch.setattr(dispatching, name, 0.0)
    job = make_job(tmp_path)
    later = Ledger(folder=name_ledger(job.output), identity="later")

    def begin_later_run(worker: str, task: Task) -> bool:
        later.put_token("later")
        later.record(1, "proof", [])
        return True

    farm = FakeFarm({"a": describe_environment(with_oidn=False)}, on_task=begin_later_run)
    with pytest.raises(FileError, match="expected no other run that writes this sequence, got one that began later"):
        filter_on_farm(
            job,
            contextlib.nullcontext(cast(Any, farm)),
            tell=lambda _: None,
            remark=lambda *_: None,
            progress=lambda *_: None,
        )
    assert later.list_recorded() == {1}
    assert later.has_token("later")
