"""What a paired pass compares colours by: the mean of both filtered halves' logarithms, and how noisy that is."""

from __future__ import annotations

import math
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.kernels import expressions
from lobewise.kernels.buffers import borrow as _borrow
from lobewise.kernels.buffers import take_image
from lobewise.kernels.cross_filter import begin_at_zero
from lobewise.kernels.engine import get_kernel
from lobewise.kernels.paired import COLORS, GUIDE_CHANNELS

BLUR_RADIUS = 3
_PROFILE = [math.exp(-0.5 * k * k) for k in range(-BLUR_RADIUS, BLUR_RADIUS + 1)]
BLUR = tuple(weight / sum(_PROFILE) for weight in _PROFILE)
"""Gaussian of one pixel, over which the variance is averaged."""
VARIANCE_FLOOR = 5e-4
"""Least variance of the mean: relative differences below some 4 % are never told apart."""
DARKEST = 0.04
"""What is added under the logarithm, as a share of the mean luminance."""


class _Funcs:
    """The scheduled functions of the guide's kernel."""

    def __init__(self, target: hl.Target) -> None:
        x, y, c = hl.Var("x"), hl.Var("y"), hl.Var("c")
        halves = [hl.ImageParam(hl.Float(32), 3, f"half{number}") for number in range(2)]
        offset = hl.Param(hl.Float(32), "offset")
        for half in halves:
            half.dim(1).set_stride(COLORS)
            begin_at_zero(half)
        width, height = halves[0].dim(1).extent(), halves[0].dim(2).extent()
        at = hl.clamp(x, 0, width - 1), hl.clamp(y, 0, height - 1)
        logs = hl.Func("logs")
        values: list[hl.Expr] = [
            expressions.log2(half[k, at[0], at[1]] + offset) * hl.f32(math.log(2.0))
            for half in halves
            for k in range(COLORS)
        ]
        logs[x, c, y] = hl.mux(c, values)
        spread, rows = hl.Func("spread"), hl.Func("rows")
        steps = [logs[x, k, y] - logs[x, k + COLORS, y] for k in range(COLORS)]
        spread[x, y] = sum((step * step for step in steps), hl.f32(0.0)) * hl.f32(0.25 / COLORS)
        taps = list(zip(range(-BLUR_RADIUS, BLUR_RADIUS + 1), BLUR, strict=True))
        rows[x, y] = sum((hl.f32(weight) * spread[x + k, y] for k, weight in taps), hl.f32(0.0))
        variance = sum((hl.f32(weight) * rows[x, y + k] for k, weight in taps), hl.f32(VARIANCE_FLOOR))
        out = hl.Func("out")
        half = hl.f32(0.5)
        means = [half * (logs[x, k, y] + logs[x, k + COLORS, y]) for k in range(COLORS)]
        out[c, x, y] = hl.mux(c, [*means, variance])

        lanes = target.natural_vector_size(hl.Float(32))
        ys, yi, tail = hl.Var("ys"), hl.Var("yi"), hl.TailStrategy.GuardWithIf
        out.bound(c, 0, GUIDE_CHANNELS).reorder(c, x, y).unroll(c)
        out.output_buffer().dim(1).set_stride(GUIDE_CHANNELS)
        out.split(y, ys, yi, 32, tail).reorder(c, x, yi, ys).vectorize(x, lanes, tail).parallel(ys)
        out.never_partition_all()
        logs.compute_at(out, ys).bound(c, 0, 2 * COLORS).reorder_storage(x, c, y).reorder(c, x, y)
        logs.vectorize(x, lanes).unroll(c).never_partition_all()
        rows.compute_at(out, ys).vectorize(x, lanes)
        spread.compute_at(rows, y).vectorize(x, lanes)
        self.out = out
        self.arguments: list[Any] = [*halves, offset]


class _Sums:
    """The scheduled functions of the sum of two images over a mask, row by row in so many parts as a vector has."""

    def __init__(self, target: hl.Target) -> None:
        lane, y = hl.Var("lane"), hl.Var("y")
        lanes = target.natural_vector_size(hl.Float(32))
        halves = [hl.ImageParam(hl.Float(32), 3, f"half{number}") for number in range(2)]
        mask = hl.ImageParam(hl.UInt(8), 2, "mask")
        for half in halves:
            half.dim(1).set_stride(COLORS)
        for image in (*halves, mask):
            begin_at_zero(image)
        width = mask.width()
        steps = hl.RDom([(0, (width + lanes - 1) // lanes)], "steps")
        x = steps.x * lanes + lane
        at = hl.min(x, width - 1)
        light = sum((half[k, at, y] for half in halves for k in range(COLORS)), hl.f32(0.0))
        out = hl.Func("out")
        out[lane, y] = hl.f32(0.0)
        out[lane, y] = out[lane, y] + hl.select((x < width) & (mask[at, y] != 0), light, hl.f32(0.0))
        out.bound(lane, 0, lanes).vectorize(lane).parallel(y)
        out.update().reorder(lane, steps.x, y).vectorize(lane).parallel(y)
        self.out = out
        self.arguments: list[Any] = [*halves, mask]


def make_noise_guide(a: FloatArray, b: FloatArray, mask: NDArray[np.bool_], device: str = "cpu") -> FloatArray:
    """Return the mean of ``ln(a + d)`` and ``ln(b + d)``, and its variance, shape (height, width, 4).

    ``d`` is `DARKEST` of the mean radiance in ``mask``, so that the guide of a brighter image is the same but for a
    constant. The variance is a quarter of the squared difference of both, averaged over the colours and over `BLUR`.

    Parameters
    ----------
    a, b : array, shape (height, width, 3)
        Two filtered halves, finite, >= 0.
    mask : bool array, shape (height, width)
        Where they have meaning.
    device : str
        A name from `list_devices`.
    """
    height, width = mask.shape
    images = [take_image("half", image, (height, width, COLORS)) for image in (a, b)]
    covered = np.ascontiguousarray(mask).view(np.uint8)
    lanes = hl.get_host_target().natural_vector_size(hl.Float(32))
    # Rows in a fixed number of parts, so that the order in which they are added never changes.
    sums = np.empty((height, lanes), dtype=np.float32)
    held: list[NDArray[Any]] = [*images, covered]
    get_kernel(device, "noise guide sums", _Sums)(*(hl.Buffer(_borrow(image)) for image in held), hl.Buffer(sums))
    mean = float(sums.sum(dtype=np.float64)) / (2.0 * COLORS * max(int(np.count_nonzero(mask)), 1))
    kernel = get_kernel(device, "noise guide", _Funcs)
    target = np.empty((height, width, GUIDE_CHANNELS), dtype=np.float32)
    buffers = [hl.Buffer(_borrow(image)) for image in images]
    kernel(*buffers, max(DARKEST * mean, 1e-30), hl.Buffer(target))
    return target
