"""What a dual-buffer pass compares colours by: the mean of both filtered halves' logarithms, and how noisy that is."""

from __future__ import annotations

import math
from functools import partial

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend import expressions
from lobewise.backend.buffers import Image, device_scope, download, returns_host_images, take_image, take_mask
from lobewise.backend.jit import Scheduled, get_kernel, run_kernel
from lobewise.backend.pointwise import LARGEST_FLOAT
from lobewise.backend.signature import Signature
from lobewise.filters.cross_pass import ALBEDO_FLOOR, COLORS, demodulate, find_luminance
from lobewise.filters.dual_buffer_pass import GUIDE_CHANNELS
from lobewise.filters.planes import C, X, Y
from lobewise.filters.schedules.noise_guides import (
    LightSumFuncs,
    NoiseGuideFuncs,
    schedule_light_sums,
    schedule_noise_guide,
)
from lobewise.frame import FloatArray

BLUR_RADIUS = 3
_PROFILE = [math.exp(-0.5 * k * k) for k in range(-BLUR_RADIUS, BLUR_RADIUS + 1)]
BLUR = tuple(weight / sum(_PROFILE) for weight in _PROFILE)
"""Gaussian of one pixel, over which the variance is averaged."""
VARIANCE_FLOOR = 5e-4
"""Least variance of the mean: relative differences below some 4 % are never told apart."""
LONE_FLOOR = 1e-4
"""The same for an image without halves, whose noise is known from more pixels than a difference of halves."""
DARKEST = 0.04
"""What is added under the logarithm, as a share of the whole image's mean light."""


def _make_noise_guide(target: hl.Target) -> Scheduled:
    """Return the guide, to be compiled."""
    signature = Signature("noise guide")
    halves = [signature.image(name, "height", "width", COLORS) for name in ("a", "b")]
    offset, floor = signature.number("offset"), signature.number("floor")
    signature.output("guide", "height", "width", GUIDE_CHANNELS)
    width, height = halves[0].dim(1).extent(), halves[0].dim(2).extent()
    at = hl.clamp(X, 0, width - 1), hl.clamp(Y, 0, height - 1)
    logs, spread, rows, out = (hl.Func(name) for name in ("logs", "spread", "rows", "out"))
    values: list[hl.Expr] = [
        expressions.log2(half[k, at[0], at[1]] + offset) * hl.f32(math.log(2.0))
        for half in halves
        for k in range(COLORS)
    ]
    logs[X, C, Y] = hl.mux(C, values)
    steps = [logs[X, k, Y] - logs[X, k + COLORS, Y] for k in range(COLORS)]
    spread[X, Y] = sum((step * step for step in steps), hl.f32(0.0)) * hl.f32(0.25 / COLORS)
    taps = list(zip(range(-BLUR_RADIUS, BLUR_RADIUS + 1), BLUR, strict=True))
    rows[X, Y] = sum((hl.f32(weight) * spread[X + k, Y] for k, weight in taps), hl.f32(0.0))
    variance = sum((hl.f32(weight) * rows[X, Y + k] for k, weight in taps), floor)
    half = hl.f32(0.5)
    means = [half * (logs[X, k, Y] + logs[X, k + COLORS, Y]) for k in range(COLORS)]
    out[C, X, Y] = hl.mux(C, [*means, variance])
    schedule_noise_guide(NoiseGuideFuncs(logs, spread, rows, out), target)
    return Scheduled([out], signature)


def _make_light_sums(tinted: bool, target: hl.Target) -> Scheduled:
    """Return the sums, to be compiled: rows in a fixed number of parts, so that they always add up in one order."""
    signature, lanes = Signature("light sums"), target.natural_vector_size(hl.Float(32))
    lane, y = hl.Var("lane"), Y
    images = [signature.image(name, "height", "width", COLORS) for name in ("a", "b", *["albedo"] * tinted)]
    mask = signature.image("mask", "height", "width", type=hl.UInt(8))
    signature.output("sums", "height", lanes)
    width = mask.width()
    steps = hl.RDom([(0, (width + lanes - 1) // lanes)], "steps")
    x = steps.x * lanes + lane
    at = hl.min(x, width - 1), y
    total, count = hl.f32(0.0), hl.f32(0.0)
    for half in images[:2]:
        radiance, good = demodulate(half, images[2] if tinted else None, at, hl.f32(ALBEDO_FLOOR))
        light = find_luminance(radiance)
        # Three large channels may add up to infinity.
        good = good & (light < hl.f32(LARGEST_FLOAT))
        total = total + hl.select(good, light, hl.f32(0.0))
        count = count + hl.select(good, hl.f32(1.0), hl.f32(0.0))
    mean = total / hl.max(count, hl.f32(1.0))
    out = hl.Func("out")
    out[lane, y] = hl.f32(0.0)
    out[lane, y] = out[lane, y] + hl.select((x < width) & (mask[at] != 0), mean, hl.f32(0.0))
    schedule_light_sums(LightSumFuncs(out, lane, steps), lanes, target)
    return Scheduled([out], signature)


@device_scope()
def measure_light(
    halves: tuple[Image, Image], albedo: FloatArray | None, mask: NDArray[np.bool_], device: str = "cpu"
) -> NDArray[np.float64]:
    """Return for every row the luminance of radiance over albedo, summed in ``mask``, and its pixels: (height, 2).

    A pixel counts by the mean of its halves, or by the one that it has; where the albedo tells nothing it is dark.
    Rows add up to the same bits however an image was cut into bands of them.

    Parameters
    ----------
    halves : pair of array, shape (height, width, 3)
        Radiance. NaN, infinite and negative pixels of a half do not count.
    albedo : array, shape (height, width, 3) or None
        What it is divided by.
    mask : bool array, shape (height, width)
        Where it has meaning.
    device : str
        A name from `list_devices`.
    """
    height, width = mask.shape
    images: dict[str, Image] = {
        name: take_image("half", half, (height, width, COLORS)) for name, half in zip("ab", halves, strict=True)
    }
    if albedo is not None:
        images["albedo"] = take_image("albedo", albedo, (height, width, COLORS))
    images["mask"] = take_mask(mask)
    tinted = albedo is not None
    kernel = get_kernel(device, ("light sums", tinted), partial(_make_light_sums, tinted))
    sums = download(run_kernel(kernel, device, images)["sums"])
    return np.stack([sums.sum(axis=1, dtype=np.float64), np.count_nonzero(mask, axis=1)], axis=1)


def find_level(rows: NDArray[np.float64]) -> float:
    """Return the mean light of the rows that `measure_light` gave; 0 where nothing has meaning."""
    light, count = rows.sum(axis=0)
    return float(light / max(count, 1.0))


@returns_host_images
def make_noise_guide(a: Image, b: Image, level: float, device: str = "cpu", *, floor: float = VARIANCE_FLOOR) -> Image:
    """Return the mean of ``ln(a + d)`` and ``ln(b + d)``, and its variance, shape (height, width, 4).

    ``d`` is `DARKEST` of ``level``, so that the guide of a brighter image is the same but for a constant. The variance
    is a quarter of the squared difference of both, averaged over the colours and over `BLUR`.

    Parameters
    ----------
    a, b : array, shape (height, width, 3)
        Two filtered halves, finite, >= 0.
    level : float
        How bright the whole image is, >= 0: the mean light of its samples (`find_level`), which no filter need have run
        for, and which is the same for every part of an image.
    device : str
        A name from `list_devices`.
    floor : float
        Least variance.
    """
    shape = (*a.shape[:2], COLORS)
    images = {name: take_image("half", image, shape) for name, image in (("a", a), ("b", b))}
    kernel = get_kernel(device, ("noise guide",), _make_noise_guide)
    return run_kernel(kernel, device, images, offset=find_dark(level), floor=floor)["guide"]


def find_dark(level: float) -> float:
    """Return what is added under the logarithms of an image whose mean light is ``level``."""
    return max(DARKEST * level, 1e-30)
