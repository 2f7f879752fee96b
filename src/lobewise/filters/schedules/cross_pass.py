"""Schedules of a pass of the cross filter, for processors and graphics cards."""

from __future__ import annotations

from lobewise.backend.compiler import hl
from lobewise.filters.cross_pass import COLORS, PassFuncs, U, V, Writes
from lobewise.filters.forms import Taps
from lobewise.filters.planes import PIXEL
from lobewise.filters.scheduling import STRIP_ROWS, fill_planes, fill_rows, keep_planes, spread_channels
from lobewise.settings import LARGEST_RADIUS


def schedule_pass(funcs: PassFuncs, target: hl.Target) -> None:
    """Schedule a pass for a target."""
    if target.has_gpu_feature():
        _schedule_blocks(funcs)
    else:
        _schedule_rows(funcs, target)


def _schedule_rows(funcs: PassFuncs, target: hl.Target) -> None:
    """Run strips of rows in parallel and columns in vectors. Keep log-similarities of one row of taps in cache.

    Measured (AMD EPYC with AVX-512, two threads; benchmarks/results/filters.json), 512x512, all taps of radius 8:
    ``normal`` 18 ms, ``sg`` 24 ms, ``ggx`` 44 ms, ``asg`` 56 ms. Alternatives that were tried: docs/performance.md.
    Reasons:

    - Each stage of the log-similarity has its own loop over a row of taps, so that no loop runs out of vector
      registers. Its results stay in the first-level cache.
    - The planes of a row lie side by side, padded to whole vectors. Planes a power of two apart would share cache sets.
    - Strips of rows are independent: memory is bounded, and the number of threads changes no bit.
    - A column of taps goes down vector by vector. The rows of a vector stay in the first-level cache.
    - The sums of a tile have a fixed size and lie on the stack. Allocating memory in a loop costs as much as 12 taps.
    """
    x, y, c = PIXEL
    lanes = target.natural_vector_size(hl.Float(32))
    out, row, tail = funcs.out, funcs.row, hl.TailStrategy.GuardWithIf
    xo, yo, xi, yi, ys, yt, xv, xw = (hl.Var(name) for name in ("xo", "yo", "xi", "yi", "ys", "yt", "xv", "xw"))
    rows, columns = 8, 8 * lanes
    written = funcs.key.channels if funcs.rest is None else COLORS
    out.bound(c, 0, written).reorder(c, x, y).unroll(c)
    for func in (out, funcs.rest):
        if func is not None:
            func.split(y, ys, yt, STRIP_ROWS, tail).tile(x, yt, xo, yo, xi, yi, columns, rows, tail)
            func.split(xi, xv, xw, lanes, tail).reorder(xw, xv, yi, xo, yo, ys)
            func.vectorize(xw).parallel(ys).never_partition([xw, yi, xo, yo, ys])
    out.reorder(c, xw)
    if funcs.key.writes is not Writes.SUMS:
        # A known stride makes whole stores of interleaved vectors.
        out.output_buffer().dim(1).set_stride(written)
    if funcs.rest is not None:
        assert funcs.finish is not None
        # Tell the compiler that all outputs have one size; otherwise it emits every loop three times.
        whole, beside = out.output_buffer(), funcs.rest.output_buffers()[0]
        for axis in (0, 1):
            beside.dim(axis).set_bounds(whole.dim(axis + 1).min(), whole.dim(axis + 1).extent())
        funcs.rest.compute_with(out, xv)
        # Guard its vectors instead of moving them inwards: in a row narrower than a vector they would read mask and
        # albedo outside the image.
        finish = funcs.finish.compute_at(out, xv).vectorize(x, lanes, tail)
        finish.bound_storage(x, lanes).bound_storage(y, 1)
    sums = funcs.sums.compute_at(out, xo).vectorize(x, lanes).bound_storage(x, columns).bound_storage(y, rows)
    across, within = ([xw, y, xv], y) if funcs.key.taps is Taps.VERTICAL else ([xw, xv, y], xv)
    sums.update().split(x, xv, xw, lanes).reorder(*across, funcs.outer.x).vectorize(xw)
    row.compute_at(sums, within).vectorize(x, lanes)
    row.update().reorder(x, funcs.inner.x).vectorize(x, lanes)
    if funcs.weights is not None:
        u = funcs.weights.args()[2]
        weights = funcs.weights.compute_at(sums, y).split(x, xv, xw, lanes).reorder(xw, u, xv, y).vectorize(xw)
        weights.bound_storage(u, LARGEST_RADIUS + 1).bound_storage(y, 1).hoist_storage(out, ys)
    for stage in funcs.stages:
        (stage.compute_at(sums, within) if funcs.weights is None else stage.compute_at(weights, xv)).vectorize(x, lanes)
        taps, single = (V, U) if funcs.key.taps is Taps.VERTICAL else (U, V)
        stage.bound_storage(taps, 2 * LARGEST_RADIUS + 1).bound_storage(single, 1)
        stage.bound_storage(x, lanes).bound_storage(y, 1)

    assert funcs.rows is not None
    fill_rows(funcs.image.compute_at(out, ys), funcs.key.channels, funcs.rows)
    fill_planes(funcs.planes, funcs.rows, (out, ys))


def _schedule_blocks(funcs: PassFuncs) -> None:
    """Give each pixel of the sums a thread. Keep planes and image in memory."""
    thread = spread_channels(funcs.out, funcs.key.channels)
    funcs.sums.compute_at(funcs.out, thread)
    funcs.row.compute_at(funcs.sums, funcs.outer.x)
    keep_planes(funcs.image, funcs.key.channels)
    keep_planes(funcs.planes.planes, funcs.planes.plane_count)
