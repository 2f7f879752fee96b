"""Common parts of schedules: strips of rows on processors, a thread for each pixel on graphics cards.

Kernels for graphics cards follow one rule. The values of pixels that taps read are computed once into memory, channel
by channel, so that neighbouring threads read neighbouring numbers. One thread then gathers all sums of one pixel in
registers. The same schedules serve Vulkan, CUDA, Metal, Direct3D 12 and WebGPU.
"""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.backend.compiler import declare_vars, hl
from lobewise.filters.planes import C, Columns, GuidePlanes, X, Y

STRIP_ROWS = 32
"""Rows that a thread of a processor takes at a time."""
STRIP, LINE = declare_vars("strip", "line")
"""The loops of `schedule_stencil` over strips, and over the rows of a strip."""
COLUMNS, ROWS = 16, 8
"""Threads of a block, across and down: pixels of a block share most taps, so the block reads them from its cache."""
ALIGNMENT = 64
"""Intermediate images have a multiple of so many columns, and so of 256 bytes; see `lobewise.backend.devices`."""


def count_lanes(target: hl.Target) -> int:
    """Return the number of pixels of a target's vector; 0 for graphics cards, which have no vectors."""
    return 0 if target.has_gpu_feature() else int(target.natural_vector_size(hl.Float(32)))


def schedule_stencil(
    out: hl.Func,
    channels: int,
    target: hl.Target,
    *,
    strips: Sequence[hl.Func] = (),
    lines: Sequence[hl.Func] = (),
    stored: Sequence[hl.Func] = (),
) -> None:
    """Compute all channels of a pixel from functions of its neighbours.

    On processors strips of rows run in parallel and columns in vectors. The functions ``strips`` of (x, y) are computed
    for a strip, the functions ``lines`` for a row of it, and stay in cache. On graphics cards each pixel has a thread,
    and the functions ``stored`` lie in memory. All others are computed where they are read.
    """
    if out.args()[0].name() == C.name():
        # A known stride makes whole stores of interleaved vectors.
        for buffer in out.output_buffers():
            buffer.dim(1).set_stride(channels)
    if target.has_gpu_feature():
        spread_channels(out, channels)
        for func in stored:
            spread_pixels(func.compute_root().align_bounds(X, ALIGNMENT), X, Y)
        return
    lanes, tail = count_lanes(target), hl.TailStrategy.GuardWithIf
    out.bound(C, 0, channels).split(Y, STRIP, LINE, STRIP_ROWS, tail).reorder(C, X, LINE, STRIP).unroll(C)
    out.vectorize(X, lanes, tail).parallel(STRIP).never_partition_all()
    for loop, funcs in ((STRIP, strips), (LINE, lines)):
        for func in funcs:
            # Loops of their own for the borders would double the time to compile.
            func.compute_at(out, loop).vectorize(X, lanes).never_partition_all()


def fill_planes(planes: GuidePlanes, rows: Columns, strips: tuple[hl.Func, hl.Var]) -> None:
    """Compute planes per strip, the planes of a row side by side; ``strips`` is the loop over strips.

    In the input the channels of a pixel lie together: a vector of pixels is deinterleaved once, not once per plane.
    """
    if planes.planes is None:
        return
    fill_rows(planes.planes.compute_at(*strips), planes.plane_count, rows)
    for guides, part in zip(planes.row_guides, rows.parts, strict=False):
        vector = part.dimensions() == 2
        guides.compute_at(planes.planes, part.y if vector else part.x)
        guides.bound(C, 0, planes.guide_count).reorder_storage(X, C, Y).reorder(C, X, Y).unroll(C)
        guides.bound_storage(X, rows.lanes if vector else 1).bound_storage(Y, 1)
        if vector:
            guides.vectorize(X, rows.lanes)


def fill_rows(func: hl.Func, channels: int, rows: Columns) -> None:
    """Compute a function of `Columns`, the channels of a row side by side, in whole vectors as far as possible."""
    func.bound(C, 0, channels).reorder_storage(X, C, Y).align_storage(X, rows.lanes).align_bounds(X, rows.lanes)
    for number, domain in enumerate((*rows.margins, *rows.parts)):
        update = func.update(number).unroll(C)
        if number < len(rows.margins):
            vectors, lane = hl.RVar("vectors"), hl.RVar("lane")
            update.split(domain.x, vectors, lane, rows.lanes).reorder(C, lane, vectors, Y).vectorize(lane)
        elif domain.dimensions() == 2:
            # No two lanes write the same column.
            update.reorder(C, domain.x, domain.y, Y).allow_race_conditions().vectorize(domain.x)
        else:
            update.reorder(C, domain.x, Y)


def keep_rows(func: hl.Func, channels: int, lanes: int) -> None:
    """Compute a function vector by vector, the channels of a row side by side.

    All channels share one loop: with a loop for each, compiling takes several times as long.
    """
    func.bound(C, 0, channels).reorder_storage(X, C, Y).align_storage(X, lanes).reorder(C, X, Y)
    func.vectorize(X, lanes).unroll(C).never_partition([Y])


def spread_pixels(func: hl.Func, x: hl.Var, y: hl.Var) -> hl.Var:
    """Give each pixel of a function a thread; return the variable of the loop inside a thread."""
    column, row, xi, yi = (hl.Var(name) for name in ("block_x", "block_y", "thread_x", "thread_y"))
    func.gpu_tile(x, y, column, row, xi, yi, COLUMNS, ROWS, hl.TailStrategy.GuardWithIf).never_partition_all()
    return xi


def spread_channels(func: hl.Func, channels: int) -> hl.Var:
    """Give each pixel of a function a thread, which computes all channels."""
    func.bound(C, 0, channels).reorder(C, X, Y).unroll(C)
    return spread_pixels(func, X, Y)


def keep_planes(func: hl.Func | None, channels: int) -> None:
    """Compute a function of pixels into memory; each row holds its planes one after the other."""
    if func is not None:
        func.compute_root().reorder_storage(X, C, Y).align_bounds(X, ALIGNMENT)
        spread_channels(func, channels)
