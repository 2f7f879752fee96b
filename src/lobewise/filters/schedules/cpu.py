"""How the passes are computed, per device; the algorithms are in the modules of the passes.

Here the choice, and the processor's schedules; those of graphics cards are in `schedules_gpu`.
"""

from __future__ import annotations

import halide as hl

from lobewise.filters.accumulation import JoiningFuncs
from lobewise.filters.cross_pass import PassFuncs
from lobewise.filters.dual_buffer import COLORS, GUIDE_CHANNELS, PairedFuncs
from lobewise.filters.planes import Rows, Side
from lobewise.filters.reprojection import ReprojectionFuncs
from lobewise.filters.schedules.gpu import (
    schedule_gpu,
    schedule_joining_gpu,
    schedule_paired_gpu,
    schedule_reprojection_gpu,
)

STRIP_ROWS = 32
"""Rows of an image that a thread of the processor takes at a time."""


def count_lanes(target: hl.Target) -> int:
    """Return the pixels of a processor's vector; 0 for graphics cards, which have none."""
    return 0 if target.has_gpu_feature() else int(target.natural_vector_size(hl.Float(32)))


def schedule_pass(funcs: PassFuncs, target: hl.Target) -> None:
    """Schedule a pass of the cross filter for a target."""
    if target.has_gpu_feature():
        schedule_gpu(funcs)
    else:
        schedule_cpu(funcs, target)


def schedule_paired(funcs: PairedFuncs, target: hl.Target) -> None:
    """Schedule a pass over two halves of the samples for a target."""
    if target.has_gpu_feature():
        schedule_paired_gpu(funcs)
    else:
        schedule_paired_cpu(funcs, target)


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


def schedule_cpu(funcs: PassFuncs, target: hl.Target) -> None:
    """Rows in parallel, columns in vectors, the log-similarity of one row of taps at a time in cache.

    What it takes, and what was tried: docs/performance.md.

    What it rests on: every stage of the log-similarity has a loop of its own over a row of taps, whose results stay in
    the first-level cache, so that neither loop runs out of vector registers; planes of a strip lie row by row beside
    each other, padded to whole vectors, because planes a power of two apart would share cache sets; strips of rows
    are independent, so memory is bounded and threads change nothing; a column of taps goes down vector by vector, whose
    rows stay in the first-level cache; what a tile sums has a size known beforehand and lies on the stack, because
    asking for memory in a loop costs as much as a dozen taps.
    """
    x, y, c = funcs.x, funcs.y, funcs.c
    lanes = target.natural_vector_size(hl.Float(32))
    out, row, tail = funcs.out, funcs.row, hl.TailStrategy.GuardWithIf
    xo, yo, xi, yi, ys, yt, xv, xw = (hl.Var(name) for name in ("xo", "yo", "xi", "yi", "ys", "yt", "xv", "xw"))
    rows, columns = 8, 8 * lanes
    written = funcs.channels if funcs.rest is None else COLORS
    out.bound(c, 0, written).reorder(c, x, y).unroll(c)
    for func in (out, funcs.rest):
        if func is not None:
            func.split(y, ys, yt, STRIP_ROWS, tail).tile(x, yt, xo, yo, xi, yi, columns, rows, tail)
            func.split(xi, xv, xw, lanes, tail).reorder(xw, xv, yi, xo, yo, ys)
            func.vectorize(xw).parallel(ys).never_partition([xw, yi, xo, yo, ys])
    out.reorder(c, xw)
    if funcs.last:
        # A known stride makes whole stores of interleaved vectors.
        out.output_buffer().dim(1).set_stride(written)
    if funcs.rest is not None:
        assert funcs.finish is not None
        # They are as large as each other; where the compiler does not know that, it writes every loop three times.
        whole, beside = out.output_buffer(), funcs.rest.output_buffers()[0]
        for axis in (0, 1):
            beside.dim(axis).set_bounds(whole.dim(axis + 1).min(), whole.dim(axis + 1).extent())
        funcs.rest.compute_with(out, xv)
        funcs.finish.compute_at(out, xv).vectorize(x, lanes).bound_storage(x, lanes).bound_storage(y, 1)
    sums = funcs.sums.compute_at(out, xo).vectorize(x, lanes).bound_storage(x, columns).bound_storage(y, rows)
    across, within = ([xw, y, xv], y) if funcs.vertical else ([xw, xv, y], xv)
    sums.update().split(x, xv, xw, lanes).reorder(*across, funcs.outer.x).vectorize(xw)
    row.compute_at(sums, within).vectorize(x, lanes)
    row.update().reorder(x, funcs.inner.x).vectorize(x, lanes)
    if funcs.weights is not None:
        u = funcs.weights.args()[2]
        weights = funcs.weights.compute_at(sums, y).split(x, xv, xw, lanes).reorder(xw, u, xv, y).vectorize(xw)
    for stage in funcs.stages:
        (stage.compute_at(sums, within) if funcs.weights is None else stage.compute_at(weights, xv)).vectorize(x, lanes)

    assert funcs.rows is not None
    fill_rows(funcs.image.compute_at(out, ys), funcs.channels, (x, y, c), funcs.rows)
    if funcs.side.planes is not None:
        fill_planes(funcs.side.planes.compute_at(out, ys), funcs.side, (x, y, c), funcs.rows)


def fill_planes(planes: hl.Func, side: Side, variables: tuple[hl.Var, hl.Var, hl.Var], rows: Rows) -> None:
    """Let planes lie row by row beside each other.

    Channels of a pixel lie together in memory; a vector of them is taken apart once, and not once per plane.
    """
    x, y, c = variables
    fill_rows(planes, side.plane_count, variables, rows)
    for guides, part in zip(side.row_guides, rows.parts, strict=False):
        vector = part.dimensions() == 2
        guides.compute_at(planes, part.y if vector else part.x)
        guides.bound(c, 0, side.guide_count).reorder_storage(x, c, y).reorder(c, x, y).unroll(c)
        guides.bound_storage(x, rows.lanes if vector else 1).bound_storage(y, 1)
        if vector:
            guides.vectorize(x, rows.lanes)


def fill_rows(func: hl.Func, channels: int, variables: tuple[hl.Var, hl.Var, hl.Var], rows: Rows) -> None:
    """Let the channels of a function lie row by row beside each other, from whole vectors where there are."""
    x, y, c = variables
    func.bound(c, 0, channels).reorder_storage(x, c, y).align_storage(x, rows.lanes).align_bounds(x, rows.lanes)
    for number, domain in enumerate((*rows.margins, *rows.parts)):
        update = func.update(number).unroll(c)
        if number < len(rows.margins):
            vectors, lane = hl.RVar("vectors"), hl.RVar("lane")
            update.split(domain.x, vectors, lane, rows.lanes).reorder(c, lane, vectors, y).vectorize(lane)
        elif domain.dimensions() == 2:
            # No two lanes are one column.
            update.reorder(c, domain.x, domain.y, y).allow_race_conditions().vectorize(domain.x)
        else:
            update.reorder(c, domain.x, y)


def _keep_rows(func: hl.Func, channels: int, variables: tuple[hl.Var, hl.Var, hl.Var], lanes: int) -> None:
    """Let the channels of a function lie row by row beside each other, computed vector by vector.

    One loop for all channels: a loop for each would take the compiler several times as long.
    """
    x, y, c = variables
    func.bound(c, 0, channels).reorder_storage(x, c, y).align_storage(x, lanes).reorder(c, x, y)
    func.vectorize(x, lanes).unroll(c).never_partition([y])


def schedule_paired_cpu(funcs: PairedFuncs, target: hl.Target) -> None:
    """Strips of rows in parallel, columns in vectors, one row of taps at a time.

    What it rests on: the sums of a row of taps stay in registers, and those of a tile are updated once for each row;
    logarithms of all weights of a row of taps, which all variants share, lie in the first-level cache.
    """
    x, y, c = funcs.x, funcs.y, funcs.c
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
        stage.compute_at(sums, xv).vectorize(x, lanes)
    assert funcs.rows is not None
    fill_rows(funcs.images.compute_at(out, ys), funcs.image_count, (x, y, c), funcs.rows)
    if funcs.guide is not None:
        fill_rows(funcs.guide.compute_at(out, ys), GUIDE_CHANNELS, (x, y, c), funcs.rows)
    for side in funcs.sides:
        if side.planes is not None:
            fill_planes(side.planes.compute_at(out, ys), side, (x, y, c), funcs.rows)


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
        _keep_rows(funcs.own_planes.compute_at(out, yi), funcs.own_plane_count, (x, y, c), lanes)
    if funcs.own_guides is not None:
        _keep_rows(funcs.own_guides.compute_at(out, yi), funcs.tap_guide_count, (x, y, c), lanes)
    wide = funcs.wide.compute_at(out, xt).reorder_storage(x, c, y).align_storage(x, lanes)
    wide.reorder(x, c, y).vectorize(x, lanes).never_partition_all()
    _keep_rows(funcs.tap_planes.compute_at(out, xt), funcs.wide_count, (x, y, c), lanes)
    if funcs.tap_guides is not None:
        _keep_rows(funcs.tap_guides.compute_at(funcs.tap_planes, x), funcs.tap_guide_count, (x, y, c), lanes)


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
            _keep_rows(func.compute_at(out, xo), channels, (x, y, c), lanes)
