"""Estimate the noise of an image without halves from residuals: a pixel minus a prediction from its surroundings.

Second differences along both axes cancel everything that is linear along one axis, so edges along rows and columns and
all slopes. They leave white noise with 36 times its variance. Source: J. Immerkaer 1996, "Fast noise variance
estimation", Computer Vision and Image Understanding 64(2). The squared residual, filtered by the weights of a pass, is
the variance of the samples of the pass; over the number of samples it is the variance of their mean.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import HALIDE
from lobewise.backend.pointwise import Grid, Vector, select_or_nan
from lobewise.engine.numbers import make_single
from lobewise.filters.cross_pass import ALBEDO_FLOOR, COLORS, demodulate
from lobewise.lobes.numbers import Namespace
from lobewise.lobes.vectors import combine
from lobewise.records.frame import FloatArray

RESIDUAL_REACH = SHARED_STEP = 2
"""Pixels between the taps of a residual if neighbours share their noise, otherwise 1; and the farthest pixel read."""
SHARED_NOISE_VARIANCE = 3.2
"""Factor of the variance of a mean if neighbours share their noise: the sum of a pixel's correlations with all pixels,
for a Gaussian pixel filter of standard deviation 0.5 pixels."""
RESIDUAL_NOISE_SHARE = 0.5
"""Share of the squared residual that counts as noise. The rest is detail that differences do not cancel, and outliers
that dominate the mean of a few squares. Tuned on ``showroom`` and ``parlour``
(docs/developers/research/quality_trials.md)."""
DIFFERENCES = (1.0, -2.0, 1.0)
"""Weights of a second difference."""
_MIN_LIGHT = 1e-12


def compute_residual(xp: Namespace, take: Callable[[int, int], Vector], step: int) -> list[Any]:
    """Return the residual of each channel; its variance is that of the noise.

    ``take`` returns the channels so many columns and rows from the pixel, or what stands in for them.
    """
    places = list(enumerate(DIFFERENCES, -1))
    return combine(*((xp.number(q * p / 6.0), take(step * x, step * y)) for y, q in places for x, p in places))


def compute_squared_residual(
    image: FloatArray, albedo: FloatArray | None, mask: NDArray[np.bool_], *, shared: bool = False
) -> FloatArray:
    """Return the squared residual of radiance over albedo, times albedo, so that it is filtered like radiance.

    A bad or masked neighbour is replaced by the pixel itself. Where neighbours share their noise, taps are
    `SHARED_STEP` pixels apart, and the square is multiplied by `SHARED_NOISE_VARIANCE`.

    Parameters
    ----------
    image : array, shape (height, width, 3)
        Radiance; NaN, infinite and negative pixels are bad.
    albedo : array, shape (height, width, 3) or None
        Divides the radiance.
    mask : bool array, shape (height, width)
        True where a pixel belongs to the layer.
    shared : bool
        Whether neighbouring pixels share their noise.

    Returns
    -------
    array, shape (height, width, 3)
        NaN where the image is bad.
    """
    images = {"image": image, "albedo": albedo, "mask": mask}
    (residual,) = engine.pixels(_define_residual, images, {}, shared, names=["residual"], text="squared residuals")
    return residual


def _define_residual(grid: Grid, shared: bool) -> list[Vector]:
    residual, _, good = _compute_residual(grid, SHARED_STEP if shared else 1)
    scale = hl.f32(SHARED_NOISE_VARIANCE if shared else 1.0)
    floor = hl.f32(ALBEDO_FLOOR)
    tints = [hl.max(tint, floor) for tint in grid.read("albedo")] if grid.has("albedo") else [hl.f32(1.0)] * COLORS
    return [[select_or_nan(good, scale * value * value * tint) for value, tint in zip(residual, tints, strict=True)]]


def _compute_residual(
    grid: Grid, step: int, convert: Callable[[hl.Expr], hl.Expr] = lambda value: value
) -> tuple[list[hl.Expr], list[hl.Expr], hl.Expr]:
    """Return residual, value and whether the pixel is good; the value is radiance over albedo, converted."""
    image, albedo = (grid.images[name][0] if grid.has(name) else None for name in ("image", "albedo"))
    assert image is not None, "the caller gives one"

    at = grid.inside
    light, there = demodulate(image, albedo, at, hl.f32(ALBEDO_FLOOR))
    (known,) = grid.read("mask", *at)
    read = grid.keep([convert(value) for value in light])
    read_good = grid.keep([hl.cast(hl.UInt(8), there & (known != 0))])

    own, good = read(grid.x, grid.y), read_good(grid.x, grid.y)[0] != hl.u8(0)

    def take(dx: int, dy: int) -> list[hl.Expr]:
        near = grid.x + dx, grid.y + dy
        there = read_good(*near)[0] != hl.u8(0)
        return [hl.select(there, value, mine) for value, mine in zip(read(*near), own, strict=True)]

    return compute_residual(HALIDE, take, step), own, good


def split_samples(
    image: FloatArray, albedo: FloatArray | None, mask: NDArray[np.bool_], dark: float, *, shared: bool = False
) -> tuple[FloatArray, FloatArray]:
    """Return two images around the samples, radiance over albedo, whose logarithms differ by the noise.

    The residual is that of logarithms, so that a pixel much brighter than its neighbours does not make their noise
    large. The images may be negative, down to ``-dark``; they serve to be compared, not averaged.

    Parameters
    ----------
    image, albedo, mask, shared
        As in `compute_squared_residual`.
    dark : float
        Offset under the logarithm, > 0.
    """
    images = {"image": image, "albedo": albedo, "mask": mask}
    names, text = ["above", "below"], "samples apart by their noise"
    numbers = {"dark": make_single(dark)}
    first, second = engine.pixels(_define_samples, images, numbers, shared, names=names, text=text)
    return first, second


def _define_samples(grid: Grid, shared: bool) -> list[Vector]:
    (dark,) = grid.get("dark")
    residual, logs, good = _compute_residual(grid, SHARED_STEP if shared else 1, lambda value: hl.log(value + dark))
    zero = hl.f32(0.0)
    return [
        [
            hl.select(good, hl.exp(log + sign * hl.abs(value)) - dark, zero)
            for value, log in zip(residual, logs, strict=True)
        ]
        for sign in (hl.f32(1.0), hl.f32(-1.0))
    ]


def split_by_noise(
    mean: FloatArray, residual: FloatArray, support: FloatArray, dark: float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return two images around a filtered image that differ like filtered halves of its samples, and their support.

    A quarter of the squared difference of their logarithms (`lobewise.filters.noise_guides`) is the variance of the
    mean. Their mean is the filtered image.

    Parameters
    ----------
    mean, residual : array, shape (height, width, 3)
        The image and its squared residual, filtered by the same weights, over albedo.
    support : array, shape (height, width, 2)
        Weight sum, and twice the effective number of samples of the mean: the mean of two halves filtered by the same
        weights is worth twice as many samples as this one image.
    dark : float
        Offset under the logarithm, > 0.
    """
    images = {"mean": mean, "residual": residual, "support": support}
    names = ["above", "below", "support"]
    first, second, halved = engine.pixels(_define_split, images, {"dark": make_single(dark)}, names=names)
    return first, second, halved


def _define_split(grid: Grid) -> list[Vector]:
    """Return two images that differ by the noise, and their support; see `split_by_noise`."""
    (dark,) = grid.get("dark")
    weight_sum, effective, *_ = grid.read("support")
    half = hl.f32(0.5) * effective
    one, worth = hl.f32(1.0), hl.max(half, hl.f32(1.0))
    above: list[hl.Expr] = []
    below: list[hl.Expr] = []
    for mean, residual in zip(grid.read("mean"), grid.read("residual"), strict=True):
        offset = mean + dark
        # Half the difference of the logarithms ln(1 + t) and ln(1 - t) is the inverse hyperbolic tangent of t.
        spread = hl.sqrt(hl.f32(RESIDUAL_NOISE_SHARE) * hl.max(residual, hl.f32(0.0)) / worth) / offset
        double = hl.exp(hl.f32(2.0) * hl.min(spread, hl.f32(20.0)))
        apart = hl.min((double - one) / (double + one), mean / hl.max(offset, hl.f32(_MIN_LIGHT)))
        above.append(mean + apart * offset)
        below.append(hl.max(mean - apart * offset, hl.f32(0.0)))
    return [above, below, [weight_sum, half]]
