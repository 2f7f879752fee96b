"""Radiance of pixel areas from the radiance of the surfaces at pixel centres, against NumPy."""

from typing import Any

import numpy as np
import pytest

from lobewise.filters.compositing import MIN_TINTED_AREA, composite_parts
from lobewise.filters.cross_pass import ALBEDO_FLOOR


def make_given(shape: tuple[int, int]) -> dict[str, Any]:
    """Return a random part, with unlit pixels and black albedos."""
    rng = np.random.default_rng(shape)
    coverage = rng.random((*shape, 9)).astype(np.float32) * (rng.random((*shape, 9)) < 0.4)
    albedo, mean = (rng.uniform(0.01, 1.0, (*shape, 3)).astype(np.float32) for _ in range(2))
    albedo[rng.random((*shape, 3)) < 0.2] = 0.0
    return {
        "part": rng.exponential(1.0, (*shape, 3)).astype(np.float32),
        "weight_sum": np.float32(rng.random(shape) < 0.8),
        "albedo": albedo,
        "mean_albedo": mean,
        "coverage": (coverage / np.maximum(coverage.sum(-1, keepdims=True), 1.0)).astype(np.float32),
    }


def composite_slowly(
    part: np.ndarray, weight_sum: np.ndarray, albedo: np.ndarray, mean_albedo: np.ndarray, coverage: np.ndarray
) -> np.ndarray:
    """Return the composite, neighbour by neighbour."""
    height, width = weight_sum.shape
    weights, sums = np.zeros(part.shape), np.zeros(part.shape)
    known = (weight_sum > 0.0)[..., None] & (albedo > ALBEDO_FLOOR)
    for k in range(9):
        y = np.clip(np.arange(height) + k // 3 - 1, 0, height - 1)[:, None]
        x = np.clip(np.arange(width) + k % 3 - 1, 0, width - 1)
        weights += coverage[..., k : k + 1] * np.where(known, albedo, 0.0)[y, x]
        sums += coverage[..., k : k + 1] * np.where(known, part, 0.0)[y, x]
    some = weights > MIN_TINTED_AREA
    return np.where(some, sums / np.where(some, weights, 1.0) * mean_albedo, part)


@pytest.mark.parametrize("shape", [(1, 1), (5, 7), (9, 40), (33, 17)], ids=str)
def test_agrees_with_the_definition(shape: tuple[int, int]) -> None:
    given = make_given(shape)
    np.testing.assert_allclose(composite_parts(**given), composite_slowly(**given), rtol=1e-5, atol=1e-6)


def test_planes_of_any_layout_are_the_same() -> None:
    given = make_given((9, 40))
    planes = np.moveaxis(np.ascontiguousarray(np.moveaxis(given["part"], -1, 0)), 0, -1)
    assert composite_parts(**{**given, "part": planes}).tobytes() == composite_parts(**given).tobytes()


def test_half_of_each_surface_is_half_of_the_light_of_each() -> None:
    part, albedo = np.zeros((3, 20, 3), np.float32), np.full((3, 20, 3), 0.5, np.float32)
    part[:, :10], part[:, 10:] = 1.0, 3.0
    coverage = np.zeros((3, 20, 9), np.float32)
    coverage[..., 4] = 1.0
    coverage[:, 9, 4], coverage[:, 9, 5] = 0.5, 0.5
    found = composite_parts(part, np.ones((3, 20), np.float32), albedo, albedo, coverage)
    np.testing.assert_allclose(found[:, 9], 2.0, rtol=1e-6)
    np.testing.assert_allclose(found[:, 8], 1.0, rtol=1e-6)
