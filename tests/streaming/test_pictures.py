"""`--png`: a tone-mapped picture beside every EXR file, however it is denoised; written whole or not at all."""

import os
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from PIL import Image

from lobewise.cli.program import run
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.interchange import read_image
from lobewise.io import write_frame
from lobewise.io.png import encode_png, read_png_text
from lobewise.reporting import picture as pictures
from lobewise.reporting.picture import EXPOSURE, Pictures, name_picture
from tests.streaming.frames import make_scene

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
CHEAP = ["--quality", "fast", "--similarity", "normal", "--radius", "1"]


def load(path: Path) -> np.ndarray:
    return np.asarray(Image.open(path))


def paint(path: Path, exposure: float | None = None) -> np.ndarray:
    """Return the picture that a file should have."""
    image = read_image(path)
    return map_tones(image, choose_exposure(image) if exposure is None else exposure)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder with a sequence, the second of whose frames is much brighter."""
    for number, factor in ((1, 1.0), (2, 8.0), (3, 1.0)):
        frame = make_scene((83, 19), seed=number)
        radiance = frame.radiance
        brighter = type(radiance)(*(factor * image for image in (radiance.color, radiance.diffuse, radiance.specular)))
        write_frame(tmp_path / f"in.{number:04d}.exr", frame.with_changes(radiance=brighter, half_a=None, half_b=None))
    return tmp_path


def denoise(folder: Path, *more: str, source: str = "in.0001.exr", output: str = "out.exr") -> int:
    return run(["denoise", str(folder / source), "-o", str(folder / output), *CHEAP, *more])


@pytest.mark.parametrize("bands", ["off", "30"])
def test_the_picture_is_that_of_the_file(bands: str, folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert denoise(folder, "--png", "--bands", bands) == 0
    assert capsys.readouterr().out.splitlines()[1] == f"Wrote {folder / 'out.png'}."
    np.testing.assert_array_equal(load(folder / "out.png"), paint(folder / "out.exr"))
    assert denoise(folder, "--bands", bands, output="bare.exr") == 0
    assert not (folder / "bare.png").exists()
    assert (folder / "bare.exr").read_bytes() == (folder / "out.exr").read_bytes()


@pytest.mark.parametrize("bands", ["off", "30"])
def test_the_picture_shows_the_image_of_a_renderers_file(bands: str, folder: Path) -> None:
    frame = make_scene((83, 19), seed=1)
    passes = {
        "albedo.RGB": frame.gbuffer.diffuse_albedo,
        "beauty.RGB": frame.radiance.color,
        "N.XYZ": frame.gbuffer.normal,
    }
    parts = []
    for name, image in passes.items():
        path, letters = name.split(".")
        planes = {letter: np.ascontiguousarray(image[..., k], np.float16) for k, letter in enumerate(letters)}
        parts.append(OpenEXR.Part({}, planes, path))
    OpenEXR.File(parts).write(str(folder / "in.exr"))
    joined = {f"{part.name()}.{letter}": channel.pixels for part in parts for letter, channel in part.channels.items()}
    OpenEXR.File({}, joined).write(str(folder / "joined.exr"))
    for source in ("in.exr", "joined.exr"):
        assert denoise(folder, "--png", "--bands", bands, source=source) == 0
        np.testing.assert_array_equal(load(folder / "out.png"), paint(folder / "out.exr"))


def test_large_images_are_measured_at_some_pixels(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pictures, "MAX_EXPOSURE_PIXELS", 83 * 19 // 5)
    found = []
    for bands in ("off", "70"):
        assert denoise(folder, "--png", "--bands", bands) == 0
        found.append((folder / "out.png").read_bytes())
    assert found[0] == found[1]
    exposure = choose_exposure(read_image(folder / "out.exr")[::3, ::3])
    assert float(read_png_text(folder / "out.png", EXPOSURE) or 0.0) == exposure
    np.testing.assert_array_equal(load(folder / "out.png"), paint(folder / "out.exr", exposure))


def test_a_sequence_has_one_exposure_also_where_it_goes_on(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    sequence = {"source": "in.####.exr", "output": "out.####.exr"}
    assert denoise(folder, "--png", **sequence) == 0
    assert f"Wrote {folder / 'out.####.png'}." in capsys.readouterr().out
    names = [f"out.{number:04d}" for number in (1, 2, 3)]
    exposure = choose_exposure(read_image(folder / "out.0001.exr"))
    for name in names:
        np.testing.assert_array_equal(load(folder / f"{name}.png"), paint(folder / f"{name}.exr", exposure))
    whole = {name: (folder / f"{name}.png").read_bytes() for name in names}
    # A run that is stopped before its third frame, and one that goes on.
    write = Pictures.write
    monkeypatch.setattr(Pictures, "write", lambda *given: (_ for _ in ()).throw(KeyboardInterrupt)
                        if given[1].name == "out.0003.exr" else write(*given))  # fmt: skip
    assert denoise(folder, "--png", **sequence) == 130
    monkeypatch.setattr(Pictures, "write", write)
    (folder / "out.0003.png").unlink()
    capsys.readouterr()
    assert denoise(folder, "--png", **sequence) == 0
    assert "Going on after frame 2" in capsys.readouterr().err
    assert {name: (folder / f"{name}.png").read_bytes() for name in names} == whole


def test_the_exposure_can_be_given(folder: Path) -> None:
    assert denoise(folder, "--png", "--exposure", "-2") == 0
    np.testing.assert_array_equal(load(folder / "out.png"), paint(folder / "out.exr", 0.25))


def test_a_picture_that_cannot_be_written_is_refused_first(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (folder / "out.png").mkdir()
    assert denoise(folder, "--png") == 2
    assert capsys.readouterr().err.startswith(f"lobewise: picture '{folder / 'out.png'}': expected a file name")
    assert not (folder / "out.exr").exists()


def test_a_picture_is_replaced_as_a_whole(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (folder / "out.png").write_bytes(b"before")
    monkeypatch.setattr(pictures, "encode_png", lambda *_given, **_more: (_ for _ in ()).throw(KeyboardInterrupt))
    assert denoise(folder, "--png") == 130
    assert (folder / "out.png").read_bytes() == b"before"
    assert not [name for name in os.listdir(folder) if name.endswith(".part")]
    monkeypatch.undo()
    assert denoise(folder, "--png") == 0
    assert load(folder / "out.png").shape == (83, 19, 3)


def test_other_verbs_write_pictures_too(folder: Path) -> None:
    line = ["upsample", str(folder / "in.0001.exr"), "-o", str(folder / "up.exr"), "--scale", "2", "--radius", "1"]
    assert run([*line, "--similarity", "normal", "--png"]) == 0
    np.testing.assert_array_equal(load(folder / "up.png"), paint(folder / "up.exr"))


@pytest.mark.parametrize("suffix", ["", "_clean"])
def test_the_picture_of_a_blender_file_is_the_result(suffix: str, tmp_path: Path) -> None:
    out = tmp_path / "out.exr"
    line = ["denoise", str(FOREIGN / "blender_5.2_multipart.exr"), "-o", str(out), "--png", "--suffix", suffix]
    assert run([*line, *CHEAP]) == 0
    noisy = paint(FOREIGN / "blender_5.2_multipart.exr")
    assert not np.array_equal(load(tmp_path / "out.png"), noisy)
    if not suffix:
        np.testing.assert_array_equal(load(tmp_path / "out.png"), paint(out))


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("a.exr", "a.png"),
        ("a.EXR", "a.png"),
        ("shot.0001.exr", "shot.0001.png"),
        ("shot.0001", "shot.0001.png"),
        ("a", "a.png"),
    ],
)
def test_names(name: str, expected: str) -> None:
    assert name_picture(Path("folder") / name) == Path("folder") / expected


@pytest.mark.parametrize("damage", [b"", b"\x89PNG\r\n\x1a\n", b"\x89PNG\r\n\x1a\n\xff\xff\xff\xfftEXt", b"GIF89a"])
def test_texts_of_pictures(damage: bytes, tmp_path: Path) -> None:
    path = tmp_path / "a.png"
    image = np.zeros((2, 3, 3), np.uint8)
    path.write_bytes(encode_png(image, texts={"other": "x", "name": "0.25"}))
    assert read_png_text(path, "name") == "0.25"
    assert read_png_text(path, "nam") is None
    assert encode_png(image, texts={}) == encode_png(image)
    path.write_bytes(damage)
    assert read_png_text(path, "name") is None
    assert read_png_text(tmp_path / "none.png", "name") is None
