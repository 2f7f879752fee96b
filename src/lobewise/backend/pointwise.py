"""Kernels that compute images from images pixel by pixel, in one pass.

A definition is a function of a `Grid` that returns the expressions of every output. It is compiled once per structure
(the images, their channels, its options) and runs on images of any size. Float operations keep their order and NaN, so
neither threads nor the start of vectors change a bit. Only the comparisons ``<``, ``>`` and ``==`` are false for NaN:
Halide writes ``<=`` and ``>=`` as the negation of the opposite.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np

from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature

Vector: TypeAlias = "Sequence[hl.Expr]"
"""The channels of one pixel, or the components of a number."""

LARGEST_FLOAT = float(np.finfo(np.float32).max)


@dataclass
class Grid:
    """The images and numbers that a definition reads, and the pixel (x, y) that it defines."""

    images: Mapping[str, tuple[hl.ImageParam, int]]
    """Images by name, each with its number of channels; float32, or uint8 for masks."""
    numbers: Mapping[str, Vector]
    narrow: bool
    """Whether rows may be shorter than a vector. If not, all pixels of a vector lie inside the image."""
    x: hl.Var = field(default_factory=lambda: hl.Var("x"))
    y: hl.Var = field(default_factory=lambda: hl.Var("y"))
    stages: list[hl.Func] = field(default_factory=list)
    is_shared: bool = False
    """Whether the definition itself keeps the values that its outputs share. If not, all outputs are kept per row."""

    @property
    def size(self) -> tuple[hl.Expr, hl.Expr]:
        """Width and height, int32."""
        param, channels = next(iter(self.images.values()))
        first = int(channels > 1)
        return param.dim(first).extent(), param.dim(first + 1).extent()

    @property
    def inside(self) -> tuple[hl.Expr, hl.Expr]:
        """Column and row of this pixel, or of the nearest pixel of the image if this one lies outside."""
        width, height = self.size
        return hl.clamp(self.x, 0, width - 1), hl.clamp(self.y, 0, height - 1)

    def has(self, *names: str) -> bool:
        """Return whether all images of these names are given."""
        return all(name in self.images for name in names)

    def read(self, name: str, x: hl.Expr | None = None, y: hl.Expr | None = None) -> list[hl.Expr]:
        """Return the channels of an image at this pixel or at another one inside the image."""
        param, channels = self.images[name]
        place = self.x if x is None else x, self.y if y is None else y
        return [param[place]] if channels == 1 else [param[k, place[0], place[1]] for k in range(channels)]

    def read_channels(self, name: str, x: hl.Expr | None = None, y: hl.Expr | None = None) -> list[hl.Expr]:
        """Return the channels of an image that `give_channels` gave."""
        if name in self.images:
            return self.read(name, x, y)
        count = sum(each.startswith(f"{name}_channel") for each in self.images)
        return [value for k in range(count) for value in self.read(f"{name}_channel{k}", x, y)]

    def read_one(self, name: str) -> hl.Expr:
        """Return the only channel of an image at this pixel."""
        (value,) = self.read(name)
        return value

    def get(self, name: str) -> Vector:
        """Return the components of a number."""
        return self.numbers[name]

    def share(self, values: Vector) -> list[hl.Expr]:
        """Return ``values``, computed in a separate function row by row: long expressions then compile much faster."""
        return self.keep(values)(self.x, self.y)

    def keep(self, values: Vector) -> Callable[[hl.Expr, hl.Expr], list[hl.Expr]]:
        """Return a function that reads ``values`` at a pixel (x, y); they are computed once for a whole row.

        Definitions that read several neighbours keep the values of the pixel at `inside`, and then read the kept values
        at every neighbour. Reading the image itself at clamped columns would load every lane by itself, which takes
        several times as long to compile and to run.
        """
        func = hl.Func(f"row{len(self.stages)}")
        func[self.x, self.y] = hl.Tuple(list(values)) if len(values) > 1 else values[0]
        self.stages.append(func)

        def read(x: hl.Expr, y: hl.Expr) -> list[hl.Expr]:
            there = func[x, y]
            return [hl.Expr(there[k]) for k in range(len(values))] if len(values) > 1 else [hl.Expr(there)]

        return read

    def average(self, values: Vector, radius: int) -> list[hl.Expr]:
        """Return means over a square around the pixel of ``values``, which are those of a pixel at `inside`."""
        reach, read = range(-radius, radius + 1), self.keep(values)
        # Sum columns first: a column of the square serves all squares that it lies in.
        columns = [read(self.x, self.y + down) for down in reach]
        column = self.keep([sum(parts[1:], parts[0]) for parts in zip(*columns, strict=True)])
        squares = [column(self.x + across, self.y) for across in reach]
        share = hl.f32(1.0 / len(reach) ** 2)
        return [sum(parts[1:], parts[0]) * share for parts in zip(*squares, strict=True)]


def give_channels(name: str, image: Any) -> dict[str, Any]:
    """Return an image (height, width, channels) by name, its channels apart if they lie one after the other in memory.

    Either way no copy is needed. The channels may also come as a list of images.
    """
    if isinstance(image, list):
        return {f"{name}_channel{k}": channel for k, channel in enumerate(image)}
    if not isinstance(image, np.ndarray):
        return {name: image}
    if image.strides[-1] == image.itemsize:
        return {name: image}
    return {f"{name}_channel{k}": image[..., k] for k in range(image.shape[-1])}


Definition = Callable[..., Sequence[Vector]]
"""A function of a grid and options that returns the channels of every output; the channels of an output have one type.
A single channel makes an image without an axis for channels. Type uint8 makes a mask."""


def is_finite(value: hl.Expr) -> hl.Expr:
    """Return whether a float32 is neither infinite nor NaN, from its bits."""
    return (hl.reinterpret(hl.UInt(32), value) & hl.u32(0x7F800000)) != hl.u32(0x7F800000)


def select_bits(condition: hl.Expr, first: hl.Expr, second: hl.Expr) -> hl.Expr:
    """Return one of two float32 that may be NaN."""
    bits = [hl.reinterpret(hl.UInt(32), value) for value in (first, second)]
    return hl.reinterpret(hl.Float(32), hl.select(condition, *bits))


def select_or_nan(condition: hl.Expr, value: hl.Expr) -> hl.Expr:
    """Return a float32 where ``condition`` holds, else NaN, in a form that float optimisations do not remove."""
    bits = hl.select(condition, hl.reinterpret(hl.UInt(32), value), hl.u32(0x7FC00000))
    return hl.reinterpret(hl.Float(32), bits)


@dataclass(frozen=True)
class PointwiseKey:
    """Everything that changes the kernel's code."""

    define: Definition
    options: tuple[Hashable, ...]
    images: tuple[tuple[str, int, bool], ...]
    """Name, number of channels, and whether the image is a mask."""
    numbers: tuple[tuple[str, int, bool], ...]
    """Name, number of components, and whether they are float64."""
    narrow: bool


def make_pointwise(key: PointwiseKey, target: hl.Target) -> Scheduled:
    """Return the scheduled functions of a definition."""
    signature = Signature(key.define.__name__.lstrip("_").removeprefix("define_"))
    size = ("height", "width")
    images: dict[str, tuple[hl.ImageParam, int]] = {}
    for name, channels, truth in key.images:
        axes = size if channels == 1 else (*size, channels)
        param = signature.image(name, *axes, type=hl.UInt(8) if truth else hl.Float(32))
        if channels > 1:
            param.dim(0).set_bounds(0, channels)
        images[name] = param, channels
    numbers = {
        name: [signature.number(f"{name}_{k}", hl.Float(64 if double else 32)) for k in range(count)]
        for name, count, double in key.numbers
    }
    grid = Grid(images, numbers, key.narrow)
    outputs = key.define(grid, *key.options)
    for number, values in enumerate(outputs):
        axes = size if len(values) == 1 else (*size, len(values))
        signature.output(f"out{number}", *axes, type=hl.UInt(8) if values[0].type().is_uint() else None)
    return Scheduled(schedule_rows(grid, outputs, target.natural_vector_size(hl.Float(32))), signature)


def schedule_rows(grid: Grid, outputs: Sequence[Vector], lanes: int) -> list[hl.Func]:
    """Return the output functions, with rows in parallel. The values that outputs share are computed once per row.

    The values of a row lie in cache as planes and are interleaved when they are written.
    """
    x, y, c = grid.x, grid.y, hl.Var("c")
    if len(outputs) > 1 and not grid.is_shared:
        pixel = iter(grid.share([value for values in outputs for value in values]))
        outputs = [[next(pixel) for _ in values] for values in outputs]
    outs: list[hl.Func] = []
    for number, parts in enumerate(outputs):
        out = hl.Func(f"out{number}")
        if len(parts) == 1:
            out[x, y] = parts[0]
        else:
            out[c, x, y] = hl.mux(c, parts)
            out.bound(c, 0, len(parts)).reorder(c, x, y).unroll(c)
            out.output_buffer().dim(1).set_stride(len(parts))
        outs.append(out)
    for func in (*outs, *grid.stages):
        if not grid.narrow:
            # Use whole vectors only; the last one overlaps the one before. A tail would be compiled lane by lane.
            func.vectorize(x, lanes, hl.TailStrategy.ShiftInwards)
        func.never_partition_all()
    for out in outs:
        out.parallel(y)
        if out is not outs[0]:
            out.compute_with(outs[0], y)
    for stage in grid.stages:
        stage.compute_at(outs[0], y)
    return outs
