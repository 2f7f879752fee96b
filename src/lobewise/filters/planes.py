"""The values of a pixel that taps read: the features' arrays as planes, side by side in each row.

Guides are the input channels of all features, replaced by neutral values where a pixel has no meaning. Planes are the
results of `Feature.prepare` for the guides. Where taps reach beyond the image, either coordinates are clamped or
`Columns` fills the margins.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

from lobewise.backend.compiler import declare_vars, hl
from lobewise.features.base import Feature, Pixel, count_channels

X, Y, C = declare_vars("x", "y", "c")
"""Column, row and channel of the functions of all kernels."""


class Layout:
    """The place of a feature's planes among those of all features, and the structure to rebuild from them.

    Parameters
    ----------
    prepared : Pixel
        The result of `Feature.prepare`: gives the structure.
    start : int
        Index of the first plane.
    """

    def __init__(self, prepared: Pixel, start: int = 0) -> None:
        self._like = prepared
        self.start = start
        self.stop = start + len(flatten(prepared))

    def read(self, take: Callable[[int], hl.Expr]) -> Pixel:
        """Return a pixel's planes in the structure of `Feature.prepare`; ``take(k)`` returns the k-th plane of all."""
        return _rebuild(self._like, map(take, range(self.start, self.stop)))


def flatten(prepared: Pixel) -> list[hl.Expr]:
    """Return the planes as a flat list."""
    if isinstance(prepared, (list, tuple)):
        return [value for part in prepared for value in flatten(part)]
    return [] if prepared is None else [prepared]


def _rebuild(like: Any, values: Iterator[hl.Expr]) -> Any:
    """Return the structure of ``like`` with the next values in place of its own."""
    if not isinstance(like, (list, tuple)):
        return None if like is None else next(values)
    parts = [_rebuild(part, values) for part in like]
    return type(like)(*parts) if hasattr(like, "_fields") else parts


def count_inputs(features: Sequence[Feature]) -> list[int]:
    """Return the number of channels of each array of all features."""
    return [count for feature in features for count in count_channels(feature)]


def neutralize(features: Sequence[Feature], channels: Sequence[hl.Expr], known: hl.Expr) -> list[hl.Expr]:
    """Return the input channels of a pixel, or neutral values if it has no meaning."""
    neutral = [value for feature in features for value in feature.neutral]
    return [hl.select(known, value, hl.f32(other)) for value, other in zip(channels, neutral, strict=True)]


def prepare_planes(
    features: Sequence[Feature], scalars: Sequence[Sequence[hl.Expr]], channels: Sequence[hl.Expr]
) -> tuple[list[hl.Expr], list[Layout]]:
    """Return the planes of a pixel, from its input channels, and the layout of each feature in them."""
    values: list[hl.Expr] = []
    layouts: list[Layout] = []
    first = 0
    for feature, own in zip(features, scalars, strict=True):
        count = sum(count_channels(feature))
        prepared = feature.prepare(channels[first : first + count], own) if count else []
        first += count
        layouts.append(Layout(prepared, len(values)))
        values.extend(flatten(prepared))
    return values, layouts


def clamp_likely(x: hl.Expr, length: hl.Expr) -> hl.Expr:
    """Return x clamped to a row. "Likely" makes a loop of its own for the middle of a row, where loads are dense."""
    return hl.clamp(hl.likely(x), 0, length - 1)


class Columns:
    """The columns of an image in parts that need no clamping, for processors.

    A clamped load becomes one load for each lane of a vector, and needs code for the left, the middle and the right of
    a row: half of all code to compile. So the margins outside the image are filled, vectors begin at column 0, and the
    pixels after the last whole vector are computed one by one.

    Parameters
    ----------
    width : halide.Expr
        Width of the image, pixels.
    reach : int or halide.Expr
        Distance of the farthest tap, pixels.
    lanes : int
        Pixels of a vector.
    """

    def __init__(self, width: hl.Expr, reach: int | hl.Expr, lanes: int) -> None:
        self.lanes = lanes
        before = (reach + hl.i32(lanes - 1)) / lanes * lanes
        whole = width / lanes
        self.margins = [hl.RDom([(-before, before)], "before"), hl.RDom([(width, before + lanes)], "after")]
        """Columns left and right of the image, as far as vectors that begin inside it reach."""
        self.parts = [hl.RDom([(0, lanes), (0, whole)], "whole"), hl.RDom([(whole * lanes, width % lanes)], "left")]
        """Whole vectors, by lane and number; remaining pixels."""

    def fill(
        self,
        name: str,
        outside: hl.Expr,
        inside: Callable[[int, hl.Expr], hl.Expr],
    ) -> hl.Func:
        """Return a function of (x, c, y): ``inside(part, column)`` inside the image, ``outside`` in the margins."""
        func = hl.Func(name)
        func[X, C, Y] = hl.undef(hl.Float(32))
        for margin in self.margins:
            func[margin.x, C, Y] = outside
        for number, part in enumerate(self.parts):
            column = part.y * self.lanes + part.x if part.dimensions() == 2 else part.x
            func[column, C, Y] = inside(number, column)
        return func


def _stack(name: str, values: Sequence[hl.Expr]) -> hl.Func | None:
    """Return a function whose channel c is the c-th value; None without values."""
    if not values:
        return None
    func = hl.Func(name)
    func[X, C, Y] = _choose(values)
    return func


def _choose(values: Sequence[hl.Expr]) -> hl.Expr:
    return hl.mux(C, list(values)) if len(values) > 1 else values[0]


@dataclass
class GuidePlanes:
    """The guides and planes of one grid of pixels."""

    guides: hl.Func | None
    guide_count: int
    planes: hl.Func | None
    plane_count: int
    layouts: list[Layout]
    """Layout of each feature."""
    row_guides: list[hl.Func] = field(default_factory=list)
    """Guides by part of `Columns.parts`, if there are rows; ``guides`` is None then."""

    def read(self, layout: Layout, x: hl.Expr, y: hl.Expr) -> Pixel:
        """Return the planes of one feature at a pixel."""
        planes = self.planes
        return layout.read(lambda k: planes[x, k, y]) if planes is not None else []


def make_guide_planes(
    name: str,
    mask: hl.ImageParam,
    features: Sequence[Feature],
    scalars: Sequence[Sequence[hl.Expr]],
    arrays: Sequence[hl.ImageParam],
    *,
    inside: bool = False,
    rows: Columns | None = None,
) -> GuidePlanes:
    """Return the planes of every feature on the grid of ``mask``.

    ``arrays`` come from `lobewise.features.arrays.declare_features`. ``inside`` promises that only pixels inside the
    image are read, so that coordinates need no clamping.
    """
    count = sum(count_inputs(features))

    def read(guides: hl.Func | None, column: hl.Expr) -> list[hl.Expr]:
        return [guides[column, k, Y] for k in range(count)] if guides is not None else []

    if rows is None:
        at = (X, Y) if inside else (clamp_likely(X, mask.width()), hl.clamp(Y, 0, mask.height() - 1))
        guides = _make_guides(f"{name}_guides", mask, features, arrays, at)
        values, layouts = prepare_planes(features, scalars, read(guides, X))
        return GuidePlanes(guides, count, _stack(f"{name}_planes", values), len(values), layouts)

    line = hl.clamp(Y, 0, mask.height() - 1)
    outside, layouts = prepare_planes(features, scalars, [hl.f32(v) for feature in features for v in feature.neutral])
    if not outside:
        return GuidePlanes(None, 0, None, 0, layouts)
    parts = [
        _make_guides(f"{name}_guides{number}", mask, features, arrays, (X, line)) for number in range(len(rows.parts))
    ]
    planes = rows.fill(
        f"{name}_planes",
        _choose(outside),
        lambda number, column: _choose(prepare_planes(features, scalars, read(parts[number], column))[0]),
    )
    return GuidePlanes(None, count, planes, len(outside), layouts, [part for part in parts if part is not None])


def make_image(
    name: str,
    mask: hl.ImageParam,
    rows: Columns | None,
    take: Callable[[tuple[hl.Expr, hl.Expr], hl.Expr], hl.Expr],
) -> hl.Func:
    """Return a function of (x, c, y) from ``take(pixel, usable)``, called with a pixel and whether it has meaning.

    Outside the image ``take`` gets the nearest pixel, not usable; with ``rows`` the margins are 0 instead.
    """
    line = hl.clamp(Y, 0, mask.height() - 1)
    inside = (Y >= 0) & (mask.height() > Y)
    if rows is not None:
        zero = hl.f32(0.0)
        return rows.fill(name, zero, lambda _, at: take((at, line), inside & (mask[at, line] != 0)))
    column = clamp_likely(X, mask.width())
    func = hl.Func(name)
    func[X, C, Y] = take((column, line), inside & (X >= 0) & (mask.width() > X) & (mask[column, line] != 0))
    return func


def _make_guides(
    name: str,
    mask: hl.ImageParam,
    features: Sequence[Feature],
    arrays: Sequence[hl.ImageParam],
    at: tuple[hl.Expr, hl.Expr],
) -> hl.Func | None:
    """Return the input channels of all features as one function."""
    channels: list[hl.Expr] = []
    for array, count in zip(arrays, count_inputs(features), strict=True):
        deep = array.dimensions() == 3
        channels += [array[k, at[0], at[1]] if deep else array[at] for k in range(count)]
    return _stack(name, neutralize(features, channels, mask[at] != 0))
