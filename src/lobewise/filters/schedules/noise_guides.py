"""Schedules of the kernels of colour guides and of sums of light, for processors and graphics cards."""

from __future__ import annotations

from typing import NamedTuple

from lobewise.backend.compiler import hl
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.dual_buffer_pass import GUIDE_CHANNELS
from lobewise.filters.planes import PIXEL
from lobewise.filters.schedules.blocks import ALIGNMENT, COLUMNS, ROWS, keep_planes, spread_channels, spread_pixels
from lobewise.filters.schedules.rows import STRIP_ROWS


class NoiseGuideFuncs(NamedTuple):
    """The functions of the guide's kernel."""

    logs: hl.Func
    """Logarithms of the three colours of one half, then of the other; a function of (x, c, y)."""
    spread: hl.Func
    """A quarter of the mean squared difference of both logarithms."""
    rows: hl.Func
    """``spread`` blurred along rows."""
    out: hl.Func


class LightSumFuncs(NamedTuple):
    """The functions of the kernel of `measure_light`."""

    out: hl.Func
    """Partial sums of each row, one per lane of a vector; a function of (lane, y)."""
    lane: hl.Var
    steps: hl.RDom


def schedule_noise_guide(funcs: NoiseGuideFuncs, target: hl.Target) -> None:
    """Run strips of rows in parallel, their logarithms in cache; on graphics cards keep logarithms in memory."""
    x, y, c = PIXEL
    out, rows = funcs.out, funcs.rows
    out.output_buffer().dim(1).set_stride(GUIDE_CHANNELS)
    if target.has_gpu_feature():
        spread_channels(out, GUIDE_CHANNELS, PIXEL)
        keep_planes(funcs.logs, 2 * COLORS, PIXEL)
        spread_pixels(rows.compute_root().align_bounds(x, ALIGNMENT), x, y)
        return
    lanes = target.natural_vector_size(hl.Float(32))
    ys, yi, tail = hl.Var("ys"), hl.Var("yi"), hl.TailStrategy.GuardWithIf
    out.bound(c, 0, GUIDE_CHANNELS).reorder(c, x, y).unroll(c)
    out.split(y, ys, yi, STRIP_ROWS, tail).reorder(c, x, yi, ys).vectorize(x, lanes, tail).parallel(ys)
    out.never_partition_all()
    funcs.logs.compute_at(out, ys).bound(c, 0, 2 * COLORS).reorder_storage(x, c, y).reorder(c, x, y)
    funcs.logs.vectorize(x, lanes).unroll(c).never_partition_all()
    rows.compute_at(out, ys).vectorize(x, lanes).never_partition_all()
    funcs.spread.compute_at(rows, y).vectorize(x, lanes).never_partition_all()


def schedule_light_sums(funcs: LightSumFuncs, lanes: int, target: hl.Target) -> None:
    """Run rows in parallel, the partial sums of a row in a vector."""
    out, lane, y = funcs.out, funcs.lane, PIXEL[1]
    out.bound(lane, 0, lanes)
    if target.has_gpu_feature():
        # A tile may have more columns than a vector has lanes: threads beyond the lanes write nothing.
        names = [hl.Var(name) for name in ("column", "row", "thread_x", "thread_y")]
        for stage in (out, out.update()):
            stage.gpu_tile(lane, y, *names, COLUMNS, ROWS, hl.TailStrategy.GuardWithIf)
        return
    out.vectorize(lane).parallel(y).never_partition_all()
    out.update().reorder(lane, funcs.steps.x, y).vectorize(lane).parallel(y).never_partition_all()
