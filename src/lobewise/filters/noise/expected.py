"""Expected error of every pixel of an image: its noise times the contrast around it."""

from __future__ import annotations

from typing import Any

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, is_finite
from lobewise.filters.cross_pass import COLORS
from lobewise.records.frame import FloatArray

CONTRAST_RADIUS_PIXELS = 2
"""Pixels to the edge of the square in which the contrast around a pixel is measured."""
DARK_LEVEL, DARK_SQUARED = 0.1, 0.02
"""Light over the image's mean, and its square, below which differences of light count less."""
FLAT_CONTRAST = 0.001
"""Variance of the logarithm of light that a flat part counts as having."""
MIN_EFFECTIVE_SAMPLES, MIN_LEVEL = 0.1, 1e-30
"""Effective samples and mean light that smaller ones count as."""


def expect_error(
    image: FloatArray,
    *,
    exact: FloatArray | None = None,
    variance: FloatArray | None = None,
    effective_samples: FloatArray | None = None,
) -> FloatArray:
    """Return the expected relative squared error of every pixel, (height, width), finite, >= 0.

    The contrast is the variance of the logarithm of light in a square around the pixel: where it is large, as at edges
    and small highlights, filters have a bias beside the noise.

    Parameters
    ----------
    image : array, shape (height, width, 3)
        Radiance. Pixels whose mean is not finite or negative count as black.
    exact : array, shape (height, width, 3), optional
        Part of the image that has no error.
    variance : array, shape (height, width), optional
        Variance of the luminance.
    effective_samples : array, shape (height, width), optional
        Its inverse is the relative variance where no variance is given.
    """
    (light,) = engine.pixels(_define_light, {"image": image, "exact": exact}, {})
    level = max(float(light.mean(dtype=np.float64)), MIN_LEVEL)
    noise: dict[str, Any] = {"variance": variance, "samples": None if variance is not None else effective_samples}
    (expected,) = engine.pixels(_define_expected, {"light": light, **noise}, {"level": np.float32(level)})
    return np.asarray(expected)


def _define_light(grid: Grid) -> list[Vector]:
    channels = grid.read("image")
    if grid.has("exact"):
        channels = [value - known for value, known in zip(channels, grid.read("exact"), strict=True)]
    mean = sum(channels[1:], channels[0]) * hl.f32(1.0 / COLORS)
    return [[hl.select(is_finite(mean), hl.max(mean, hl.f32(0.0)), hl.f32(0.0))]]


def _define_expected(grid: Grid) -> list[Vector]:
    (level,) = grid.get("level")
    inverse = hl.f32(1.0) / level
    logarithm = hl.log(grid.read("light", *grid.inside)[0] * inverse + hl.f32(DARK_LEVEL))
    mean, square = grid.average([logarithm, logarithm * logarithm], CONTRAST_RADIUS_PIXELS)
    contrast = hl.max(square - mean * mean, hl.f32(0.0))
    if grid.has("variance"):
        relative = grid.read_one("light") * inverse
        noise = grid.read_one("variance") * inverse * inverse / (relative * relative + hl.f32(DARK_SQUARED))
    else:
        noise = hl.f32(1.0) / hl.max(grid.read_one("samples"), hl.f32(MIN_EFFECTIVE_SAMPLES))
    expected = noise * (contrast + hl.f32(FLAT_CONTRAST))
    return [[hl.select(is_finite(expected), expected, hl.f32(0.0))]]
