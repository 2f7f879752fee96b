"""The verbs on sequences: every frame has its file, a stop loses nothing, mistakes are one sentence."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise import TemporalFilter, WindowFilter, read_frame, read_sparse_frame, write_frame, write_sparse_frame
from lobewise.cli.program import run
from lobewise.denoising import denoise
from lobewise.interchange import read_image, write_result
from lobewise.io.sequence import FramePattern
from lobewise.recipes.ledger import name_ledger, open_ledger
from lobewise.recipes.sequence import filter_sequence
from lobewise.records.frame import Frame
from lobewise.records.sparse_frame import list_places, make_sparse
from tests.temporal.scenes import make_camera, make_frame

COUNT = 5


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a short sequence of a camera that moves, whole (d) and sparse (s)."""
    made = tmp_path_factory.mktemp("sequence")
    cameras = [make_camera(0.01 * k, 0.03 * k) for k in range(COUNT)]
    for k, camera in enumerate(cameras):
        frame = make_frame(camera, cameras[k - 1] if k else None, noise=0.5, seed=k)
        write_frame(made / f"d.{k + 1:04d}.exr", frame)
        write_sparse_frame(made / f"s.{k + 1:04d}.exr", make_sparse(frame, 4, list_places(4)[k]))
    return made


def denoise_sequence(folder: Path, target: Path, *words: str) -> None:
    assert run(["denoise", str(folder / "d.####.exr"), "-o", str(target / "o.####.exr"), *words]) == 0


def require_results(target: Path, frames: list[Frame], number: int, window: WindowFilter) -> None:
    """Raise AssertionError unless files from a number on are frames that a window filters."""
    for k in range(len(frames)):
        written = read_image(target / f"o.{number + k:04d}.exr")
        np.testing.assert_allclose(written, window.denoise(frames, k).image, rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize(
    ("words", "settings"),
    [
        pytest.param("--temporal", {"past_only": True}, marks=pytest.mark.nightly),
        ("--temporal --quality fast", {"past_only": True, "quality": "fast"}),
        ("--window 2 --quality balanced", {"quality": "balanced"}),
    ],
)
def test_every_frame_uses_its_window_up_to_a_missing_number(
    words: str, settings: dict[str, Any], folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames, window = [read_frame(folder / f"d.{k:04d}.exr") for k in range(1, COUNT + 1)], WindowFilter(2, **settings)
    denoise_sequence(folder, tmp_path, *words.split())
    assert "5 of 5 frames" in capsys.readouterr().out.replace("\n", " ")
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"o.{k:04d}.exr" for k in range(1, COUNT + 1)]
    require_results(tmp_path, frames, 1, window)
    for k in (1, 2, 4, 5):
        (tmp_path / f"d.{k:04d}.exr").symlink_to(folder / f"d.{k:04d}.exr")
    denoise_sequence(tmp_path, tmp_path, *words.split())
    require_results(tmp_path, frames[:2], 1, window)
    require_results(tmp_path, frames[3:], 4, window)


def test_parts_of_a_sequence_are_those_of_the_whole(folder: Path, tmp_path: Path) -> None:
    words = ("--window", "1", "--quality", "balanced")
    denoise_sequence(folder, tmp_path, *words)
    whole = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    for name in whole:
        (tmp_path / name).unlink()
    denoise_sequence(folder, tmp_path, *words, "--frames", "1-3x2,2")
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(whole)[:3]
    denoise_sequence(folder, tmp_path, *words, "--frames", "4-5")
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == whole


def test_upsampling_a_sequence_is_the_filter_frame_by_frame(folder: Path, tmp_path: Path) -> None:
    line = ["upsample", str(folder / "s.%04d.exr"), "-o", str(tmp_path / "o.%04d.exr"), "--temporal", "--memory", "0.9"]
    assert run(line) == 0
    active = TemporalFilter(memory=0.9)
    for k in range(1, COUNT + 1):
        expected = active.add(read_sparse_frame(folder / f"s.{k:04d}.exr")).image
        np.testing.assert_allclose(read_image(tmp_path / f"o.{k:04d}.exr"), expected, rtol=1e-3, atol=1e-4)


def test_without_the_option_every_frame_is_filtered_by_itself(folder: Path, tmp_path: Path, capsys) -> None:
    denoise_sequence(folder, tmp_path, "--quality", "balanced")
    assert "--temporal" not in capsys.readouterr().err
    expected = denoise(read_frame(folder / "d.0003.exr"), quality="balanced").image
    np.testing.assert_allclose(read_image(tmp_path / "o.0003.exr"), expected, rtol=1e-3, atol=1e-4)


def test_a_run_that_was_stopped_goes_on_with_the_same_bits(folder: Path, tmp_path: Path) -> None:
    def filter_into(where: Path, stop_at: int | None) -> None:
        count = 0

        def write(target, result, frame, source) -> None:
            nonlocal count
            count += 1
            if count == stop_at:
                raise KeyboardInterrupt
            write_result(target, result, source=source)

        names = [FramePattern.parse(folder / "d.####.exr"), FramePattern.parse(where / "o.####.exr")]
        ledger = open_ledger(*names, None, "x")
        with ledger.hold():
            options = {"ledger": ledger, "checkpoint_seconds": 0.0}
            filter_sequence(*names, TemporalFilter, read=read_frame, write=write, **options)
            ledger.remove()

    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    whole.mkdir()
    stopped.mkdir()
    filter_into(whole, None)
    with pytest.raises(KeyboardInterrupt):
        filter_into(stopped, 4)
    assert name_ledger(stopped / "o.####.exr").exists()
    filter_into(stopped, None)
    for k in range(1, COUNT + 1):
        name = f"o.{k:04d}.exr"
        assert (whole / name).read_bytes() == (stopped / name).read_bytes()
    assert not name_ledger(stopped / "o.####.exr").exists()


def test_a_missing_frame_is_named_and_notes_name_their_frame(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = make_camera(shift=0.0)
    for number in (1, 2, 4):
        frame = make_frame(camera, None, noise=0.5, seed=number)
        if number == 2:
            frame = frame.with_changes(gbuffer=replace(frame.gbuffer, diffuse_albedo=np.full((*frame.shape, 3), 7.0)))
        write_frame(tmp_path / f"d.{number:04d}.exr", frame)
    denoise_sequence(tmp_path, tmp_path, "--quality", "fast")
    told = " ".join(capsys.readouterr().err.split())
    assert told.startswith("Frame 3 of 1 to 4 is missing.")
    assert "Frame 2: diffuse_albedo is above 1" in told
    assert "Frame 1: Used: lobewise's own filters" in told
    assert told.count("Used:") == 1
