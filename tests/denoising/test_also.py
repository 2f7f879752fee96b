"""Light passes and light groups keep their own light: none takes the highlights, fireflies or detail of another."""

from dataclasses import replace
from functools import reduce
from pathlib import Path

import numpy as np
import pytest

from lobewise import WindowFilter, read_frame
from lobewise.denoising import denoise
from lobewise.peers import has_oidn
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.images import pack_planes, unpack_planes
from lobewise.records.radiance import RadianceLayer
from tests.denoising.test_denoising import make_frame

QUALITIES = ("fast", "balanced", "high", *(("auto",) if has_oidn() else ()))
SHAPE = (48, 64)
REACH = 40
"""Pixels that no filter reaches, with the largest kernel and the network."""
LAMP = (slice(10, 13), slice(12, 15))
FIREFLY = (30, 20)


def make_group(rng: np.random.Generator, left: float, right: float) -> FloatArray:
    """Return noisy light of a lamp that is brighter on one side."""
    light = np.where(np.arange(SHAPE[1]) < SHAPE[1] // 2, left, right)[None, :, None] * np.ones((*SHAPE, 3))
    return (light * rng.gamma(2.0, 0.5, (*SHAPE, 1))).astype(np.float32)


def make_groups() -> tuple[dict[str, FloatArray], dict[str, FloatArray]]:
    """Return noisy light groups and their truths: one has a highlight and a firefly, one is black on the right."""
    rng = np.random.default_rng(3)
    sides = {"key": (1.0, 0.5), "fill": (0.1, 0.3), "rim": (0.2, 0.0)}
    noisy = {name: make_group(rng, *side) for name, side in sides.items()}
    truth = {
        name: np.where(np.arange(SHAPE[1]) < SHAPE[1] // 2, *side)[None, :, None] * np.ones((*SHAPE, 3))
        for name, side in sides.items()
    }
    for images in (noisy, truth):
        images["key"][LAMP] = 60.0
    noisy["key"][FIREFLY] = 500.0
    return noisy, truth


@pytest.fixture(params=["groups", "passes"])
def split(request: pytest.FixtureRequest) -> tuple[Frame, dict[str, FloatArray], dict[str, FloatArray]]:
    """Return a frame whose total, or whose specular layer, is the sum of three images, and these; then their truths."""
    noisy, truth = make_groups()
    total = reduce(np.add, noisy.values())
    frame = make_frame(SHAPE, apart=False)
    if request.param == "groups":
        return frame.with_changes(radiance=Radiance(total), also=noisy), noisy, truth
    black = np.zeros_like(total)
    layers = (
        RadianceLayer("diffuse", "diffuse", black, frame.gbuffer.diffuse_albedo),
        RadianceLayer("gloss", "glossy", total, frame.gbuffer.specular_albedo, parts=noisy),
    )
    named = {f"gloss/{name}": image for name, image in noisy.items()}
    frame = frame.with_changes(radiance=Radiance(total, black, total), layers=layers)
    return frame, named, {f"gloss/{name}": image for name, image in truth.items()}


@pytest.mark.parametrize("quality", QUALITIES)
def test_every_part_is_filtered_as_if_it_were_alone(
    quality: str, split: tuple[Frame, dict[str, FloatArray], dict[str, FloatArray]]
) -> None:
    """It gets nearer to its truth, takes no firefly or highlight of others, and stays black where it is black."""
    frame, noisy, truth = split
    result = denoise(frame, quality=quality)
    total = reduce(np.add, (result.also[name] for name in noisy))
    np.testing.assert_allclose(total, result.image, rtol=2e-3, atol=1e-4)
    for name, image in noisy.items():
        done, before = (np.square(each - truth[name]).mean() for each in (result.also[name], image))
        assert done < before, name
        if not name.endswith("key"):
            for place in (LAMP, FIREFLY):
                done = result.also[name][place]
                assert done.max() < 3.0 * noisy[name].max(), (name, place)
                assert done.mean() > 0.2 * truth[name][place].mean(), (name, place)
        if name.endswith("rim"):
            assert not result.also[name][:, SHAPE[1] // 2 + 24 :].any()


@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_groups_with_light_below_0_sum_to_the_picture(quality: str) -> None:
    noisy, _ = make_groups()
    wide = np.array([[1.4, -0.3, -0.1], [-0.1, 1.2, -0.1], [0.0, -0.2, 1.2]], np.float32)
    tints = ([1.0, 0.2, 0.1], [0.1, 1.0, 0.3], [0.3, 0.1, 1.0])
    groups = {name: (noisy[name] * np.float32(tint)) @ wide for name, tint in zip(noisy, tints, strict=True)}
    total = reduce(np.add, groups.values())
    assert min(image.min() for image in groups.values()) < 0.0
    frame = make_frame(SHAPE, apart=False).with_changes(radiance=Radiance(total), also=groups)
    result = denoise(frame, quality=quality)
    np.testing.assert_allclose(reduce(np.add, result.also.values()), result.image, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_a_part_that_is_not_finite_at_a_pixel_is_finite_afterwards(quality: str) -> None:
    """At these pixels the samples of the other parts are taken back."""
    noisy, _ = make_groups()
    frame = make_frame(SHAPE, apart=False).with_changes(radiance=Radiance(reduce(np.add, noisy.values())), also=noisy)
    spoiled = noisy["fill"].copy()
    spoiled[11, 13], spoiled[20, 20] = np.nan, np.inf
    result = denoise(frame.with_changes(also={**noisy, "fill": spoiled}), quality=quality)
    assert all(np.isfinite(image).all() for image in result.also.values())


@pytest.mark.real_exr
@pytest.mark.parametrize("quality", QUALITIES)
def test_no_pass_of_a_file_gets_light_that_none_of_its_neighbours_has(quality: str, field_folder: Path) -> None:
    frame = read_frame(field_folder / "passes_leak.exr")
    result = denoise(frame, quality=quality)
    for layer in frame.layers:
        for part, image in layer.parts.items():
            done = result.also[f"{layer.name}/{part}"]
            assert done.max() <= 1.05 * image.max(), part
            assert done.sum() == pytest.approx(image.sum(), rel=0.03), part
    # A highlight of direct light lies beside this pixel, and no indirect light.
    assert result.also["glossy/GlossInd"][17, 39].max() < 0.5


@pytest.mark.parametrize("quality", QUALITIES)
def test_a_lamp_in_view_stays_in_its_own_light_group(quality: str) -> None:
    """The total has exact light, of a lamp in view: the group of a sky keeps its dim light in these pixels."""
    noisy, _ = make_groups()
    frame = make_frame(SHAPE)
    diffuse, specular = 0.5 * reduce(np.add, noisy.values()), 0.5 * reduce(np.add, noisy.values())
    shone = np.zeros((*SHAPE, 3), np.float32)
    shone[40:44, 40:44] = 80.0
    groups = {**noisy, "lamp": shone}
    radiance = Radiance(diffuse + specular + shone, diffuse, specular)
    result = denoise(
        frame.with_changes(radiance=radiance, also=groups, unscattered={"emission": shone}), quality=quality
    )
    lamp = shone[..., 0] > 0.0
    for name, image in noisy.items():
        assert result.also[name][lamp].max() < 3.0 * image.max(), name
    total = reduce(np.add, (result.also[name] for name in groups))
    np.testing.assert_allclose(total, result.image, rtol=2e-3, atol=1e-4)


@pytest.mark.parametrize("quality", QUALITIES)
def test_a_lamp_out_of_focus_stays_in_its_own_pass(quality: str) -> None:
    """Few samples meet it. A dim surface, which has hardly any noise, takes nothing of what is added to the picture."""
    rng, frame = np.random.default_rng(2), make_frame(SHAPE, apart=False)
    met = rng.random((*SHAPE, 1)) < 0.06
    lamp = np.where(met, np.float32(100.0), np.float32(0.0)) * np.ones(3, np.float32)
    surface = np.where(met, np.float32(0.15), np.float32(0.2)) * np.ones(3, np.float32)
    layer = RadianceLayer("diffuse", "diffuse", surface, frame.gbuffer.diffuse_albedo, parts={"direct": surface})
    frame = frame.with_changes(
        radiance=Radiance(surface + lamp, surface, np.zeros_like(surface)),
        gbuffer=replace(frame.gbuffer, blur_radius=np.full(SHAPE, 12.0, np.float32)),
        layers=(layer,),
        unscattered={"emission": lamp},
        spp=8,
    )
    result = denoise(frame, quality=quality)
    assert np.quantile(result.also["diffuse/direct"], 0.75) < 0.25
    total = result.also["diffuse/direct"] + {**frame.unscattered, **result.also}["emission"]
    np.testing.assert_allclose(total, result.image, rtol=2e-3, atol=1e-4)


def make_planes() -> tuple[Frame, FloatArray]:
    """Return a frame of gray light on colourful textures, with bands and planes of values, and the truth of a band."""
    rng = np.random.default_rng(5)
    noisy, truth = make_groups()
    albedo = rng.uniform(0.1, 0.9, (*SHAPE, 3))
    frame = make_frame(SHAPE, apart=False, diffuse_albedo=albedo, specular_albedo=albedo)
    light = noisy["key"][..., 0]
    bands = {f"S0.{wavelength},00nm": 0.25 * light for wavelength in range(400, 750, 50)}
    values = {"AO": np.float32(0.7) + rng.normal(0.0, 0.2, SHAPE), "mask": np.full(SHAPE, 0.7, np.float32)}
    also = {**values, **bands, "S1.400,00nm": -0.25 * light, "RGBA_key": noisy["key"]}
    # A band without the highlight and the firefly.
    also["S0.380nm"] = 0.25 * make_group(rng, 1.0, 0.5)[..., 0]
    return frame.with_changes(radiance=Radiance(noisy["key"]), also=also), 0.25 * truth["key"][..., 0]


@pytest.mark.parametrize("quality", QUALITIES)
def test_planes_are_filtered_by_the_weights_of_the_light(quality: str) -> None:
    frame, truth = make_planes()
    result = denoise(frame, quality=quality)
    assert set(result.also) == set(frame.also)
    first, *others = (result.also[name] for name in frame.also if name.endswith(",00nm") and name.startswith("S0"))
    for other in others:
        np.testing.assert_allclose(other, first, rtol=2e-6)
    noisy = frame.also["S0.400,00nm"]
    assert np.square(first - truth).mean() < 0.5 * np.square(noisy - truth).mean()
    # A band of 0.25 follows the image in neither of both.
    assert result.also["S0.380nm"][8:15, 10:17].max() < 1.5
    assert result.also["S0.380nm"][25:36, 15:26].mean() > 0.2
    # Light below 0 is filtered apart.
    assert np.square(result.also["S1.400,00nm"] + truth).mean() < np.square(noisy - truth).mean()
    # Neither albedo nor highlights nor fireflies nor what was mixed in leave a trace in values.
    np.testing.assert_allclose(result.also["mask"], 0.7, rtol=1e-5)
    assert result.also["AO"].std() < 0.5 * frame.also["AO"].std()


@pytest.mark.parametrize("quality", ["balanced", "high"])
def test_a_band_that_is_not_finite_at_a_pixel_is_finite_afterwards(quality: str) -> None:
    frame, _ = make_planes()
    color, band = frame.radiance.color.copy(), frame.also["S0.400,00nm"].copy()
    color[11, 13] = band[11, 13] = np.inf
    also = {**frame.also, "S0.400,00nm": band, "RGBA_key": color}
    result = denoise(frame.with_changes(radiance=Radiance(color), also=also), quality=quality)
    assert all(np.isfinite(image).all() for image in result.also.values())


def test_bands_of_gray_light_are_as_the_image() -> None:
    frame, _ = make_planes()
    gray = replace(frame.gbuffer, diffuse_albedo=None, specular_albedo=None)
    result = denoise(frame.with_changes(gbuffer=gray))
    first, *others = (image for name, image in result.also.items() if name.endswith(",00nm") and name.startswith("S0"))
    np.testing.assert_allclose(4.0 * first, result.image[..., 0], rtol=1e-4)
    for other in others:
        np.testing.assert_array_equal(other, first)


def test_planes_in_windows_of_frames() -> None:
    frame, truth = make_planes()
    frames = [frame, frame.with_changes(also={name: image[::-1] for name, image in frame.also.items()})]
    result = WindowFilter(1, quality="fast").denoise(frames, 0)
    assert {name: image.shape for name, image in result.also.items() if name != "RGBA_key"} == {
        name: SHAPE for name in frame.also if name != "RGBA_key"
    }
    first = result.also["S0.400,00nm"]
    assert np.square(first - truth).mean() < 0.5 * np.square(frame.also["S0.400,00nm"] - truth).mean()


def test_as_few_images_as_can_be() -> None:
    bands = {f"S0.{wavelength}nm": np.full((2, 3), wavelength, np.float32) for wavelength in range(400, 710, 10)}
    packed = pack_planes({**bands, "AO": np.ones((2, 3), np.float32)})
    assert [image.shape for image in packed.values()] == [(2, 3, 3)] * 12
    unpacked = unpack_planes(packed)
    assert set(unpacked) == {*bands, "AO"}
    for name, plane in bands.items():
        np.testing.assert_array_equal(unpacked[name], plane)
