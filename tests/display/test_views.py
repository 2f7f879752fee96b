"""Pictures by views of OpenColorIO, among them Blender's own."""

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lobewise.cli.program import run
from lobewise.display import views
from lobewise.display.colors import AP0, REC709, convert_light
from lobewise.display.views import View, open_view, paint_picture
from lobewise.errors import FileError, InputError, MissingDependencyError
from lobewise.records.frame import FloatArray
from tests.display.test_colors import ACESCG, write
from tests.mistakes import refuses

needs_ocio = pytest.mark.skipif(
    not os.environ.get("CI") and find_spec("PyOpenColorIO") is None,
    reason="needs OpenColorIO: pip install 'lobewise[color]'",
)

# Light is squared by the first view, and halved by the second; the scene's light has the primaries of Rec. 709.
CONFIG = """ocio_profile_version: 2
roles: {scene_linear: lin709, aces_interchange: ap0, default: lin709}
file_rules:
  - !<Rule> {name: Default, colorspace: default}
displays:
  screen:
    - !<View> {name: Square, colorspace: square}
    - !<View> {name: Half, colorspace: half}
  other:
    - !<View> {name: Lost, colorspace: nowhere}
colorspaces:
  - !<ColorSpace> {name: ap0}
  - !<ColorSpace>
    name: lin709
    to_scene_reference: !<MatrixTransform> {matrix: [MATRIX]}
  - !<ColorSpace>
    name: square
    from_scene_reference: !<GroupTransform>
      children:
        - !<ColorSpaceTransform> {src: ap0, dst: lin709}
        - !<ExponentTransform> {value: [2, 2, 2, 1]}
  - !<ColorSpace>
    name: half
    from_scene_reference: !<GroupTransform>
      children:
        - !<ColorSpaceTransform> {src: ap0, dst: lin709}
        - !<MatrixTransform> {matrix: [0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 0.5, 0, 0, 0, 0, 1]}
  - !<ColorSpace>
    name: nowhere
    from_scene_reference: !<FileTransform> {src: nowhere.cube}
"""


@pytest.fixture
def config(tmp_path: Path) -> Path:
    matrix = np.eye(4)
    matrix[:3, :3] = convert_light(np.eye(3, dtype=np.float32)[None], REC709, AP0)[0].T
    path = tmp_path / "config.ocio"
    path.write_text(CONFIG.replace("MATRIX", ", ".join(f"{number:.8f}" for number in matrix.ravel())))
    return path


@pytest.fixture
def light() -> FloatArray:
    return np.random.default_rng(1).uniform(0.05, 0.9, (6, 7, 3)).astype(np.float32)


def to_codes(light: Any) -> Any:
    return np.clip(np.asarray(light) * 255.0, 0.0, 255.0)


@needs_ocio
def test_a_view_is_painted(config: Path, light: FloatArray) -> None:
    square, half = open_view(config, None, None), open_view(config, "screen", "Half")
    assert (square.display, square.view) == ("screen", "Square")
    np.testing.assert_allclose(paint_picture(light, None, 1.0, square), to_codes(light**2), atol=0.6)
    np.testing.assert_allclose(paint_picture(light, None, 2.0, half), to_codes(light), atol=0.6)
    wide = convert_light(light, REC709, ACESCG)
    np.testing.assert_allclose(paint_picture(wide, ACESCG, 1.0, square), to_codes(light**2), atol=0.7)
    light[0, 0], light[0, 1] = np.nan, np.inf
    painted = paint_picture(light, None, 1.0, half)
    assert painted[0, :2].tolist() == [[0, 0, 0], [255, 255, 255]]


@needs_ocio
def test_options_paint_the_picture(
    config: Path, light: FloatArray, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    source, output = write(tmp_path / "a.exr", light, None), tmp_path / "b.exr"
    command = ["denoise", str(source), "-o", str(output), "--quality", "fast", "--radius", "0", "--png"]
    pictures = []
    for options in (["--view", "Half", "--ocio", str(config)], ["--display", "screen"]):
        assert run([*command, *options]) == 0
        pictures.append(np.asarray(Image.open(output.with_suffix(".png"))))
        monkeypatch.setenv("OCIO", str(config))
    np.testing.assert_allclose(pictures[0], to_codes(light / 2.0), atol=1.0)
    np.testing.assert_allclose(pictures[1], to_codes(light**2), atol=1.0)


@needs_ocio
def test_wrong_names_get_a_sentence(config: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("OCIO", raising=False)
    with refuses(InputError, "--ocio"):
        open_view(None, None, "AgX")
    with refuses(InputError, "--display"):
        open_view(config, "scren", None)
    with refuses(InputError, "--view"):
        open_view(config, None, "Halve")
    with refuses(InputError, "--view 'Lost'"):
        open_view(config, "other", "Lost")
    (tmp_path / "text.ocio").write_text("no configuration\n")
    for name in ("text.ocio", "missing.ocio"):
        with refuses(FileError, expected="a configuration of OpenColorIO") as problem:
            open_view(tmp_path / name, None, None)
        assert "\n" not in str(problem.value)


def test_without_the_library_the_extra_is_named(config: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "PyOpenColorIO", None)
    views._read_config.cache_clear()
    with refuses(MissingDependencyError, action="pip install 'lobewise[color]', or leave --display and --view out"):
        open_view(config, None, None)


SHOW = """
import sys
import bpy

scene = bpy.context.scene
image = bpy.data.images.load(sys.argv[1])
scene.render.dither_intensity = 0.0
scene.render.image_settings.file_format, scene.render.image_settings.color_mode = "PNG", "RGB"
scene.display_settings.display_device = "sRGB"
for name in sys.argv[3:]:
    scene.view_settings.view_transform = name
    image.save_render(sys.argv[2] % name, scene=scene)
print(bpy.utils.resource_path("LOCAL"))
"""


@needs_ocio
def test_pictures_are_blenders(tmp_path: Path) -> None:
    python = os.environ.get("LOBEWISE_BPY_PYTHON")
    if not python:
        pytest.skip("needs Blender: LOBEWISE_BPY_PYTHON names a Python with bpy")
    # From far below black to far above white, saturated colors among them.
    light = (2.0 ** np.random.default_rng(1).uniform(-9.0, 6.0, (64, 64, 3))).astype(np.float16).astype(np.float32)
    source, names = write(tmp_path / "a.exr", light, None), ("AgX", "Filmic", "Standard")
    command = [python, "-c", SHOW, str(source), str(tmp_path / "%s.png"), *names]
    told = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    config = Path(told.strip().splitlines()[-1]) / "datafiles" / "colormanagement" / "config.ocio"
    for name in names:
        theirs = np.asarray(Image.open(tmp_path / f"{name}.png"))[..., :3].astype(int)
        ours = paint_picture(light, None, 1.0, View(str(config), "sRGB", name)).astype(int)
        assert np.abs(ours - theirs).max() <= 2, name
        assert 20 < ours.mean() < 235
