"""Find the error that the samples of another frame would bring in.

Light changes from frame to frame, reflections move, motion vectors are wrong: the samples of another frame have a bias.
Two tests find it. The first compares the samples: noise is independent from pixel to pixel, bias is not, so it is what
the mean difference of a neighbourhood has beyond its standard error. The second compares pilots, the frames after a
first denoising, in which little noise is left: it sees small things as well, but also the errors of the pilots.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector
from lobewise.filters.noise.pooling import add_channels, average_light, blur_image, count_weights
from lobewise.guides.squares import sum_square
from lobewise.records.frame import FloatArray

WIDTH_COUNT = 2
"""Widths at which differences of samples are averaged: standard deviations of 1 and 2.2 pixels."""
MAX_SAMPLE_DIFFERENCE = 6.0
"""Largest difference, over the local light, that counts: few bright samples must not decide about a neighbourhood."""
MIN_RELATIVE_VARIANCE = 1e-6
"""Smallest variance of a difference of samples, over the squared local light."""
MIN_RELATIVE_NOISE = 1e-6
"""Smallest variance of samples, over the squared local light."""
SMEARED_SHARE = 0.05
"""Difference of two denoised images, blurred and over the local light, at which one counts half for the other: above it
the light has changed more often than a denoiser has smeared its noise."""
BRIGHTNESS_RADIUS_PIXELS, MAX_BRIGHTNESS_FACTOR = 16, 1.4
"""Distance, rows or columns, of the pixels whose mean light tells how far another frame is brighter, and largest factor
that makes up for it."""
UNCOMPARED_SHARE = 0.1
"""Light below which differences of denoised images count as in the dark, over the mean light of the image."""
MIN_LIGHT = 1e-4
"""Smallest local light, over the mean light of the image."""


def estimate_variance(samples: FloatArray, pilot: FloatArray) -> FloatArray:
    """Return the variance of samples, the mean over the channels and over pixels nearby, (height, width), > 0.

    Parameters
    ----------
    samples, pilot : array, shape (height, width, 3)
        Samples, and what a first denoising made of them; finite.
    """
    (squares,) = engine.pixels(_define_noise, {"samples": samples, "pilot": pilot}, {"floor": _compute_floor(pilot)})
    for level in (1, 2):
        squares = blur_image(squares, level)
    return np.asarray(squares)


def _compute_floor(image: FloatArray) -> np.float32:
    """Return the local light below which an image counts as dark."""
    return np.float32(MIN_LIGHT) * _compute_mean(image)


def _compute_mean(image: FloatArray) -> np.float32:
    """Return the mean of an image, bounded so that squares of small parts of it neither under- nor overflow."""
    return np.float32(min(max(float(np.mean(image, dtype=np.float64)), 1e-12), 1e16))


def _average_squares(grid: Grid, one: str, other: str) -> hl.Expr:
    """Return the squared difference of two images, the mean over the channels."""
    apart = [p - q for p, q in zip(grid.read(one), grid.read(other), strict=True)]
    return add_channels([value * value for value in apart]) * hl.f32(1.0 / 3.0)


def _define_noise(grid: Grid) -> list[Vector]:
    light = average_light(grid, "pilot") + grid.get("floor")[0]
    square = _average_squares(grid, "samples", "pilot")
    return [[hl.max(square, hl.f32(MIN_RELATIVE_NOISE) * light * light)]]


def compare_pilots(own: FloatArray, other: FloatArray, agreement: FloatArray) -> FloatArray:
    """Return the squared difference of two pilots, the mean over channels and pixels nearby, (height, width), >= 0.

    Parameters
    ----------
    own, other : array, shape (height, width, 3)
        Pilots of the frame, and of the other frame at the pixels of this one; finite.
    agreement : array, shape (height, width)
        How well the surfaces match, 0 to 1. Pixels with agreement 0 do not count.
    """
    (squares,) = engine.pixels(_define_pilots, {"own": own, "other": other, "agreement": agreement}, {})
    squares = blur_image(squares, 1)
    (bias,) = engine.pixels(_define_mean, {"squares": squares}, {})
    return np.asarray(bias)


def compare_denoised(own: FloatArray, other: FloatArray) -> FloatArray:
    """Return how alike two denoised images are around each pixel, (height, width), 1 where they are equal, > 0.

    Parameters
    ----------
    own, other : array, shape (height, width, 3)
        Denoised radiance of the frame, and of another frame at the pixels of this one; finite.
    """
    floor = np.float32(UNCOMPARED_SHARE) * _compute_mean(own)
    blurred = {"own": blur_image(own, 1), "other": blur_image(other, 1)}
    return engine.pixels(_define_likeness, blurred, {"floor": floor})[0]


def compute_brightness_factor(own: FloatArray, other: FloatArray, agreement: FloatArray) -> FloatArray:
    """Return the factor, (height, width, 1), that makes the light of another frame as bright as this frame's nearby.

    A lamp that becomes brighter changes each pixel by less than its noise. The mean over many pixels shows it.

    Parameters
    ----------
    own, other : array, shape (height, width, 3)
        Denoised radiance of the frame, and of another frame at the pixels of this one.
    agreement : array, shape (height, width)
        How well the surfaces match, 0 to 1.
    """
    here, there = (sum_square(np.mean(image, axis=-1) * agreement, BRIGHTNESS_RADIUS_PIXELS) for image in (own, other))
    factor = np.divide(here, there, out=np.ones_like(there), where=there > 0.0)
    return np.asarray(
        np.clip(factor, np.float32(1.0 / MAX_BRIGHTNESS_FACTOR), np.float32(MAX_BRIGHTNESS_FACTOR))[..., None]
    )


def _define_likeness(grid: Grid) -> list[Vector]:
    floor = grid.get("floor")[0]
    square = _average_squares(grid, "own", "other")
    light = [add_channels([value * value for value in grid.read(name)]) for name in ("own", "other")]
    scale = (light[0] + light[1]) * hl.f32(1.0 / 6.0) + floor * floor
    return [[hl.f32(1.0) / (hl.f32(1.0) + square / (hl.f32(SMEARED_SHARE**2) * scale))]]


def _define_pilots(grid: Grid) -> list[Vector]:
    weight = grid.read_one("agreement")
    square = _average_squares(grid, "own", "other")
    return [[hl.select(weight > hl.f32(0.0), weight * square, hl.f32(0.0)), weight]]


def _define_mean(grid: Grid) -> list[Vector]:
    square, weight = grid.read("squares")
    return [[square / hl.max(weight, hl.f32(1e-6))]]


def estimate_relative_bias(own: FloatArray, other: FloatArray, agreement: FloatArray) -> FloatArray:
    """Return the squared bias of the samples of another frame over their variance, (height, width), >= 0.

    Parameters
    ----------
    own, other : array, shape (height, width, 3)
        Samples of the frame, and of the other frame at the pixels of this one; finite.
    agreement : array, shape (height, width)
        How well the surfaces match, 0 to 1. Pixels with agreement 0 do not count.
    """
    images = {"own": own, "other": other, "agreement": agreement}
    sums, squares = engine.pixels(_define_differences, images, {"floor": _compute_floor(own)})
    bias = np.zeros(agreement.shape, np.float32)
    for level in range(WIDTH_COUNT):
        sums, squares = (blur_image(image, 2**level) for image in (sums, squares))
        images = {"sums": sums, "squares": squares, "before": bias}
        (bias,) = engine.pixels(_define_relative, images, {"count": np.float32(count_weights(level))})
    return bias


def _define_differences(grid: Grid) -> list[Vector]:
    """Return weighted relative differences, and weighted squares with the weight."""
    light = average_light(grid, "own") + grid.get("floor")[0]
    weight = grid.read_one("agreement")
    most = hl.f32(MAX_SAMPLE_DIFFERENCE)
    apart = [hl.clamp((q - p) / light, -most, most) for p, q in zip(grid.read("own"), grid.read("other"), strict=True)]
    seen = weight > hl.f32(0.0)
    sums = [hl.select(seen, weight * value, hl.f32(0.0)) for value in apart]
    squares = [hl.select(seen, weight * value * value, hl.f32(0.0)) for value in apart]
    return [sums, [*squares, weight]]


def _define_relative(grid: Grid) -> list[Vector]:
    one, zero = hl.f32(1.0), hl.f32(0.0)
    *squares, weight = grid.read("squares")
    total = hl.max(weight, hl.f32(1e-6))
    # Fewer pixels with a match make the average less certain.
    count = hl.max(grid.get("count")[0] * weight, hl.f32(1.5))
    bias: Sequence[hl.Expr] = ()
    noise: Sequence[hl.Expr] = ()
    for value, square in zip(grid.read("sums"), squares, strict=True):
        mean = value / total
        spread = hl.max(square / total - mean * mean, hl.f32(MIN_RELATIVE_VARIANCE)) * count / (count - one)
        bias = [*bias, hl.max(mean * mean - spread / count, zero)]
        noise = [*noise, spread]
    # The variance of a difference is that of two frames.
    ratio = hl.f32(2.0) * add_channels(bias) / add_channels(noise)
    return [[hl.max(grid.read_one("before"), ratio)]]
