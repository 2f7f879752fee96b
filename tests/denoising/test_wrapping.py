"""An image of 360 degrees that is turned gives the turned result: its left and right border are neighbours."""

from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

import lobewise
from lobewise.cli.program import run
from lobewise.denoising.plan import foretell
from lobewise.errors import InputError
from lobewise.guides.usable import check_guides
from lobewise.recipes.streaming import plan
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.settings import DenoiseSettings
from tests.mistakes import refuses

SIZE = 32, 256
"""Half of the width is as far as pixels of the network's levels reach."""
NEAR = 1e-3
"""Largest difference of a turned result, over the mean of the result."""


def make_panorama(*, halves: bool = True) -> Frame:
    """Return a noisy frame whose light and guides go on from the right border to the left one."""
    height, width = SIZE
    random = np.random.default_rng(4)
    down, around = (np.arange(height) + 0.5) / height * np.pi, (np.arange(width) + 0.5) / width * 2.0 * np.pi
    flat, above = np.sin(down)[:, None], np.cos(down)[:, None] + 0.0 * around
    rays = np.stack([flat * np.cos(around), above, flat * np.sin(around)], axis=-1)
    is_red = np.floor(around / np.pi * 4.0 - 0.3)[None, :, None] % 2.0 == 0.0
    albedo = np.broadcast_to(np.where(is_red, [0.7, 0.3, 0.2], [0.3, 0.4, 0.6]), (height, width, 3))
    light = albedo * (1.0 + 0.8 * np.cos(around - 0.4)[:, None] * flat[..., None])
    first, second = ((light * random.gamma(2.0, 0.5, (height, width, 1))).astype(np.float32) for _ in range(2))
    diffuse, nothing = (first + second) / np.float32(2.0), np.zeros((height, width, 3), np.float32)
    return Frame(
        Radiance(diffuse, diffuse, nothing),
        GBuffer(normal=-rays, diffuse_albedo=albedo, specular_albedo=nothing),
        half_a=Radiance(first, first, nothing) if halves else None,
        half_b=Radiance(second, second, nothing) if halves else None,
        spp=4,
        wraps=True,
    )


def turn(image: FloatArray, columns: int) -> FloatArray:
    return np.roll(image, columns, axis=1)


def turn_frame(frame: Frame, columns: int) -> Frame:
    """Return a frame with all its images turned to the right."""

    def turn_radiance(radiance: Radiance | None) -> Radiance | None:
        return None if radiance is None else Radiance(**turn_all(radiance))

    def turn_all(images: Any) -> dict[str, Any]:
        return {name: turn(getattr(images, name), columns) for name in images.names}

    parts = {name: turn_radiance(getattr(frame, name)) for name in ("radiance", "half_a", "half_b")}
    alpha = None if frame.alpha is None else turn(frame.alpha, columns)
    return frame.with_changes(**parts, gbuffer=GBuffer(**turn_all(frame.gbuffer)), alpha=alpha)


def measure_change(frame: Frame, columns: int, **settings: Any) -> float:
    """Return how far the result of a turned frame is from the turned result, over the mean."""
    image, turned = (lobewise.denoise(each, **settings).image for each in (frame, turn_frame(frame, columns)))
    return float(np.abs(turn(image, columns) - turned).max() / image.mean())


@pytest.mark.sampled("True-fast", "True-high", "False-auto")
@pytest.mark.parametrize("quality", ["fast", "balanced", "high", "auto"])
@pytest.mark.parametrize("halves", [True, False])
def test_the_result_turns_with_the_image(quality: Any, halves: bool) -> None:
    frame = make_panorama(halves=halves)
    assert measure_change(frame, 48, quality=quality) < NEAR
    assert measure_change(frame.with_changes(wraps=False), 48, quality=quality) > 0.1


def test_the_light_of_fireflies_turns_with_the_image() -> None:
    # The columns opposite of the border, where the added columns end, do not count in the light that is shared out.
    frame = make_panorama(halves=False)
    color = frame.radiance.color.copy()
    color[4:28:3, 120:136:3] *= 400.0
    frame = frame.with_changes(radiance=Radiance(color, color, np.zeros_like(color)))
    assert measure_change(frame, 48, quality="balanced") < NEAR


def test_all_images_of_the_result_have_the_size_of_the_frame() -> None:
    frame = make_panorama()
    result = lobewise.denoise(frame, quality="balanced")
    for image in (result.image, result.diffuse, result.bad_pixels, result.weight_sum, result.effective_samples):
        assert image.shape[:2] == SIZE
    assert result.find_noisy() is frame.radiance.color


def test_opacity_turns_with_the_image() -> None:
    frame = make_panorama()
    alpha = np.clip(frame.radiance.color[..., 0] - 0.2, 0.0, 1.0)
    alpha[:, 4:60], alpha[:, 60:] = 0.0, 1.0  # pixels at the right border are near the fractions at the left one
    frame = frame.with_changes(alpha=alpha)
    first, turned = (lobewise.denoise(each, quality="fast").alpha for each in (frame, turn_frame(frame, 48)))
    np.testing.assert_allclose(turn(first, 48), turned, atol=NEAR)
    apart = lobewise.denoise(frame.with_changes(wraps=False), quality="fast").alpha
    assert np.abs(apart - first).max() > 0.01


def test_light_below_zero_turns_with_the_image() -> None:
    frame = make_panorama(halves=False)
    color = frame.radiance.color.copy()
    color[10:20, :6], color[10:20, -6:] = -color[10:20, :6], -color[10:20, -6:]
    frame = frame.with_changes(radiance=Radiance(color))
    assert measure_change(frame, 48, quality="fast") < NEAR


def test_surfaces_stand_in_from_the_other_border() -> None:
    frame = make_panorama()
    normal = frame.gbuffer.normal
    holed = normal.copy()
    holed[:, 0] = holed[:, 1:4] = 0.0  # the nearest surface is that of the last column
    frame = frame.with_changes(gbuffer=GBuffer(normal=holed))
    around = check_guides(frame).frame.gbuffer.normal
    np.testing.assert_array_equal(around[:, 0], normal[:, -1])
    apart = check_guides(frame.with_changes(wraps=False)).frame.gbuffer.normal
    assert (apart[:, 0] != normal[:, -1]).any()


def test_a_note_counts_every_pixel_once() -> None:
    frame = make_panorama()
    albedo = np.array(frame.gbuffer.diffuse_albedo)
    albedo[3, 5] = 2.0
    frame = frame.with_changes(gbuffer=GBuffer(normal=frame.gbuffer.normal, diffuse_albedo=albedo))
    assert any("at 1 pixel:" in note for note in check_guides(frame).notes)


def test_fog_has_one_wall_behind_it() -> None:
    frame = make_panorama()
    normal, position = np.array(frame.gbuffer.normal), -5.0 * np.array(frame.gbuffer.normal)
    normal[:, 90:130] = position[:, 90:130] = 0.0
    guides = GBuffer(normal=normal, position=position)
    frame = frame.with_changes(gbuffer=guides, camera=lobewise.Camera((0, 0, 0), (0, 0, 1), (0, 1, 0), 1.0))
    wall = check_guides(frame).frame.gbuffer.normal
    # A pinhole's rays, by which it would face the camera, are not those of the panorama.
    np.testing.assert_array_equal(wall[:, 95:125], np.broadcast_to(wall[0, 95], (SIZE[0], 30, 3)))


def test_a_pinhole_camera_without_positions_is_refused() -> None:
    with refuses(InputError, "camera"):
        make_panorama().with_changes(camera=lobewise.Camera((0, 0, 0), (0, 0, 1), (0, 1, 0), 1.0))


def test_the_plan_counts_the_columns_that_are_added() -> None:
    frame = make_panorama()
    around, apart = (
        foretell(each, DenoiseSettings(quality="fast"))[-1].split()[2]
        for each in (frame, frame.with_changes(wraps=False))
    )
    assert float(around) == pytest.approx(2.0 * float(apart), rel=0.1)


def test_a_filter_over_time_says_that_borders_stay_apart() -> None:
    notes = lobewise.TemporalFilter().add(make_panorama(halves=False)).notes
    assert any("wraps around" in note for note in notes)


def write(path: Path, envmap: int | None, *, foreign: bool = False, cropped: bool = False) -> Path:
    """Write a panorama with OpenEXR's attribute, 0 for latitude and longitude, 1 for a cube."""
    color = make_panorama().radiance.color
    names = {name: f"ViewLayer.Combined.{name}" if foreign else name for name in "RGB"}
    header: dict[str, Any] = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    header |= {"cycles.ViewLayer.samples": "4"} if foreign else {"lobewise/schema": 1}
    header |= {} if envmap is None else {"envmap": OpenEXR.Envmap(envmap)}
    if cropped:
        header["displayWindow"] = (np.zeros(2, np.int32), np.array([SIZE[1] + 9, SIZE[0] - 1], np.int32))
    channels = {names[name]: np.ascontiguousarray(color[..., k]) for k, name in enumerate("RGB")}
    OpenEXR.File(header, channels).write(str(path))
    return path


@pytest.mark.parametrize("foreign", [True, False])
def test_the_header_tells_a_panorama(foreign: bool, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    frame = lobewise.read_frame(write(path, 0, foreign=foreign))
    assert frame.wraps
    assert "The image wraps around, as its header says" in frame.notes[0]
    assert not lobewise.read_frame(path, wraps=False).wraps
    assert not lobewise.read_frame(write(path, 1, foreign=foreign)).wraps, "a cube"
    assert not lobewise.read_frame(write(path, 0, foreign=foreign, cropped=True)).wraps
    assert not lobewise.read_frame(write(path, None, foreign=foreign)).wraps, "a wide image proves nothing"
    assert lobewise.read_frame(path, wraps=True).wraps


def test_a_frame_that_is_written_still_wraps(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    lobewise.write_frame(path, make_panorama())
    assert lobewise.read_frame(path).wraps


def tell(capsys: pytest.CaptureFixture[str], source: Path, output: Path, *options: str) -> str:
    """Return what the command says beside the result of a file."""
    assert run(["denoise", str(source), "-o", str(output), "--quality", "fast", *options]) == 0
    return capsys.readouterr().err


@pytest.mark.parametrize("foreign", [True, False])
def test_the_command_says_what_the_header_tells(
    foreign: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, told, asked, apart = (tmp_path / f"{name}.exr" for name in ("source", "told", "asked", "apart"))
    write(source, 0, foreign=foreign)
    assert tell(capsys, source, told).count("wraps around, as its header says (envmap)") == 1
    assert "wraps around" not in tell(capsys, source, apart, "--no-wrap")
    tell(capsys, write(source, None, foreign=foreign), asked, "--wrap")
    images = [lobewise.read_frame(path).radiance.color for path in (told, asked, apart)]
    np.testing.assert_array_equal(images[0], images[1])
    assert (images[0] != images[2]).any()


def test_bands_are_refused(tmp_path: Path) -> None:
    source, output = write(tmp_path / "a.exr", 0), tmp_path / "b.exr"
    with refuses(InputError, "input 'a.exr'"):
        lobewise.denoise_file(source, output, quality="fast", rows=16)


def test_bands_are_not_chosen(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(plan, "MAX_WHOLE_GIB", 1e-6)
    lobewise.write_frame(tmp_path / "a.exr", make_panorama())
    assert run(["denoise", str(tmp_path / "a.exr"), "-o", str(tmp_path / "b.exr"), "--quality", "fast"]) == 0
    assert " in 1 band" not in capsys.readouterr().out
