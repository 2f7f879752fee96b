"""Light below 0 is filtered as light; a lone pixel far below its surroundings is damage."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise import TemporalFilter, WindowFilter, make_sparse, read_frame, upsample, write_result
from lobewise.denoising import denoise
from lobewise.guides.negative import MAX_DIM_SHARE, MAX_ROUNDING, is_dim, mark_damaged, split_negative
from lobewise.io import write_frame
from lobewise.peers import has_oidn
from lobewise.recipes.streaming.recipe import denoise_file
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.radiance import RadianceLayer
from lobewise.settings import DenoiseSettings
from tests.denoising.test_denoising import make_frame

QUALITIES = ("fast", "balanced", "high", *(("auto",) if has_oidn() else ()))
SHAPE = (32, 48)
COLOR = np.array([-0.2, 0.6, 0.4], np.float32)
"""A colour outside of the gamut."""


def measure(image: FloatArray, truth: FloatArray) -> float:
    return float(np.mean((image - truth) ** 2 / (truth.mean(axis=-1, keepdims=True) ** 2 + 0.01)))


def make_saturated(**changes: Any) -> Frame:
    """Return a noisy frame of one colour outside of the gamut, split by lobe."""
    rng = np.random.default_rng(5)
    diffuse, specular = (0.5 * COLOR * rng.gamma(2.0, 0.5, (*SHAPE, 1)).astype(np.float32) for _ in range(2))
    return make_frame(SHAPE).with_changes(radiance=Radiance(diffuse + specular, diffuse, specular), **changes)


@pytest.mark.sampled("fast", "high")
@pytest.mark.real_exr
@pytest.mark.parametrize("quality", QUALITIES)
def test_colours_outside_of_the_gamut_are_filtered(quality: str, field_folder: Path, tmp_path: Path) -> None:
    source = field_folder / "gamut_negative.exr"
    frame, truth = read_frame(source), np.load(field_folder / "gamut_negative_ref.npy").astype(np.float32)
    result = denoise(frame, quality=quality)
    most = {"fast": 0.7, "balanced": 0.2, "high": 0.2, "auto": 0.2}[quality]
    assert measure(result.image, truth) < most * measure(frame.radiance.color, truth)
    assert result.bad_pixel_count == 0
    write_result(tmp_path / "out.exr", result, source=source)
    written = read_frame(tmp_path / "out.exr").radiance.color
    np.testing.assert_allclose(written, result.image, rtol=1e-3, atol=1e-4)


@pytest.mark.real_exr
@pytest.mark.parametrize("quality", [each for each in QUALITIES if each != "fast"])
def test_lamps_that_take_light_away_are_filtered_as_lamps(quality: str, field_folder: Path) -> None:
    frame, truths = read_frame(field_folder / "negative_light.exr"), np.load(field_folder / "negative_light_ref.npz")
    result = denoise(frame, quality=quality)
    groups = {name.removeprefix("ViewLayer.Combined"): name for name in frame.also}
    assert set(groups) | {""} == set(truths)
    for name, truth in truths.items():
        clean, noisy = (
            (result.also[groups[name]], frame.also[groups[name]]) if name else (result.image, frame.radiance.color)
        )
        assert measure(clean, truth) < 0.6 * measure(noisy, truth), name
    np.testing.assert_allclose(sum(result.also[name] for name in groups.values()), result.image, atol=1e-4)


def test_light_below_0_is_dim_up_to_a_share_of_the_light() -> None:
    light = Frame(Radiance(np.full((*SHAPE, 3), 2.0, np.float32)))
    shares = [0.0, 0.9 * MAX_DIM_SHARE, 1.1 * MAX_DIM_SHARE]
    frames = [Frame(Radiance(np.full((*SHAPE, 3), 2.0 * share, np.float32))) for share in shares]
    assert [is_dim(below, light) for below in frames] == [True, True, False]


@pytest.mark.parametrize("is_sparse", [False, True])
def test_rounding_below_0_becomes_0(is_sparse: bool) -> None:
    def split(block: float, pixel: float) -> tuple[Any, Any]:
        """Return both parts of a frame of specular light of 1 with a block and a pixel of diffuse light."""
        specular, diffuse = np.ones((*SHAPE, 3), np.float32), np.zeros((*SHAPE, 3), np.float32)
        diffuse[3:6, 4:7], diffuse[8, 9, 1] = block, pixel
        frame = make_frame(SHAPE).with_changes(radiance=Radiance(specular + diffuse, diffuse, specular))
        return split_negative(make_sparse(frame, 1) if is_sparse else frame)

    above, below = split(-0.9 * MAX_ROUNDING, -0.9 * MAX_ROUNDING)
    assert below is None
    np.testing.assert_array_equal(above.radiance.diffuse, 0.0)
    above, below = split(-2.0 * MAX_ROUNDING, -0.9 * MAX_ROUNDING)
    np.testing.assert_array_equal(above.radiance.diffuse, 0.0)
    assert below.radiance.diffuse.sum() == pytest.approx(9.0 * 3.0 * 2.0 * MAX_ROUNDING)


@pytest.mark.parametrize(("quality", "count"), [("balanced", 1), ("fast", 0)])
def test_bands_name_bright_light_below_0(quality: str, count: int, tmp_path: Path) -> None:
    write_frame(tmp_path / "in.exr", make_saturated())
    settings = DenoiseSettings(quality=quality, with_oidn=False)
    result = denoise_file(tmp_path / "in.exr", tmp_path / "out.exr", settings, rows=16)
    assert sum(note.startswith("Light below 0 is 20 % of the light.") for note in result.notes) == count


RECIPES: dict[str, Callable[[Frame], FloatArray]] = {
    **{quality: lambda frame, quality=quality: denoise(frame, quality=quality).image for quality in QUALITIES},
    "upsample": lambda frame: upsample(make_sparse(frame, 2)).image,
    "history": lambda frame: TemporalFilter().add(frame).image,
    "sparse history": lambda frame: TemporalFilter().add(make_sparse(frame, 2)).image,
    "window": lambda frame: WindowFilter(1, quality="balanced").denoise([frame, frame.with_changes(spp=5)], 0).image,
}


@pytest.mark.parametrize("name", RECIPES)
def test_every_recipe_filters_light_below_0(name: str) -> None:
    frame = make_saturated()
    image = RECIPES[name](frame)
    assert measure(image, np.broadcast_to(COLOR, image.shape)) < 0.5 * measure(frame.radiance.color, COLOR)
    np.testing.assert_allclose(image.mean(axis=(0, 1)), COLOR, rtol=0.06)


def test_the_difference_of_both_frames_is_the_frame() -> None:
    rng = np.random.default_rng(1)

    def draw() -> FloatArray:
        return rng.normal(0.2, 0.3, (*SHAPE, 3)).astype(np.float32)

    halves = [[draw(), draw()] for _ in range(2)]
    means = [0.5 * (a + b) for a, b in zip(*halves, strict=True)]
    layers = [
        RadianceLayer(name, lobe, mean, half_a=a, half_b=b, parts={"key": 0.25 * mean, "fill": 0.75 * mean})
        for (name, lobe), mean, a, b in zip((("d", "diffuse"), ("g", "glossy")), means, *halves, strict=True)
    ]
    frame = make_frame(SHAPE).with_changes(
        radiance=Radiance(means[0] + means[1] + 0.1, *means),
        half_a=Radiance(sum(halves[0]), *halves[0]),
        half_b=Radiance(sum(halves[1]), *halves[1]),
        layers=layers,
        also={"lamp": draw()},
    )
    above, below = split_negative(frame)
    for name in frame.radiance.names:
        first, second = getattr(above.radiance, name), getattr(below.radiance, name)
        np.testing.assert_allclose(first - second, getattr(frame.radiance, name), atol=1e-6)
        assert first.min() >= -1e-6
        assert second.min() >= 0.0
    for layer, first, second in zip(frame.layers, above.layers, below.layers, strict=True):
        np.testing.assert_allclose(first.radiance - second.radiance, layer.radiance, atol=1e-6)
        # The halves are what is filtered, and their mean is the radiance.
        np.testing.assert_allclose(0.5 * (first.half_a + first.half_b), first.radiance, atol=1e-6)
        for part in layer.parts:
            np.testing.assert_allclose(first.parts[part] - second.parts[part], layer.parts[part], atol=1e-6)
    np.testing.assert_allclose(above.also["lamp"] - below.also["lamp"], frame.also["lamp"], atol=1e-6)
    total = below.layers[0].radiance + below.layers[1].radiance
    np.testing.assert_allclose(below.radiance.color, np.maximum(total, -frame.radiance.color), atol=1e-6)


def test_a_frame_without_light_below_0_stays_itself() -> None:
    frame = make_frame(SHAPE)
    assert split_negative(frame) == (frame, None)


def test_one_or_two_pixels_far_below_all_around_are_damage() -> None:
    image = np.full((*SHAPE, 3), 0.5, np.float32)
    image[5, 5], image[20, 20], image[20, 21] = -30.0, -1e20, -1e30
    np.testing.assert_array_equal(np.argwhere(mark_damaged(image)), [[5, 5], [20, 20], [20, 21]])
    result = denoise(make_frame(SHAPE, apart=False).with_changes(radiance=Radiance(image)), quality="balanced")
    assert result.bad_pixel_count == 3
    np.testing.assert_allclose(result.image, 0.5, rtol=1e-3)


def test_the_ringing_around_a_lamp_is_no_damage() -> None:
    image = np.full((*SHAPE, 3), 0.05, np.float32)
    image[13:18, 13:18] = -2.0
    image[14:17, 14:17] = 30.0
    assert not mark_damaged(image).any()


def test_a_saturated_firefly_is_no_damage() -> None:
    image = np.full((*SHAPE, 3), 0.05, np.float32)
    image[9, 9] = [-5.0, -1.0, 60.0]
    assert not mark_damaged(image).any()


def test_many_bad_pixels_raise_a_question() -> None:
    frame = make_saturated()
    color = np.array(frame.radiance.color)
    color[:1] = np.nan
    result = denoise(frame.with_changes(radiance=Radiance(color)), quality="fast")
    assert any("is this channel the picture" in note for note in result.notes)
    assert not any("is this channel" in note for note in denoise(frame, quality="fast").notes)
