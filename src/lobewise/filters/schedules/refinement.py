"""Schedules of the refining network, for processors and graphics cards."""

from __future__ import annotations

from lobewise.backend.compiler import hl
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.planes import PIXEL
from lobewise.filters.refinement.convolutions import Convolution, Input, Network
from lobewise.filters.refinement.pyramid import SUMS, Filter, Pyramid
from lobewise.filters.refinement.shape import GROUPS, VECTORS
from lobewise.filters.schedules.blocks import ALIGNMENT, keep_planes, spread_channels, spread_pixels

STRIP_ROWS = 8
"""Rows that a thread takes at a time."""
VECTORS_ACROSS, CHANNELS_TOGETHER = 3, 8
"""Vectors of columns and output channels whose sums a thread keeps in registers."""
SMALL_LEVEL = 3
"""From this level on images are so small that a thread takes one vector and one row."""


def schedule_refinement(network: Network, pyramid: Pyramid, out: hl.Func, target: hl.Target) -> None:
    """Schedule the kernel for a target; ``out`` is the result, a function of (c, x, y)."""
    if target.has_gpu_feature():
        _schedule_blocks(network, pyramid, out)
    else:
        _schedule_rows(network, pyramid, out, target.natural_vector_size(hl.Float(32)))


def _schedule_rows(network: Network, pyramid: Pyramid, out: hl.Func, lanes: int) -> None:
    """Run strips of rows in parallel. Keep the inputs of a strip in cache and a block of sums in registers."""
    x, y, c = PIXEL
    for each in network.convolutions:
        _keep_strips(each, lanes)
    ys, yi, xo, xi = (hl.Var(name) for name in ("ys", "yi", "xo", "xi"))
    for level, sums in enumerate(pyramid.sums):
        sums.compute_root().bound(c, 0, 2 * SUMS).reorder_storage(x, c, y)
        sums.split(y, ys, yi, STRIP_ROWS).split(x, xo, xi, lanes).reorder(c, xi, xo, yi, ys)
        sums.vectorize(xi).unroll(c).parallel(ys).never_partition_all()
        if level == 0:
            _keep_head(pyramid.sources, sums, xo, lanes)
            _keep_input(pyramid.light, sums, ys, lanes)
        else:
            vectors = pyramid.vectors[level].compute_root().bound(c, 0, VECTORS).reorder_storage(x, c, y)
            vectors.split(y, ys, yi, STRIP_ROWS).split(x, xo, xi, lanes).reorder(c, xi, xo, yi, ys)
            vectors.vectorize(xi).unroll(c).parallel(ys).never_partition_all()
            if level == 1:
                _keep_input(Input(pyramid.vectors[0], VECTORS), vectors, ys, lanes)
    for level, one in enumerate(pyramid.filters):
        _filter_strips(one, out if level == 0 else one.out, lanes)


def _keep_strips(each: Convolution, lanes: int) -> None:
    x, y, c = PIXEL
    small = each.level >= SMALL_LEVEL
    across = 1 if small else VECTORS_ACROSS
    ys, yi, xo, xi, co, ci = (hl.Var(name) for name in ("ys", "yi", "xo", "xi", "co", "ci"))
    out = each.out.compute_root().reorder_storage(x, c, y).bound(c, 0, each.channels)
    out.split(y, ys, yi, 2 if small else STRIP_ROWS).split(x, xo, xi, lanes * across)
    out.split(c, co, ci, CHANNELS_TOGETHER).reorder(xi, ci, co, xo, yi, ys)
    out.vectorize(xi, lanes).unroll(ci).parallel(ys).never_partition_all()
    if across > 1:
        out.unroll(xi)
    _keep_sums(each, out, co, lanes, across)
    for source in each.inputs:
        _keep_input(source, out, ys, lanes)


def _keep_sums(each: Convolution, out: hl.Func, loop: hl.Var, lanes: int, across: int = 1) -> None:
    """Keep a block of sums in registers."""
    x, y, c = PIXEL
    sums = each.sums.compute_at(out, loop).reorder_storage(x, c, y).reorder(x, c, y)
    for stage in (sums, *(sums.update(number) for number in range(len(each.domains)))):
        stage.vectorize(x, lanes).unroll(c)
        if across > 1:
            stage.unroll(x)
    for number, taps in enumerate(each.domains):
        update = sums.update(number).reorder(x, c, taps.x, taps.y, taps.z, y)
        if each.is_square:
            update.unroll(taps.x)


def _keep_input(source: Input, out: hl.Func, loop: hl.Var, lanes: int) -> None:
    x, y, c = PIXEL
    if source.is_copy:
        func = source.func.compute_at(out, loop).reorder_storage(x, c, y).reorder(x, c, y)
        func.bound(c, 0, source.channels).vectorize(x, lanes).never_partition_all()


def _keep_head(head: Convolution, out: hl.Func, loop: hl.Var, lanes: int) -> None:
    """Compute the logits of a vector of pixels."""
    x, y, c = PIXEL
    logits = head.out.compute_at(out, loop).reorder_storage(x, c, y)
    co, ci = hl.Var("co"), hl.Var("ci")
    logits.split(c, co, ci, CHANNELS_TOGETHER).reorder(x, ci, co, y)
    logits.vectorize(x, lanes).unroll(ci)
    _keep_sums(head, logits, co, lanes)


def _filter_strips(each: Filter, out: hl.Func, lanes: int) -> None:
    x, y, c = PIXEL
    ys, yi, xo, xi = (hl.Var(name) for name in ("ys", "yi", "xo", "xi"))
    tail = hl.TailStrategy.GuardWithIf
    if out is each.out:
        out.compute_root().reorder_storage(x, c, y)
        tail = hl.TailStrategy.Auto
    out.bound(c, 0, COLORS).split(y, ys, yi, STRIP_ROWS, tail).split(x, xo, xi, lanes, tail)
    out.reorder(c, xi, xo, yi, ys)
    out.vectorize(xi).unroll(c).parallel(ys).never_partition_all()
    _keep_head(each.head, out, xo, lanes)
    each.exponents.compute_at(out, xo).bound(c, 0, len(GROUPS)).reorder_storage(x, c, y).reorder(c, x, y)
    each.exponents.vectorize(x, lanes).unroll(c)
    each.total.compute_at(out, xo).vectorize(x, lanes)
    for number, taps in enumerate(each.domains):
        each.total.update(number).reorder(x, taps.x, taps.y, y).vectorize(x, lanes)
    for source in each.near:
        _keep_input(source, out, ys, lanes)


def _schedule_blocks(network: Network, pyramid: Pyramid, out: hl.Func) -> None:
    """Keep every result that neighbours read in memory, and the sums of a pixel in one thread's registers."""
    x, y, c = PIXEL
    for each in network.convolutions:
        co, ci = hl.Var("co"), hl.Var("ci")
        func = each.out.compute_root().reorder_storage(x, c, y).bound(c, 0, each.channels).align_bounds(x, ALIGNMENT)
        func.split(c, co, ci, CHANNELS_TOGETHER).reorder(ci, x, y, co).unroll(ci)
        each.sums.compute_at(func, spread_pixels(func, x, y)).unroll(c)
        func.gpu_blocks(co)
        for number, taps in enumerate(each.domains):
            each.sums.update(number).reorder(c, taps.x, taps.y, taps.z, x, y).unroll(c)
    for level, sums in enumerate(pyramid.sums):
        if level == 0:
            func = sums.compute_root().reorder_storage(x, c, y).align_bounds(x, ALIGNMENT)
            _keep_logits(pyramid.sources, func, spread_channels(func, 2 * SUMS, PIXEL))
        else:
            keep_planes(sums, 2 * SUMS, PIXEL)
            keep_planes(pyramid.vectors[level], VECTORS, PIXEL)
    for level, one in enumerate(pyramid.filters):
        func = out if level == 0 else one.out
        if level > 0:
            func.compute_root().reorder_storage(x, c, y).align_bounds(x, ALIGNMENT)
        thread = spread_channels(func, COLORS, PIXEL)
        _keep_logits(one.head, func, thread)
        one.exponents.compute_at(func, thread).bound(c, 0, len(GROUPS)).unroll(c)
        one.total.compute_at(func, thread)


def _keep_logits(head: Convolution, out: hl.Func, thread: hl.Var) -> None:
    """Compute the logits of a pixel in its thread."""
    x, y, c = PIXEL
    head.out.compute_at(out, thread).bound(c, 0, head.channels)
    head.sums.compute_at(out, thread)
    for number, taps in enumerate(head.domains):
        head.sums.update(number).reorder(c, taps.x, taps.y, taps.z, x, y)
