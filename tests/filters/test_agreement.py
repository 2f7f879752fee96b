"""What the samples say of two filtered images."""

import numpy as np
import pytest

from lobewise.filters.noise.agreement import (
    AGREEMENT_FEATURES,
    AGREEMENT_FEATURES_PER_LEVEL,
    AGREEMENT_LEVELS,
    compute_agreement,
)

SIZE = 64
STEP, CERTAINTY = 2, 3
"""Which feature of a level is the best step, and how certain that is."""


def draw(rng: np.random.Generator, noise: float) -> list[np.ndarray]:
    """Return two halves of an even image's samples."""
    return [(1.0 + noise * rng.normal(size=(SIZE, SIZE, 3))).astype(np.float32) for _ in range(2)]


def test_the_step_is_the_one_that_brings_one_image_to_the_truth(rng: np.random.Generator) -> None:
    a, b = draw(rng, 0.05)
    one, other = np.full_like(a, 1.2), np.full_like(a, 0.8)
    found = compute_agreement(one, other, 0.5 * (a + b), level=1.0)
    assert found.shape == (SIZE, SIZE, AGREEMENT_FEATURES)
    assert np.isfinite(found).all()
    for number in range(len(AGREEMENT_LEVELS)):
        level = found[..., number * AGREEMENT_FEATURES_PER_LEVEL :]
        assert level[..., STEP].mean() == pytest.approx(0.5, abs=0.02)
        assert level[..., CERTAINTY].min() > 0.5
        # Three channels, relative to a luminance of 1.2.
        assert level[..., 0].mean() == pytest.approx(np.log2(3.0 * 0.16 / 1.44), abs=0.01)
        assert level[..., 1].mean() == pytest.approx(np.log2(3.0 * 0.05**2 / 2.0 / 1.44), abs=0.4)
    np.testing.assert_array_equal(found[..., -2:], 0.0)


def test_exposure_changes_nothing(rng: np.random.Generator) -> None:
    a, b = draw(rng, 0.2)
    one, other = (np.float32(1.0) + np.float32(0.2) * rng.random((SIZE, SIZE, 3), np.float32) for _ in range(2))
    images = one, other, 0.5 * (a + b)
    before = compute_agreement(*images, level=1.0)
    scale = np.float32(64.0)
    after = compute_agreement(*(scale * each for each in images), level=64.0)
    np.testing.assert_allclose(after, before, rtol=1e-4, atol=1e-3)


def test_bad_pixels_take_no_part(rng: np.random.Generator) -> None:
    a, b = draw(rng, 0.2)
    one, other = np.full_like(a, 1.1), np.full_like(a, 0.9)
    noisy = 0.5 * (a + b)
    before = compute_agreement(one, other, noisy, level=1.0)
    noisy[5, 5], noisy[9, 9] = np.nan, np.inf
    after = compute_agreement(one, other, noisy, level=1.0)
    assert np.isfinite(after).all()
    np.testing.assert_array_equal(after[45:], before[45:])
