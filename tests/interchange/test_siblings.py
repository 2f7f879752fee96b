"""Passes in files of their own, beside that of the picture."""

from pathlib import Path

import numpy as np
import pytest
from renderers import Written, make_scene, name, read_channels, write

from lobewise.cli.program import run
from lobewise.interchange.reading import import_file

SCENE = make_scene()
FILES = {"beauty": SCENE.color, "albedo": SCENE.diffuse_albedo, "normals": SCENE.normal}


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return a folder of a picture, its albedo and its normals, a file each, and of another picture."""
    (tmp_path / "in").mkdir()
    for word, image in (*FILES.items(), ("rgba", np.zeros_like(SCENE.color))):
        write(tmp_path / "in" / f"shot_{word}.0001.exr", Written("", name("", image), {}, ()))
    return tmp_path / "in"


def test_guides_beside_the_picture_are_read(folder: Path, tmp_path: Path) -> None:
    imported = import_file(folder / "shot_beauty.0001.exr")
    guides = imported.frame.gbuffer
    np.testing.assert_array_equal(guides.denoiser_albedo, SCENE.diffuse_albedo)
    np.testing.assert_allclose(guides.normal[SCENE.surface], SCENE.normal[SCENE.surface], atol=1e-6)
    np.testing.assert_array_equal(imported.frame.radiance.color, SCENE.color)
    names = "shot_albedo.0001.exr, shot_normals.0001.exr"
    assert imported.frame.notes == (f"Passes are read from the files beside it: {names}.",)
    assert run(["denoise", str(folder / "shot_beauty.0001.exr"), "-o", str(tmp_path / "a.exr")]) == 0
    assert read_channels(tmp_path / "a.exr").keys() == set("RGB")


def test_whoever_denoises_a_guide_is_told(folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["denoise", str(folder), "-o", str(tmp_path / "out"), "--quality", "fast"]) == 0
    told = " ".join(capsys.readouterr().err.split())
    for word in ("albedo", "normals"):
        assert f"By its name, shot_{word}.0001.exr is a pass of shot_beauty.0001.exr, and no picture." in told


def test_other_pixels_and_other_names_make_no_family(folder: Path) -> None:
    small = Written("", name("", np.ascontiguousarray(SCENE.normal[::2])), {}, ())
    write(folder / "shot_normals.0001.exr", small)
    (folder / "shot_albedo.0001.exr").rename(folder / "other_albedo.0001.exr")
    for word in ("shot_beauty", "shot_normals", "other_albedo"):
        assert import_file(folder / f"{word}.0001.exr").frame.notes == ()
