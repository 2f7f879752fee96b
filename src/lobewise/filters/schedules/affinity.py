"""Schedule of kernels that sum over the neighbours of the affinity filter, for processors and graphics cards."""

from __future__ import annotations

from typing import NamedTuple

import halide as hl

from lobewise.filters.planes import PIXEL
from lobewise.filters.schedules.blocks import keep_planes, spread_channels

STRIP_ROWS = 16
"""Rows that a thread of the processor takes at a time: few, because the crops that train the network have 128 rows."""


class AffinityFuncs(NamedTuple):
    """The functions of a kernel that sums over the neighbours of a pixel."""

    pixels: hl.Func
    """All values of a pixel; 0 left and right of the image, where vectors and taps reach."""
    pixel_channels: int
    sums: hl.Func
    window: hl.RDom
    out: hl.Func
    out_channels: int


def schedule_affinity(funcs: AffinityFuncs, target: hl.Target) -> None:
    """Let each vector of pixels, or thread of a card, compute all its sums. Keep the values of pixels in memory."""
    (x, y, c), (out, sums) = PIXEL, (funcs.out, funcs.sums)
    if target.has_gpu_feature():
        thread = spread_channels(out, funcs.out_channels, PIXEL)
        sums.compute_at(out, thread)
        keep_planes(funcs.pixels, funcs.pixel_channels, PIXEL)
        return
    lanes, tail = target.natural_vector_size(hl.Float(32)), hl.TailStrategy.GuardWithIf
    strip, row, xo, xi = (hl.Var(name) for name in ("strip", "row", "xo", "xi"))
    out.bound(c, 0, funcs.out_channels).split(x, xo, xi, lanes, tail).split(y, strip, row, STRIP_ROWS, tail)
    out.reorder(c, xi, xo, row, strip).unroll(c).vectorize(xi).parallel(strip).never_partition_all()
    # Compute whole vectors of sums, also where a row ends inside a vector: both stages then cover the same pixels.
    sums.compute_at(out, xo).align_bounds(x, lanes).vectorize(x, lanes).bound_storage(x, lanes).bound_storage(y, 1)
    sums.update().reorder(x, funcs.window.x, funcs.window.y).vectorize(x, lanes)
    pixels = funcs.pixels.compute_root().bound(c, 0, funcs.pixel_channels).reorder_storage(x, c, y)
    pixels.align_bounds(x, lanes).reorder(x, c, y).unroll(c).vectorize(x, lanes).parallel(y)
