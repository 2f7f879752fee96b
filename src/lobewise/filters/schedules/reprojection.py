"""Schedules of a reprojection, for processors and graphics cards."""

from __future__ import annotations

from lobewise.backend.compiler import hl
from lobewise.filters.history.reprojection_pass import PreparationFuncs, ReprojectionFuncs, VectorFuncs, WayFuncs
from lobewise.filters.history.vectors import LANE, VECTOR
from lobewise.filters.planes import X, Y
from lobewise.filters.scheduling import keep_rows, spread_pixels

ROWS_PER_TASK = 8
"""Rows that a thread takes at a time."""


def schedule_preparation(funcs: PreparationFuncs, lanes: int) -> None:
    """Schedule the planes for processors: rows in parallel, columns in vectors."""
    out, own = funcs.out, funcs.own
    xi, xo = hl.Var("xi"), hl.Var("xo")
    out.split(X, xo, xi, lanes, hl.TailStrategy.ShiftInwards).reorder(xi, xo, Y).vectorize(xi)
    out.parallel(Y, ROWS_PER_TASK, hl.TailStrategy.GuardWithIf).never_partition_all()
    for func, channels in ((own.guides, own.guide_count), (own.planes, own.plane_count)):
        if func is not None:
            keep_rows(func.compute_at(out, xo), channels, lanes)


def schedule_reprojection(funcs: ReprojectionFuncs) -> None:
    """Schedule the kernel for processors, or for graphics cards if its pixels are not in vectors."""
    if funcs.domain is None:
        _schedule_gpu(funcs)
    else:
        _schedule_cpu(funcs, funcs.domain)


def _schedule_gpu(funcs: ReprojectionFuncs) -> None:
    """Give each pixel a thread, which gathers the four pixels of each place."""
    thread = spread_pixels(funcs.out, X, Y)
    for way in funcs.ways:
        way.sums.compute_at(funcs.out, thread)
        for func in (way.spots, *way.agrees):
            func.compute_at(funcs.out, thread)


def _schedule_cpu(funcs: ReprojectionFuncs, domain: hl.RDom) -> None:
    """Run rows in parallel and columns in vectors. Every value of a vector stays in registers or the nearest cache."""
    out, lanes = funcs.out, funcs.pixels.lanes
    # No two vectors of a row differ where they overlap.
    update = out.update().reorder(domain.x, domain.y, Y).allow_race_conditions().vectorize(domain.x)
    update.parallel(Y, ROWS_PER_TASK, hl.TailStrategy.GuardWithIf).never_partition_all()
    for way in funcs.ways:
        _schedule_way(out, domain.y, way, lanes)
    for func in funcs.pixels.once:
        func.compute_at(out, domain.y).bound(LANE, 0, lanes).vectorize(LANE)


def _schedule_way(out: hl.Func, vector: hl.RVar, way: WayFuncs, lanes: int) -> None:
    for func in (way.spots, way.sums):
        func.compute_at(out, vector).bound(LANE, 0, lanes).vectorize(LANE)
    if way.judged is not None:
        _schedule_runs(out, vector, way.judged, lanes)
    for number, (domain, agrees) in enumerate(zip(way.domains, way.agrees, strict=True)):
        agrees.compute_at(out, vector).bound(LANE, 0, lanes).vectorize(LANE).update().vectorize(LANE)
        way.sums.update(number).reorder(LANE, domain.x, VECTOR, Y).vectorize(LANE)


def _schedule_runs(out: hl.Func, vector: hl.RVar, judged: VectorFuncs, lanes: int) -> None:
    code, _, _, outside = judged.lanes
    for func, domain in ((judged.code, code), (judged.outside, outside)):
        func.compute_at(out, vector).update().atomic().vectorize(domain.x)
    for func in (judged.run, judged.starts):
        # Each pixel needs the one before it.
        func.compute_at(out, vector).bound(LANE, 0, lanes).vectorize(LANE).update().unscheduled()
    judged.way.compute_at(out, vector)
