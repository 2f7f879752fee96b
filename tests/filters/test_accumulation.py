"""Accumulation of samples into a history, and the trust in the history, against the definitions."""

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from lobewise.backend.jit import count_compiled_kernels
from lobewise.errors import InputError
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.history.accumulation import AccumulatedOutput, KnownKernel, SampleGrid
from lobewise.filters.history.accumulation_pass import (
    FULL_TRUST_ERRORS,
    IGNORED_DIFFERENCE,
    MIN_KNOWN_FRAMES,
    MIN_WEIGHT,
    NO_TRUST_ERRORS,
)
from lobewise.filters.history.sums import HISTORY_CHANNELS
from lobewise.lobes.vectors import LUMINANCE
from lobewise.records.frame import FloatArray
from tests.features.frames import make_feature, make_mask, make_radiance
from tests.features.oracles import get_similarity
from tests.filters.sizes import SMALL_SIZES
from tests.mistakes import refuses

FloatImage = NDArray[np.float64]

SHAPE = (13, 21)
RADIUS = 2
CASES = [(1, (0, 0)), (2, (1, 0)), (3, (0, 2)), (4, (3, 1))]
GROWTH, OWN = 0.5, 1.4
# Relative error: that of the kernels' logarithm, raised to a power of at most 3.
TOLERANCE = 2e-3
FLOOR = 1e-3


def make_given(shape: tuple[int, int], scale: int, place: tuple[int, int]) -> dict[str, Any]:
    """Return a frame of random samples, guides and history: a tenth of everything is bad."""
    rng = np.random.default_rng([scale, *shape])
    samples = make_radiance(shape)[place[0] :: scale, place[1] :: scale].copy()
    samples[rng.random(samples.shape[:2]) < 0.1] = np.nan
    albedo = rng.uniform(0.1, 1.0, (*shape, 3)).astype(np.float32)
    albedo[rng.random(shape) < 0.1] = rng.choice([np.nan, -1.0, 0.9e-3, 5e-4])
    history = rng.exponential(1.0, (*shape, HISTORY_CHANNELS)).astype(np.float32)
    history[rng.random(shape) < 0.1] = 0.0
    return {
        "samples": samples,
        "mask": rng.random(shape) > 0.1,
        "albedo": albedo,
        "history": history,
        "trust": rng.random(samples.shape[:2]).astype(np.float32),
    }


def make_grid(given: dict[str, Any], scale: int, place: tuple[int, int]) -> SampleGrid:
    """Return a grid of one feature."""
    features = [make_feature("position", given["mask"].shape)]
    return SampleGrid(given["mask"], features, scale=scale, place=place, albedo=given["albedo"])


def accumulate(given: dict[str, Any], scale: int, place: tuple[int, int], **changes: Any) -> AccumulatedOutput:
    """Return the result of the kernel."""
    options = {"radius": RADIUS, "history": given["history"], "trust": given["trust"], "growth": GROWTH, "own": OWN}
    return make_grid(given, scale, place).accumulate(given["samples"], **{**options, **changes})


def compute_weights(mask: NDArray[np.bool_], scale: int, place: tuple[int, int], radius: int) -> FloatImage:
    """Return the similarity of every pixel and every sample near it, (height, width, rows, columns)."""
    height, width = mask.shape
    feature = make_feature("position", mask.shape)
    rows, columns = np.arange(place[0], height, scale), np.arange(place[1], width, scale)
    y, x, row, column = np.meshgrid(np.arange(height), np.arange(width), rows, columns, indexing="ij")
    weights = get_similarity(feature, (y, x), (row, column))
    near = (abs(row // scale - y // scale) <= radius) & (abs(column // scale - x // scale) <= radius)
    return np.where(near & mask[y, x] & mask[row, column], weights, 0.0)


def demodulate(samples: FloatArray, albedo: FloatArray, floor: float) -> tuple[FloatImage, NDArray[np.bool_]]:
    """Return samples over their albedo, 0 where bad, and which of them are good."""
    both = np.concatenate([samples, albedo], axis=-1).astype(np.float64)
    good = (np.isfinite(both) & (both >= 0.0)).all(axis=-1) & (both[..., 3:].max(axis=-1) > floor)
    light = both[..., :3] / np.maximum(both[..., 3:], floor)
    return np.where(good[..., None], light, 0.0), good


def narrow_known(
    weights: FloatImage, given: dict[str, Any], scale: int, place: tuple[int, int], known: KnownKernel
) -> FloatImage:
    """Return weights in which pixels that have a history have a narrower kernel."""
    height, width = given["mask"].shape
    rows, columns = (np.arange(first, length, scale) for first, length in zip(place, (height, width), strict=True))
    y, x, row, column = np.meshgrid(np.arange(height), np.arange(width), rows, columns, indexing="ij")
    near = np.maximum(abs(row // scale - y // scale), abs(column // scale - x // scale)) <= known.radius
    precision = 1.0 / (2.0 * known.sigma**2) - 1.0 / (2.0 * known.screen_sigma**2)
    narrow = weights * near * np.exp(-precision * ((row - y) ** 2 + (column - x) ** 2))
    last = given["trust"].shape
    block = [np.minimum(np.arange(size) // scale, most - 1) for size, most in zip((height, width), last, strict=True)]
    is_known = given["history"][..., 6] * given["trust"][np.ix_(*block)] >= MIN_KNOWN_FRAMES
    assert 0.1 < is_known.mean() < 0.9
    return np.where(is_known[..., None, None], narrow, weights)


def add_own_samples(sums: FloatImage, unit: FloatImage, given: dict[str, Any], shaded: Any) -> None:
    """Add each pixel's own sample, which counts as one of weight own; the part that is 1 is in the sums already."""
    light, good = demodulate(given["samples"], given["albedo"][shaded], FLOOR / OWN)
    more = np.where(good & given["mask"][shaded], (OWN - 1.0) * unit[shaded], 0.0)
    sums[shaded][..., :3] += more[..., None] * light
    sums[shaded][..., 3] += more
    sums[shaded][..., 4] += (more + unit[shaded]) ** 2 * (more > 0.0) - unit[shaded] ** 2 * (more > 0.0)
    sums[shaded][..., 5] += more * (light @ LUMINANCE) ** 2


def check_summary(found: AccumulatedOutput, unit: FloatImage, albedo: FloatArray) -> None:
    """Raise AssertionError unless image, weight sum, effective samples and variance are those of the sums."""
    sums = found.sums.astype(np.float64)
    weight = sums[..., 3]
    some = np.where(weight > 0.0, weight, np.inf)
    mean = sums[..., :3] / some[..., None]
    count = np.where(weight > 0.0, np.maximum(weight**2 / np.maximum(sums[..., 4], 1e-30), 1.0), 0.0)
    tint = np.where(((albedo >= 0.0) & np.isfinite(albedo)).all(axis=-1, keepdims=True), albedo, 0.0)
    spread = np.maximum(sums[..., 5] / some - (mean @ LUMINANCE) ** 2, 0.0) / np.maximum(count, 1.0)
    np.testing.assert_allclose(found.image, mean * tint, rtol=2e-6, atol=1e-12)
    np.testing.assert_allclose(found.weight_sum, weight / unit, rtol=5e-6)
    np.testing.assert_allclose(found.effective_samples, count, rtol=5e-6)
    # The variance is a difference of squares.
    np.testing.assert_allclose(found.variance, spread * (tint @ LUMINANCE) ** 2, rtol=1e-3, atol=1e-5)


def trust_history(given: dict[str, Any], scale: int, place: tuple[int, int]) -> FloatImage:
    """Return the sums of the history as far as they are trusted."""
    near = compute_weights(given["mask"], scale, place, 2 if scale == 1 else 1)
    told = near.sum(axis=(2, 3))
    trust = np.where(told > 0.0, (near * given["trust"]).sum(axis=(2, 3)) / np.where(told > 0.0, told, 1.0), 1.0)
    sums = given["history"].astype(np.float64) * trust[..., None]
    sums[..., 4] *= trust
    return sums


def accumulate_slowly(
    given: dict[str, Any], scale: int, place: tuple[int, int], known: KnownKernel | None = None
) -> FloatImage:
    """Return the sums from the definition, (height, width, 7)."""
    mask, shaded = given["mask"], np.s_[place[0] :: scale, place[1] :: scale]
    sums = trust_history(given, scale, place)
    unit = (sums[..., 6] + 1.0) ** GROWTH
    light, good = demodulate(given["samples"], given["albedo"][shaded], FLOOR)
    weights = compute_weights(mask, scale, place, RADIUS)
    if known is not None:
        weights = narrow_known(weights, given, scale, place, known)
    weights = np.where(weights > 0.0, weights ** unit[..., None, None], 0.0) * good
    sums[..., :3] += unit[..., None] * np.einsum("yxrc,rck->yxk", weights, light)
    sums[..., 3] += unit * weights.sum(axis=(2, 3))
    sums[..., 4] += unit**2 * (weights**2).sum(axis=(2, 3))
    sums[..., 5] += unit * np.einsum("yxrc,rc->yx", weights, (light @ LUMINANCE) ** 2)
    sums[..., 6] += weights.sum(axis=(2, 3)) > 0.0
    add_own_samples(sums, unit, given, shaded)
    return sums


def check_definition(scale: int, place: tuple[int, int], shape: tuple[int, int]) -> None:
    """Raise AssertionError unless random samples, one of each block, are accumulated as the definition says."""
    # The first block has the place, however small the image is.
    place = min(place[0], shape[0] - 1), min(place[1], shape[1] - 1)
    given = make_given(shape, scale, place)
    out = accumulate(given, scale, place)
    np.testing.assert_allclose(out.sums, accumulate_slowly(given, scale, place), rtol=TOLERANCE, atol=1e-6)


@given(scale=st.integers(1, 4), place=st.tuples(st.integers(0, 3), st.integers(0, 3)), shape=SMALL_SIZES)
def test_agrees_with_the_definition(scale: int, place: tuple[int, int], shape: tuple[int, int]) -> None:
    check_definition(scale, (place[0] % scale, place[1] % scale), shape)


@pytest.mark.parametrize(("scale", "place"), CASES[1:])
@pytest.mark.parametrize("radius", [0, 1])
def test_pixels_with_a_history_have_their_own_kernel(radius: int, scale: int, place: tuple[int, int]) -> None:
    # Wide enough for vectors that are all known, all unknown, and mixed.
    shape = (9, 140)
    given, known = make_given(shape, scale, place), KnownKernel(radius, 9.0, 4.0)
    given["history"][:, :50, 6], given["history"][:, 90:, 6] = 0.0, 5.0
    given["mask"][:, 64:96] = False
    out = accumulate(given, scale, place, known=known)
    expected = accumulate_slowly(given, scale, place, known)
    np.testing.assert_allclose(out.sums, expected, rtol=TOLERANCE, atol=1e-6)
    assert (accumulate(given, scale, place).sums != out.sums).any()


def compute_trust_slowly(given: dict[str, Any], scale: int, place: tuple[int, int]) -> FloatImage:
    """Return the trust from the definition, (rows, columns)."""
    mask, shaded = given["mask"], np.s_[place[0] :: scale, place[1] :: scale]
    weights = compute_weights(mask, scale, place, 2)[shaded]
    light, good = demodulate(given["samples"], given["albedo"][shaded], FLOOR / OWN)
    history = given["history"][shaded].astype(np.float64)
    known = good & mask[shaded] & (history[..., 3] > 0.5 * OWN)
    before = history[..., :3] / np.where(history[..., 3] > 0.0, history[..., 3], np.inf)[..., None]
    weights = weights * known
    total = weights.sum(axis=(2, 3))
    some = np.where(total > 0.0, total, np.inf)
    count = total**2 / np.where(total > 0.0, (weights**2).sum(axis=(2, 3)), np.inf)
    excess = np.zeros(known.shape)
    for k in range(3):
        step = np.where(known, light[..., k] - before[..., k], 0.0)
        mean, square = (np.einsum("yxrc,rc->yx", weights, value) / some for value in (step, step**2))
        mean = np.abs(mean)
        error = np.sqrt(np.maximum(square - mean**2, 0.0) / np.maximum(count - 1.0, 1e-9))
        high = mean / np.maximum(error + IGNORED_DIFFERENCE * (before[..., k] + mean), 1e-30)
        excess = np.where((count > 1.5) & known, np.maximum(excess, high), excess)
    return np.clip((NO_TRUST_ERRORS - excess) / (NO_TRUST_ERRORS - FULL_TRUST_ERRORS), 0.0, 1.0)


@pytest.mark.sampled("cpu-2-place1", "vulkan-2-place1")
@pytest.mark.parametrize(("scale", "place"), CASES[:2])
def test_trust_agrees_with_the_definition(scale: int, place: tuple[int, int]) -> None:
    given = make_given((40, 50), scale, place)
    # Some of the history is of another light, by far or by little.
    light = np.random.default_rng(2).choice([1.0, 2.0, 6.0], (5, 5)).repeat(8, 0).repeat(10, 1)
    given["history"][..., :3] = (light * given["history"][..., 3])[..., None]
    trust = make_grid(given, scale, place).compute_trust(given["samples"], given["history"], OWN)
    expected = compute_trust_slowly(given, scale, place)
    assert np.mean((expected > 0.0) & (expected < 1.0)) > 0.05
    np.testing.assert_allclose(trust, expected, rtol=0.0, atol=0.02)


@pytest.mark.sampled("cpu-False", "vulkan-False")
@pytest.mark.parametrize("remembers", [True, False])
def test_whole_frames_are_accumulated_as_their_filter_gives_them(remembers: bool) -> None:
    given = make_given(SHAPE, 1, (0, 0))
    history, trust = (given[name] if remembers else None for name in ("history", "trust"))
    options = {"history": history, "trust": trust, "growth": GROWTH, "own": OWN}
    found = make_grid(given, 1, (0, 0)).accumulate_filtered(given["samples"], form="separable", radius=3, **options)
    sums = trust_history(given, 1, (0, 0)) * remembers
    unit = (sums[..., 6] + 1.0) ** GROWTH
    features = [make_feature("position", SHAPE)]
    filtering: dict[str, Any] = {
        "albedo": given["albedo"],
        "modulate": False,
        "moment": True,
        "strictness": unit.astype(np.float32),
    }
    filtered = run_filter(given["samples"], given["mask"], features, form="separable", radius=3, **filtering)
    weight = filtered.weight_sum * unit
    sums[..., :3] += filtered.image * weight[..., None]
    sums[..., 3] += weight
    sums[..., 4] += weight**2 / np.maximum(filtered.effective_samples, 1.0)
    sums[..., 5] += filtered.moment * weight
    sums[..., 6] += weight > 0.0
    add_own_samples(sums, unit, given, np.s_[:, :])
    np.testing.assert_allclose(found.sums, sums, rtol=1e-4, atol=1e-6)
    check_summary(found, unit, given["albedo"])


def test_what_resembles_nothing_keeps_the_little_that_it_has() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    sums = accumulate(given, 2, (1, 0), history=None, trust=None, own=1.0).sums
    alive = sums[..., 3] > 0.0
    assert alive.any()
    assert not alive.all()
    assert (sums[alive][:, 3] >= np.float32(MIN_WEIGHT)).all()
    assert (sums[~alive] == 0.0).all()


def test_the_summary_is_that_of_the_sums() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    trust = np.full_like(given["trust"], 0.25)
    out = accumulate(given, 2, (1, 0), trust=trust)
    told = compute_weights(given["mask"], 2, (1, 0), 1).sum(axis=(2, 3)) > 0.0
    frames = given["history"][..., 6] * np.where(told, 0.25, 1.0)
    check_summary(out, (frames + 1.0) ** GROWTH, given["albedo"])


def test_no_history_is_one_that_holds_nothing() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    nothing = accumulate(given, 2, (1, 0), history=None, trust=None)
    empty = accumulate(given, 2, (1, 0), history=np.zeros_like(given["history"]))
    for name in ("sums", "image", "weight_sum", "effective_samples", "variance"):
        assert getattr(nothing, name).tobytes() == getattr(empty, name).tobytes(), name


def test_without_trust_the_history_counts_whole() -> None:
    given = make_given(SHAPE, 3, (0, 2))
    without = accumulate(given, 3, (0, 2), trust=None)
    whole = accumulate(given, 3, (0, 2), trust=np.ones_like(given["trust"]))
    np.testing.assert_allclose(without.sums, whole.sums, rtol=2e-6)


def test_histories_of_any_layout_are_the_same() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    planes = np.moveaxis(np.ascontiguousarray(np.moveaxis(given["history"], -1, 0)), 0, -1)
    planes.setflags(write=False)
    assert accumulate(given, 2, (1, 0), history=planes).sums.tobytes() == accumulate(given, 2, (1, 0)).sums.tobytes()


def test_one_kernel_serves_every_radius_scale_and_strength() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    accumulate(given, 2, (1, 0))
    compiled = count_compiled_kernels()
    for radius in range(5):
        accumulate(given, 2, (1, 0), radius=radius, growth=0.1 * radius, own=1.0 + radius)
    for scale, place in CASES:
        accumulate(make_given(SHAPE, scale, place), scale, place, trust=None)
        accumulate(make_given(SHAPE, scale, place), scale, place, history=None)
    assert count_compiled_kernels() == compiled


def test_shapes_are_checked() -> None:
    given = make_given(SHAPE, 2, (1, 0))
    for name in ("trust", "history"):
        with refuses(InputError, name):
            accumulate(given, 2, (1, 0), **{name: given[name][:-1]})
    with refuses(InputError, "albedo"):
        SampleGrid(make_mask(SHAPE), [], scale=2, albedo=given["albedo"][:-1])
