"""Sums against the samples that they stand for, written out one by one in float64."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from lobewise.filters.accumulation import SMALLEST_WEIGHT
from lobewise.filters.cross_filter import FilterOutput, run_filter
from lobewise.filters.reprojection import HISTORY_CHANNELS
from lobewise.frame import FloatArray
from lobewise.lobes.vectors import LUMINANCE
from lobewise.temporal.sums import (
    FRAMES,
    MOMENT,
    SQUARED_WEIGHT,
    WEIGHT,
    Samples,
    add_own_samples,
    divide,
    fade,
    find_effective_samples,
    find_luminance,
    find_variance,
    gather_samples,
    make_sums,
    summarize,
)

SHAPE = (5, 6)
COUNT = 9
# A dozen roundings of float32.
TOLERANCE = 2e-6
EVERYWHERE = slice(None), slice(None)


def make_samples(seed: int = 1) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return weights (height, width, n) and radiances (height, width, n, 3) of the samples of every pixel."""
    rng = np.random.default_rng(seed)
    return rng.uniform(0.01, 1.0, (*SHAPE, COUNT)), rng.exponential(1.0, (*SHAPE, COUNT, 3))


def add_up(weights: NDArray[np.float64], radiances: NDArray[np.float64]) -> FloatArray:
    """Return the sums over samples, of one frame."""
    sums = np.ones((*weights.shape[:2], HISTORY_CHANNELS))
    sums[..., :3] = np.sum(weights[..., None] * radiances, axis=2)
    sums[..., WEIGHT] = np.sum(weights, axis=2)
    sums[..., SQUARED_WEIGHT] = np.sum(weights**2, axis=2)
    sums[..., MOMENT] = np.sum(weights * (radiances @ np.array(LUMINANCE)) ** 2, axis=2)
    return sums.astype(np.float32)


def make_output(weights: NDArray[np.float64], radiances: NDArray[np.float64]) -> FilterOutput:
    """Return what a filter with these weights gives."""
    sums = add_up(weights, radiances).astype(np.float64)
    total, squares = sums[..., WEIGHT], sums[..., SQUARED_WEIGHT]
    parts = sums[..., :3] / total[..., None], total, total**2 / squares, sums[..., MOMENT] / total
    return FilterOutput(*(part.astype(np.float32) for part in parts))


def make_own(radiance: FloatArray, good: NDArray[np.bool_]) -> Samples:
    """Return samples at every pixel."""
    return Samples(EVERYWHERE, np.where(good[..., None], radiance, 0.0).astype(np.float32), good)


def test_divide_is_the_weighted_mean() -> None:
    weights, radiances = make_samples()
    expected = np.sum(weights[..., None] * radiances, axis=2) / np.sum(weights, axis=2)[..., None]
    np.testing.assert_allclose(divide(add_up(weights, radiances)), expected, rtol=TOLERANCE)


@pytest.mark.parametrize("weight", [1e-36, 1e-12, 1.0, 1e12])
def test_a_mean_does_not_depend_on_how_much_it_weighs(weight: float) -> None:
    weights, radiances = make_samples()
    mean = divide(add_up(weights, radiances))
    np.testing.assert_allclose(divide(add_up(weight * weights, radiances)), mean, rtol=1e-5)


def test_no_weight_is_black_and_no_sample() -> None:
    nothing = np.ones((*SHAPE, HISTORY_CHANNELS), np.float32)
    nothing[..., WEIGHT] = 0.0
    for value in (divide(nothing), find_effective_samples(nothing), find_variance(nothing)):
        assert (value == 0.0).all()


@pytest.mark.parametrize("image", [False, True])
def test_fading_scales_every_weight(image: bool) -> None:
    weights, radiances = make_samples()
    share = np.random.default_rng(2).random(SHAPE).astype(np.float32) if image else 0.7
    expected = add_up(weights * np.broadcast_to(share, SHAPE)[..., None], radiances)
    expected[..., FRAMES] = share
    faded = fade(add_up(weights, radiances), share)
    assert faded.dtype == np.float32
    np.testing.assert_allclose(faded, expected, rtol=TOLERANCE)


def test_fading_leaves_mean_and_effective_samples() -> None:
    sums = add_up(*make_samples())
    faded = fade(sums, 0.3)
    np.testing.assert_allclose(divide(faded), divide(sums), rtol=TOLERANCE)
    np.testing.assert_allclose(find_effective_samples(faded), find_effective_samples(sums), rtol=TOLERANCE)
    np.testing.assert_allclose(find_variance(faded), find_variance(sums), rtol=1e-5)


@pytest.mark.parametrize("weight", [1e-6, 1.0, 1e8])
def test_equal_weights_are_as_many_samples(weight: float) -> None:
    _, radiances = make_samples()
    sums = add_up(np.full((*SHAPE, COUNT), weight), radiances)
    np.testing.assert_allclose(find_effective_samples(sums), COUNT, rtol=TOLERANCE)


def test_effective_samples_are_at_least_one() -> None:
    sums = add_up(*make_samples())
    sums[..., SQUARED_WEIGHT] = 4.0 * sums[..., WEIGHT] ** 2
    assert (find_effective_samples(sums) == 1.0).all()


def test_variance_of_equal_weights_is_that_of_the_mean() -> None:
    _, radiances = make_samples()
    sums = add_up(np.full((*SHAPE, COUNT), 0.25), radiances)
    expected = np.var(radiances @ np.array(LUMINANCE), axis=2) / COUNT
    # A difference of squares, some ten times as large as it.
    np.testing.assert_allclose(find_variance(sums), expected, rtol=1e-4)


def test_variance_counts_unequal_weights_by_their_squares() -> None:
    weights, radiances = make_samples()
    share = weights / np.sum(weights, axis=2, keepdims=True)
    luminance = radiances @ np.array(LUMINANCE)
    mean = np.sum(share * luminance, axis=2)
    spread = np.sum(share * (luminance - mean[..., None]) ** 2, axis=2)
    expected = spread * np.sum(share**2, axis=2)
    np.testing.assert_allclose(find_variance(add_up(weights, radiances)), expected, rtol=1e-4)


def test_variance_of_a_constant_is_nothing_but_rounding() -> None:
    weights, radiances = make_samples()
    variance = find_variance(add_up(weights, np.full_like(radiances, 0.7)))
    assert ((variance >= 0.0) & (variance < 1e-6)).all()


def gather(output: FilterOutput, factor: FloatArray, history: FloatArray | None = None) -> FloatArray:
    """Return the sums of a filter's output."""
    assert output.moment is not None
    return make_sums(output.image, output.weight_sum, output.effective_samples, output.moment, factor, history)


def test_a_history_is_added() -> None:
    weights, radiances = make_samples()
    ones = np.ones(SHAPE, np.float32)
    output = make_output(weights, radiances)
    history = np.random.default_rng(3).random((*SHAPE, 7)).astype(np.float32)
    np.testing.assert_allclose(gather(output, ones, history), gather(output, ones) + history, rtol=TOLERANCE)


@pytest.mark.parametrize("albedo", [None, 0.25])
def test_a_summary_is_what_the_sums_tell_one_by_one(albedo: float | None) -> None:
    sums = gather(make_output(*make_samples()), np.ones(SHAPE, np.float32))
    unit = np.random.default_rng(4).uniform(1.0, 3.0, SHAPE).astype(np.float32)
    tint = [] if albedo is None else [np.full((*SHAPE, 3), albedo, np.float32)]
    image, weight_sum, effective, variance = summarize(sums, unit, *tint)
    factor = 1.0 if albedo is None else albedo
    np.testing.assert_allclose(image, factor * divide(sums), rtol=TOLERANCE)
    np.testing.assert_allclose(weight_sum, sums[..., WEIGHT] / unit, rtol=TOLERANCE)
    np.testing.assert_array_equal(effective, find_effective_samples(sums))
    np.testing.assert_allclose(variance, factor**2 * find_variance(sums), rtol=TOLERANCE)


def test_a_summary_has_no_light_where_the_albedo_is_none() -> None:
    sums = gather(make_output(*make_samples()), np.ones(SHAPE, np.float32))
    tint = np.full((*SHAPE, 3), np.nan, np.float32)
    image, _, _, variance = summarize(sums, np.ones(SHAPE, np.float32), tint)
    assert (image == 0.0).all()
    assert (variance == 0.0).all()


def test_what_a_filter_gathered_are_its_sums() -> None:
    weights, radiances = make_samples()
    factor = np.random.default_rng(2).uniform(0.5, 8.0, SHAPE).astype(np.float32)
    expected = add_up(weights * factor[..., None], radiances)
    np.testing.assert_allclose(gather(make_output(weights, radiances), factor), expected, rtol=TOLERANCE)


def test_what_resembles_nothing_keeps_the_little_that_it_has() -> None:
    output = make_output(*make_samples())
    output.weight_sum[0, 0] = 1e-36
    output.weight_sum[1, 1] = 0.0
    sums = gather(output, np.ones(SHAPE, np.float32))
    assert sums[0, 0, WEIGHT] == np.float32(SMALLEST_WEIGHT)
    np.testing.assert_allclose(divide(sums)[0, 0], output.image[0, 0], rtol=TOLERANCE)
    np.testing.assert_allclose(find_effective_samples(sums)[0, 0], output.effective_samples[0, 0], rtol=TOLERANCE)
    assert (sums[1, 1] == 0.0).all()


def test_own_sample_counts_more_and_stays_one() -> None:
    weights, radiances = make_samples()
    own = np.random.default_rng(3).uniform(0.5, 2.0, SHAPE)
    bonus = np.random.default_rng(4).uniform(0.5, 40.0, SHAPE)
    weights[..., 0] = own
    sums = add_up(weights, radiances)
    samples = make_own(radiances[..., 0, :].astype(np.float32), np.ones(SHAPE, bool))
    add_own_samples(sums, samples, bonus.astype(np.float32), own.astype(np.float32))
    weights[..., 0] += bonus
    np.testing.assert_allclose(sums, add_up(weights, radiances), rtol=TOLERANCE)
    # By default it is one more sample.
    sums = add_up(weights, radiances)
    add_own_samples(sums, samples, bonus.astype(np.float32))
    more = np.concatenate([weights, bonus[..., None]], axis=2), np.concatenate([radiances, radiances[..., :1, :]], 2)
    np.testing.assert_allclose(sums, add_up(*more), rtol=TOLERANCE)


def test_bad_own_samples_are_left_out() -> None:
    sums = add_up(*make_samples())
    good = np.random.default_rng(3).random(SHAPE) > 0.5
    before = sums.copy()
    own = make_own(np.ones((*SHAPE, 3), np.float32), good)
    add_own_samples(sums, own, np.full(SHAPE, 2.0, np.float32))
    assert (sums[~good] == before[~good]).all()
    np.testing.assert_allclose(sums[good][:, WEIGHT], before[good][:, WEIGHT] + 2.0, rtol=TOLERANCE)


def test_own_samples_of_a_sparse_frame_go_to_their_pixels() -> None:
    sums = np.zeros((*SHAPE, HISTORY_CHANNELS), np.float32)
    where = slice(1, None, 2), slice(0, None, 3)
    samples = Samples(where, np.full((2, 2, 3), 0.5, np.float32), np.ones((2, 2), bool))
    bonus = np.arange(30, dtype=np.float32).reshape(SHAPE)
    add_own_samples(sums, samples, bonus)
    expected = np.zeros(SHAPE)
    expected[where] = bonus[where]
    np.testing.assert_array_equal(sums[..., WEIGHT], expected)
    np.testing.assert_allclose(divide(sums)[where], 0.5, rtol=0.0, atol=1e-7)
    assert (sums[..., FRAMES] == 0.0).all()


def test_samples_are_what_the_filter_takes() -> None:
    rng = np.random.default_rng(7)
    radiance = rng.exponential(1.0, (*SHAPE, 3)).astype(np.float32)
    albedo = rng.uniform(0.01, 1.0, (*SHAPE, 3)).astype(np.float32)
    mask = np.ones(SHAPE, bool)
    mask[4, 5] = False
    radiance[0, 0, 1], radiance[0, 1, 2], radiance[0, 2, 0] = np.nan, np.inf, -1.0
    albedo[1, 0, 1], albedo[1, 1, 2], albedo[1, 2, 0] = np.nan, np.inf, -1.0
    albedo[2, 0], albedo[2, 1], albedo[2, 2, 1:], albedo[2, 3] = 0.0, 1e-3, 0.0, (1.1e-3, 0.0, 0.0)
    samples = gather_samples(radiance, albedo, mask, EVERYWHERE)
    out = run_filter(radiance, mask, [], form="full", radius=0, albedo=albedo, modulate=False)
    np.testing.assert_array_equal(samples.good, out.weight_sum > 0.0)
    assert np.count_nonzero(~samples.good) == 9
    np.testing.assert_allclose(samples.radiance, out.image, rtol=TOLERANCE)
    np.testing.assert_allclose(samples.luminance, samples.radiance @ np.array(LUMINANCE, np.float32), rtol=TOLERANCE)


def test_samples_without_albedo_are_the_radiance() -> None:
    radiance = np.random.default_rng(7).exponential(1.0, (3, 2, 3)).astype(np.float32)
    where = slice(0, None, 2), slice(1, None, 3)
    mask = np.ones(SHAPE, bool)
    mask[2, 4] = False
    samples = gather_samples(radiance, None, mask, where)
    assert not samples.good[1, 1]
    assert (samples.radiance[1, 1] == 0.0).all()
    assert np.count_nonzero(samples.good) == 5
    np.testing.assert_array_equal(samples.radiance[samples.good], radiance[samples.good])


def test_luminance_takes_the_first_three_channels() -> None:
    image = np.random.default_rng(1).random((*SHAPE, 5)).astype(np.float32)
    np.testing.assert_allclose(find_luminance(image), image[..., :3] @ np.array(LUMINANCE, np.float32), rtol=TOLERANCE)


def test_samples_that_overflow_are_no_warning() -> None:
    ones = np.ones(SHAPE, np.float32)
    huge = np.full((*SHAPE, 3), 1e38, np.float32)
    sums = gather(FilterOutput(huge, 100.0 * ones, ones, np.full(SHAPE, np.inf, np.float32)), ones)
    add_own_samples(sums, make_own(huge, ones > 0.0), ones)
    assert np.isinf(sums[..., [0, 1, 2, MOMENT]]).all()
    divide(fade(sums, 0.0))
    find_variance(sums)
