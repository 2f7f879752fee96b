"""What a dual-buffer pass compares colours by: the mean of both filtered halves' logarithms, and how noisy that is."""

from __future__ import annotations

import math
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend import expressions
from lobewise.backend.buffers import (
    Image,
    device_scope,
    download,
    lend,
    make_output,
    returns_host_images,
    take_image,
    take_mask,
)
from lobewise.backend.jit import get_kernel
from lobewise.backend.pointwise import LARGEST_FLOAT
from lobewise.filters.cross_pass import ALBEDO_FLOOR, COLORS, demodulate, find_luminance
from lobewise.filters.dual_buffer_pass import GUIDE_CHANNELS
from lobewise.filters.planes import begin_at_zero
from lobewise.filters.schedules.blocks import ALIGNMENT, COLUMNS, ROWS, keep_planes, spread_channels, spread_pixels
from lobewise.frame import FloatArray

BLUR_RADIUS = 3
_PROFILE = [math.exp(-0.5 * k * k) for k in range(-BLUR_RADIUS, BLUR_RADIUS + 1)]
BLUR = tuple(weight / sum(_PROFILE) for weight in _PROFILE)
"""Gaussian of one pixel, over which the variance is averaged."""
VARIANCE_FLOOR = 5e-4
"""Least variance of the mean: relative differences below some 4 % are never told apart."""
DARKEST = 0.04
"""What is added under the logarithm, as a share of the whole image's mean light."""


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

        self.out = out
        self.arguments: list[Any] = [*halves, offset]
        out.output_buffer().dim(1).set_stride(GUIDE_CHANNELS)
        if target.has_gpu_feature():
            spread_channels(out, GUIDE_CHANNELS, (x, y, c))
            keep_planes(logs, 2 * COLORS, (x, y, c))
            spread_pixels(rows.compute_root().align_bounds(x, ALIGNMENT), x, y)
            return
        lanes = target.natural_vector_size(hl.Float(32))
        ys, yi, tail = hl.Var("ys"), hl.Var("yi"), hl.TailStrategy.GuardWithIf
        out.bound(c, 0, GUIDE_CHANNELS).reorder(c, x, y).unroll(c)
        out.split(y, ys, yi, 32, tail).reorder(c, x, yi, ys).vectorize(x, lanes, tail).parallel(ys)
        out.never_partition_all()
        logs.compute_at(out, ys).bound(c, 0, 2 * COLORS).reorder_storage(x, c, y).reorder(c, x, y)
        logs.vectorize(x, lanes).unroll(c).never_partition_all()
        rows.compute_at(out, ys).vectorize(x, lanes)
        spread.compute_at(rows, y).vectorize(x, lanes)


class _Sums:
    """The scheduled functions of `measure_light`, row by row in so many parts as a vector has."""

    def __init__(self, target: hl.Target, tinted: bool) -> None:
        lane, y = hl.Var("lane"), hl.Var("y")
        lanes = target.natural_vector_size(hl.Float(32))
        halves = [hl.ImageParam(hl.Float(32), 3, f"half{number}") for number in range(2)]
        albedo = hl.ImageParam(hl.Float(32), 3, "albedo")
        mask = hl.ImageParam(hl.UInt(8), 2, "mask")
        for image in (*halves, albedo):
            image.dim(1).set_stride(COLORS)
        for image in (*halves, albedo, mask):
            begin_at_zero(image)
        width = mask.width()
        steps = hl.RDom([(0, (width + lanes - 1) // lanes)], "steps")
        x = steps.x * lanes + lane
        at = hl.min(x, width - 1), y
        total, count = hl.f32(0.0), hl.f32(0.0)
        for half in halves:
            radiance, good = demodulate(half, albedo if tinted else None, at, hl.f32(ALBEDO_FLOOR))
            light = find_luminance(radiance)
            # Three large channels may add up to infinity.
            good = good & (light < hl.f32(LARGEST_FLOAT))
            total = total + hl.select(good, light, hl.f32(0.0))
            count = count + hl.select(good, hl.f32(1.0), hl.f32(0.0))
        mean = total / hl.max(count, hl.f32(1.0))
        out = hl.Func("out")
        out[lane, y] = hl.f32(0.0)
        out[lane, y] = out[lane, y] + hl.select((x < width) & (mask[at] != 0), mean, hl.f32(0.0))
        self.out = out
        self.arguments: list[Any] = [*halves, *([albedo] if tinted else []), mask]
        out.bound(lane, 0, lanes)
        if target.has_gpu_feature():
            # A processor of narrow vectors has fewer lanes than a tile has columns: what is beyond is not written.
            names = [hl.Var(name) for name in ("column", "row", "thread_x", "thread_y")]
            for stage in (out, out.update()):
                stage.gpu_tile(lane, y, *names, COLUMNS, ROWS, hl.TailStrategy.GuardWithIf)
            return
        out.vectorize(lane).parallel(y)
        out.update().reorder(lane, steps.x, y).vectorize(lane).parallel(y)


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
    # Every array is held in a local name until the call has returned: Halide keeps no reference.
    held: list[Image] = [take_image("half", half, (height, width, COLORS)) for half in halves]
    held += [] if albedo is None else [take_image("albedo", albedo, (height, width, COLORS))]
    held.append(take_mask(mask))
    lanes = hl.get_host_target().natural_vector_size(hl.Float(32))
    # Rows in a fixed number of parts, so that the order in which they are added never changes.
    buffer, sums = make_output((height, lanes), device)
    kernel = get_kernel(device, (measure_light, albedo is not None), lambda target: _Sums(target, albedo is not None))
    kernel(*(lend(image, device) for image in held), buffer)
    return np.stack([download(sums).sum(axis=1, dtype=np.float64), np.count_nonzero(mask, axis=1)], axis=1)


def find_level(rows: NDArray[np.float64]) -> float:
    """Return the mean light of the rows that `measure_light` gave; 0 where nothing has meaning."""
    light, count = rows.sum(axis=0)
    return float(light / max(count, 1.0))


@returns_host_images
def make_noise_guide(a: Image, b: Image, level: float, device: str = "cpu") -> Image:
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
    """
    height, width = a.shape[0], a.shape[1]
    images = [take_image("half", image, (height, width, COLORS)) for image in (a, b)]
    kernel = get_kernel(device, "noise guide", _Funcs)
    buffer, guide = make_output((height, width, GUIDE_CHANNELS), device)
    kernel(*(lend(image, device) for image in images), max(DARKEST * level, 1e-30), buffer)
    return guide
