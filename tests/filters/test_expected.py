"""The expected error of pixels against NumPy."""

from typing import Any

import numpy as np
import pytest

from lobewise.filters.noise.expected import (
    CONTRAST_RADIUS_PIXELS,
    DARK_LEVEL,
    DARK_SQUARED,
    FLAT_CONTRAST,
    MIN_EFFECTIVE_SAMPLES,
    expect_error,
)

SHAPES = [(1, 1), (3, 40), (33, 17)]


def make_given(shape: tuple[int, int], scale: float) -> dict[str, Any]:
    rng = np.random.default_rng(shape)
    image, exact = (rng.exponential(scale, (*shape, 3)).astype(np.float32) for _ in range(2))
    return {"image": image + exact, "exact": exact, "variance": (image[..., 0] ** 2).astype(np.float32)}


def expect_slowly(image: Any, exact: Any, variance: Any = None, effective_samples: Any = None) -> Any:
    """Return the expected error, square by square."""
    light = np.maximum(np.asarray(image, np.float64) - exact, 0.0).mean(-1)
    relative = light / light.mean()
    padded = np.pad(np.log(relative + DARK_LEVEL), CONTRAST_RADIUS_PIXELS, mode="edge")
    side = 2 * CONTRAST_RADIUS_PIXELS + 1
    contrast = np.lib.stride_tricks.sliding_window_view(padded, (side, side)).var(axis=(2, 3))
    if variance is None:
        noise = 1.0 / np.maximum(effective_samples, MIN_EFFECTIVE_SAMPLES)
    else:
        noise = variance / light.mean() ** 2 / (relative**2 + DARK_SQUARED)
    return noise * (contrast + FLAT_CONTRAST)


@pytest.mark.parametrize("scale", [1e-3, 1.0, 1e4])
@pytest.mark.parametrize("shape", SHAPES, ids=str)
def test_agrees_with_the_definition(shape: tuple[int, int], scale: float) -> None:
    given = make_given(shape, scale)
    np.testing.assert_allclose(expect_error(**given), expect_slowly(**given), rtol=2e-3, atol=1e-6)


def test_without_variance_the_samples_count() -> None:
    given = make_given((9, 40), 1.0)
    del given["variance"]
    samples = np.random.default_rng(1).exponential(1.0, (9, 40)).astype(np.float32)
    found = expect_error(**given, effective_samples=samples)
    np.testing.assert_allclose(found, expect_slowly(**given, effective_samples=samples), rtol=2e-3, atol=1e-6)


def test_light_that_is_no_number_is_black() -> None:
    given = make_given((9, 40), 1.0)
    black, odd = given["image"].copy(), given["image"].copy()
    black[2, 3], odd[2, 3] = given["exact"][2, 3], np.nan
    black[5, 30], odd[5, 30] = given["exact"][5, 30], -5.0
    assert expect_error(**{**given, "image": odd}).tobytes() == expect_error(**{**given, "image": black}).tobytes()


def test_a_black_image_expects_no_error() -> None:
    black = np.zeros((9, 40, 3), np.float32)
    assert np.isfinite(expect_error(black, variance=np.zeros((9, 40), np.float32))).all()
