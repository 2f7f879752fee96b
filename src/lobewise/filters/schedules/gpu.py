"""How the passes between two grids are computed on graphics cards; see `lobewise.filters.schedules.blocks`."""

from __future__ import annotations

from lobewise.filters.accumulation import JoiningFuncs
from lobewise.filters.reprojection import ReprojectionFuncs
from lobewise.filters.schedules.blocks import keep_planes, spread_pixels


def schedule_joining_gpu(funcs: JoiningFuncs) -> None:
    """One thread for one pixel of the full grid; planes of the samples and of all pixels in memory."""
    variables = funcs.x, funcs.y, funcs.c
    thread = spread_pixels(funcs.out, funcs.x, funcs.y)
    for func, taps, weights in funcs.weights:
        func.compute_at(funcs.out, thread)
        weights.compute_at(func, taps.x)
    for func in funcs.once:
        func.compute_at(funcs.out, thread)
    keep_planes(funcs.tap_planes, funcs.wide_count, variables)
    keep_planes(funcs.own_planes, funcs.own_plane_count, variables)


def schedule_reprojection_gpu(funcs: ReprojectionFuncs) -> None:
    """One thread for one pixel, which gathers the four pixels of each place."""
    thread = spread_pixels(funcs.out, funcs.x, funcs.y)
    funcs.sums.compute_at(funcs.out, thread).bound(funcs.ways, 0, funcs.way_count)
    funcs.spots.compute_at(funcs.out, thread)
    for stage in (*funcs.stages, funcs.near):
        stage.compute_at(funcs.sums, funcs.taps.x)
    if funcs.planes is not None:
        funcs.planes.compute_at(funcs.out, thread).bound(funcs.c, 0, funcs.plane_count).unroll(funcs.c)
