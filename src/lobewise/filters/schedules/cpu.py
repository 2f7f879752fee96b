"""How the passes are computed, per device; the algorithms are in the modules of the passes.

Here the choice, and the processor's schedules; those of graphics cards are in `gpu`.
"""

from __future__ import annotations

import halide as hl

from lobewise.filters.accumulation import JoiningFuncs
from lobewise.filters.reprojection import ReprojectionFuncs
from lobewise.filters.schedules.gpu import schedule_joining_gpu, schedule_reprojection_gpu
from lobewise.filters.schedules.rows import STRIP_ROWS, keep_rows


def schedule_joining(funcs: JoiningFuncs, target: hl.Target) -> None:
    """Schedule the pass that brings samples to every pixel for a target."""
    if target.has_gpu_feature():
        schedule_joining_gpu(funcs)
    else:
        schedule_joining_cpu(funcs, target)


def schedule_reprojection(funcs: ReprojectionFuncs, target: hl.Target) -> None:
    """Schedule the pass that gathers histories for a target."""
    if target.has_gpu_feature():
        schedule_reprojection_gpu(funcs)
    else:
        schedule_reprojection_cpu(funcs, target)


def schedule_joining_cpu(funcs: JoiningFuncs, target: hl.Target) -> None:
    """Tiles of rows in parallel, columns in vectors, the logarithms of all of a vector's weights at a time in cache.

    Measured (EPYC with AVX-512), 512x512 from 128x128, processor time of both threads, with history: diffuse 15 ms for
    radius 2 and 39 ms for radius 5, ``ggx`` 20 ms and 54 ms. A kernel compiles in 0.8 s.

    What it rests on: a row of samples is spread out over its blocks' width once per tile, so that the taps of a vector
    of pixels are plain loads at any scale; the logarithms serve trust and samples; what only one pixel reads is
    computed there. The last vector of a row begins where it must to end with the row, so a row has a vector at least.
    """
    x, y, c = funcs.x, funcs.y, funcs.c
    lanes = target.natural_vector_size(hl.Float(32))
    out, tail = funcs.out, hl.TailStrategy.GuardWithIf
    xi, xv, xw, xt = (hl.Var(name) for name in ("xi", "xv", "xw", "xt"))
    yi, yo, yt, ys = (hl.Var(name) for name in ("yi", "yo", "yt", "ys"))
    rows, vectors = 8, 256 // lanes
    out.split(x, xv, xi, lanes, hl.TailStrategy.ShiftInwards).split(xv, xt, xw, vectors, tail)
    out.split(y, ys, yt, STRIP_ROWS, tail).split(yt, yo, yi, rows, tail)
    out.reorder(xi, yi, xw, yo, xt, ys).vectorize(xi).parallel(ys).never_partition_all()

    for func, taps, weights in funcs.weights:
        func.compute_at(out, yi).vectorize(x, lanes)
        func.update().reorder(x, taps.x, taps.y).vectorize(x, lanes)
        weights.compute_at(func, taps.x).vectorize(x, lanes)
    for func in funcs.once:
        func.compute_at(out, yi).vectorize(x, lanes)
    u, v = funcs.log_weight.args()[2:]
    funcs.log_weight.compute_at(out, yi).hoist_storage(out, ys).reorder(x, u, v).vectorize(x, lanes)
    for stage in funcs.stages:
        stage.compute_at(funcs.log_weight, v).hoist_storage(out, ys).vectorize(x, lanes)
    if funcs.own_planes is not None:
        keep_rows(funcs.own_planes.compute_at(out, yi), funcs.own_plane_count, lanes)
    if funcs.own_guides is not None:
        keep_rows(funcs.own_guides.compute_at(out, yi), funcs.tap_guide_count, lanes)
    wide = funcs.wide.compute_at(out, xt).reorder_storage(x, c, y).align_storage(x, lanes)
    wide.reorder(x, c, y).vectorize(x, lanes).never_partition_all()
    keep_rows(funcs.tap_planes.compute_at(out, xt), funcs.wide_count, lanes)
    if funcs.tap_guides is not None:
        keep_rows(funcs.tap_guides.compute_at(funcs.tap_planes, x), funcs.tap_guide_count, lanes)


def schedule_reprojection_cpu(funcs: ReprojectionFuncs, target: hl.Target) -> None:
    """Rows in parallel, columns in vectors; the four taps gather, so their planes are computed where they are read.

    Measured (EPYC with AVX-512), 512x512, processor time of both threads: 12 ms for plane and normal at one place,
    39 ms for plane, ``ggx`` and hit distance at two; most of it is reading. The channels of a pixel are copied at once,
    pixel by pixel and before anything is computed of them: vectors that read lane by lane take a fifth more.

    The last vector of a row begins where it must to end with the row, so a row has a vector at least.
    """
    x, y, c = funcs.x, funcs.y, funcs.c
    lanes = target.natural_vector_size(hl.Float(32))
    out, sums, ways = funcs.out, funcs.sums, funcs.ways
    xi, xo = hl.Var("xi"), hl.Var("xo")
    out.split(x, xo, xi, lanes, hl.TailStrategy.ShiftInwards).reorder(xi, xo, y).vectorize(xi)
    out.parallel(y, 8, hl.TailStrategy.GuardWithIf).never_partition_all()
    sums.compute_at(out, xo).bound(ways, 0, funcs.way_count).vectorize(x, lanes)
    sums.update().reorder(x, funcs.taps.x, funcs.taps.y, ways).vectorize(x, lanes)
    for func in (funcs.spots, funcs.near):
        func.compute_at(out, xo).vectorize(x, lanes)
    for stage in funcs.stages:
        stage.compute_at(sums, funcs.taps.x).vectorize(x, lanes)
    if funcs.surface_stages:
        last = funcs.surface_stages[-1].compute_at(out, xo).vectorize(x, lanes)
        for stage in funcs.surface_stages[:-1]:
            stage.compute_at(last, last.args()[2]).vectorize(x, lanes)
    for gathered in funcs.gathered:
        func = gathered.func.bound(c, 0, gathered.channels).vectorize(c).unroll(x, 4)
        if gathered.shared:
            func.compute_at(out, xo)
        else:
            func.compute_at(sums, ways)
    for func, channels in ((funcs.guides, funcs.guide_count), (funcs.planes, funcs.plane_count)):
        if func is not None:
            keep_rows(func.compute_at(out, xo), channels, lanes)
