"""How specks are shared out, on processors and on graphics cards."""

from __future__ import annotations

from typing import NamedTuple

import halide as hl

from lobewise.filters.planes import PIXEL
from lobewise.filters.schedules.blocks import ALIGNMENT, spread_pixels
from lobewise.filters.schedules.rows import STRIP_ROWS


class SpeckFuncs(NamedTuple):
    """The functions of the kernel, for its schedule."""

    bright: hl.Func
    """Luminance; 0 outside the image."""
    mixed: hl.Func
    """Whether a pixel shows several objects, 1 or 0, and 1 for being inside the image."""
    rows: hl.Func
    """Sums of `mixed` along rows of the window."""
    blurred: hl.Func
    near: hl.Func
    """Whether a blurred pixel is near, by rows."""
    low: hl.Func
    """Luminance up to the bound, the light above it, and what takes part in sharing."""
    quotient: hl.Func
    """Light above the bound over the sum of what takes it."""
    out: hl.Func


def schedule_specks(funcs: SpeckFuncs, target: hl.Target) -> None:
    """Let strips of rows run in parallel, planes in cache; on cards give every pixel a thread, planes in memory."""
    x, y, _ = PIXEL
    planes = (funcs.bright, funcs.mixed, funcs.rows, funcs.blurred, funcs.near, funcs.low, funcs.quotient)
    if target.has_gpu_feature():
        spread_pixels(funcs.out, x, y)
        for func in planes:
            func.compute_root().align_bounds(x, ALIGNMENT)
            spread_pixels(func, x, y)
        return
    lanes = target.natural_vector_size(hl.Float(32))
    ys, yi, tail = hl.Var("ys"), hl.Var("yi"), hl.TailStrategy.GuardWithIf
    funcs.out.split(y, ys, yi, STRIP_ROWS, tail).vectorize(x, lanes, tail).parallel(ys).never_partition_all()
    for func in planes:
        func.compute_at(funcs.out, ys).vectorize(x, lanes)
