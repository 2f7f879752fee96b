"""What schedules of graphics cards have in common: a thread for every pixel, planes in memory.

One rule for all: what taps read of a pixel is computed once into memory, channel by channel, so that neighbouring
threads read neighbouring numbers; one thread then gathers everything of one pixel in registers. The same schedules
serve Vulkan, CUDA, Metal, Direct3D 12 and WebGPU.
"""

from __future__ import annotations

from collections.abc import Sequence

import halide as hl

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
