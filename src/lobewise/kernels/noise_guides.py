"""What a crossed pass compares colours by: both filtered halves on a logarithmic scale, and how far apart they are."""

from __future__ import annotations

import math
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.kernels import expressions
from lobewise.kernels.cross_filter import begin_at_zero
from lobewise.kernels.crossed import COLORS, GUIDE_CHANNELS
from lobewise.kernels.engine import _borrow, get_kernel, take_image

BLUR_RADIUS = 3
_PROFILE = [math.exp(-0.5 * k * k) for k in range(-BLUR_RADIUS, BLUR_RADIUS + 1)]
BLUR = tuple(weight / sum(_PROFILE) for weight in _PROFILE)
"""Gaussian of one pixel, over which the variance is averaged."""
VARIANCE_FLOOR = 1e-3
"""Least variance of a logarithm: relative differences below some 4 % are never told apart."""
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
        spread[x, y] = sum((step * step for step in steps), hl.f32(0.0)) * hl.f32(0.5 / COLORS)
        taps = list(zip(range(-BLUR_RADIUS, BLUR_RADIUS + 1), BLUR, strict=True))
        rows[x, y] = sum((hl.f32(weight) * spread[x + k, y] for k, weight in taps), hl.f32(0.0))
        variance = sum((hl.f32(weight) * rows[x, y + k] for k, weight in taps), hl.f32(VARIANCE_FLOOR))
        out = hl.Func("out")
        out[c, x, y] = hl.mux(c, [*(logs[x, k, y] for k in range(2 * COLORS)), variance])

        lanes = target.natural_vector_size(hl.Float(32))
        ys, yi, tail = hl.Var("ys"), hl.Var("yi"), hl.TailStrategy.GuardWithIf
        out.bound(c, 0, GUIDE_CHANNELS).reorder(c, x, y).unroll(c)
        out.split(y, ys, yi, 32, tail).reorder(c, x, yi, ys).vectorize(x, lanes, tail).parallel(ys)
        out.never_partition_all()
        logs.compute_at(out, ys).bound(c, 0, 2 * COLORS).reorder_storage(x, c, y).reorder(c, x, y)
        logs.vectorize(x, lanes).unroll(c).never_partition_all()
        rows.compute_at(out, ys).vectorize(x, lanes)
        spread.compute_at(rows, y).vectorize(x, lanes)
        self.out = out
        self.arguments: list[Any] = [*halves, offset]


def make_noise_guide(a: FloatArray, b: FloatArray, mask: NDArray[np.bool_], device: str = "cpu") -> FloatArray:
    """Return ``ln(a + d)``, ``ln(b + d)`` and the variance of either, shape (height, width, 7).

    ``d`` is `DARKEST` of the mean luminance in ``mask``, so that the guide of a brighter image is the same but for a
    constant. The variance is half the squared difference of both, averaged over the colours and over `BLUR`.

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
    kernel = get_kernel(device, "noise guide", _Funcs)
    # Sums of whole rows, so that the order in which they are added never changes.
    mean = float(sum(np.where(mask[..., None], image, np.float32(0.0)).sum(dtype=np.float64) for image in images))
    mean /= 2.0 * COLORS * max(int(np.count_nonzero(mask)), 1)
    target = np.empty((height, width, GUIDE_CHANNELS), dtype=np.float32)
    buffers = [hl.Buffer(_borrow(image)) for image in images]
    kernel(*buffers, max(DARKEST * mean, 1e-30), hl.Buffer(target))
    return target
