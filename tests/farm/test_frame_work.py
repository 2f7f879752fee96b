"""What a worker does with a frame, in this process: the work of the verbs, with the memory of the worker."""

import pickle
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest

from lobewise.cli import farming
from lobewise.cli.farming import FrameWork
from lobewise.cli.program import run
from lobewise.farm.ledger import name_ledger
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


def do(work: FrameWork, *numbers: int, memory: float | None = None) -> tuple[TaskLog, list[int]]:
    """Let a worker filter frames; return what it told, and the frames that it called done."""
    done: list[int] = []
    sent = pickle.loads(pickle.dumps(work))
    told = sent.filter_frames(numbers, first=1, memory=memory, checkpoint=Path("kept.npz"), done=done.append)
    return told, done


def test_frames_are_those_of_the_verb_and_remarks_are_told_once(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["denoise", "in.#.exr", "-o", "near.#.exr", *CHEAP]) == 0
    capsys.readouterr()
    job = catch_job(monkeypatch=monkeypatch)
    first, done = do(job.work, 1)
    second, _ = do(job.work, 2)
    assert done == [1]
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
    work = catch_job(monkeypatch=monkeypatch).work
    assert "bands" not in do(work, 1)[0].last
    told, _ = do(work, 1, memory=1.0)
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
    assert other.fingerprint != job.fingerprint
    changes = ((), ("--progress", "off"), ("--beta", "2"))
    plain, silent, wide = (catch_job(*words, monkeypatch=monkeypatch).fingerprint for words in changes)
    assert plain == silent != wide


def test_only_the_frames_that_are_asked_for(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert catch_job(monkeypatch=monkeypatch).numbers is None
    assert catch_job("--frames", "2", monkeypatch=monkeypatch).numbers == [2]


def test_paths_are_absolute(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "camera.json").write_text(CAMERA)
    work = catch_job("--camera", "camera.json", "--half", "in.#.exr", monkeypatch=monkeypatch).work
    paths = [work.source, work.output, work.request.camera, work.request.half]
    assert all(path.is_absolute() for path in paths)


@pytest.mark.parametrize(
    ("options", "follows"), [((), False), (("--png",), True), (("--png", "--exposure", "1"), False)]
)
def test_which_frames_depend_on_others(
    options: tuple[str, ...], follows: bool, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = catch_job(*options, monkeypatch=monkeypatch)
    assert (job.follows_first, job.by_shot) == (follows, False)


def test_a_shot_over_time_is_one_task(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert catch_job("--temporal", monkeypatch=monkeypatch, verb=["upsample"]).by_shot
    assert not catch_job(monkeypatch=monkeypatch, verb=["upsample"]).by_shot


def test_pictures_are_outputs_and_have_the_exposure_of_the_first(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    assert run(["denoise", "in.#.exr", "-o", "near.#.exr", *CHEAP, "--png"]) == 0
    work = catch_job("--png", monkeypatch=monkeypatch).work
    assert work.list_outputs(2) == [folder / "far.2.exr", folder / "far.2.png"]
    do(work, 1)
    # Another worker knows the exposure from the picture alone.
    farming._open_filter.cache_clear()
    do(work, 2)
    for number in (1, 2):
        assert (folder / f"far.{number}.png").read_bytes() == (folder / f"near.{number}.png").read_bytes()


def test_a_single_process_that_ends_removes_what_a_farm_recorded(folder: Path) -> None:
    records = name_ledger(folder / "out.#.exr")
    records.mkdir()
    (records / "1.json").write_text("{}")
    assert run(["denoise", "in.#.exr", "-o", "out.#.exr", *CHEAP]) == 0
    assert not records.exists()
    assert read_image("out.2.exr").shape == (83, 19, 3)
