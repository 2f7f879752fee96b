"""Sequences meet files that fit only nearly: the other frames are written, and the frame is named at the end."""

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from lobewise.cli.program import run
from lobewise.interchange import read_image
from lobewise.io import write_frame
from lobewise.metrics import rel_mse
from tests.streaming.frames import make_scene
from tests.temporal.scenes import make_camera, make_frame

CAMERA = make_camera()
NUMBERS = (1, 2, 3, 4, 5)
FAST = ("--quality", "fast")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with five frames of a camera that stands still, and make it the current one."""
    monkeypatch.chdir(tmp_path)
    for number in NUMBERS:
        frame = make_frame(CAMERA, CAMERA if number > 1 else None, noise=0.3, seed=number)
        write_frame(f"in.{number:04d}.exr", frame)
        write_frame(f"b.{number:04d}.exr", make_frame(CAMERA, CAMERA, noise=0.3, seed=number + 50))
    return tmp_path


def denoise(output: str, *options: str) -> int:
    return run(["denoise", "in.####.exr", "-o", f"{output}.####.exr", *FAST, *options])


def read_files(output: str) -> dict[str, bytes]:
    return {path.name.removeprefix(output): path.read_bytes() for path in sorted(Path().glob(f"{output}.*.exr"))}


def cut_off(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


FAULTS: dict[str, Callable[[Path], object]] = {
    "damaged": lambda path: path.write_bytes(b"no image"),
    "being written": cut_off,
    "empty": lambda path: path.write_bytes(b""),
}


@pytest.mark.sampled("damaged-()", "empty-()", "being written-('--window', '1')")
@pytest.mark.parametrize("options", [(), ("--window", "1")], ids=str)
@pytest.mark.parametrize("fault", FAULTS)
def test_a_frame_that_cannot_be_read_is_like_a_missing_one(
    fault: str, options: tuple[str, ...], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    FAULTS[fault](folder / "in.0003.exr")
    assert denoise("out", *options) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "Frame 3: input 'in.0003.exr': " in told
    assert "1 of 5 frames could not be filtered (frame 3); mend what is said above" in told
    (folder / "in.0003.exr").unlink()
    assert denoise("without", *options) == 0
    assert len(read_files("out")) == 4
    assert read_files("out") == read_files("without")


@pytest.mark.sampled("('--window', '1')")
@pytest.mark.parametrize("options", [(), ("--window", "1")], ids=str)
def test_a_frame_without_its_second_half(
    options: tuple[str, ...], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (folder / "b.0002.exr").unlink()
    assert denoise("out", *options, "--half", "b.####.exr") == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "Frame 2: input 'b.0002.exr': expected an existing file" in told
    assert list(read_files("out")) == [".0001.exr", ".0003.exr", ".0004.exr", ".0005.exr"]
    shutil.copy("b.0001.exr", "b.0002.exr")
    assert denoise("out", *options, "--half", "b.####.exr") == 0


def test_what_every_frame_lacks_is_one_sentence(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for path in folder.glob("b.*.exr"):
        path.rename(path.with_name(f"b.9{path.name[3:]}"))
    assert denoise("out", "--half", "b.####.exr") == 2
    told = capsys.readouterr()
    assert " ".join(told.err.split()).startswith("lobewise: input 'b.0001.exr': expected an existing file")
    assert "b.0002.exr" not in told.err
    assert told.out == ""


def test_only_what_failed_is_made_again(folder: Path) -> None:
    whole = (folder / "in.0003.exr").read_bytes()
    cut_off(folder / "in.0003.exr")
    assert denoise("out") == 2
    before = {path: path.stat().st_mtime_ns for path in folder.glob("out.*.exr")}
    (folder / "in.0003.exr").write_bytes(whole)
    assert denoise("out") == 0
    assert {path: path.stat().st_mtime_ns for path in before} == before
    assert not (folder / "out.lobewise-done").exists()


def test_frames_of_another_size_and_below_0_are_filtered(folder: Path) -> None:
    shutil.copy("in.0001.exr", "in.-001.exr")
    write_frame("in.0003.exr", make_scene((20, 30), seed=3))
    for options in ((), ("--window", "1")):
        assert denoise("out", *options) == 0
        assert len(read_files("out")) == 6
        assert read_image("out.0003.exr").shape == (20, 30, 3)


def test_a_data_window_that_moves_is_followed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A render region, or a crop that follows an object: pixels are counted from another corner in every frame."""
    monkeypatch.chdir(tmp_path)
    cameras = [make_camera(0.01 * k, 0.03 * k) for k in range(3)]
    for k, left in enumerate((0, 9, 3)):
        frame = make_frame(cameras[k], cameras[k - 1] if k else None, noise=0.3, seed=k)
        bare = replace(frame.gbuffer, position=None, depth=None)
        write_frame("whole.exr", frame.with_changes(camera=None, gbuffer=bare))
        (part,) = OpenEXR.File("whole.exr").parts
        rows, columns = slice(2, 47), slice(left, left + 50)
        planes = {name: np.ascontiguousarray(one.pixels[rows, columns]) for name, one in part.channels.items()}
        header = {
            **part.header,
            "dataWindow": (np.array([left, 2], np.int32), np.array([left + 49, 46], np.int32)),
            "displayWindow": (np.zeros(2, np.int32), np.array([63, 47], np.int32)),
        }
        OpenEXR.File(header, planes).write(f"in.{k + 1:04d}.exr")
    truth = make_frame(cameras[1]).radiance.color[2:47, 9:59]
    errors = []
    for output, options in (("alone", ()), ("joined", ("--window", "1"))):
        assert denoise(output, *options) == 0
        errors.append(rel_mse(read_image(f"{output}.0002.exr"), truth))
    assert errors[1] < 0.8 * errors[0]


@pytest.mark.parametrize("changed", ["mine.toml", "camera.json", "b.0001.exr"])
def test_a_run_that_goes_on_uses_no_result_of_other_files(changed: str, folder: Path) -> None:
    """A preset, a camera or a second half that changed after a stop changes all frames, or its own."""
    cut_off(folder / "in.0005.exr")
    (folder / "mine.toml").write_text('title = "mine"\ncolor = ["radiance"]\nnormal = ["normal"]\n')
    (folder / "camera.json").write_text('{"position": [0, 0, 0], "forward": [0, 0, -1], "up": [0, 1, 0], "fov_y": 1}')
    options = ("--half", "b.####.exr", "--camera", "camera.json", "--preset", "mine.toml")
    assert denoise("out", *options) == 2
    before = {path.name: path.stat().st_mtime_ns for path in folder.glob("out.*.exr")}
    with Path(changed).open("ab") as stream:
        stream.write(b"\n")
    denoise("out", *options)
    again = {path.name for path in folder.glob("out.*.exr") if path.stat().st_mtime_ns != before[path.name]}
    assert again == ({"out.0001.exr"} if changed == "b.0001.exr" else set(before))
