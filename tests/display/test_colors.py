"""Light is shown in the primaries of screens, whatever primaries a file has."""

import base64
import io
import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from lobewise.cli.program import run
from lobewise.display.colors import REC709, Chromaticities, are_plausible, convert_light
from lobewise.interchange import read_image, read_light
from lobewise.records.frame import FloatArray
from lobewise.settings import DenoiseSettings
from lobewise.viewer.frame_target import FrameTarget

ACESCG: Chromaticities = (0.713, 0.293, 0.165, 0.83, 0.128, 0.044, 0.32168, 0.33767)
REC2020: Chromaticities = (0.708, 0.292, 0.17, 0.797, 0.131, 0.046, 0.3127, 0.329)


def write(path: Path, image: FloatArray, chromaticities: Chromaticities | None) -> Path:
    """Write an EXR file of float channels, with primaries or without."""
    import OpenEXR

    header: dict[str, Any] = {} if chromaticities is None else {"chromaticities": chromaticities}
    channels = {name: np.ascontiguousarray(image[..., k], np.float32) for k, name in enumerate("RGB")}
    with OpenEXR.File({**header, "type": OpenEXR.scanlineimage}, channels) as file:
        file.write(str(path))
    return path


@pytest.fixture
def image() -> FloatArray:
    """Return saturated colors, which look different in other primaries."""
    colors = np.array([[0.6, 0.1, 0.1], [0.1, 0.5, 0.1], [0.1, 0.1, 0.7], [0.5, 0.5, 0.5]], np.float32)
    return np.repeat(colors.reshape(2, 2, 3), 8, axis=0).repeat(8, axis=1)


def test_conversion_is_that_of_the_standards() -> None:
    # ITU-R BT.2087-0, the inverse of its matrix M2, and the matrix of ACES from AP1 to Rec. 709.
    from_2020 = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]
    from_ap1 = [[1.70505, -0.62179, -0.08326], [-0.13026, 1.14080, -0.01055], [-0.02400, -0.12897, 1.15297]]
    for chromaticities, matrix in ((REC2020, from_2020), (ACESCG, from_ap1)):
        converted = convert_light(np.eye(3, dtype=np.float32)[None], chromaticities)[0]
        np.testing.assert_allclose(converted.T, matrix, atol=2e-4)


def test_white_stays_white_and_the_way_back_is_exact() -> None:
    rng = np.random.default_rng(1)
    light = rng.uniform(0.0, 4.0, (5, 6, 3)).astype(np.float32)
    np.testing.assert_allclose(convert_light(np.ones((1, 1, 3), np.float32), ACESCG), 1.0, rtol=1e-4)
    np.testing.assert_allclose(convert_light(convert_light(light, ACESCG), REC709, ACESCG), light, rtol=1e-4)


def test_what_changes_nothing_is_not_copied_and_bad_pixels_stay() -> None:
    light = np.ones((2, 2, 3), np.float32)
    assert convert_light(light, None) is light
    assert convert_light(light, tuple(np.float32(REC709).tolist())) is light
    light[0, 0] = (np.inf, 1.0, 1.0)
    np.testing.assert_array_equal(convert_light(light, ACESCG)[0, 0], light[0, 0])


@pytest.mark.parametrize("wrong", [(0.0,) * 8, (float("nan"),) * 8, (*REC709[:6], 0.3127, 0.0)])
def test_implausible_primaries_are_ignored(wrong: Chromaticities, image: FloatArray, tmp_path: Path) -> None:
    assert not are_plausible(wrong)
    path = write(tmp_path / "a.exr", image, wrong)
    np.testing.assert_array_equal(read_light(path), read_image(path))


def test_two_files_of_one_light_look_alike_everywhere(image: FloatArray, tmp_path: Path, capsys: Any) -> None:
    plain = write(tmp_path / "plain.exr", image, None)
    wide = write(tmp_path / "wide.exr", convert_light(image, REC709, ACESCG), ACESCG)
    pictures = []
    for path in (plain, wide):
        output = tmp_path / f"{path.stem}-clean.exr"
        assert run(["denoise", str(path), "-o", str(output), "--quality", "fast", "--png", "--exposure", "0"]) == 0
        pictures.append(np.asarray(Image.open(output.with_suffix(".png"))).astype(int))
    assert np.abs(pictures[0] - pictures[1]).max() <= 1
    # The file keeps its primaries: its numbers are not those of Rec. 709.
    assert np.abs(read_image(tmp_path / "wide-clean.exr") - read_image(tmp_path / "plain-clean.exr")).max() > 0.05
    targets = [FrameTarget(str(path), reference=str(other)) for path, other in ((plain, wide), (wide, plain))]
    for name in ("noisy", "reference"):
        shown = [target.paint(name, DenoiseSettings()).astype(np.float32) for target in targets]
        np.testing.assert_allclose(shown[1], shown[0], rtol=2e-3, atol=1e-4)
    assert run(["compare", str(wide), "-r", str(plain), "--json", str(tmp_path / "figures.json")]) == 0
    figures = json.loads((tmp_path / "figures.json").read_text())["images"][0]
    assert figures["mse"] < 1e-10
    assert figures.get("flip", 0.0) < 1e-3
    shown = []
    for path in (plain, wide):
        assert run(["inspect", str(path), "--html", str(tmp_path / "page.html")]) == 0
        picture = re.search(r"data:image/\w+;base64,([^\"]+)", (tmp_path / "page.html").read_text())
        shown.append(np.asarray(Image.open(io.BytesIO(base64.b64decode(picture[1])))).astype(int))
    assert np.abs(shown[0] - shown[1]).max() <= 1
