"""Schedules of the passes of an accumulation, for processors and graphics cards."""

from __future__ import annotations

from lobewise.backend.compiler import hl
from lobewise.filters.history.accumulation_stages import AccumulationFuncs
from lobewise.filters.history.accumulation_taps import TapGrid
from lobewise.filters.history.vectors import LANE, VECTOR
from lobewise.filters.planes import C, X, Y
from lobewise.filters.scheduling import STRIP_ROWS, keep_planes, keep_rows, spread_pixels

TILE_ROWS, TILE_COLUMNS = 8, 256
"""Size of the tiles whose samples are repeated over the width of their blocks together, pixels."""


def schedule_accumulation(funcs: AccumulationFuncs) -> None:
    """Schedule a pass for processors, or for graphics cards if its pixels are not in vectors."""
    if funcs.domain is None:
        _schedule_gpu(funcs)
    else:
        _schedule_cpu(funcs, funcs.domain)


def _schedule_gpu(funcs: AccumulationFuncs) -> None:
    """Give each pixel of the full grid a thread. Keep planes of samples and of all pixels in memory."""
    thread = spread_pixels(funcs.out, X, Y)
    for each in funcs.sums:
        each.func.compute_at(funcs.out, thread)
        each.weights.compute_at(each.func, each.taps.x)
    for func in funcs.pixels.once:
        func.compute_at(funcs.out, thread)
    if funcs.grid is not None:
        keep_planes(funcs.grid.values, funcs.grid.value_count)
        keep_planes(funcs.grid.own.planes, funcs.grid.own.plane_count)


def _schedule_cpu(funcs: AccumulationFuncs, domain: hl.RDom) -> None:
    """Run tiles of rows in parallel and columns in vectors. Keep the log-weights of a vector's taps in cache.

    A row of samples is repeated over the width of its blocks once per tile, so that the taps of a vector of pixels are
    plain loads at any scale. The logarithms serve both trust and samples. Values that only one pixel reads are computed
    where it reads them. The last vector of a row ends with the row, so a row has at least one vector of pixels.
    """
    out, lanes, tail = funcs.out, funcs.pixels.lanes, hl.TailStrategy.GuardWithIf
    vector, tile = hl.RVar("vector_in_tile"), hl.RVar("tile")
    yi, yo, yt, ys = (hl.Var(name) for name in ("yi", "yo", "yt", "ys"))
    # No two vectors of a row differ where they overlap.
    update = out.update().allow_race_conditions()
    update.split(domain.y, tile, vector, TILE_COLUMNS // lanes, tail)
    update.split(Y, ys, yt, STRIP_ROWS, tail).split(yt, yo, yi, TILE_ROWS, tail)
    update.reorder(domain.x, yi, vector, yo, tile, ys).vectorize(domain.x).parallel(ys).never_partition_all()
    for func, lane in funcs.pixels.judged:
        func.compute_at(out, yi).update().atomic().vectorize(lane.x)
    for func in funcs.pixels.once:
        func.compute_at(out, yi).bound(LANE, 0, lanes).vectorize(LANE)
    for each in funcs.sums:
        for func, taps in ((each.weights, each.weighed), (each.func, each.taps)):
            assert taps is not None
            func.compute_at(out, yi).bound(LANE, 0, lanes).vectorize(LANE)
            func.update().reorder(LANE, taps.x, taps.y, VECTOR, Y).vectorize(LANE)
        each.weights.hoist_storage(out, ys)
    if funcs.grid is not None:
        _schedule_taps(funcs, funcs.grid, (yi, tile, ys), lanes)


def _schedule_taps(funcs: AccumulationFuncs, grid: TapGrid, at: tuple[hl.Var, hl.RVar, hl.Var], lanes: int) -> None:
    """Schedule all functions that taps read; ``at`` are the loops over vectors, tiles and strips."""
    out, (vector, tile, strip) = funcs.out, at
    taps = grid.weighed
    assert taps is not None
    grid.log_weight.compute_at(out, vector).hoist_storage(out, strip).bound(LANE, 0, lanes).vectorize(LANE)
    grid.log_weight.update().reorder(LANE, taps.x, taps.y, VECTOR, Y).vectorize(LANE)
    if grid.factor is not None and grid.multiplied is not None:
        grid.factor.compute_at(out, vector).hoist_storage(out, strip).bound(LANE, 0, lanes).vectorize(LANE)
        grid.factor.update().reorder(LANE, grid.multiplied.x, grid.multiplied.y, VECTOR, Y).vectorize(LANE)
    for func, count in ((grid.own.planes, grid.own.plane_count), (grid.own.guides, grid.own.guide_count)):
        if func is not None:
            keep_rows(func.compute_at(out, vector), count, lanes)
    wide = grid.wide.compute_at(out, tile).reorder_storage(X, C, Y).align_storage(X, lanes)
    wide.reorder(X, C, Y).vectorize(X, lanes).never_partition_all()
    keep_rows(grid.values.compute_at(out, tile), grid.value_count, lanes)
    if grid.taps.guides is not None:
        keep_rows(grid.taps.guides.compute_at(grid.values, X), grid.taps.guide_count, lanes)
