"""Schedules of the kernel that mixes candidates, for processors and graphics cards."""

from __future__ import annotations

from collections.abc import Sequence

import halide as hl

from lobewise.filters.cross_pass import COLORS
from lobewise.filters.mixing_pass import MixingFuncs, Stage
from lobewise.filters.planes import PIXEL
from lobewise.filters.schedules.blocks import keep_planes, spread_channels

STRIP_ROWS = 16
"""Rows that a thread takes at a time: fewer than in other kernels, because a strip has many planes in cache."""


def schedule_mixing(funcs: MixingFuncs, target: hl.Target) -> None:
    """Schedule the kernel for a target."""
    if target.has_gpu_feature():
        _schedule_blocks(funcs)
    else:
        _schedule_rows(funcs, target.natural_vector_size(hl.Float(32)))


def _schedule_blocks(funcs: MixingFuncs) -> None:
    """Keep planes that several pixels read in memory, and the network of a pixel in one thread's registers."""
    key, c = funcs.key, PIXEL[2]
    thread = spread_channels(funcs.out, key.channels, PIXEL)
    for copied in funcs.copies:
        keep_planes(copied, 2 * COLORS, PIXEL)
    for func in (funcs.light, funcs.spread):
        keep_planes(func, key.candidates, PIXEL)
    for func in (funcs.sharp, *(each for blur in funcs.blurs for each in blur)):
        keep_planes(func, key.squares, PIXEL)
    keep_planes(funcs.features, key.features, PIXEL)
    for stage in funcs.network[1:]:
        stage.func.compute_at(funcs.out, thread).bound(c, 0, stage.channels)


def _schedule_rows(funcs: MixingFuncs, lanes: int) -> None:
    """Run strips of rows in parallel, columns in vectors. Keep a strip's averages and a vector's network in cache."""
    (x, y, c), key, out = PIXEL, funcs.key, funcs.out
    ys, yi, xo, xi, tail = hl.Var("ys"), hl.Var("yi"), hl.Var("xo"), hl.Var("xi"), hl.TailStrategy.GuardWithIf
    out.bound(c, 0, key.channels).reorder(c, x, y).unroll(c).split(y, ys, yi, STRIP_ROWS, tail)
    out.split(x, xo, xi, lanes, tail).reorder(c, xi, xo, yi, ys).vectorize(xi).parallel(ys).never_partition_all()
    for func in (funcs.light, funcs.spread):
        func.compute_at(out, ys).bound(c, 0, key.candidates).reorder_storage(x, c, y).reorder(c, x, y)
        func.vectorize(x, lanes).unroll(c).never_partition_all()
    for blur in funcs.blurs:
        blur.rows.compute_at(out, ys).reorder_storage(x, c, y).reorder(x, c, y).vectorize(x, lanes)
        # The next average reads this one some rows away, so keep a whole strip of it.
        blur.soft.compute_at(out, yi if blur is funcs.blurs[-1] else ys)
        blur.soft.reorder_storage(x, c, y).reorder(x, c, y).vectorize(x, lanes)
    funcs.sharp.compute_at(funcs.blurs[0].rows, y).bound(c, 0, key.squares).reorder_storage(x, c, y).reorder(c, x, y)
    funcs.sharp.vectorize(x, lanes).unroll(c)
    funcs.features.compute_at(out, xo).bound(c, 0, key.features).reorder_storage(x, c, y).reorder(c, x, y)
    funcs.features.vectorize(x, lanes).unroll(c)
    schedule_network(funcs.network, out, xo, lanes)


def schedule_network(stages: Sequence[Stage], out: hl.Func, column: hl.Var, lanes: int) -> None:
    """Compute the stages of a network for one vector of pixels at a time, in the loop ``column`` of ``out``."""
    x, y, c = PIXEL
    for stage in stages:
        func = stage.func.compute_at(out, column).bound(c, 0, stage.channels)
        func.reorder_storage(x, c, y).reorder(x, c, y).vectorize(x, lanes)
        if stage.inputs is not None:
            func.update().reorder(x, stage.inputs.x, c, y).vectorize(x, lanes)
