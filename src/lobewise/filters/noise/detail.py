"""What tells noise from detail in the difference of a noisy image and what a filter made of it.

Noise of neighbouring pixels is independent. What a filter blurred away is not: light and dark lie beside each other in
some order. So products of the difference with itself, a pixel or two apart, over its square are 0 in the mean where all
is noise. Of tiles and stripes they may cancel out in the mean over directions, so the features also tell how far
directions are apart. The others are how certain the products are, how large the difference is beside the noise that the
samples show, and how steep the result is, at three widths. From these a small network tells how much of the noisy image
a result takes back (`lobewise.denoising.evidence`).

Source: the correlation of residuals is the classical test of whiteness (Ljung and Box 1978, "On a Measure of Lack of
Fit in Time Series Models", Biometrika 65(2)), here in two dimensions and at every pixel.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import halide as hl
import numpy as np

from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector, run_pointwise
from lobewise.filters.noise.pooling import (
    DARK_SHARE,
    add_channels,
    average_light,
    blur_image,
    clamp_to_image,
    count_weights,
    estimate_noise,
    find_slope,
    gather_noise,
    take_logarithm,
)
from lobewise.filters.noise.pooling import REACH as POOLING_REACH
from lobewise.frame import FloatArray

OFFSETS = (
    ((1, 0), (0, 1)),
    ((1, 1), (1, -1)),
    ((2, 0), (0, 2)),
    ((2, 1), (1, -2)),
    ((1, 2), (2, -1)),
    ((2, 2), (2, -2)),
)
"""Which neighbours a pixel's difference is multiplied with, columns and rows: pairs at a right angle."""
LEVELS = (0, 1, 3)
"""Which blurs are looked at, of `blur_image` with taps 1, 2, 4 and 8 pixels apart in turn."""
FEATURES_PER_LEVEL = 6 + 3 * len(OFFSETS)
COUNT = FEATURES_PER_LEVEL * len(LEVELS) + 4
"""Features of a pixel."""
REACH: int = 2 * POOLING_REACH + 2 * (2 ** (max(LEVELS) + 1) - 1)
"""Pixels to each side that tell on a pixel's features."""
LARGEST_DIFFERENCE = 1e3
"""Relative differences are bounded by this: a few pixels may not rule a neighbourhood for ever."""
LARGEST_ERRORS = 8.0
"""Standard errors beyond which a mean is as certain as any."""
LEAST_SQUARE, LEAST_RATIO, LEAST_LIGHT = 1e-8, 1e-3, 1e-4
"""Below which logarithms do not fall: of relative squares, of ratios of squares, of luminance over the image's."""
BAND_ROWS, STRIP_ROWS = 256, 64
"""Rows whose neighbourhoods are averaged at a time, and rows whose features are held at a time."""


def find_detail(
    filtered: FloatArray,
    noisy: FloatArray,
    *,
    halves: tuple[FloatArray, FloatArray] | None = None,
    level: float,
    shared: bool = False,
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield what is known of the difference of two images: some rows, and their features.

    The features of a pixel are base-2 logarithms unless said otherwise. At each width they are: the squared difference
    over squared local luminance; of each pair of `OFFSETS` the mean product of differences over the mean square, in
    [-1, 1], this mean in standard errors, in plus or minus `LARGEST_ERRORS`, and by how many the two of the pair are
    apart; the sum of all squared correlations; the variance of the noisy image over the squared difference; what the
    squared difference exceeds that variance by, over itself, in [-1, 1], and in standard errors; the squared slope of
    the filtered image over squared local luminance. Then follow the pixel's own squared difference, local luminance
    over ``level``, whether there are halves, and whether neighbours share noise, 1 or 0.

    Parameters
    ----------
    filtered : array, shape (height, width, 3)
        Finite, >= 0.
    noisy : array, shape (height, width, 3)
        What it was filtered from. Pixels that are NaN, infinite or negative are bad: they take no part.
    halves : two arrays, shape (height, width, 3), optional
        Means of one half of the samples each, whose mean is ``noisy``. Without them the variance is that of the
        difference's residual.
    level : float
        About the mean luminance of the whole image, of which this may be a part.
    shared : bool
        Whether neighbouring pixels share their noise.

    Yields
    ------
    rows : slice
    features : array, shape (rows, width, `COUNT`)

    Raises
    ------
    InputError
        If the images differ in size.
    """
    told, factor = gather_noise(halves, None, shared=shared)
    level = min(max(level, 1e-12), 1e12)
    numbers = {
        "counts": np.array([count_weights(number) for number in LEVELS], np.float32),
        "factor": np.float32(factor),
        "level": np.float32(level),
        "flags": np.array([halves is not None, shared], np.float32),
    }
    floor = np.float32(max((DARK_SHARE * level) ** 2, 1e-24))
    images = {"filtered": filtered, "noisy": noisy, **told}
    for top in range(0, len(noisy), BAND_ROWS):
        bottom, first = min(top + BAND_ROWS, len(noisy)), max(top - REACH, 0)
        band = slice(first, bottom + REACH)
        pooled = _pool({name: None if each is None else each[band] for name, each in images.items()}, floor)
        for start in range(top, bottom, STRIP_ROWS):
            rows = slice(start, min(start + STRIP_ROWS, bottom))
            inside = slice(rows.start - first, rows.stop - first)
            (found,) = run_pointwise(_define_features, {name: each[inside] for name, each in pooled.items()}, numbers)
            yield rows, np.asarray(found)


def _pool(images: Mapping[str, FloatArray | None], floor: np.float32) -> dict[str, FloatArray]:
    """Return what features are made of: own squared difference, local light, and what is averaged at each width."""
    bounds = {"floor": floor}
    apart, noise, light = run_pointwise(_define_difference, images, bounds)
    held = {"apart": apart, "noise": noise, "light": light, "filtered": images["filtered"]}
    (sums,) = run_pointwise(_define_products, held, bounds)
    pooled: dict[str, FloatArray] = {"own": np.ascontiguousarray(sums[..., 0]), "light": light}
    for number in range(max(LEVELS) + 1):
        sums = blur_image(sums, 2**number)
        if number in LEVELS:
            pooled[f"sums{number}"] = sums
    return pooled


def _define_difference(grid: Grid) -> list[Vector]:
    """Define the difference over local luminance, the squared noise over its square, and local luminance."""
    filtered, noisy = grid.read("filtered"), grid.read("noisy")
    squares, known = estimate_noise(grid, "filtered")
    luminance = average_light(grid, "filtered")
    unit = hl.f32(1.0) / (luminance * luminance + grid.get("floor")[0])
    scale, bound = hl.sqrt(unit), hl.f32(LARGEST_DIFFERENCE)
    good = is_good(noisy) & is_good(filtered)
    apart = [hl.clamp((p - q) * scale, -bound, bound) for p, q in zip(noisy, filtered, strict=True)]
    noise = hl.min(add_channels(squares) * unit, bound * bound)
    zero = hl.f32(0.0)
    return [
        [hl.select(good, value, zero) for value in apart],
        [hl.select(good & known, noise, zero)],
        [luminance],
    ]


def _define_products(grid: Grid) -> list[Vector]:
    """Define what is averaged: squares, products with neighbours, their mean square, noise, its excess, slope."""
    apart = grid.read("apart")
    square = add_channels([value * value for value in apart])
    products = []
    for dx, dy in (offset for pair in OFFSETS for offset in pair):
        near = grid.read("apart", *clamp_to_image(grid, dx, dy))
        products.append(add_channels([p * q for p, q in zip(apart, near, strict=True)]))
    spread = _add_squares(products) * hl.f32(1.0 / len(products))
    noise, luminance = grid.read_one("noise"), grid.read_one("light")
    excess = square - noise
    unit = hl.f32(1.0) / (luminance * luminance + grid.get("floor")[0])
    slope = hl.min(find_slope(grid, "filtered") * unit, hl.f32(LARGEST_DIFFERENCE**2))
    values = [square, *products, spread, noise, excess, excess * excess, slope]
    return [values]


def _define_features(grid: Grid) -> list[Vector]:
    values: list[hl.Expr] = []
    (factor,) = grid.get("factor")
    bound, one = hl.f32(LARGEST_ERRORS), hl.f32(1.0)
    for count, number in zip(grid.get("counts"), LEVELS, strict=True):
        square, *products, spread, noise, excess, excess_square, slope = grid.read(f"sums{number}")
        whole = hl.max(square, hl.f32(1e-12))

        def find_certainty(mean: hl.Expr, square: hl.Expr, count: hl.Expr) -> hl.Expr:
            return hl.clamp(mean / hl.sqrt(hl.max(square, hl.f32(1e-20)) / count), -bound, bound)

        values.append(take_logarithm(square, LEAST_SQUARE))
        # The mean of two products, and half their difference, vary half as much as one of them.
        varies = hl.f32(0.5) * spread
        for first, second in zip(products[::2], products[1::2], strict=True):
            mean, half = hl.f32(0.5) * (first + second), hl.f32(0.5) * hl.abs(first - second)
            values.append(hl.clamp(mean / whole, -one, one))
            values += [find_certainty(mean, varies, count), find_certainty(half, varies, count)]
        values.append(take_logarithm(_add_squares(products) / (whole * whole), LEAST_RATIO))
        values += [
            take_logarithm(noise / whole, LEAST_RATIO),
            hl.clamp(excess / whole, -one, one),
            find_certainty(excess, excess_square, count / factor),
            take_logarithm(slope, LEAST_SQUARE),
        ]
    values.append(take_logarithm(grid.read_one("own"), LEAST_SQUARE))
    values.append(take_logarithm(grid.read_one("light") / grid.get("level")[0], LEAST_LIGHT))
    return [values + [one * flag for flag in grid.get("flags")]]


def _add_squares(values: Vector) -> hl.Expr:
    total = values[0] * values[0]
    for value in values[1:]:
        total = total + value * value
    return total
