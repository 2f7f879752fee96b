"""The kernels against the float64 oracle: weights read back from single pixels, weight sums, images."""

import os
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from lobewise.backend.jit import count_compiled_kernels
from lobewise.features import Feature, GgxFeature, GgxLobe, ScreenFeature
from lobewise.filters import cross_filter as engine
from lobewise.filters.cross_filter import _list_tiles, run_filter
from lobewise.records.frame import FloatArray
from lobewise.settings import LARGEST_RADIUS
from tests.features.frames import make_feature, make_mask, make_radiance
from tests.filters.reference import filter_reference
from tests.filters.sizes import SIZES

# tests/features compares features with their oracles; a form runs the same code for all features. These two have planes
# side by side; the second has an intermediate stage and approximate weights.
LOBES = ("position", "ggx")
# One feature of the offset and one with planes; the weight of a pixel with itself is exactly 1.
PLACE = ("screen", "position")
# The kernels' log2 is good to 1e-4 and is multiplied by beta = 4; ggx expands 1/|m|^2 to third order.
RELATIVE = {LOBES: 1e-3, PLACE: 1e-4}
EVERY_FORM = ["full", "separable", pytest.param("atrous", marks=pytest.mark.nightly)]
RADIUS = 3


def make_features(kinds: tuple[str, ...], shape: tuple[int, int]) -> list[Feature]:
    """Return some features of a random frame."""
    return [make_feature(kind, shape) for kind in kinds]


def get_tolerance(kinds: tuple[str, ...], form: str) -> float:
    """Return the largest relative error of a product of weights: one factor per pass."""
    return RELATIVE[kinds] * {"full": 1.0, "separable": 2.0, "atrous": 5.0}[form]


STRUCTURES = {"lobes": LOBES, "strict": PLACE, "albedo": PLACE}
"""What decides the code of a pass: the features that it compares, by what else the pass reads and writes."""


def check_definition(structure: str, form: str, shape: tuple[int, int], radius: int = RADIUS) -> None:
    """Raise AssertionError unless the filter is the oracle on a frame in which a tenth is bad, a tenth masked."""
    kinds = STRUCTURES[structure]
    rng = np.random.default_rng(shape)
    radiance, mask = make_radiance(shape).copy(), rng.random(shape) > 0.1
    bad = rng.random(shape) < 0.1
    radiance[bad, rng.integers(0, 3)] = rng.choice([np.nan, np.inf, -np.inf, -1.0], int(bad.sum()))
    options: dict[str, Any] = {"form": form, "radius": radius}
    if structure == "strict":
        options["strictness"] = make_strictness(shape, 0.25, 4.0)
    if structure == "albedo":
        options["albedo"] = rng.uniform(0.0, 1.0, (*shape, 3)).astype(np.float32)
        options["albedo"][rng.random(shape) < 0.1] = 0.0
    features = make_features(kinds, shape)
    out = run_filter(radiance, mask, features, moment=structure == "strict", **options)
    # Four times the power is four times the error of the logarithm.
    tolerance = get_tolerance(kinds, form) * (4.0 if structure == "strict" else 1.0)
    for name, expected in filter_reference(radiance, mask, features, **options)._asdict().items():
        found = getattr(out, name)
        if found is not None:
            np.testing.assert_allclose(found, expected, rtol=2.0 * tolerance, err_msg=name)


@pytest.mark.sampled("cpu", "vulkan")
@given(
    structure=st.sampled_from(sorted(STRUCTURES)),
    form=st.sampled_from(["full", "separable"]),
    shape=SIZES,
    radius=st.integers(0, RADIUS),
)
def test_agrees_with_the_definition(structure: str, form: str, shape: tuple[int, int], radius: int) -> None:
    check_definition(structure, form, shape, radius)


@pytest.mark.nightly
@given(structure=st.sampled_from(sorted(STRUCTURES)), shape=SIZES)
def test_atrous_agrees_with_the_definition(structure: str, shape: tuple[int, int]) -> None:
    check_definition(structure, "atrous", shape)


@given(form=st.sampled_from(["full", "separable"]), shape=SIZES, seed=st.integers(0, 99))
def test_impulse_response_is_the_weight(form: str, shape: tuple[int, int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    at = int(rng.integers(shape[0])), int(rng.integers(shape[1]))
    features, mask, impulse = make_features(LOBES, shape), make_mask(shape), np.zeros((*shape, 3), np.float32)
    impulse[at] = 1.0
    out = run_filter(impulse, mask, features, form=form, radius=RADIUS)
    image, total, *_ = filter_reference(impulse, mask, features, form=form, radius=RADIUS)
    tolerance = 2.0 * get_tolerance(LOBES, form)
    np.testing.assert_allclose(out.image[..., 0] * out.weight_sum, image[..., 0] * total, rtol=tolerance, atol=2e-5)


def test_full_weights_are_symmetric() -> None:
    shape = (9, 11)
    features = make_features(LOBES, shape)
    count = shape[0] * shape[1]
    weights = np.empty((count, count), np.float32)
    for j in range(count):
        impulse = np.zeros((*shape, 3), np.float32)
        impulse.reshape(count, 3)[j] = 1.0
        out = run_filter(impulse, make_mask(shape), features, form="full", radius=RADIUS)
        weights[:, j] = (out.image[..., 0] * out.weight_sum).ravel()
    np.testing.assert_allclose(weights, weights.T, rtol=2e-5, atol=1e-7)
    np.testing.assert_allclose(np.diag(weights), 1.0, atol=2e-3)
    assert weights.max() <= 1.0 + 2e-3


@pytest.mark.parametrize("form", EVERY_FORM)
def test_masked_pixels_neither_give_nor_take(form: str) -> None:
    shape = (16, 21)
    mask = np.random.default_rng(1).random(shape) > 0.4
    place, feature = make_features(LOBES, shape)
    assert isinstance(feature, GgxFeature)
    # Guides that are garbage where the mask says so.
    garbage = (np.nan, np.nan, np.nan, np.inf, np.inf, np.inf, -1.0, -1.0)
    planes = [np.where(mask, *pair).astype(np.float32) for pair in zip(feature.lobe, garbage, strict=True)]
    poisoned = GgxFeature(GgxLobe(*planes), 4.0)
    radiance = make_radiance(shape)
    out = run_filter(radiance, mask, [place, poisoned], form=form, radius=RADIUS)
    image, total, *_ = filter_reference(radiance, mask, [place, feature], form=form, radius=RADIUS)
    assert (out.image[~mask] == 0.0).all()
    assert (out.weight_sum[~mask] == 0.0).all()
    np.testing.assert_allclose(out.weight_sum, total, rtol=get_tolerance(LOBES, form))
    np.testing.assert_allclose(out.image, image, rtol=2.0 * get_tolerance(LOBES, form))


@pytest.mark.sampled("cpu-full")
@pytest.mark.parametrize("form", EVERY_FORM)
def test_demodulation(form: str) -> None:
    shape = (19, 18)
    rng = np.random.default_rng(2)
    albedo = rng.uniform(0.0, 1.0, (*shape, 3)).astype(np.float32)
    albedo[4:6, 3:9] = 0.0
    albedo[..., 2] = 0.0
    light = np.full((*shape, 3), 2.5, np.float32)
    features = make_features(PLACE, shape)
    out = run_filter(light * albedo, make_mask(shape), features, form=form, radius=RADIUS, albedo=albedo)
    lit = albedo > 1e-3
    np.testing.assert_allclose(out.image[lit], (2.5 * albedo)[lit], rtol=1e-5)
    assert (out.image[albedo == 0.0] == 0.0).all()


@pytest.mark.processor
@pytest.mark.parametrize("shape", [(1100, 5), (9, 2060)], ids=str)
def test_tiles_of_the_separable_form_join(shape: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    mask = np.random.default_rng(1).random(shape) > 0.1
    features, radiance = make_features(PLACE, shape), make_radiance(shape)
    albedo = np.random.default_rng(2).uniform(0.1, 1.0, (*shape, 3)).astype(np.float32)
    out = run_filter(radiance, mask, features, form="separable", radius=RADIUS, albedo=albedo)
    image, total, *_ = filter_reference(radiance, mask, features, form="separable", radius=RADIUS, albedo=albedo)
    np.testing.assert_allclose(out.weight_sum, total, rtol=get_tolerance(PLACE, "separable"))
    np.testing.assert_allclose(out.image, image, rtol=2.0 * get_tolerance(PLACE, "separable"))


@pytest.mark.processor
def test_tiles_change_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    shape = (150, 111)
    mask = np.random.default_rng(1).random(shape) > 0.1
    features, radiance = make_features(PLACE, shape), make_radiance(shape)
    strictness = make_strictness(shape, 0.5, 2.0)
    options: dict[str, Any] = {"form": "separable", "radius": RADIUS, "strictness": strictness, "moment": True}
    whole = run_filter(radiance, mask, features, **options)
    monkeypatch.setattr(engine, "MAX_TILE_COLUMNS", 40)
    monkeypatch.setattr(engine, "MIN_TILE_STRIPS", 1)
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    assert len(_list_tiles(*shape)) == 9
    tiles = run_filter(radiance, mask, features, **options)
    for name in ("image", "weight_sum", "effective_samples", "moment"):
        np.testing.assert_array_equal(getattr(tiles, name), getattr(whole, name))


def test_tiles_are_the_image(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    tiles = _list_tiles(1100, 5000)
    assert [(rows.start, rows.stop) for rows, _ in tiles[::3]] == [(0, 512), (512, 1024), (1024, 1100)]
    assert [(columns.start, columns.stop) for _, columns in tiles[:3]] == [(0, 1680), (1680, 3360), (3360, 5000)]
    assert _list_tiles(1, 1) == [(slice(0, 1), slice(0, 1))]


def make_strictness(shape: tuple[int, int], low: float, high: float) -> FloatArray:
    """Return a power per pixel, as often below 1 as above for ``low = 1 / high``."""
    return np.exp(np.random.default_rng(shape).uniform(np.log(low), np.log(high), shape)).astype(np.float32)


@pytest.mark.sampled("cpu-full")
@pytest.mark.parametrize("form", EVERY_FORM)
def test_further_images_are_filtered_as_if_alone(form: str) -> None:
    """Each has bad pixels of its own, and one has no good pixel."""
    shape = (23, 30)
    rng = np.random.default_rng(4)
    features, mask = make_features(PLACE, shape), rng.random(shape) > 0.1
    options: dict[str, Any] = {"form": form, "radius": RADIUS, "moment": True}
    options["albedo"] = rng.uniform(0.1, 1.0, (*shape, 3)).astype(np.float32)
    images = [(rng.random((*shape, 3)) * (number + 1)).astype(np.float32) for number in range(3)]
    for number, image in enumerate(images):
        image[rng.random(shape) < (0.0, 0.1, 1.0)[number]] = (0.0, np.inf, np.nan)[number]
    out = run_filter(make_radiance(shape), mask, features, more=images, **options)
    alone = run_filter(make_radiance(shape), mask, features, **options)
    for name in ("image", "weight_sum", "effective_samples", "moment"):
        np.testing.assert_allclose(getattr(out, name), getattr(alone, name), rtol=1e-5)
    for image, found in zip(images, out.more, strict=True):
        expected = run_filter(image, mask, features, **options)
        np.testing.assert_allclose(found, expected.image, rtol=1e-5)
    assert out.more[1].any()
    assert not out.more[2].any()


def test_without_modulation_the_light_is_left() -> None:
    shape = (19, 18)
    albedo = np.random.default_rng(2).uniform(0.05, 1.0, (*shape, 3)).astype(np.float32)
    albedo[3, 4] = 0.0
    radiance, mask, features = make_radiance(shape), make_mask(shape), make_features(PLACE, shape)
    light = run_filter(radiance, mask, features, form="full", radius=RADIUS, albedo=albedo, modulate=False, moment=True)
    image = run_filter(radiance, mask, features, form="full", radius=RADIUS, albedo=albedo).image
    # The compiler may divide by the weight sum after the product: a rounding each.
    np.testing.assert_allclose(light.image * albedo, image, rtol=3e-7)
    reference = filter_reference(radiance, mask, features, form="full", radius=RADIUS, albedo=albedo, modulate=False)
    np.testing.assert_allclose(light.image, reference.image, rtol=get_tolerance(PLACE, "full"))
    np.testing.assert_allclose(light.moment, reference.moment, rtol=get_tolerance(PLACE, "full"))


@pytest.mark.parametrize("form", ["full", "separable"])
def test_another_size_radius_or_parameter_does_not_compile_again(form: str) -> None:
    features = make_features(LOBES, (8, 9))
    run_filter(make_radiance((8, 9)), make_mask((8, 9)), features, form=form, radius=RADIUS)
    before = count_compiled_kernels()
    shape = (31, 50)
    other: list[Feature] = [make_feature("position", shape), make_feature("ggx", shape, beta=9.0)]
    for radius in (0, RADIUS + 1, LARGEST_RADIUS):
        run_filter(make_radiance(shape), make_mask(shape), other, form=form, radius=radius)
    assert count_compiled_kernels() == before


@pytest.mark.parametrize("form", ["full", "separable"])
def test_the_largest_radius_agrees_with_the_definition(form: str) -> None:
    shape = 9, 70
    radiance, features = make_radiance(shape), [ScreenFeature(30.0)]
    out = run_filter(radiance, make_mask(shape), features, form=form, radius=LARGEST_RADIUS)
    expected = filter_reference(radiance, make_mask(shape), features, form=form, radius=LARGEST_RADIUS)
    np.testing.assert_allclose(out.image, expected.image, rtol=get_tolerance(PLACE, form))


def test_a_larger_radius_than_any_setting_is_refused() -> None:
    with pytest.raises(TypeError, match="radius"):
        run_filter(make_radiance((8, 9)), make_mask((8, 9)), [], form="full", radius=LARGEST_RADIUS + 1)
