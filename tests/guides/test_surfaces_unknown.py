"""Pixels with scattered light but no surface, as in fog, are filtered with the surfaces beside them."""

from dataclasses import replace

import numpy as np
import pytest

from lobewise.denoising import denoise
from lobewise.guides.stand_ins import BACKDROP_DISTANCE, stand_in_surfaces
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.radiance import RadianceLayer
from tests.denoising.test_denoising import make_frame

SHAPE = (40, 56)


def make_fog(share: float, fog: float = 0.3) -> tuple[Frame, FloatArray]:
    """Return a plane in noisy fog, of which a share of the pixels has no surface, and the truth."""
    rng = np.random.default_rng(4)
    frame, gone = make_frame(SHAPE), rng.random(SHAPE) < share
    light = (fog * rng.gamma(1.0, 1.0, (*SHAPE, 1)) * np.ones(3)).astype(np.float32)
    black = np.zeros_like(light)
    layers = (
        RadianceLayer("surface", "diffuse", black, frame.gbuffer.diffuse_albedo),
        RadianceLayer("gloss", "glossy", black, frame.gbuffer.specular_albedo),
        RadianceLayer("fog", "volume", light),
    )
    guides = {name: np.array(getattr(frame.gbuffer, name)) for name in ("depth", "position", "normal")}
    for image in guides.values():
        image[gone] = 0.0
    frame = frame.with_changes(
        radiance=Radiance(light, light, black), gbuffer=replace(frame.gbuffer, **guides), layers=layers
    )
    return frame, np.full_like(light, fog)


@pytest.mark.parametrize("quality", ["fast", "balanced", "high"])
@pytest.mark.parametrize("share", [0.3, 0.9])
def test_fog_is_filtered_where_no_surface_is_known(quality: str, share: float) -> None:
    frame, truth = make_fog(share)
    result = denoise(frame, quality=quality)
    error, before = (np.square(image - truth).mean() for image in (result.image, frame.radiance.color))
    assert error < 0.15 * before
    assert any("as in fog" in note for note in result.notes)


def test_the_nearest_surface_stands_for_an_unknown_one_and_else_a_wall() -> None:
    frame, _ = make_fog(0.0)
    whole = frame.gbuffer
    normal, depth = np.array(whole.normal), np.array(whole.depth)
    normal[20, 20], depth[20, 20] = 0.0, 0.0
    normal[:, 40:], depth[:, 40:] = 0.0, 0.0
    filled, _ = stand_in_surfaces(frame.with_changes(gbuffer=replace(whole, normal=normal, depth=depth)))
    assert filled.gbuffer.depth[20, 20] in {whole.depth[y, x] for y, x in ((19, 20), (21, 20), (20, 19), (20, 21))}
    np.testing.assert_array_equal(filled.gbuffer.depth[:, 42], whole.depth[:, 39])
    assert (filled.gbuffer.depth[:, 43:] == np.float32(BACKDROP_DISTANCE)).all()
    assert (np.linalg.norm(filled.gbuffer.require("normal", "a test"), axis=-1) > 0.9).all()


def test_backgrounds_and_light_that_is_not_split_stay_as_they_are() -> None:
    frame, _ = make_fog(0.3)
    whole = frame.with_changes(layers=(), radiance=Radiance(frame.radiance.color))
    assert stand_in_surfaces(whole) == (whole, ())
    black = np.zeros((*SHAPE, 3), np.float32)
    sky = frame.with_changes(layers=(), radiance=Radiance(frame.radiance.color, black, black))
    assert stand_in_surfaces(sky) == (sky, ())


def test_black_samples_in_fog_belong_to_it_and_holes_between_leaves_do_not() -> None:
    frame, _ = make_fog(1.0)
    light = np.array(frame.layers[2].radiance)
    light[10, 10] = 0.0
    layers = (*frame.layers[:2], replace(frame.layers[2], radiance=light))
    foggy = frame.with_changes(layers=layers, radiance=Radiance(light, light, np.zeros_like(light)))
    filled, _ = stand_in_surfaces(foggy)
    assert filled.gbuffer.depth[10, 10] > 0.0
    leaves, _ = make_fog(0.0)
    depth = np.array(leaves.gbuffer.depth)
    depth[10, 10] = 0.0
    holed = leaves.with_changes(gbuffer=replace(leaves.gbuffer, depth=depth), layers=layers, radiance=foggy.radiance)
    assert stand_in_surfaces(holed)[0] is holed


@pytest.mark.parametrize("sees_a_surface", [True, False])
def test_a_black_pixel_with_an_albedo_is_no_sky(sees_a_surface: bool) -> None:
    frame, _ = make_fog(0.0)
    depth, light, albedo = (
        np.array(image) for image in (frame.gbuffer.depth, frame.layers[2].radiance, frame.layers[0].albedo)
    )
    depth[10, 10], light[10, 10], albedo[10, 10] = 0.0, 0.0, 0.2 * sees_a_surface
    depth[30, 30] = 0.0  # somewhere else the fog hides a surface
    layers = (replace(frame.layers[0], albedo=albedo), replace(frame.layers[2], radiance=light))
    filled, _ = stand_in_surfaces(
        frame.with_changes(
            gbuffer=replace(frame.gbuffer, depth=depth),
            layers=layers,
            radiance=Radiance(light, light, np.zeros_like(light)),
        )
    )
    assert bool(filled.gbuffer.depth[10, 10] > 0.0) is sees_a_surface
    assert filled.gbuffer.depth[30, 30] > 0.0
