"""The convolution of the refining network: one kernel for all its layers, as Halide functions of (x, c, y).

A layer reads one image, or the channels of two one after the other. The first image may belong to another level: it is
read as `Reading` says. Outside the image every input is 0.
"""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum
from functools import reduce
from typing import Any, NamedTuple

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature
from lobewise.filters.planes import C, X, Y, clamp_likely
from lobewise.filters.refinement.shape import BLOCK_OUTPUTS, WEIGHT_ROWS
from lobewise.filters.scheduling import ALIGNMENT, count_lanes, spread_pixels

CONVOLUTION_LEAK = 0.1
"""Slope of the activation below 0 (leaky ReLU)."""
MAX_SIDE = 3
"""Largest side of the square of taps, pixels."""
VECTORS_ACROSS = 3
"""Vectors of columns whose sums a thread of a processor keeps in registers."""


class Reading(IntEnum):
    """What a layer reads of its first image at a pixel."""

    SAME = 0
    """The pixel; the image has the layer's size."""
    ENLARGED = 1
    """The pixel of the level above that covers it."""
    HALVED = 2
    """The largest of four pixels of the level below."""
    BLOCKS = 3
    """Four pixels of the level below as channels: channel, then row, then column."""


class Size(NamedTuple):
    """Rows and columns of a level."""

    height: hl.Expr
    width: hl.Expr


def make_convolution(target: hl.Target) -> Scheduled:
    """Return the kernel.

    Its images may have more columns than the level. What stands there means nothing.
    """
    # Signature
    signature = Signature("convolution of the refining network")
    first = signature.image("first", "first_height", "first_channels", "first_columns")
    second = signature.image("second", "second_height", "second_channels", "second_columns")
    weights = signature.image("weights", WEIGHT_ROWS, BLOCK_OUTPUTS)
    start, side = signature.count("start", 0, WEIGHT_ROWS - 1), signature.count("side", 1, MAX_SIDE)
    reading = signature.count("reading", min(Reading), max(Reading))
    first_width, width, height = (signature.count(name, 1) for name in ("first_width", "width", "height"))
    taken = signature.count("channels_of_second")
    strip = signature.count("strip_rows", 1)
    signature.output("out", "height", "channels", "columns")

    # Algorithm
    size, own = Size(height, width), first.dim(1).extent()
    inputs = [
        (_read_first(first, reading, first_width, size), hl.select(reading == Reading.BLOCKS.value, 4 * own, own)),
        (surround(second, size, "second_near"), taken),
    ]
    sums, out, before = hl.Func("sums"), hl.Func("out"), hl.i32(0)
    row = start + C // BLOCK_OUTPUTS * (1 + side * side * (inputs[0][1] + inputs[1][1]))
    sums[X, C, Y] = weights[C % BLOCK_OUTPUTS, row]
    for number, (source, channels) in enumerate(inputs):
        taps = hl.RDom([(0, side), (0, side), (0, channels)], f"taps{number}")
        place = ((before + taps.z) * side + taps.y) * side + taps.x
        near = source[X + taps.x - side // 2, taps.z, Y + taps.y - side // 2]
        sums[X, C, Y] = sums[X, C, Y] + weights[C % BLOCK_OUTPUTS, row + 1 + place] * near
        before = channels
    out[X, C, Y] = hl.max(sums[X, C, Y], hl.f32(CONVOLUTION_LEAK) * sums[X, C, Y])

    # Schedule
    chosen = [reading == each.value for each in Reading if each is not Reading.BLOCKS]
    if target.has_gpu_feature():
        _spread(out, sums, chosen)
    else:
        _vectorize(out, sums, inputs, strip, target)
        for case in chosen:
            inputs[0][0].specialize(case)
    return Scheduled([out], signature)


def _vectorize(
    out: hl.Func, sums: hl.Func, inputs: Sequence[tuple[hl.Func, hl.Expr]], strip: hl.Expr, target: hl.Target
) -> None:
    """Run strips of rows in parallel. Keep the sums of some vectors and channels in a thread's registers."""
    lanes, whole = count_lanes(target), hl.TailStrategy.RoundUp
    # There are 16 or 32 registers.
    together = 8 if target.arch == hl.TargetArch.ARM or lanes > 8 else 4
    ys, yi, xo, xi, co, ci = (hl.Var(name) for name in ("ys", "yi", "xo", "xi", "co", "ci"))
    out.split(Y, ys, yi, strip, hl.TailStrategy.GuardWithIf).split(X, xo, xi, lanes * VECTORS_ACROSS, whole)
    out.split(C, co, ci, together, whole).reorder(xi, ci, co, xo, yi, ys)
    out.vectorize(xi, lanes).unroll(xi).unroll(ci).parallel(ys).never_partition_all()
    sums.compute_at(out, co).reorder_storage(X, C, Y).reorder(X, C, Y).never_partition_all()
    for stage in (sums, *(sums.update(number) for number in range(len(inputs)))):
        stage.vectorize(X, lanes).unroll(X).unroll(C)
    for number, (source, channels) in enumerate(inputs):
        sums.update(number).reorder(X, C, *sums.rvars(number), Y)
        keep_copy(source, channels, (out, ys), lanes)


def keep_copy(func: hl.Func, channels: int | hl.Expr, at: tuple[hl.Func, hl.Var], lanes: int) -> None:
    """Compute what taps read in a loop of a function, plane by plane in each row."""
    func.compute_at(*at).reorder_storage(X, C, Y).reorder(X, C, Y)
    func.bound(C, 0, channels).vectorize(X, lanes).never_partition([Y, C])


def _spread(out: hl.Func, sums: hl.Func, cases: Sequence[hl.Expr]) -> None:
    """On graphics cards keep the sums of a block of channels of a pixel in one thread's registers."""
    co, ci = hl.Var("co"), hl.Var("ci")
    out.split(C, co, ci, BLOCK_OUTPUTS, hl.TailStrategy.RoundUp).reorder(ci, X, Y, co).unroll(ci)
    sums.compute_at(out, spread_pixels(out, X, Y)).unroll(C)
    out.gpu_blocks(co)
    for number in range(sums.num_update_definitions()):
        sums.update(number).reorder(C, *sums.rvars(number), X, Y).unroll(C)
    for case in cases:
        out.specialize(case)


def pad_columns(width: Any) -> Any:
    """Return the columns of an image of the network, so that kernels compute whole blocks of a row."""
    return engine.pad(width, VECTORS_ACROSS * engine.get_engine().lanes or ALIGNMENT)


def surround(source: hl.ImageParam, size: Size, name: str) -> hl.Func:
    """Return a function that is 0 outside the image."""
    near = hl.Func(name)
    near[X, C, Y] = keep_inside(source[clamp_likely(X, size.width), C, hl.clamp(Y, 0, size.height - 1)], size)
    return near


def keep_inside(value: hl.Expr, size: Size) -> hl.Expr:
    """Return a value at (x, y), 0 outside the image."""
    inside = (X >= 0) & (size.width > X) & (Y >= 0) & (size.height > Y)
    return hl.select(inside, value, hl.f32(0.0))


def _read_first(source: hl.ImageParam, reading: hl.Param, source_width: hl.Expr, size: Size) -> hl.Func:
    """Return the first image at the size of the layer, 0 outside it."""
    x, y = clamp_likely(X, size.width), hl.clamp(Y, 0, size.height - 1)
    rows = source.dim(2).extent()

    def read(column: hl.Expr, channel: hl.Expr, line: hl.Expr) -> hl.Expr:
        return source[hl.min(hl.likely(column), source_width - 1), channel, hl.min(line, rows - 1)]

    first, *others = (read(2 * x + across, C, 2 * y + down) for down in range(2) for across in range(2))
    largest = reduce(hl.max, others, first)
    column, line = 2 * x + C % 2, 2 * y + C // 2 % 2
    block = hl.select((column < source_width) & (line < rows), read(column, C // 4, line), hl.f32(0.0))
    values = {Reading.SAME: source[x, C, y], Reading.ENLARGED: source[x // 2, C, y // 2], Reading.HALVED: largest}
    chosen = block
    for way, value in values.items():
        chosen = hl.select(reading == way.value, value, chosen)
    near = hl.Func("first_near")
    near[X, C, Y] = keep_inside(chosen, size)
    return near
