"""Distinguish noise from detail in the difference of a noisy image and its filtered image.

Noise of neighbouring pixels is independent; detail that a filter blurred away is not. The correlations of the
difference with itself, shifted by a pixel or two, therefore have mean 0 where the difference is noise. For tiles and
stripes the correlations may cancel in the mean over directions, so the features also hold the differences between
directions. Further features are the certainty of the correlations, the size of the difference relative to the noise
that the samples show, and the slope of the filtered image, all at three widths. From the features a small network
predicts how much of the noisy image the result takes back (`lobewise.denoising.evidence`).

Source: the correlation of residuals is the classical test of whiteness (Ljung and Box 1978, "On a Measure of Lack of
Fit in Time Series Models", Biometrika 65(2)), here in two dimensions and at every pixel.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from functools import partial
from typing import Any

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector
from lobewise.engine.numbers import choose_larger, choose_smaller, make_single
from lobewise.filters.glue import define_channel
from lobewise.filters.mixing import Perceptron, make_shares
from lobewise.filters.noise.pooling import (
    DARK_SHARE,
    MIN_RELATIVE_SQUARE,
    POOLING_REACH,
    add_channels,
    average_light,
    blur_image,
    compute_squared_slope,
    count_weights,
    estimate_noise,
    gather_noise,
    take_logarithm,
)
from lobewise.records.frame import FloatArray

OFFSETS = (
    ((1, 0), (0, 1)),
    ((1, 1), (1, -1)),
    ((2, 0), (0, 2)),
    ((2, 1), (1, -2)),
    ((1, 2), (2, -1)),
    ((2, 2), (2, -2)),
)
"""Shifts of the correlations, columns and rows, in pairs at a right angle."""
DETAIL_LEVELS = (0, 1, 3)
"""Blurs whose results become features: `blur_image` runs in turn with taps 1, 2, 4 and 8 pixels apart."""
DETAIL_FEATURES_PER_LEVEL = 6 + 3 * len(OFFSETS)
DETAIL_FEATURES = DETAIL_FEATURES_PER_LEVEL * len(DETAIL_LEVELS) + 4
"""Features of a pixel."""
DETAIL_REACH: int = 2 * POOLING_REACH + 2 * (2 ** (max(DETAIL_LEVELS) + 1) - 1)
"""Distance of the farthest pixel that affects a pixel's features, rows or columns."""
MAX_RELATIVE_DIFFERENCE = 1e3
"""Largest difference over the local luminance: a few pixels must not dominate their neighbourhood."""
MAX_MEAN_CERTAINTY = 8.0
"""Largest certainty of a mean, standard errors."""
MIN_RATIO, MIN_RELATIVE_LIGHT = 1e-3, 1e-4
"""Smallest arguments of logarithms: a ratio of squares, a luminance over the image's."""
BAND_ROWS, FEATURE_ROWS = 256, 64
"""Rows whose neighbourhoods are averaged at once, and rows whose features are held in memory at once."""


def compute_detail(
    filtered: FloatArray,
    noisy: FloatArray,
    *,
    halves: tuple[FloatArray, FloatArray] | None = None,
    level: float,
    shared: bool = False,
) -> Iterator[tuple[slice, FloatArray]]:
    """Yield the features of the difference of two images for some rows after others.

    Features are base-2 logarithms unless a range is given. At each width: the squared difference over squared local
    luminance; for each pair of `OFFSETS` the mean correlation of both shifts, in [-1, 1], this mean in standard errors,
    within +-`MAX_MEAN_CERTAINTY`, and half the distance of the two correlations in standard errors; the sum of all
    squared correlations; the variance of the noisy image over the squared difference; the excess of the squared
    difference over the variance, over the squared difference, in [-1, 1], and in standard errors; the squared slope of
    the filtered image over squared local luminance. Then, once: the pixel's own squared difference; local luminance
    over ``level``; whether there are halves, and whether neighbours share noise, each 1 or 0.

    Parameters
    ----------
    filtered : array, shape (height, width, 3)
        Finite, >= 0.
    noisy : array, shape (height, width, 3)
        The image that was filtered. NaN, infinite and negative pixels do not count.
    halves : two arrays, shape (height, width, 3), optional
        Means of one half of the samples each; their mean is ``noisy``. Without them the variance is estimated from the
        residual of the difference.
    level : float
        About the mean luminance of the whole image, of which the images may be a part.
    shared : bool
        Whether neighbouring pixels share their noise.

    Yields
    ------
    rows : slice
    features : array, shape (rows, width, `DETAIL_FEATURES`)

    Raises
    ------
    InputError
        If the images differ in size.
    """
    images, numbers, floor = _take_arguments(filtered, noisy, halves, level, shared=shared)
    for top in range(0, len(noisy), BAND_ROWS):
        bottom, first = min(top + BAND_ROWS, len(noisy)), max(top - DETAIL_REACH, 0)
        pooled = _pool({name: each[first : bottom + DETAIL_REACH] for name, each in images.items()}, floor)
        for start in range(top, bottom, FEATURE_ROWS):
            rows = slice(start, min(start + FEATURE_ROWS, bottom))
            inside = slice(rows.start - first, rows.stop - first)
            (features,) = engine.pixels(define_features, {name: each[inside] for name, each in pooled.items()}, numbers)
            yield rows, np.asarray(features)


def predict_shares(
    filtered: FloatArray,
    noisy: FloatArray,
    network: Perceptron,
    *,
    halves: tuple[FloatArray, FloatArray] | None = None,
    level: float,
    shared: bool = False,
) -> FloatArray:
    """Return the shares of the noisy and of the filtered image that a network predicts, (height, width, 2), in [0, 1].

    Parameters are those of `compute_detail`, and a network of two outputs.

    Raises
    ------
    InputError
        If the images differ in size, or the network has another number of inputs or outputs.
    """
    images, numbers, floor = _take_arguments(filtered, noisy, halves, level, shared=shared)
    network.require_fit(DETAIL_FEATURES, 2)
    sizes = DETAIL_FEATURES, *(len(bias) for bias in network.biases)

    def predict(pooled: dict[str, FloatArray]) -> FloatArray:
        shares: FloatArray = engine.chain(
            define_features,
            pooled,
            numbers,
            ("shares", sizes),
            partial(make_shares, sizes),
            network.name_arrays(),
            rows=FEATURE_ROWS,
            name="seen",
            channels=DETAIL_FEATURES,
            texts=("features of the difference", "a small network says how much to take back"),
        )
        return shares

    shares: FloatArray = engine.in_bands(lambda band: _pool(band, floor), predict, images, BAND_ROWS, DETAIL_REACH)
    return shares


def _take_arguments(
    filtered: FloatArray, noisy: FloatArray, halves: tuple[FloatArray, FloatArray] | None, level: float, *, shared: bool
) -> tuple[dict[str, FloatArray], dict[str, Any], Any]:
    """Return the images that features are computed from, the numbers of `define_features`, and the floor of light."""
    noise_images, factor = gather_noise(halves, shared=shared)
    level = choose_smaller(choose_larger(level, 1e-12), 1e12)
    numbers = {
        "counts": np.array([count_weights(number) for number in DETAIL_LEVELS], np.float32),
        "factor": np.float32(factor),
        "level": make_single(level),
        "flags": np.array([halves is not None, shared], np.float32),
    }
    images = {"filtered": filtered, "noisy": noisy, **noise_images}
    floor = make_single(choose_larger((DARK_SHARE * level) ** 2, 1e-24))
    return {name: each for name, each in images.items() if each is not None}, numbers, floor


def _pool(images: Mapping[str, FloatArray], floor: Any) -> dict[str, FloatArray]:
    """Return the images that features are computed from: squared difference, local light, averages at each width."""
    bounds, names = {"floor": floor}, ["apart", "noise", "light"]
    apart, noise, light = engine.pixels(define_difference, images, bounds, names=names)
    held = {"apart": apart, "noise": noise, "light": light, "filtered": images["filtered"]}
    (sums,) = engine.pixels(define_products, held, bounds, names=["products"])
    (own,) = engine.pixels(define_channel, {"image": sums}, {}, 0, names=["own"], text="squared difference")
    pooled: dict[str, FloatArray] = {"own": own, "light": light}
    for number in range(max(DETAIL_LEVELS) + 1):
        sums = blur_image(sums, 2**number)
        if number in DETAIL_LEVELS:
            pooled[f"sums{number}"] = sums
    return pooled


def define_difference(grid: Grid) -> list[Vector]:
    """Define the difference over local luminance, the squared noise over squared local luminance, local luminance."""
    filtered, noisy = grid.read("filtered"), grid.read("noisy")
    squares, known = estimate_noise(grid, "filtered")
    luminance = average_light(grid, "filtered")
    unit = hl.f32(1.0) / (luminance * luminance + grid.get("floor")[0])
    scale, bound = hl.sqrt(unit), hl.f32(MAX_RELATIVE_DIFFERENCE)
    good = is_good(noisy) & is_good(filtered)
    apart = [hl.clamp((p - q) * scale, -bound, bound) for p, q in zip(noisy, filtered, strict=True)]
    noise = hl.min(add_channels(squares) * unit, bound * bound)
    zero = hl.f32(0.0)
    return [
        [hl.select(good, value, zero) for value in apart],
        [hl.select(good & known, noise, zero)],
        [luminance],
    ]


def define_products(grid: Grid) -> list[Vector]:
    """Define the channels to average: square, products with neighbours, their mean square, noise, excess, slope."""
    apart = grid.read("apart")
    square = add_channels([value * value for value in apart])
    products = []
    read = grid.keep(grid.read("apart", *grid.inside))
    for dx, dy in (offset for pair in OFFSETS for offset in pair):
        near = read(grid.x + dx, grid.y + dy)
        products.append(add_channels([p * q for p, q in zip(apart, near, strict=True)]))
    spread = _add_squares(products) * hl.f32(1.0 / len(products))
    noise, luminance = grid.read_one("noise"), grid.read_one("light")
    excess = square - noise
    unit = hl.f32(1.0) / (luminance * luminance + grid.get("floor")[0])
    slope = hl.min(compute_squared_slope(grid, "filtered") * unit, hl.f32(MAX_RELATIVE_DIFFERENCE**2))
    values = [square, *products, spread, noise, excess, excess * excess, slope]
    return [values]


def define_features(grid: Grid) -> list[Vector]:
    values: list[hl.Expr] = []
    (factor,) = grid.get("factor")
    bound, one = hl.f32(MAX_MEAN_CERTAINTY), hl.f32(1.0)
    for count, number in zip(grid.get("counts"), DETAIL_LEVELS, strict=True):
        square, *products, spread, noise, excess, excess_square, slope = grid.read(f"sums{number}")
        whole = hl.max(square, hl.f32(1e-12))

        def compute_certainty(mean: hl.Expr, square: hl.Expr, count: hl.Expr) -> hl.Expr:
            return hl.clamp(mean / hl.sqrt(hl.max(square, hl.f32(1e-20)) / count), -bound, bound)

        values.append(take_logarithm(square, MIN_RELATIVE_SQUARE))
        # The variance of the mean of two products, and of half their difference, is half that of one product.
        varies = hl.f32(0.5) * spread
        for first, second in zip(products[::2], products[1::2], strict=True):
            mean, half = hl.f32(0.5) * (first + second), hl.f32(0.5) * hl.abs(first - second)
            values.append(hl.clamp(mean / whole, -one, one))
            values += [compute_certainty(mean, varies, count), compute_certainty(half, varies, count)]
        values.append(take_logarithm(_add_squares(products) / (whole * whole), MIN_RATIO))
        values += [
            take_logarithm(noise / whole, MIN_RATIO),
            hl.clamp(excess / whole, -one, one),
            compute_certainty(excess, excess_square, count / factor),
            take_logarithm(slope, MIN_RELATIVE_SQUARE),
        ]
    values.append(take_logarithm(grid.read_one("own"), MIN_RELATIVE_SQUARE))
    values.append(take_logarithm(grid.read_one("light") / grid.get("level")[0], MIN_RELATIVE_LIGHT))
    return [values + [one * flag for flag in grid.get("flags")]]


def _add_squares(values: Vector) -> hl.Expr:
    total = values[0] * values[0]
    for value in values[1:]:
        total = total + value * value
    return total
