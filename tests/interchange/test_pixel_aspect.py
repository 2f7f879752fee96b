"""Pixels that are not square: the camera has them so, wherever it comes from."""

import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from renderers import CAMERA, HEIGHT, WIDTH, WRITERS, make_scene, name, read_channels

from lobewise.interchange.cameras.files import read_camera_file
from lobewise.interchange.reading import import_file
from lobewise.io import read_frame, write_frame
from lobewise.records.camera import Camera

ASPECT = 2.0
HALF_WIDTH = math.tan(0.5 * CAMERA.fov_y) * ASPECT * WIDTH / HEIGHT
WIDE = replace(CAMERA, fov_x=2.0 * math.atan(HALF_WIDTH))
RNG = np.random.default_rng(5)
DEPTH = RNG.uniform(2.0, 4.0, (HEIGHT, WIDTH)).astype(np.float32)
POSITION = WIDE.make_positions(DEPTH)


def save(path: Path, aspect: float, channels: dict[str, np.ndarray], **header: object) -> Path:
    fields = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, "pixelAspectRatio": aspect}
    OpenEXR.File({**fields, **header}, dict(channels)).write(str(path))
    return path


def require_wide(camera: Camera | None) -> None:
    rays, wanted = (one.make_ray_directions(WIDTH, HEIGHT) for one in (camera, WIDE))
    np.testing.assert_allclose(rays, wanted, atol=2e-3)


def test_the_camera_of_the_positions(tmp_path: Path) -> None:
    channels = name("", make_scene().color) | name("P", POSITION, "XYZ")
    found = import_file(save(tmp_path / "a.exr", ASPECT, channels))
    require_wide(found.frame.camera)
    assert any("Pixels are 2 times as wide as high (pixelAspectRatio)" in note for note in found.notes)
    square = import_file(save(tmp_path / "b.exr", 1.0, channels))
    assert square.frame.camera is None, "no camera with square pixels sees them"
    assert not any("pixelAspectRatio" in note for note in square.notes)


def test_a_camera_that_is_given(tmp_path: Path) -> None:
    told = {
        "position": CAMERA.position.tolist(),
        "forward": CAMERA.forward.tolist(),
        "up": CAMERA.up.tolist(),
        "fov_y": math.degrees(CAMERA.fov_y),
    }
    (tmp_path / "camera.json").write_text(json.dumps(told))
    camera = read_camera_file(tmp_path / "camera.json")
    channels = name("", make_scene().color) | name("P", POSITION, "XYZ")
    found = import_file(save(tmp_path / "a.exr", ASPECT, channels), camera=camera)
    require_wide(found.frame.camera)
    assert found.frame.gbuffer.position is not None, "it sees the positions where they are"
    # A horizontal angle that is told goes before the shape of the pixels.
    kept = import_file(tmp_path / "a.exr", camera=replace(camera, fov_x=0.5)).frame.camera
    assert kept.fov_x == 0.5


def test_a_file_in_our_own_names(tmp_path: Path) -> None:
    write(tmp_path / "a.exr")
    require_wide(read_frame(tmp_path / "a.exr").camera)


def write(path: Path) -> None:
    from lobewise.records.frame import Frame, GBuffer, Radiance

    guides = GBuffer(normal=make_scene().normal, depth=DEPTH)
    write_frame(path, Frame(Radiance(make_scene().color), guides, CAMERA))
    header = {**OpenEXR.File(str(path)).header(), "pixelAspectRatio": ASPECT}
    OpenEXR.File(header, read_channels(path)).write(str(path))


@pytest.mark.parametrize("aspect", [1e-5, 1e5])
def test_what_no_pixels_have_counts_as_square(aspect: float, tmp_path: Path) -> None:
    written = WRITERS["arnold"](make_scene())
    path = save(tmp_path / "a.exr", aspect, written.channels, **written.attributes)
    found = import_file(path)
    assert any("pixelAspectRatio is none of pixels" in note for note in found.notes)
    rays = found.frame.camera.make_ray_directions(WIDTH, HEIGHT)
    np.testing.assert_allclose(rays, CAMERA.make_ray_directions(WIDTH, HEIGHT), atol=1e-5)
