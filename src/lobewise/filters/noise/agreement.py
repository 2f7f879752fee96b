"""What the samples say of two filtered images: how far they are apart, and which of them the noisy image is nearer to.

Moving from one image towards the other pays where the noisy image lies on that side: the mean of
``(other - one) (noisy - one)`` over that of ``(other - one)^2`` is the best step, up to noise. How certain it is, how
large noise and differences are and how bright the place is, at three widths, are the features from which a small
network tells the step (`lobewise.denoising.combining`).
"""

from __future__ import annotations

import halide as hl
import numpy as np

from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector, run_pointwise
from lobewise.filters.noise.pooling import (
    DARK_SHARE,
    add_channels,
    average_light,
    blur_image,
    count_weights,
    estimate_noise,
    find_slope,
    gather_noise,
    take_logarithm,
)
from lobewise.frame import FloatArray

LEVELS = (0, 2, 3)
"""Which blurs are looked at, of `blur_image` with taps 1, 2, 4 and 8 pixels apart in turn."""
FEATURES_PER_LEVEL = 7
COUNT = FEATURES_PER_LEVEL * len(LEVELS) + 3
"""Features of a pixel."""
LEAST_SQUARE = 1e-8
LARGEST_ERRORS = 6.0
"""Standard errors beyond which a difference is as certain as any."""
LARGEST = 1e6
"""Relative squares are bounded by this: a few pixels may not rule a neighbourhood for ever."""


def find_agreement(
    one: FloatArray,
    other: FloatArray,
    noisy: FloatArray,
    *,
    halves: tuple[FloatArray, FloatArray] | None = None,
    level: float,
    shared: bool = False,
) -> FloatArray:
    """Return what is known of a mixture of two images at every pixel, shape (height, width, `COUNT`).

    At each width, base-2 logarithms unless said otherwise, all relative to the squared local luminance: the squared
    difference of the images; the variance of the noisy one; the best step from one to the other, in [-1, 2]; that step
    in standard errors, in plus or minus `LARGEST_ERRORS`; the squared difference of the noisy image to the one, and to
    the other; the squared slope of the one. Then local luminance over ``level``; whether there are halves, and
    whether neighbours share noise, 1 or 0.

    Parameters
    ----------
    one, other : array, shape (height, width, 3)
        Two results, finite, >= 0.
    noisy : array, shape (height, width, 3)
        What both were made from; bad pixels take no part.
    halves : two arrays, shape (height, width, 3), optional
        As in `lobewise.filters.noise.evidence.find_noisy_share`.
    level : float
        About the mean luminance of the whole image, > 0.
    shared : bool
        Whether neighbouring pixels share their noise.

    Raises
    ------
    InputError
        If the images differ in size.
    """
    told, factor = gather_noise(halves, None, shared=shared)
    images = {"one": one, "other": other, "noisy": noisy, **told}
    floor = np.float32(min(max((DARK_SHARE * level) ** 2, 1e-24), 1e30))
    sums, light = run_pointwise(_define_sums, images, {"floor": floor})
    held: dict[str, FloatArray | None] = {"light": light}
    for number in range(max(LEVELS) + 1):
        sums = blur_image(sums, 2**number)
        if number in LEVELS:
            held[f"sums{number}"] = sums
    counts = [count_weights(number) / factor for number in LEVELS]
    numbers = {
        "counts": np.array(counts, np.float32),
        "level": np.float32(max(level, 1e-12)),
        "flags": np.array([halves is not None, shared], np.float32),
    }
    (found,) = run_pointwise(_define_features, held, numbers)
    return np.asarray(found)


def _define_sums(grid: Grid) -> list[Vector]:
    one, other, noisy = (grid.read(name) for name in ("one", "other", "noisy"))
    squares, known = estimate_noise(grid, "one")
    good = is_good(noisy) & is_good(one) & is_good(other) & known
    apart = [p - q for p, q in zip(other, one, strict=True)]
    to_one = [p - q for p, q in zip(noisy, one, strict=True)]
    to_other = [p - q for p, q in zip(noisy, other, strict=True)]
    luminance = average_light(grid, "one")
    unit = hl.f32(1.0) / (luminance * luminance + grid.get("floor")[0])
    product = add_channels([p * q for p, q in zip(apart, to_one, strict=True)]) * unit
    product = hl.clamp(product, hl.f32(-LARGEST), hl.f32(LARGEST))
    values = [
        add_channels([p * p for p in apart]) * unit,
        add_channels(squares) * unit,
        product,
        product * product,
        add_channels([p * p for p in to_one]) * unit,
        add_channels([p * p for p in to_other]) * unit,
        find_slope(grid, "one") * unit,
    ]
    bounded = [value if k in (2, 3) else hl.min(value, hl.f32(LARGEST)) for k, value in enumerate(values)]
    return [[hl.select(good, value, hl.f32(0.0)) for value in bounded], [luminance]]


def _define_features(grid: Grid) -> list[Vector]:
    values: list[hl.Expr] = []
    for count, number in zip(grid.get("counts"), LEVELS, strict=True):
        apart, noise, product, square, to_one, to_other, slope = grid.read(f"sums{number}")
        error = hl.sqrt(hl.max(square, hl.f32(1e-20)) / count)
        bound = hl.f32(LARGEST_ERRORS)
        values += [
            take_logarithm(apart, LEAST_SQUARE),
            take_logarithm(noise, LEAST_SQUARE),
            hl.clamp(product / hl.max(apart, hl.f32(LEAST_SQUARE)), hl.f32(-1.0), hl.f32(2.0)),
            hl.clamp(product / error, -bound, bound),
            take_logarithm(to_one, LEAST_SQUARE),
            take_logarithm(to_other, LEAST_SQUARE),
            take_logarithm(slope, LEAST_SQUARE),
        ]
    values.append(take_logarithm(grid.read_one("light") / grid.get("level")[0], 1e-4))
    values += [hl.f32(1.0) * flag for flag in grid.get("flags")]
    return [values]
