"""`lobewise denoise --window` on sequences of files."""

from pathlib import Path

import numpy as np
import pytest

from lobewise import WindowFilter, read_frame, write_frame
from lobewise.cli.main import run
from tests.temporal.scenes import make_camera, make_frame

COUNT = 5


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a sequence of a camera that moves, d.0001.exr and on."""
    cameras = [make_camera(0.01 * k, 0.03 * k) for k in range(COUNT)]
    for k, camera in enumerate(cameras):
        write_frame(tmp_path / f"d.{k + 1:04d}.exr", make_frame(camera, cameras[max(k - 1, 0)], noise=0.3, seed=k))
    return tmp_path


def denoise(folder: Path, *more: str) -> int:
    return run(
        ["denoise", str(folder / "d.####.exr"), "-o", str(folder / "o.####.exr"), "--quality", "balanced", *more]
    )


def read_color(path: Path) -> np.ndarray:
    return read_frame(path).radiance.color


def test_every_frame_uses_its_window(folder, capsys):
    assert denoise(folder, "--window", "2") == 0
    frames = [read_frame(folder / f"d.{k:04d}.exr") for k in range(1, COUNT + 1)]
    window = WindowFilter(2, quality="balanced")
    for k in range(COUNT):
        wanted = window.denoise(frames, k).image
        np.testing.assert_allclose(read_color(folder / f"o.{k + 1:04d}.exr"), wanted, rtol=2e-3, atol=1e-3)
    assert "5 of 5 frames" in capsys.readouterr().out


def test_a_missing_number_ends_the_window(folder):
    (folder / "d.0003.exr").unlink()
    assert denoise(folder, "--window", "2") == 0
    frames = [read_frame(folder / f"d.{k:04d}.exr") for k in (1, 2)]
    wanted = WindowFilter(2, quality="balanced").denoise(frames, 1).image
    np.testing.assert_allclose(read_color(folder / "o.0002.exr"), wanted, rtol=2e-3, atol=1e-3)


def test_parts_of_a_sequence_are_those_of_the_whole(folder):
    assert denoise(folder, "--window", "1") == 0
    whole = {path.name: path.read_bytes() for path in folder.glob("o.*")}
    for name in whole:
        (folder / name).unlink()
    assert denoise(folder, "--window", "1", "--frames", "1-3x2,2") == 0
    assert sorted(path.name for path in folder.glob("o.*")) == sorted(whole)[:3]
    assert denoise(folder, "--window", "1", "--frames", "4-5") == 0
    assert {path.name: path.read_bytes() for path in folder.glob("o.*")} == whole
