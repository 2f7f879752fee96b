"""How highlights are found, on processors and on graphics cards."""

from __future__ import annotations

from typing import TYPE_CHECKING

import halide as hl

from lobewise.filters.planes import PIXEL
from lobewise.filters.schedules.blocks import ALIGNMENT, spread_channels, spread_pixels
from lobewise.filters.schedules.rows import STRIP_ROWS

if TYPE_CHECKING:
    from lobewise.filters.highlights import HighlightFuncs


def schedule_highlights(funcs: HighlightFuncs, target: hl.Target) -> None:
    """Let strips of rows run in parallel, planes in cache; on cards give every pixel a thread, planes in memory."""
    (x, y, c), out = PIXEL, funcs.out
    for buffer in out.output_buffers():
        buffer.dim(1).set_stride(3)
    if target.has_gpu_feature():
        spread_channels(out, 3, PIXEL)
        for func in (funcs.light, funcs.rows, funcs.level, funcs.blocks, funcs.core, funcs.share):
            func.compute_root().align_bounds(x, ALIGNMENT)
            spread_pixels(func, x, y)
        return
    lanes = target.natural_vector_size(hl.Float(32))
    ys, yi, tail = hl.Var("ys"), hl.Var("yi"), hl.TailStrategy.GuardWithIf
    out.bound(c, 0, 3).reorder(c, x, y).unroll(c)
    out.split(y, ys, yi, STRIP_ROWS, tail).vectorize(x, lanes, tail).parallel(ys).never_partition_all()
    funcs.share.compute_at(out, yi).vectorize(x, lanes)
    for func in (funcs.light, funcs.both, funcs.least, funcs.rows, funcs.level, funcs.blocks, funcs.core):
        func.compute_at(out, ys).vectorize(x, lanes)
