"""The colour guide of a dual-buffer pass: the mean of the logarithms of two filtered halves, and its variance."""

from __future__ import annotations

import math
from functools import partial

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend import expressions
from lobewise.backend.buffers import Image, device_scope, download, returns_host_images, take_image
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.pointwise import LARGEST_FLOAT
from lobewise.backend.signature import Signature
from lobewise.engine.numbers import choose_larger
from lobewise.filters.cross_pass import ALBEDO_FLOOR, COLORS, compute_expression_luminance, demodulate
from lobewise.filters.dual_buffer import GUIDE_CHANNELS
from lobewise.filters.fireflies import take_halves
from lobewise.filters.planes import C, X, Y
from lobewise.filters.scheduling import COLUMNS, ROWS, STRIP, count_lanes, keep_planes, keep_rows, schedule_stencil
from lobewise.records.frame import FloatArray

BLUR_RADIUS = 3
"""Radius of the blur of the variance, pixels."""
_PROFILE = [math.exp(-0.5 * k * k) for k in range(-BLUR_RADIUS, BLUR_RADIUS + 1)]
VARIANCE_BLUR = tuple(weight / sum(_PROFILE) for weight in _PROFILE)
"""Gaussian of standard deviation 1 pixel, which blurs the variance."""
MIN_LOG_VARIANCE = 5e-4
"""Smallest variance of the mean of logarithms: relative differences below about 4 % are never distinguished."""
MIN_LOG_VARIANCE_WITHOUT_HALVES = 1e-4
"""Smallest variance for an image without halves, whose noise is estimated from more pixels than with halves."""
LOG_OFFSET_SHARE = 0.04
"""Offset added before taking the logarithm, as a share of the mean light of the whole image."""


def make_scheduled_noise_guide(target: hl.Target) -> Scheduled:
    """Return the kernel of `make_noise_guide`."""
    # Signature
    signature = Signature("noise guide")
    halves = [signature.image(name, "height", "width", COLORS) for name in ("a", "b")]
    offset, floor = signature.number("offset"), signature.number("floor")
    signature.output("guide", "height", "width", GUIDE_CHANNELS)

    # Algorithm
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
    taps = list(zip(range(-BLUR_RADIUS, BLUR_RADIUS + 1), VARIANCE_BLUR, strict=True))
    rows[X, Y] = sum((hl.f32(weight) * spread[X + k, Y] for k, weight in taps), hl.f32(0.0))
    variance = sum((hl.f32(weight) * rows[X, Y + k] for k, weight in taps), floor)
    half = hl.f32(0.5)
    means = [half * (logs[X, k, Y] + logs[X, k + COLORS, Y]) for k in range(COLORS)]
    out[C, X, Y] = hl.mux(C, [*means, variance])

    # Schedule
    schedule_stencil(out, GUIDE_CHANNELS, target, strips=[rows], stored=[rows])
    if target.has_gpu_feature():
        keep_planes(logs, 2 * COLORS)
    else:
        keep_rows(logs.compute_at(out, STRIP), 2 * COLORS, count_lanes(target))
        spread.compute_at(rows, Y).vectorize(X, count_lanes(target)).never_partition_all()
    return Scheduled([out], signature)


def make_light_sums(tinted: bool, target: hl.Target) -> Scheduled:
    """Return the kernel of `measure_light`. It sums each row in a fixed number of parts, so the order never changes."""
    # Signature
    signature, lanes = Signature("light sums"), target.natural_vector_size(hl.Float(32))
    images = [signature.image(name, "height", "width", COLORS) for name in ("a", "b", *["albedo"] * tinted)]
    mask = signature.image("mask", "height", "width", type=hl.UInt(8))
    signature.output("sums", "height", lanes)

    # Algorithm
    lane, width = hl.Var("lane"), mask.width()
    steps = hl.RDom([(0, (width + lanes - 1) // lanes)], "steps")
    x = steps.x * lanes + lane
    at = hl.min(x, width - 1), Y
    total, count = hl.f32(0.0), hl.f32(0.0)
    for half in images[:2]:
        radiance, good = demodulate(half, images[2] if tinted else None, at, hl.f32(ALBEDO_FLOOR))
        light = compute_expression_luminance(radiance)
        # The luminance of finite channels may overflow to infinity.
        good = good & (light < hl.f32(LARGEST_FLOAT))
        total = total + hl.select(good, light, hl.f32(0.0))
        count = count + hl.select(good, hl.f32(1.0), hl.f32(0.0))
    mean = total / hl.max(count, hl.f32(1.0))
    out = hl.Func("out")
    out[lane, Y] = hl.f32(0.0)
    out[lane, Y] = out[lane, Y] + hl.select((x < width) & (mask[at] != 0), mean, hl.f32(0.0))

    # Schedule: rows in parallel, the partial sums of a row in a vector
    out.bound(lane, 0, lanes)
    if target.has_gpu_feature():
        # A tile may have more columns than a vector has lanes: threads beyond the lanes write nothing.
        names = [hl.Var(name) for name in ("column", "row", "thread_x", "thread_y")]
        for stage in (out, out.update()):
            stage.gpu_tile(lane, Y, *names, COLUMNS, ROWS, hl.TailStrategy.GuardWithIf)
    else:
        out.vectorize(lane).parallel(Y).never_partition_all()
        out.update().reorder(lane, steps.x, Y).vectorize(lane).parallel(Y).never_partition_all()
    return Scheduled([out], signature)


@device_scope()
def measure_light(
    halves: tuple[Image, Image], albedo: FloatArray | None, mask: NDArray[np.bool_]
) -> NDArray[np.float64]:
    """Return for every row the sum of luminance over albedo inside ``mask``, and its number of pixels: (height, 2).

    A pixel counts with the mean of its good halves, and with 0 if it has none or its albedo is almost 0. The sums of
    rows have the same bits however the image is cut into bands of rows.

    Parameters
    ----------
    halves : pair of array, shape (height, width, 3)
        Radiance. NaN, infinite and negative pixels of a half do not count.
    albedo : array, shape (height, width, 3) or None
        Divides the radiance.
    mask : bool array, shape (height, width)
        True where pixels count.
    """
    return _count_light(add_light(halves, albedo, mask), mask)


def add_light(halves: tuple[Image, Image], albedo: FloatArray | None, mask: NDArray[np.bool_]) -> Image:
    """Return for every row in parts the sum of luminance over albedo, (height, parts); see `measure_light`."""
    images, tinted = take_halves(halves, albedo, mask), albedo is not None
    make = partial(make_light_sums, tinted)
    sums: Image = engine.kernel(("light sums", tinted), make, images, text="light of every row")["sums"]
    return sums


def _count_light(sums: Image, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    return np.stack([download(sums).sum(axis=1, dtype=np.float64), np.count_nonzero(mask, axis=1)], axis=1)


def measure_level(sums: Image, mask: NDArray[np.bool_]) -> float:
    """Return the mean light of a layer; see `add_light`, which makes the sums. It is 0 if no pixel counts."""
    return compute_mean_light(_count_light(sums, mask))


def compute_mean_light(rows: NDArray[np.float64]) -> float:
    """Return the mean light of rows measured by `measure_light`; 0 if no pixel counts."""
    light, count = rows.sum(axis=0)
    return float(light / max(count, 1.0))


@returns_host_images
def make_noise_guide(a: Image, b: Image, level: float, *, floor: float = MIN_LOG_VARIANCE) -> Image:
    """Return the mean of ``ln(a + d)`` and ``ln(b + d)``, and its variance, shape (height, width, 4).

    ``d`` is ``LOG_OFFSET_SHARE * level``: scaling the image only adds a constant to the guide. The variance is a
    quarter of the squared difference of both logarithms, averaged over the colours and blurred by `VARIANCE_BLUR`.

    Parameters
    ----------
    a, b : array, shape (height, width, 3)
        Two filtered halves, finite, >= 0.
    level : float
        Mean light of the samples of the whole image (`compute_mean_light`), >= 0; the same for every part of an image.
    floor : float
        Added to the variance.
    """
    shape = (*a.shape[:2], COLORS)
    images = {name: take_image("half", image, shape) for name, image in (("a", a), ("b", b))}
    numbers = {"offset": compute_log_offset(level), "floor": floor}
    made = engine.kernel(("noise guide",), make_scheduled_noise_guide, images, numbers, text="noise guide")
    guide: Image = made["guide"]
    return guide


def compute_log_offset(level: float) -> float:
    """Return the offset under the logarithms of an image with mean light ``level``."""
    return choose_larger(LOG_OFFSET_SHARE * level, 1e-30)
