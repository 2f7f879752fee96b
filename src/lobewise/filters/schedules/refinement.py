"""Schedules of the refining network, for processors and graphics cards."""

from __future__ import annotations

from typing import Any, NamedTuple

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.filters.planes import PIXEL
from lobewise.filters.scheduling import ALIGNMENT, spread_channels, spread_pixels

STRIP_ROWS = 8
"""Rows that a thread takes at a time."""
VECTORS_ACROSS, LOGITS_TOGETHER = 3, 8
"""Vectors of columns whose sums a thread keeps in registers, and logits of one vector."""


class Copy(NamedTuple):
    """A function that taps read, and its channels."""

    func: hl.Func
    channels: int | hl.Expr


class Convolution(NamedTuple):
    """The functions of a convolution.

    Parameters
    ----------
    inputs : tuple of Copy
        Copies of the inputs that are 0 outside the image.
    taps : tuple of halide.RDom
        Columns, rows and channels of the taps of each input.
    sums, out : halide.Func
        The sum of a pixel, with an update for each input, and the result.
    """

    inputs: tuple[Copy, ...]
    taps: tuple[hl.RDom, ...]
    sums: hl.Func
    out: hl.Func


class Head(NamedTuple):
    """The convolution that gives the logits of a pixel: its sums, and the domain of its taps."""

    sums: hl.Func
    taps: hl.RDom


class Filter(NamedTuple):
    """The functions of the filter of a level.

    Parameters
    ----------
    head : Head
    near : tuple of Copy
        What taps read, 0 outside the level: sums of light, vectors, and the level above; last the tint.
    exponents : Copy
        Factors of the squared distances of each group of vectors, a function of (x, c, y).
    total : halide.Func
        Tuple of the sums, a function of (x, y).
    taps : list of halide.RDom
        Of each kind.
    out : Copy
        The filtered light times the tint, a function of (c, x, y).
    """

    head: Head
    near: tuple[Copy, ...]
    exponents: Copy
    total: hl.Func
    taps: list[hl.RDom]
    out: Copy


def pad_columns(width: Any) -> Any:
    """Return the columns of an image of the network, so that kernels compute whole blocks of a row."""
    return engine.pad(width, VECTORS_ACROSS * engine.get_engine().lanes or ALIGNMENT)


def schedule_convolution(
    made: Convolution, strip: hl.Expr, readings: list[hl.Expr], block: int, target: hl.Target
) -> None:
    """Schedule a convolution.

    ``strip`` is the number of rows that a thread takes at a time, ``readings`` are conditions that choose what the
    first input is, and a multiple of ``block`` output channels is computed.
    """
    if target.has_gpu_feature():
        _convolve_blocks(made, readings, block)
        return
    x, y, c = PIXEL
    lanes = target.natural_vector_size(hl.Float(32))
    ys, yi, xo, xi, co, ci = (hl.Var(name) for name in ("ys", "yi", "xo", "xi", "co", "ci"))
    whole, out, sums = hl.TailStrategy.RoundUp, made.out, made.sums
    out.split(y, ys, yi, strip, hl.TailStrategy.GuardWithIf).split(x, xo, xi, lanes * VECTORS_ACROSS, whole)
    out.split(c, co, ci, _count_channels(target), whole).reorder(xi, ci, co, xo, yi, ys)
    out.vectorize(xi, lanes).unroll(xi).unroll(ci).parallel(ys).never_partition_all()
    sums.compute_at(out, co).reorder_storage(x, c, y).reorder(x, c, y).never_partition_all()
    for stage in (sums, *(sums.update(number) for number in range(len(made.taps)))):
        stage.vectorize(x, lanes).unroll(x).unroll(c)
    for number, (source, taps) in enumerate(zip(made.inputs, made.taps, strict=True)):
        sums.update(number).reorder(x, c, taps.x, taps.y, taps.z, y)
        _keep_copy(source, out, ys, lanes)
    for reading in readings:
        made.inputs[0].func.specialize(reading)


def _count_channels(target: hl.Target) -> int:
    """Return the output channels whose sums a thread keeps in registers; there are 16 or 32 of these."""
    return 8 if target.arch == hl.TargetArch.ARM or target.natural_vector_size(hl.Float(32)) > 8 else 4


def _keep_copy(source: Copy, out: hl.Func, loop: hl.Var, lanes: int) -> None:
    x, y, c = PIXEL
    func = source.func.compute_at(out, loop).reorder_storage(x, c, y).reorder(x, c, y)
    func.bound(c, 0, source.channels).vectorize(x, lanes).never_partition([y, c])


def schedule_sums(head: Head, light: Copy, out: Copy, target: hl.Target) -> None:
    """Schedule the sums of the finest level; ``light`` is a copy of the light."""
    x, y, c = PIXEL
    if target.has_gpu_feature():
        _keep_logits(head, out.func, spread_channels(out.func, out.channels))
        return
    lanes = target.natural_vector_size(hl.Float(32))
    ys, loop = _spread_vectors(out, lanes, hl.TailStrategy.RoundUp)
    logits = head.sums.compute_at(out.func, loop).reorder_storage(x, c, y).reorder(x, c, y)
    logits.vectorize(x, lanes).unroll(c)
    logits.update().reorder(x, c, head.taps.x, y).vectorize(x, lanes).unroll(c)
    _keep_copy(light, out.func, ys, lanes)


def schedule_averages(out: hl.Func, target: hl.Target) -> None:
    """Schedule the averages of a level."""
    x, y, c = PIXEL
    if target.has_gpu_feature():
        spread_pixels(out.reorder(x, y, c), x, y)
        out.gpu_blocks(c)
        return
    lanes = target.natural_vector_size(hl.Float(32))
    out.reorder(x, c, y).vectorize(x, lanes, hl.TailStrategy.RoundUp).parallel(y).never_partition([y, c])


def _spread_vectors(out: Copy, lanes: int, tail: hl.TailStrategy) -> tuple[hl.Var, hl.Var]:
    """Run strips of rows in parallel, and all channels of a vector together. Return both loops."""
    x, y, c = PIXEL
    ys, yi, xo, xi = (hl.Var(name) for name in ("ys", "yi", "xo", "xi"))
    func = out.func.bound(c, 0, out.channels).split(y, ys, yi, STRIP_ROWS, hl.TailStrategy.GuardWithIf)
    func.split(x, xo, xi, lanes, tail).reorder(c, xi, xo, yi, ys)
    func.vectorize(xi).unroll(c).parallel(ys).never_partition_all()
    return ys, xo


def schedule_filter(made: Filter, target: hl.Target) -> None:
    """Schedule the filter of a level."""
    if target.has_gpu_feature():
        _filter_blocks(made)
        return
    x, y, c = PIXEL
    lanes = target.natural_vector_size(hl.Float(32))
    out = made.out.func
    ys, loop = _spread_vectors(made.out, lanes, hl.TailStrategy.GuardWithIf)
    co, ci = hl.Var("co"), hl.Var("ci")
    logits = made.head.sums.compute_at(out, loop).reorder_storage(x, c, y)
    for stage in (logits, logits.update()):
        stage.split(c, co, ci, LOGITS_TOGETHER).vectorize(x, lanes).unroll(ci)
    logits.reorder(x, ci, co, y)
    logits.update().reorder(x, ci, made.head.taps.x, co, y)
    made.exponents.func.compute_at(out, loop).bound(c, 0, made.exponents.channels).reorder_storage(x, c, y)
    made.exponents.func.reorder(c, x, y).vectorize(x, lanes).unroll(c)
    made.total.compute_at(out, loop).vectorize(x, lanes)
    for number, taps in enumerate(made.taps):
        made.total.update(number).reorder(x, taps.x, taps.y, y).vectorize(x, lanes)
    for source in made.near:
        _keep_copy(source, out, ys, lanes)


def _convolve_blocks(made: Convolution, readings: list[hl.Expr], block: int) -> None:
    """Keep the sums of a block of channels of a pixel in one thread's registers."""
    x, y, c = PIXEL
    co, ci = hl.Var("co"), hl.Var("ci")
    out = made.out.split(c, co, ci, block, hl.TailStrategy.RoundUp).reorder(ci, x, y, co).unroll(ci)
    made.sums.compute_at(out, spread_pixels(out, x, y)).unroll(c)
    out.gpu_blocks(co)
    for number, taps in enumerate(made.taps):
        made.sums.update(number).reorder(c, taps.x, taps.y, taps.z, x, y).unroll(c)
    for reading in readings:
        out.specialize(reading)


def _filter_blocks(made: Filter) -> None:
    """Keep the sums of a pixel in one thread's registers."""
    _, _, c = PIXEL
    out = made.out.func
    thread = spread_channels(out, made.out.channels)
    _keep_logits(made.head, out, thread)
    made.exponents.func.compute_at(out, thread).bound(c, 0, made.exponents.channels).unroll(c)
    made.total.compute_at(out, thread)


def _keep_logits(head: Head, out: hl.Func, thread: hl.Var) -> None:
    """Compute the logits of a pixel in its thread."""
    x, y, c = PIXEL
    head.sums.compute_at(out, thread).update().reorder(c, head.taps.x, x, y)
