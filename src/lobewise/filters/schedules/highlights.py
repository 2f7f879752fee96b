"""Schedule of the kernel that splits highlights off, for processors and graphics cards."""

from __future__ import annotations

from dataclasses import dataclass

from lobewise.backend.compiler import hl
from lobewise.filters.planes import PIXEL
from lobewise.filters.schedules.blocks import ALIGNMENT, spread_channels, spread_pixels
from lobewise.filters.schedules.rows import STRIP_ROWS


@dataclass(frozen=True, kw_only=True)
class HighlightFuncs:
    """The functions of the kernel; `lobewise.filters.highlights` defines them."""

    light: hl.Func
    both: hl.Func
    least: hl.Func
    rows: hl.Func
    level: hl.Func
    agreed: hl.Func
    blocks: hl.Func
    core: hl.Func
    share: hl.Func
    out: hl.Func


def schedule_highlights(funcs: HighlightFuncs, target: hl.Target) -> None:
    """Run strips of rows in parallel, planes in cache; on graphics cards give each pixel a thread, planes in memory."""
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
    funcs.share.compute_at(out, yi).vectorize(x, lanes).never_partition_all()
    for func in (funcs.light, funcs.both, funcs.least, funcs.agreed, funcs.rows, funcs.level, funcs.blocks, funcs.core):
        # Loops of their own for the borders would double the time to compile.
        func.compute_at(out, ys).vectorize(x, lanes).never_partition_all()
