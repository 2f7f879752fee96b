"""Histories that follow a change of the light: ratios of samples, and what they make of sums."""

import numpy as np
import pytest

from lobewise.filters.history.sums import HISTORY_CHANNELS, split_sums
from lobewise.interactive.temporal_gradients import (
    MAX_RATIO,
    Change,
    Shaded,
    compute_changes,
    relight_sums,
)
from lobewise.records.camera import Camera
from lobewise.records.frame import Radiance

SCALE, ROWS, COLUMNS = 4, 6, 8
SHAPE = SCALE * ROWS - 1, SCALE * COLUMNS - 2
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def make_radiance(diffuse: np.ndarray, specular: np.ndarray) -> Radiance:
    return Radiance(diffuse + specular, diffuse=diffuse, specular=specular)


@pytest.fixture
def former(rng: np.random.Generator) -> Shaded:
    diffuse, specular = rng.gamma(2.0, 0.5, (2, ROWS, COLUMNS, 3)).astype(np.float32)
    camera = Camera((0, 0, 4), (0, 0, -1), (0, 1, 0), 0.6)
    pixels = np.zeros(0, np.intp), np.zeros(0, np.intp)
    depth = np.full((ROWS, COLUMNS), 4.0, np.float32)
    shapes = np.zeros((2, ROWS, COLUMNS), np.float32)
    return Shaded(camera, pixels, SCALE, (1, 2), 1, 0, make_radiance(diffuse, specular), depth, shapes)


def test_samples_that_change_alike_tell_the_ratio(former: Shaded) -> None:
    tint = np.array([0.5, 2.0, 3.0], np.float32)
    old = former.radiance
    changes = compute_changes(former, make_radiance(old.diffuse * tint, old.specular * 0.25), former.depth, SHAPE)
    assert changes["diffuse"].ratio.shape == (*SHAPE, 3)
    # The samples differ in colour, so their luminances do not change alike.
    np.testing.assert_allclose(changes["diffuse"].ratio, np.broadcast_to(tint, (*SHAPE, 3)), rtol=0.2)
    np.testing.assert_allclose(changes["specular"].ratio, 0.25, rtol=1e-5)
    assert changes["specular"].error.max() < 1e-3


def test_the_error_is_that_of_a_ratio_of_sums(former: Shaded, rng: np.random.Generator) -> None:
    """The jackknife, which leaves out one sample at a time, estimates the same error in another way."""
    old = former.radiance.diffuse
    new = old * rng.uniform(2.4, 3.6, (ROWS, COLUMNS, 1)).astype(np.float32)
    error = compute_changes(former, make_radiance(new, new), former.depth, SHAPE)["diffuse"].error
    for row, column in ((2, 3), (3, 5)):
        window = slice(row - 1, row + 2), slice(column - 1, column + 2)
        before, now = (image[window].reshape(9, 3) @ LUMINANCE for image in (old, new))
        left_out = [np.delete(now, k).sum() / np.delete(before, k).sum() for k in range(9)]
        expected = np.sqrt(8.0 / 9.0 * np.sum((left_out - np.mean(left_out)) ** 2))
        assert error[SCALE * row + 1, SCALE * column + 2] == pytest.approx(expected, rel=0.25)


def test_a_change_within_its_error_is_none(former: Shaded, rng: np.random.Generator) -> None:
    """Ratios would otherwise multiply noise into a history, frame after frame."""
    old = former.radiance.diffuse
    noise = rng.uniform(0.5, 1.5, (200, ROWS, COLUMNS, 1)).astype(np.float32)
    ratios = [
        compute_changes(former, make_radiance(old * each, old * each), former.depth, SHAPE)["diffuse"].ratio
        for each in noise
    ]
    # The standard error is not known exactly either: of 9 samples, 1 or 2 ratios in 5 lie beyond it.
    at_samples = np.array(ratios)[:, 1::SCALE, 2::SCALE]
    assert np.mean(at_samples == 1.0) > 0.55
    assert np.mean(np.abs(at_samples - 1.0)) < 0.04


def test_samples_of_another_surface_tell_nothing(former: Shaded) -> None:
    old = former.radiance.diffuse
    depth = former.depth.copy()
    depth[:, :4] = 3.9
    change = compute_changes(former, make_radiance(old * 5.0, old * 5.0), depth, SHAPE)["diffuse"]
    assert (change.ratio[:, : SCALE * 2] == 1.0).all()
    assert (change.error[:, : SCALE * 2] == 0.0).all()
    np.testing.assert_allclose(change.ratio[:, SCALE * 5 :], 5.0, rtol=1e-5)


@pytest.mark.parametrize("which", range(4))
def test_a_moving_reflection_tells_nothing_of_specular_light(former: Shaded, which: int) -> None:
    old = former.radiance
    moved = np.zeros((4, ROWS, COLUMNS), bool)
    moved[which, :, :4] = True
    again = make_radiance(old.diffuse * 5.0, old.specular * 5.0)
    changes = compute_changes(former, again, former.depth, SHAPE, moved)
    assert (changes["specular"].ratio[:, : SCALE * 2] == 1.0).all()
    assert (changes["specular"].error[:, : SCALE * 2] == 0.0).all()
    np.testing.assert_allclose(changes["specular"].ratio[:, SCALE * 5 :], 5.0, rtol=1e-5)
    np.testing.assert_allclose(changes["diffuse"].ratio, 5.0, rtol=1e-5)


def test_a_single_sample_tells_no_change(former: Shaded) -> None:
    """It equals its own ratio exactly, which once passed for certainty: histories became a hundred times brighter."""
    old = former.radiance.diffuse
    depth = np.full_like(former.depth, 3.9)
    depth[2, 3] = former.depth[2, 3]
    change = compute_changes(former, make_radiance(old * 50.0, old * 50.0), depth, SHAPE)["diffuse"]
    assert (change.ratio == 1.0).all()
    # At the corners of an image four samples are all that there are.
    whole = compute_changes(former, make_radiance(old * 5.0, old * 5.0), former.depth, SHAPE)["diffuse"]
    np.testing.assert_allclose(whole.ratio, 5.0, rtol=1e-5)


def make_sums(rng: np.random.Generator) -> np.ndarray:
    """Return sums over samples of weight 1."""
    samples = rng.gamma(2.0, 0.5, (30, 5, 6, 3))
    luminance = samples @ LUMINANCE
    sums = np.empty((5, 6, HISTORY_CHANNELS))
    sums[..., :3] = samples.sum(axis=0)
    sums[..., 3:5] = 30.0
    sums[..., 5] = (luminance**2).sum(axis=0)
    sums[..., 6] = 30.0
    return sums.astype(np.float32)


def describe(sums: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the luminance of the mean, and its variance."""
    parts = split_sums(sums)
    mean = np.stack(parts.light, axis=-1) @ LUMINANCE / parts.weight
    count = parts.weight**2 / parts.squared_weight
    return mean, (parts.moment / parts.weight - mean**2) / count


def test_a_relit_history_is_brighter_and_as_long(rng: np.random.Generator) -> None:
    sums = make_sums(rng)
    change = Change(np.full((5, 6, 3), 3.0, np.float32), np.zeros((5, 6), np.float32))
    (mean, variance), (new_mean, new_variance) = describe(sums), describe(relight_sums(sums, change))
    np.testing.assert_allclose(new_mean, 3.0 * mean, rtol=1e-5)
    np.testing.assert_allclose(new_variance, 9.0 * variance, rtol=1e-3)
    np.testing.assert_array_equal(relight_sums(sums, change)[..., 6], 30.0)


def test_an_uncertain_ratio_adds_to_the_variance(rng: np.random.Generator) -> None:
    sums = make_sums(rng)
    error = rng.uniform(0.1, 0.3, (5, 6)).astype(np.float32)
    relit = relight_sums(sums, Change(np.full((5, 6, 3), 0.5, np.float32), error))
    (mean, variance), (new_mean, new_variance) = describe(sums), describe(relit)
    np.testing.assert_allclose(new_mean, 0.5 * mean, rtol=1e-5)
    np.testing.assert_allclose(new_variance, 0.25 * variance + (error * mean) ** 2, rtol=1e-3)
    assert (relit[..., 6] < 30.0).all()


def test_light_in_the_dark_ends_the_history(former: Shaded, rng: np.random.Generator) -> None:
    """What was black says nothing about a light that goes on, and light that goes out leaves black."""
    black, lit = np.zeros((ROWS, COLUMNS, 3), np.float32), np.ones((ROWS, COLUMNS, 3), np.float32)
    dark = Shaded(**{**former.__dict__, "radiance": make_radiance(black, lit)})
    changes = compute_changes(dark, make_radiance(lit, black), former.depth, SHAPE)
    sums = np.tile(make_sums(rng)[:1, :1], (*SHAPE, 1))
    assert changes["diffuse"].ratio.max() <= MAX_RATIO
    assert changes["diffuse"].error.min() > MAX_RATIO
    assert relight_sums(sums, changes["diffuse"])[..., 6].max() < 1.0
    gone = relight_sums(sums, changes["specular"])
    assert not gone[..., :3].any()
    np.testing.assert_array_equal(gone[..., 6], 30.0)
