"""How the passes are computed on graphics cards; the algorithms are in the modules of the passes.

One rule for all: what taps read of a pixel is computed once into memory, channel by channel, so that neighbouring
threads read neighbouring numbers; one thread then gathers everything of one pixel in registers. The same schedules
serve Vulkan, CUDA, Metal, Direct3D 12 and WebGPU.
"""

from __future__ import annotations

from collections.abc import Sequence

import halide as hl

from lobewise.filters.accumulation import JoiningFuncs
from lobewise.filters.cross_pass import PassFuncs
from lobewise.filters.dual_buffer import COLORS, GUIDE_CHANNELS, PairedFuncs
from lobewise.filters.reprojection import ReprojectionFuncs

COLUMNS, ROWS = 16, 8
"""Threads of a block: as wide as half a warp, so that the rows that taps share are read by the same block."""
ALIGNMENT = 64
"""Columns that intermediate images have a multiple of, and so of 256 bytes; see `lobewise.backend.devices`."""


def spread_pixels(func: hl.Func, x: hl.Var, y: hl.Var) -> hl.Var:
    """Give every pixel of a function a thread; return the variable at which it computes."""
    column, row, xi, yi = (hl.Var(name) for name in ("block_x", "block_y", "thread_x", "thread_y"))
    func.gpu_tile(x, y, column, row, xi, yi, COLUMNS, ROWS, hl.TailStrategy.GuardWithIf).never_partition_all()
    return xi


def spread_channels(func: hl.Func, channels: int, variables: Sequence[hl.Var]) -> hl.Var:
    """Give every pixel of a function a thread, which computes all its channels."""
    x, y, c = variables
    func.bound(c, 0, channels).reorder(c, x, y).unroll(c)
    return spread_pixels(func, x, y)


def keep_planes(func: hl.Func | None, channels: int, variables: tuple[hl.Var, hl.Var, hl.Var]) -> None:
    """Compute a function of pixels into memory, plane by plane in a row."""
    if func is not None:
        x, _, c = variables
        func.compute_root().reorder_storage(x, c, variables[1]).align_bounds(x, ALIGNMENT)
        spread_channels(func, channels, variables)


def schedule_gpu(funcs: PassFuncs) -> None:
    """One thread for one pixel of the sums; planes and image in memory."""
    variables = funcs.x, funcs.y, funcs.c
    thread = spread_channels(funcs.out, funcs.channels, variables)
    funcs.sums.compute_at(funcs.out, thread)
    funcs.row.compute_at(funcs.sums, funcs.outer.x)
    keep_planes(funcs.image, funcs.channels, variables)
    keep_planes(funcs.side.planes, funcs.side.plane_count, variables)


def schedule_paired_gpu(funcs: PairedFuncs) -> None:
    """One thread for one pixel: both halves and all variants of it."""
    variables = funcs.x, funcs.y, funcs.c
    for buffer in funcs.out.output_buffers():
        buffer.dim(1).set_stride(COLORS)
    thread = spread_channels(funcs.out, COLORS, variables)
    funcs.sums.compute_at(funcs.out, thread)
    funcs.row.compute_at(funcs.sums, funcs.down.x)
    for stage in funcs.stages:
        stage.compute_at(funcs.row, funcs.across.x)
    keep_planes(funcs.images, funcs.image_count, variables)
    keep_planes(funcs.guide, GUIDE_CHANNELS, variables)
    for side in funcs.sides:
        keep_planes(side.planes, side.plane_count, variables)


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
