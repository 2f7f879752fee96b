"""Compare two filtered images by the samples: how different they are, and which one is nearer to the noisy image.

The best step from one image towards the other is, up to noise, the mean of ``(other - one) (noisy - one)`` over the
mean of ``(other - one)^2``. A small network predicts the step (`lobewise.denoising.combining`). Its features, at three
widths, are this quotient, its certainty, the noise, the differences and the brightness.
"""

from __future__ import annotations

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector
from lobewise.filters.noise.pooling import (
    DARK_SHARE,
    MIN_RELATIVE_SQUARE,
    RESIDUAL_VARIANCE,
    add_channels,
    average_light,
    blur_image,
    compute_squared_slope,
    count_weights,
    square_residual,
    take_logarithm,
)
from lobewise.records.frame import FloatArray

AGREEMENT_LEVELS = (0, 2, 3)
"""Blurs whose results become features: `blur_image` runs in turn with taps 1, 2, 4 and 8 pixels apart."""
AGREEMENT_FEATURES_PER_LEVEL = 7
AGREEMENT_FEATURES = AGREEMENT_FEATURES_PER_LEVEL * len(AGREEMENT_LEVELS) + 3
"""Features of a pixel."""
MAX_STEP_CERTAINTY = 6.0
"""Largest certainty of a step, standard errors."""
MAX_RELATIVE_SQUARE = 1e6
"""Largest square over the squared local luminance: a few pixels must not dominate their neighbourhood."""


def compute_agreement(
    one: FloatArray,
    other: FloatArray,
    noisy: FloatArray,
    *,
    level: float,
    shared: bool = False,
) -> FloatArray:
    """Return features for a mixture of two images at every pixel, shape (height, width, `AGREEMENT_FEATURES`).

    Features are base-2 logarithms unless a range is given, of squares over the squared local luminance. At each width:
    the squared difference of the images; the variance of the noisy image; the best step from ``one`` to ``other``, in
    [-1, 2]; the step in standard errors, within +-`MAX_STEP_CERTAINTY`; the squared difference of the noisy image to
    ``one``, and to ``other``; the squared slope of ``one``. Then, once: the local luminance over ``level``; 0 (whether
    there were halves, in the training); whether neighbours share noise, 1 or 0.

    Parameters
    ----------
    one, other : array, shape (height, width, 3)
        Two results, finite, >= 0.
    noisy : array, shape (height, width, 3)
        The image that both were made from. NaN, infinite and negative pixels do not count.
    level : float
        About the mean luminance of the whole image, > 0.
    shared : bool
        Whether neighbouring pixels share their noise.

    Raises
    ------
    InputError
        If the images differ in size.
    """
    images = {"one": one, "other": other, "noisy": noisy}
    floor = np.float32(min(max((DARK_SHARE * level) ** 2, 1e-24), 1e30))
    sums, light = engine.pixels(_define_sums, images, {"floor": floor})
    held: dict[str, FloatArray | None] = {"light": light}
    for number in range(max(AGREEMENT_LEVELS) + 1):
        sums = blur_image(sums, 2**number)
        if number in AGREEMENT_LEVELS:
            held[f"sums{number}"] = sums
    counts = [count_weights(number) / RESIDUAL_VARIANCE for number in AGREEMENT_LEVELS]
    numbers = {
        "counts": np.array(counts, np.float32),
        "level": np.float32(max(level, 1e-12)),
        "flags": np.array([False, shared], np.float32),
    }
    (features,) = engine.pixels(_define_features, held, numbers)
    return np.asarray(features)


def _define_sums(grid: Grid) -> list[Vector]:
    one, other, noisy = (grid.read(name) for name in ("one", "other", "noisy"))
    squares, known = square_residual(grid, "one")
    good = is_good(noisy) & is_good(one) & is_good(other) & known
    apart = [p - q for p, q in zip(other, one, strict=True)]
    to_one = [p - q for p, q in zip(noisy, one, strict=True)]
    to_other = [p - q for p, q in zip(noisy, other, strict=True)]
    luminance = average_light(grid, "one")
    unit = hl.f32(1.0) / (luminance * luminance + grid.get("floor")[0])
    product = add_channels([p * q for p, q in zip(apart, to_one, strict=True)]) * unit
    product = hl.clamp(product, hl.f32(-MAX_RELATIVE_SQUARE), hl.f32(MAX_RELATIVE_SQUARE))
    values = [
        add_channels([p * p for p in apart]) * unit,
        add_channels(squares) * unit,
        product,
        product * product,
        add_channels([p * p for p in to_one]) * unit,
        add_channels([p * p for p in to_other]) * unit,
        compute_squared_slope(grid, "one") * unit,
    ]
    bounded = [value if k in (2, 3) else hl.min(value, hl.f32(MAX_RELATIVE_SQUARE)) for k, value in enumerate(values)]
    return [[hl.select(good, value, hl.f32(0.0)) for value in bounded], [luminance]]


def _define_features(grid: Grid) -> list[Vector]:
    values: list[hl.Expr] = []
    for count, number in zip(grid.get("counts"), AGREEMENT_LEVELS, strict=True):
        apart, noise, product, square, to_one, to_other, slope = grid.read(f"sums{number}")
        error = hl.sqrt(hl.max(square, hl.f32(1e-20)) / count)
        bound = hl.f32(MAX_STEP_CERTAINTY)
        values += [
            take_logarithm(apart, MIN_RELATIVE_SQUARE),
            take_logarithm(noise, MIN_RELATIVE_SQUARE),
            hl.clamp(product / hl.max(apart, hl.f32(MIN_RELATIVE_SQUARE)), hl.f32(-1.0), hl.f32(2.0)),
            hl.clamp(product / error, -bound, bound),
            take_logarithm(to_one, MIN_RELATIVE_SQUARE),
            take_logarithm(to_other, MIN_RELATIVE_SQUARE),
            take_logarithm(slope, MIN_RELATIVE_SQUARE),
        ]
    values.append(take_logarithm(grid.read_one("light") / grid.get("level")[0], 1e-4))
    values += [hl.f32(1.0) * flag for flag in grid.get("flags")]
    return [values]
