"""How the passes are computed, per device; the algorithms are in `cross_filter`."""

from __future__ import annotations

import halide as hl

from lobewise.kernels.cross_filter import PassFuncs
from lobewise.kernels.history import HISTORY_CHANNELS, ReprojectionFuncs


def schedule_cpu(funcs: PassFuncs, target: hl.Target) -> None:
    """Rows in parallel, columns in vectors, the log-similarity of one row of taps at a time in cache.

    Measured (benchmarks/results/filters.json: EPYC with AVX-512, 2 threads), full form, radius 8, 512x512: ``normal``
    31.3 ms, ``sg`` 38.8 ms, ``ggx`` 67.9 ms, that is 0.41, 0.51 and 0.90 ns per tap and pixel; separable, radius 8,
    1920x1080: 94 ms for ``sg``.

    What it rests on: every stage of the log-similarity has a loop of its own over a row of taps, whose results stay in
    the first-level cache, so that neither loop runs out of vector registers; planes of a strip lie row by row beside
    each other, padded to whole vectors, because planes a power of two apart would share cache sets; strips of 32 rows
    are independent, so memory is bounded and threads change nothing.
    """
    x, y, c = funcs.x, funcs.y, funcs.c
    lanes = target.natural_vector_size(hl.Float(32))
    rows = 8
    xo, yo, xi, yi = hl.Var("xo"), hl.Var("yo"), hl.Var("xi"), hl.Var("yi")
    out, tail = funcs.out, hl.TailStrategy.GuardWithIf
    out.bound(c, 0, funcs.channels).reorder(c, x, y).unroll(c)
    strip = 32
    ys, yt = hl.Var("ys"), hl.Var("yt")
    out.split(y, ys, yt, strip, tail).tile(x, yt, xo, yo, xi, yi, lanes, rows, tail)
    out.reorder(c, xi, yi, xo, yo, ys).vectorize(xi).parallel(ys).never_partition_all()

    sums = funcs.sums
    sums.compute_at(out, yi).vectorize(x, lanes)
    update = sums.update()
    update.reorder(x, funcs.taps.x, funcs.taps.y).vectorize(x, lanes)
    for stage in funcs.stages:
        stage.compute_at(sums, funcs.taps.y).vectorize(x, lanes)

    sides = ((funcs.guides, funcs.planes), (funcs.centre_guides, funcs.centre_planes))
    counts = ((funcs.image, funcs.channels), *((planes, funcs.plane_count) for _, planes in sides))
    for func, channels in counts:
        if func is None:
            continue
        func.bound(c, 0, channels)
        func.compute_at(out, ys).reorder_storage(x, c, y).align_storage(x, lanes).reorder(x, c, y)
        func.vectorize(x, lanes).unroll(c).never_partition_all()
    for guides, planes in sides:
        if guides is None:
            continue
        # Channels of a pixel lie together in memory; a row of them is taken apart once, and not once per plane.
        guides.compute_at(planes, y).reorder_storage(x, c, y).align_storage(x, lanes).reorder(x, c, y)
        guides.bound(c, 0, funcs.guide_count).vectorize(x, lanes).unroll(c).never_partition_all()


def schedule_reprojection_cpu(funcs: ReprojectionFuncs, target: hl.Target) -> None:
    """Rows in parallel, columns in vectors; the four taps gather, so their planes are computed where they are read."""
    x, y, c = funcs.x, funcs.y, funcs.c
    lanes = target.natural_vector_size(hl.Float(32))
    out, tail = funcs.out, hl.TailStrategy.GuardWithIf
    xi, xo = hl.Var("xi"), hl.Var("xo")
    out.bound(c, 0, HISTORY_CHANNELS + 1).reorder(c, x, y).unroll(c)
    out.split(x, xo, xi, lanes, tail).reorder(c, xi, xo, y).vectorize(xi).parallel(y, 4, tail).never_partition_all()
    funcs.sums.compute_at(out, xo).vectorize(x, lanes)
    funcs.sums.update().reorder(x, funcs.taps.x, funcs.taps.y).vectorize(x, lanes)
    for stage in funcs.stages:
        stage.compute_at(funcs.sums, funcs.taps.y).vectorize(x, lanes)
    if funcs.planes is not None:
        funcs.planes.bound(c, 0, funcs.plane_count).compute_at(out, xo).reorder_storage(x, c, y).reorder(x, c, y)
        funcs.planes.vectorize(x, lanes).unroll(c)
