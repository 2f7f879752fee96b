"""What a worker does with a frame, in this process: the work of the verbs, with the memory of the worker."""

import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from lobewise.cli import farming
from lobewise.cli.program import run
from lobewise.farm.tasks import TaskLog
from lobewise.interchange import read_image
from lobewise.io import write_frame
from lobewise.recipes.streaming import plan
from lobewise.work import limits
from tests.streaming.frames import make_scene

pytestmark = pytest.mark.usefixtures("dask")
CHEAP = ("--quality", "fast", "--similarity", "normal")
CAMERA = '{"position": [0, 0, 0], "forward": [0, 0, -1], "up": [0, 1, 0], "fov_y": 1}'


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with two frames of 83x19 pixels, and make it the current one."""
    monkeypatch.chdir(tmp_path)
    for number in (1, 2):
        write_frame(f"in.{number}.exr", make_scene((83, 19), seed=number))
    return tmp_path


class Caught(Exception):
    """Carries the job that a verb would send to a farm."""


def catch_job(*options: str, monkeypatch: pytest.MonkeyPatch, verb: Sequence[str] = ("denoise", *CHEAP)) -> Any:
    """Return the job that the program would send to a farm."""
    found: list[Any] = []

    def catch(job: Any, *_: Any, **__: Any) -> None:
        found.append(job)
        raise Caught

    with monkeypatch.context() as patch:
        patch.setattr(farming, "filter_on_farm", catch)
        assert run([*verb, "in.#.exr", "-o", "far.#.exr", "--workers", "2", *options]) == 1
    return found[0]


def do(job: Any, *numbers: int, memory: float | None = None) -> TaskLog:
    """Let a worker filter frames; return what it told."""
    sent = pickle.loads(pickle.dumps(job.work))
    with job.ledger.lock():
        told: TaskLog = sent.filter_frames(numbers, memory=memory, ledger=job.ledger)
    return told


def test_frames_are_those_of_the_verb_and_remarks_are_told_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["denoise", "in.#.exr", "-o", "near.#.exr", *CHEAP]) == 0
    capsys.readouterr()
    job = catch_job(monkeypatch=monkeypatch)
    first, second = do(job, 1), do(job, 2)
    assert job.ledger.list_recorded() == {1, 2}
    for number in (1, 2):
        assert (folder / f"far.{number}.exr").read_bytes() == (folder / f"near.{number}.exr").read_bytes()
    assert any("Used: " in text for _, text in first.remarks)
    assert second.remarks == ()
    assert "19x83 pixels, quality fast" in first.last
    assert "similarity normal" in first.settings
    # Nothing is printed on a worker.
    assert capsys.readouterr().out == ""


def test_a_frame_that_is_too_large_for_the_worker_is_filtered_in_bands(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(["denoise", "in.#.exr", "-o", "near.#.exr", *CHEAP]) == 0
    monkeypatch.setattr(limits, "PROGRAM_GIB", 100.0)
    # The smallest band would still be refused.
    monkeypatch.setattr(plan, "require_memory", lambda needed: None)
    job = catch_job(monkeypatch=monkeypatch)
    assert "bands" not in do(job, 1).last
    (folder / "far.1.exr").unlink()
    told = do(job, 1, memory=1.0)
    assert "19x83 pixels in 3 bands" in told.last
    assert (folder / "far.1.exr").read_bytes() == (folder / "near.1.exr").read_bytes()


def test_everything_that_changes_a_frame_is_among_its_sources(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "half.2.exr").write_bytes((folder / "in.2.exr").read_bytes())
    (folder / "camera.json").write_text(CAMERA)
    job = catch_job("--half", "half.#.exr", "--camera", "camera.json", monkeypatch=monkeypatch)
    sources = job.work.list_sources(2, job.source.name(2))
    assert sources == [folder / "in.2.exr", folder / "half.2.exr"]
    windowed = catch_job("--window", "1", monkeypatch=monkeypatch)
    work = windowed.work
    assert (job.by_runs, windowed.by_runs) == (False, True)
    assert work.list_sources(2, job.source.name(2)) == [folder / "in.1.exr", folder / "in.2.exr"]
    past = catch_job("--temporal", monkeypatch=monkeypatch).work
    assert past.list_sources(1, job.source.name(1)) == [folder / "in.1.exr"]
    (folder / "camera.json").write_text(f"{CAMERA} ")
    other = catch_job("--half", "half.#.exr", "--camera", "camera.json", monkeypatch=monkeypatch)
    assert other.ledger.identity != job.ledger.identity
    changes = ((), ("--progress", "off"), ("--beta", "2"))
    plain, silent, wide = (catch_job(*words, monkeypatch=monkeypatch).ledger.identity for words in changes)
    assert plain == silent != wide


def test_only_the_frames_that_are_asked_for(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert catch_job(monkeypatch=monkeypatch).numbers is None
    assert catch_job("--frames", "2", monkeypatch=monkeypatch).numbers == [2]


def test_paths_are_absolute(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "camera.json").write_text(CAMERA)
    work = catch_job("--camera", "camera.json", "--half", "in.#.exr", monkeypatch=monkeypatch).work
    paths = [work.source, work.output, work.request.camera, work.request.half]
    assert all(path.is_absolute() for path in paths)


def test_a_shot_over_time_is_one_task(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert catch_job("--temporal", monkeypatch=monkeypatch, verb=["upsample"]).by_shot
    assert not catch_job(monkeypatch=monkeypatch, verb=["upsample"]).by_shot
    assert not catch_job(monkeypatch=monkeypatch).by_shot


def test_pictures_are_outputs_and_have_one_exposure(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(["denoise", "in.#.exr", "-o", "near.#.exr", *CHEAP, "--png"]) == 0
    job = catch_job("--png", monkeypatch=monkeypatch)
    assert job.work.list_outputs(2) == [folder / "far.2.exr", folder / "far.2.png"]
    do(job, 1)
    farming._open_filter.cache_clear()
    do(job, 2)
    for number in (1, 2):
        assert (folder / f"far.{number}.png").read_bytes() == (folder / f"near.{number}.png").read_bytes()


def test_a_single_process_goes_on_where_workers_were_stopped(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    job = catch_job(monkeypatch=monkeypatch)
    do(job, 1)
    before = (folder / "far.1.exr").stat().st_mtime_ns
    with job.ledger.lock():
        # A second command beside a running one.
        assert run(["denoise", "in.#.exr", "-o", "far.#.exr", *CHEAP]) == 2
        assert not (folder / "far.2.exr").exists()
    assert run(["denoise", "in.#.exr", "-o", "far.#.exr", *CHEAP]) == 0
    assert (folder / "far.1.exr").stat().st_mtime_ns == before
    assert read_image("far.2.exr").shape == (83, 19, 3)
    assert not job.ledger.folder.exists()
