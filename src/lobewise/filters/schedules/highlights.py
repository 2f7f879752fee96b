"""How highlights are found, on processors and on graphics cards."""

from __future__ import annotations

from typing import NamedTuple

import halide as hl

from lobewise.filters.planes import PIXEL
from lobewise.filters.schedules.blocks import ALIGNMENT, spread_channels, spread_pixels
from lobewise.filters.schedules.rows import STRIP_ROWS


class HighlightFuncs(NamedTuple):
    """The functions of the kernel, for its schedule."""

    light: hl.Func
    both: hl.Func
    """What a pixel is to its surroundings: the mean of its halves, or the one that it has."""
    least: hl.Func
    """What a pixel is to its block: the darker of its halves, or the one that it has."""
    rows: hl.Func
    """Sum and count of a row of the surroundings: of all its pixels, and of those beside the spot."""
    level: hl.Func
    """Mean of the surroundings."""
    agreed: hl.Func
    """The darker half of a pixel if both agree, else 0."""
    blocks: hl.Func
    """Of the block whose first corner is a pixel: the least value, and the least but one."""
    core: hl.Func
    """Whether a block around a pixel is a highlight: 1 or 0."""
    share: hl.Func
    """Which share of a pixel's light is split off, in [0, 1)."""
    out: hl.Func


def schedule_highlights(funcs: HighlightFuncs, target: hl.Target) -> None:
    """Let strips of rows run in parallel, planes in cache; on cards give every pixel a thread, planes in memory."""
    (x, y, c), out = PIXEL, funcs.out
    for buffer in out.output_buffers():
        buffer.dim(1).set_stride(3)
    if target.has_gpu_feature():
        spread_channels(out, 3, PIXEL)
        for func in (funcs.light, funcs.agreed, funcs.rows, funcs.level, funcs.blocks, funcs.core, funcs.share):
            func.compute_root().align_bounds(x, ALIGNMENT)
            spread_pixels(func, x, y)
        return
    lanes = target.natural_vector_size(hl.Float(32))
    ys, yi, tail = hl.Var("ys"), hl.Var("yi"), hl.TailStrategy.GuardWithIf
    out.bound(c, 0, 3).reorder(c, x, y).unroll(c)
    out.split(y, ys, yi, STRIP_ROWS, tail).vectorize(x, lanes, tail).parallel(ys).never_partition_all()
    funcs.share.compute_at(out, yi).vectorize(x, lanes)
    for func in (funcs.light, funcs.both, funcs.least, funcs.agreed, funcs.rows, funcs.level, funcs.blocks, funcs.core):
        func.compute_at(out, ys).vectorize(x, lanes)
