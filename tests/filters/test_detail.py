"""Features that distinguish noise from detail, and the shares that a network predicts from them."""

from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.filters.mixing import Perceptron, compute_shares
from lobewise.filters.noise import detail
from lobewise.filters.noise.detail import (
    DETAIL_FEATURES,
    DETAIL_FEATURES_PER_LEVEL,
    DETAIL_LEVELS,
    DETAIL_REACH,
    OFFSETS,
    compute_detail,
)
from lobewise.records.frame import FloatArray
from tests.mistakes import refuses

SIZE = 72
INNER = slice(20, -20)
PAIRS = len(OFFSETS)
TOTAL, NOISE, EXCESS, CERTAINTY, SLOPE = (1 + 3 * PAIRS + k for k in range(5))
AXES, DIAGONALS = 2, PAIRS - 1
"""Which pairs are two columns and two rows away, and both."""


def gather(*images: FloatArray, **told: Any) -> FloatArray:
    """Return the features of all rows."""
    return np.concatenate([features for _, features in compute_detail(*images, **{"level": 1.0, **told})])


def draw_halves(truth: FloatArray, noise: float, rng: np.random.Generator) -> tuple[FloatArray, FloatArray]:
    """Return two halves of the samples."""
    first, second = (truth + np.float32(noise) * rng.normal(size=truth.shape) for _ in range(2))
    return first.astype(np.float32), second.astype(np.float32)


@pytest.mark.parametrize("with_halves", [True, False])
def test_noise_and_detail_are_told_apart(with_halves: bool, rng: np.random.Generator) -> None:
    """The left half of a flat result lacks stripes of four pixels; in the right one all is noise."""
    truth = np.full((SIZE, 2 * SIZE, 3), 1.0, np.float32)
    truth[:, :SIZE] += np.float32(0.2) * np.sign(np.sin(0.5 * np.pi * (np.arange(SIZE) + 0.5)))[None, :, None]
    a, b = draw_halves(truth, 0.05, rng)
    flat = np.ones_like(truth)
    found = gather(flat, 0.5 * (a + b), halves=(a, b) if with_halves else None)
    assert found.shape == (SIZE, 2 * SIZE, DETAIL_FEATURES)
    assert np.isfinite(found).all()
    detail, noise = found[INNER, :SIZE][:, INNER], found[INNER, SIZE:][:, INNER]
    for number in range(len(DETAIL_LEVELS)):
        left, right = (each[..., number * DETAIL_FEATURES_PER_LEVEL :].mean(axis=(0, 1)) for each in (detail, noise))
        # Columns two apart are opposite, rows are alike: they cancel out, and are far apart. On the diagonals both are
        # opposite.
        assert left[1 + 3 * DIAGONALS] == pytest.approx(-1.0, abs=0.05)
        assert left[2 + 3 * DIAGONALS] < -2.0
        assert left[1 + 3 * AXES] == pytest.approx(0.0, abs=0.05)
        assert left[3 + 3 * AXES] > 2.0 > right[3 + 3 * AXES]
        assert np.abs(right[1 : 1 + 3 * PAIRS : 3]).max() < 0.1
        assert left[TOTAL] > 2.0 > right[TOTAL]
        assert (left[SLOPE], right[SLOPE]) == pytest.approx((np.log2(1e-8), np.log2(1e-8)), abs=0.01)
        assert left[0] == pytest.approx(np.log2(3.0 * 0.04125), abs=0.1)
        assert right[0] == pytest.approx(np.log2(3.0 * 0.00125), abs=0.3)
        assert right[NOISE] == pytest.approx(0.0, abs=0.4)
        if with_halves:
            assert left[NOISE] == pytest.approx(np.log2(0.00125 / 0.04125), abs=0.3)
            assert left[EXCESS] > 0.9
            assert left[CERTAINTY] > right[CERTAINTY] + 2.0
    np.testing.assert_array_equal(found[..., -2:], np.broadcast_to([float(with_halves), 0.0], (SIZE, 2 * SIZE, 2)))


def test_exposure_changes_nothing(rng: np.random.Generator) -> None:
    a, b = draw_halves(np.full((SIZE, SIZE, 3), 1.0, np.float32), 0.2, rng)
    smooth = (1.0 + 0.2 * rng.random((SIZE, SIZE, 3))).astype(np.float32)
    before = gather(smooth, 0.5 * (a + b), halves=(a, b))
    scale = np.float32(64.0)
    after = gather(scale * smooth, scale * 0.5 * (a + b), halves=(scale * a, scale * b), level=64.0)
    np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-3)


def test_bad_pixels_take_no_part(rng: np.random.Generator) -> None:
    a, b = draw_halves(np.full((SIZE, SIZE, 3), 1.0, np.float32), 0.2, rng)
    flat, noisy = np.ones_like(a), 0.5 * (a + b)
    before = gather(flat, noisy, halves=(a, b))
    noisy[5, 5], a[9, 9], noisy[7, 7] = np.nan, np.inf, -1.0
    after = gather(flat, noisy, halves=(a, b))
    assert np.isfinite(after).all()
    np.testing.assert_array_equal(after[60:], before[60:])


@pytest.mark.parametrize("rows", [70, 192])
def test_bands_change_no_bit(rows: int, rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch) -> None:
    filtered, a, b = (rng.uniform(1.0, 2.0, (200, 9, 3)).astype(np.float32) for _ in range(3))
    monkeypatch.setattr(detail, "BAND_ROWS", 200)
    whole = gather(filtered, 0.5 * (a + b), halves=(a, b))
    monkeypatch.setattr(detail, "BAND_ROWS", rows)
    np.testing.assert_array_equal(gather(filtered, 0.5 * (a + b), halves=(a, b)), whole)


@pytest.mark.parametrize("with_halves", [True, False])
def test_features_reach_as_far_as_they_say(with_halves: bool) -> None:
    rng, width = np.random.default_rng(3), 9
    filtered, a, b = (rng.uniform(1.0, 2.0, (121, width, 3)).astype(np.float32) for _ in range(3))
    changed = filtered.copy()
    changed[60] += 1.0
    told = {"halves": (a, b) if with_halves else None}
    before, after = (gather(each, 0.5 * (a + b), **told) for each in (filtered, changed))
    rows = np.flatnonzero((before != after).reshape(len(before), -1).any(axis=1))
    assert int(np.abs(rows - 60).max()) == DETAIL_REACH


def make_network(features: int, rng: np.random.Generator, outputs: int = 2, units: int = 24) -> Perceptron:
    """Return a network of random numbers."""

    def draw(*shape: int) -> FloatArray:
        return (0.3 * rng.normal(size=shape)).astype(np.float32)

    weights = draw(features, units), draw(units, units), draw(units, outputs)
    return Perceptron(draw(features), draw(features), weights, (draw(units), draw(units), draw(outputs)))


@pytest.mark.parametrize("outputs", [2, 3])
@pytest.mark.parametrize("shape", [(37, 53), (1, 1), (3, 8), (2, 100)])
def test_shares_are_the_network_s(shape: tuple[int, int], outputs: int, rng: np.random.Generator) -> None:
    network = make_network(20, rng, outputs)
    seen = rng.normal(size=(*shape, 20)).astype(np.float32)
    values = ((seen - network.mean) * network.scale).astype(np.float64)
    for number, (weights, biases) in enumerate(zip(network.weights, network.biases, strict=True)):
        values = values @ weights + biases
        values = np.where((values < 0.0) & (number < 2), 0.01 * values, values)
    expected = np.exp(values) / np.exp(values).sum(axis=-1, keepdims=True)
    found = compute_shares(seen, network, outputs)
    assert found.shape == (*shape, outputs)
    np.testing.assert_allclose(found, expected, atol=1e-5)
    # Where an image is cut changes no bit.
    np.testing.assert_array_equal(compute_shares(seen[shape[0] // 2 :], network, outputs), found[shape[0] // 2 :])


def test_shares_stay_shares_however_large_the_scores(rng: np.random.Generator) -> None:
    network = make_network(4, rng)
    last = network.biases[-1]
    for apart, share in ((1e4, 1.0), (-1e4, 0.0)):
        last[:] = apart, 0.0
        found = compute_shares(np.zeros((2, 3, 4), np.float32), network, 2)
        np.testing.assert_array_equal(found, np.broadcast_to([share, 1.0 - share], found.shape))


def test_another_network_is_refused(rng: np.random.Generator) -> None:
    with refuses(InputError, "network", expected="3 layers from 5 inputs to 2 outputs"):
        compute_shares(np.zeros((2, 3, 5), np.float32), make_network(4, rng), 2)
