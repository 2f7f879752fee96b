"""Common parts of schedules for graphics cards: a thread for each pixel, planes in memory.

All kernels follow one rule. The values of pixels that taps read are computed once into memory, channel by channel, so
that neighbouring threads read neighbouring numbers. One thread then gathers all sums of one pixel in registers. The
same schedules serve Vulkan, CUDA, Metal, Direct3D 12 and WebGPU.
"""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.backend.compiler import hl

COLUMNS, ROWS = 16, 8
"""Threads of a block, across and down: pixels of a block share most taps, so the block reads them from its cache."""
ALIGNMENT = 64
"""Intermediate images have a multiple of so many columns, and so of 256 bytes; see `lobewise.backend.devices`."""


def spread_pixels(func: hl.Func, x: hl.Var, y: hl.Var) -> hl.Var:
    """Give each pixel of a function a thread; return the variable of the loop inside a thread."""
    column, row, xi, yi = (hl.Var(name) for name in ("block_x", "block_y", "thread_x", "thread_y"))
    func.gpu_tile(x, y, column, row, xi, yi, COLUMNS, ROWS, hl.TailStrategy.GuardWithIf).never_partition_all()
    return xi


def spread_channels(func: hl.Func, channels: int, variables: Sequence[hl.Var]) -> hl.Var:
    """Give each pixel of a function a thread, which computes all channels."""
    x, y, c = variables
    func.bound(c, 0, channels).reorder(c, x, y).unroll(c)
    return spread_pixels(func, x, y)


def keep_planes(func: hl.Func | None, channels: int, variables: tuple[hl.Var, hl.Var, hl.Var]) -> None:
    """Compute a function of pixels into memory; each row holds its planes one after the other."""
    if func is not None:
        x, _, c = variables
        func.compute_root().reorder_storage(x, c, variables[1]).align_bounds(x, ALIGNMENT)
        spread_channels(func, channels, variables)
