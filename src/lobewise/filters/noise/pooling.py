"""Common parts of noise estimates: blurs of growing width, residuals of a difference, local light."""

from __future__ import annotations

import math
from functools import partial, reduce
from operator import and_

import numpy as np

from lobewise import engine
from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import HALIDE, is_good
from lobewise.backend.pointwise import Grid, Vector
from lobewise.filters.noise.residuals import SHARED_NOISE_VARIANCE, compute_residual
from lobewise.records.frame import FloatArray

BLUR_WEIGHTS = (0.0625, 0.25, 0.375, 0.25, 0.0625)
"""Weights of five taps along a row or column: a cubic B-spline, variance 1 in squared steps."""
RESIDUAL_STEP = 2
"""Pixels between the taps of a residual: pixel filters share samples among neighbours, hardly farther."""
RESIDUAL_VARIANCE = 6.0
"""Factor of the variance of a mean of residuals, compared with independent pixels: residuals share taps, and neighbours
may share samples."""
DARK_SHARE = 0.03
"""Share of the image's mean luminance that features of a network add, in square, to the squared local luminance that
they divide by."""
POOLING_REACH: int = max(RESIDUAL_STEP, len(BLUR_WEIGHTS) // 2)
"""Distance of the farthest pixel that a residual or the local light reads, rows or columns."""
MIN_RELATIVE_SQUARE = 1e-8
"""Smallest square over the squared local luminance that a logarithm distinguishes."""


def gather_noise(halves: tuple[FloatArray, FloatArray] | None, *, shared: bool) -> tuple[dict[str, FloatArray], float]:
    """Return the images that `estimate_noise` reads, and the factor of the variance of a mean of its noise.

    The factor is 1 for independent pixels.

    Parameters
    ----------
    halves : two arrays, shape (height, width, 3), optional
        Means of one half of the samples each.
    shared : bool
        Whether neighbouring pixels share their noise.
    """
    if halves is not None:
        return {"half_a": halves[0], "half_b": halves[1]}, SHARED_NOISE_VARIANCE if shared else 1.0
    return {}, RESIDUAL_VARIANCE


def estimate_noise(grid: Grid, name: str) -> tuple[list[hl.Expr], hl.Expr]:
    """Return the squared noise of each channel of the noisy image, and whether all pixels that were read are good.

    The noise is half the difference of the halves. Without halves it is the residual of the difference to the image
    ``name``.
    """
    if grid.has("half_a"):
        a, b = grid.read("half_a"), grid.read("half_b")
        squares = [hl.f32(0.25) * (p - q) * (p - q) for p, q in zip(a, b, strict=True)]
        return squares, is_good(a) & is_good(b)
    return square_residual(grid, name)


def count_weights(level: int) -> float:
    """Return the effective number of pixels that the first ``level + 1`` blurs average, taps twice as far apart each.

    The variances of the blurs add up: 1 + 4 + 16 + ... A Gaussian of variance s averages like 4 pi s equal weights.
    """
    return 4.0 * math.pi * (4.0 ** (level + 1) - 1.0) / 3.0


def average_light(grid: Grid, name: str) -> hl.Expr:
    """Return the mean of the channels of an image around the pixel; bad pixels count as 0."""
    near = grid.read(name, *grid.inside)
    read = grid.keep([hl.select(is_good(near), add_channels(near), hl.f32(0.0))])
    total, taps = hl.f32(0.0), range(-2, 3)
    for j in taps:
        for i in taps:
            share = hl.f32(BLUR_WEIGHTS[i + 2] * BLUR_WEIGHTS[j + 2] / 3.0)
            (light,) = read(grid.x + i, grid.y + j)
            total = total + share * light
    return total


def compute_squared_slope(grid: Grid, name: str) -> hl.Expr:
    """Return the squared slope of an image's channels, summed."""
    read, total = grid.keep(grid.read(name, *grid.inside)), hl.f32(0.0)
    for dx, dy in ((1, 0), (0, 1)):
        ahead, behind = (read(grid.x + sign * dx, grid.y + sign * dy) for sign in (1, -1))
        total = total + add_channels([(p - q) * (p - q) for p, q in zip(ahead, behind, strict=True)])
    return hl.f32(0.25) * total


def take_logarithm(value: hl.Expr, least: float) -> hl.Expr:
    """Return the base-2 logarithm of a value, or of ``least`` if the value is smaller."""
    return expressions.log2(hl.max(value, hl.f32(least)))


def add_channels(values: Vector) -> hl.Expr:
    """Return the sum of three channels."""
    return values[0] + values[1] + values[2]


def square_residual(grid: Grid, name: str) -> tuple[list[hl.Expr], hl.Expr]:
    """Return the squared residual of the noisy image minus another one, and whether all pixels that were read are good.

    Taps outside the image are mirrored: a tap that repeated the pixel itself would hide noise.
    """
    at = [hl.clamp(_mirror(place, size), 0, size - 1) for place, size in zip((grid.x, grid.y), grid.size, strict=True)]
    noisy, filtered = grid.read("noisy", *at), grid.read(name, *at)
    read = grid.keep([p - q for p, q in zip(noisy, filtered, strict=True)])
    read_good = grid.keep([hl.cast(hl.UInt(8), is_good(noisy) & is_good(filtered))])
    steps = (-RESIDUAL_STEP, 0, RESIDUAL_STEP)
    good = reduce(and_, (read_good(grid.x + i, grid.y + j)[0] != hl.u8(0) for j in steps for i in steps))
    residual = compute_residual(HALIDE, lambda dx, dy: read(grid.x + dx, grid.y + dy), RESIDUAL_STEP)
    return [value * value for value in residual], good


def _mirror(place: hl.Expr, size: hl.Expr) -> hl.Expr:
    """Return a coordinate, mirrored about the first or the last pixel if it is outside [0, size)."""
    return hl.select(place < 0, -place, hl.select(place > size - 1, 2 * (size - 1) - place, place))


def blur_image(image: FloatArray, step: int) -> FloatArray:
    """Return an image blurred along rows and columns with five taps ``step`` pixels apart."""
    numbers, text = {"step": np.float32(step)}, f"blur, taps {step} pixels apart"

    def blur(image: FloatArray, *, along_rows: bool) -> FloatArray:
        return engine.pixels(define_blur, {"image": image}, numbers, along_rows, names=["blurred"], text=text)[0]

    blurred: FloatArray = engine.by_value(partial(blur, along_rows=False), blur(image, along_rows=True))
    return blurred


def define_blur(grid: Grid, along_rows: bool) -> list[Vector]:
    _, height = grid.size
    (step,) = grid.get("step")
    read = grid.keep(grid.read("image", *grid.inside)) if along_rows else None
    totals: list[hl.Expr] = []
    for number, weight in enumerate(BLUR_WEIGHTS):
        offset = (number - 2) * hl.cast(hl.Int(32), step)
        if read is None:
            near = grid.read("image", grid.x, hl.clamp(grid.y + offset, 0, height - 1))
        else:
            near = read(grid.x + offset, grid.y)
        values = [hl.f32(weight) * value for value in near]
        totals = [total + value for total, value in zip(totals, values, strict=True)] if totals else values
    return [totals]
