"""The verbs on sequences: every frame has its file, a stop loses nothing, mistakes are one sentence."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lobewise import TemporalFilter, WindowFilter, read_frame, read_sparse_frame, write_frame, write_sparse_frame
from lobewise.cli.main import run
from lobewise.denoising import denoise
from lobewise.interchange import read_image, write_result
from lobewise.recipes.sequence import filter_sequence, name_checkpoint
from lobewise.records.sparse_frame import list_places, make_sparse
from tests.temporal.scenes import make_camera, make_frame

COUNT = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with a short sequence, whole (d) and sparse (s)."""
    made = tmp_path_factory.mktemp("sequence")
    cameras = [make_camera(shift=0.02 * k) for k in range(COUNT)]
    for k, camera in enumerate(cameras):
        frame = make_frame(camera, cameras[k - 1] if k else None, noise=0.5, seed=k)
        write_frame(made / f"d.{k + 1:04d}.exr", frame)
        write_sparse_frame(made / f"s.{k + 1:04d}.exr", make_sparse(frame, 4, list_places(4)[k]))
    return made


def test_denoising_a_sequence_is_the_filter_frame_by_frame(folder: Path, tmp_path: Path, capsys) -> None:
    assert run(["denoise", str(folder / "d.####.exr"), "-o", str(tmp_path / "o.####.exr"), "--temporal"]) == 0
    assert "4 of 4 frames" in capsys.readouterr().out.replace("\n", " ")
    window = WindowFilter(2, past_only=True)
    frames = [read_frame(folder / f"d.{k:04d}.exr") for k in range(1, COUNT + 1)]
    for k in range(1, COUNT + 1):
        expected = window.denoise(frames[:k], k - 1).image
        written = read_image(tmp_path / f"o.{k:04d}.exr")
        np.testing.assert_allclose(written, expected, rtol=1e-3, atol=1e-4)
    assert sorted(path.name for path in tmp_path.iterdir()) == [f"o.{k:04d}.exr" for k in range(1, COUNT + 1)]


def test_upsampling_a_sequence_is_the_filter_frame_by_frame(folder: Path, tmp_path: Path) -> None:
    line = ["upsample", str(folder / "s.%04d.exr"), "-o", str(tmp_path / "o.%04d.exr"), "--temporal", "--memory", "0.9"]
    assert run(line) == 0
    active = TemporalFilter(memory=0.9)
    for k in range(1, COUNT + 1):
        expected = active.add(read_sparse_frame(folder / f"s.{k:04d}.exr")).image
        np.testing.assert_allclose(read_image(tmp_path / f"o.{k:04d}.exr"), expected, rtol=1e-3, atol=1e-4)


def test_without_the_option_every_frame_is_filtered_by_itself(folder: Path, tmp_path: Path, capsys) -> None:
    line = ["denoise", str(folder / "d.####.exr"), "-o", str(tmp_path / "o.####.exr"), "--quality", "balanced"]
    assert run(line) == 0
    assert "--temporal" not in capsys.readouterr().err
    expected = denoise(read_frame(folder / "d.0003.exr"), quality="balanced").image
    np.testing.assert_allclose(read_image(tmp_path / "o.0003.exr"), expected, rtol=1e-3, atol=1e-4)


def test_a_missing_number_is_a_cut(folder: Path, tmp_path: Path) -> None:
    for k in (1, 2, 4):
        (tmp_path / f"d.{k:04d}.exr").symlink_to(folder / f"d.{k:04d}.exr")
    assert run(["denoise", str(tmp_path / "d.####.exr"), "-o", str(tmp_path / "o.####.exr"), "--temporal"]) == 0
    expected = denoise(read_frame(folder / "d.0004.exr")).image
    np.testing.assert_allclose(read_image(tmp_path / "o.0004.exr"), expected, rtol=1e-3, atol=1e-4)


def test_a_run_that_was_stopped_goes_on_with_the_same_bits(folder: Path, tmp_path: Path) -> None:
    def filter_into(where: Path, stop_at: int | None) -> None:
        count = 0

        def write(target, result, frame, source) -> None:
            nonlocal count
            count += 1
            if count == stop_at:
                raise KeyboardInterrupt
            write_result(target, result, source=source)

        filter_sequence(
            folder / "d.####.exr",
            where / "o.####.exr",
            TemporalFilter,
            read=read_frame,
            write=write,
            fingerprint="x",
            checkpoint_seconds=0.0,
        )

    whole, stopped = tmp_path / "whole", tmp_path / "stopped"
    whole.mkdir()
    stopped.mkdir()
    filter_into(whole, None)
    with pytest.raises(KeyboardInterrupt):
        filter_into(stopped, 4)
    assert name_checkpoint(stopped / "o.####.exr").exists()
    filter_into(stopped, None)
    for k in range(1, COUNT + 1):
        name = f"o.{k:04d}.exr"
        assert (whole / name).read_bytes() == (stopped / name).read_bytes()
    assert not name_checkpoint(stopped / "o.####.exr").exists()


def test_a_missing_frame_is_named_and_notes_name_their_frame(
    tmp_path: Path, rng: np.random.Generator, capsys: pytest.CaptureFixture[str]
) -> None:
    camera = make_camera(shift=0.0)
    for number in (1, 2, 4):
        frame = make_frame(camera, None, noise=0.5, seed=number)
        if number == 2:
            frame = frame.with_changes(gbuffer=replace(frame.gbuffer, diffuse_albedo=np.full((*frame.shape, 3), 7.0)))
        write_frame(tmp_path / f"d.{number:04d}.exr", frame)
    line = ["denoise", str(tmp_path / "d.####.exr"), "-o", str(tmp_path / "o.####.exr"), "--quality", "fast"]
    assert run(line) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert told.startswith("Frame 3 of 1 to 4 is missing.")
    assert "Frame 2: diffuse_albedo is above 1" in told
    assert "Frame 1: Used: lobewise's own filters" in told
    assert told.count("Used:") == 1
