"""Schedules of the pass over two halves of the samples, for processors and graphics cards."""

from __future__ import annotations

from lobewise.backend.compiler import hl
from lobewise.filters.cross_pass import COLORS, U, V
from lobewise.filters.dual_buffer_pass import GUIDE_CHANNELS, PLANES, DualBufferFuncs
from lobewise.filters.planes import PIXEL
from lobewise.filters.scheduling import STRIP_ROWS, fill_planes, fill_rows, keep_planes, spread_channels
from lobewise.settings import LARGEST_RADIUS


def schedule_dual_buffer(funcs: DualBufferFuncs, target: hl.Target) -> None:
    """Schedule a dual-buffer pass for a target."""
    if target.has_gpu_feature():
        _schedule_blocks(funcs)
    else:
        _schedule_rows(funcs, target)


def _schedule_rows(funcs: DualBufferFuncs, target: hl.Target) -> None:
    """Run strips of rows in parallel, columns in vectors, one row of taps at a time.

    The sums of a row of taps stay in registers, and the sums of a tile are updated once per row of taps. The logarithms
    of a row's weights lie in the first-level cache.
    """
    x, y, c = PIXEL
    lanes = target.natural_vector_size(hl.Float(32))
    out, tail = funcs.out, hl.TailStrategy.GuardWithIf
    xo, yo, xi, yi, ys, yt, xv, xw = (hl.Var(name) for name in ("xo", "yo", "xi", "yi", "ys", "yt", "xv", "xw"))
    rows, columns = 8, 8 * lanes
    out.bound(c, 0, COLORS)
    for buffer in out.output_buffers():
        buffer.dim(1).set_stride(COLORS)
    out.split(y, ys, yt, STRIP_ROWS, tail).tile(x, yt, xo, yo, xi, yi, columns, rows, tail)
    out.reorder(c, xi, yi, xo, yo, ys).unroll(c).vectorize(xi, lanes).parallel(ys).never_partition_all()
    sums, row = funcs.sums, funcs.row
    sums.compute_at(out, xo).vectorize(x, lanes).bound_storage(x, columns).bound_storage(y, rows)
    sums.update().split(x, xv, xw, lanes).reorder(xw, xv, y, funcs.down.x).vectorize(xw)
    row.compute_at(sums, xv).vectorize(x, lanes)
    row.update().reorder(x, funcs.across.x).vectorize(x, lanes)
    for stage in funcs.stages:
        stage.compute_at(sums, xv).vectorize(x, lanes).bound_storage(U, 2 * LARGEST_RADIUS + 1)
        stage.bound_storage(x, lanes).bound_storage(y, 1).bound_storage(V, 1)
    assert funcs.rows is not None
    fill_rows(funcs.images.compute_at(out, ys), PLANES, funcs.rows)
    if funcs.guide is not None:
        fill_rows(funcs.guide.compute_at(out, ys), GUIDE_CHANNELS, funcs.rows)
    for planes in funcs.planes:
        fill_planes(planes, funcs.rows, (out, ys))


def _schedule_blocks(funcs: DualBufferFuncs) -> None:
    """Give each pixel a thread, which computes both halves."""
    for buffer in funcs.out.output_buffers():
        buffer.dim(1).set_stride(COLORS)
    thread = spread_channels(funcs.out, COLORS)
    funcs.sums.compute_at(funcs.out, thread)
    funcs.row.compute_at(funcs.sums, funcs.down.x)
    for stage in funcs.stages:
        stage.compute_at(funcs.row, funcs.across.x)
    keep_planes(funcs.images, PLANES)
    keep_planes(funcs.guide, GUIDE_CHANNELS)
    for planes in funcs.planes:
        keep_planes(planes.planes, planes.plane_count)
