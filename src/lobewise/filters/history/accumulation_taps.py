"""The taps of an accumulation: which samples a pixel compares itself with, and the logarithms of their weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from operator import mul
from typing import Any

from lobewise.backend.compiler import declare_vars, hl
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Feature, Stage
from lobewise.filters.history.vectors import Pixels, Place
from lobewise.filters.planes import C, GuidePlanes, X, Y, make_guide_planes
from lobewise.filters.weigh import make_stage

U, V = declare_vars("u", "v")
"""Offset of a tap, samples across and down."""


@dataclass(frozen=True)
class Taps:
    """A domain of taps, offsets in samples across and down.

    Parameters
    ----------
    reach : halide.Expr
        Radius of the taps, samples. On processors it may differ from vector to vector.
    most : halide.Expr
        Largest reach of all.
    """

    reach: hl.Expr
    most: hl.Expr

    def make(self, name: str) -> hl.RDom:
        """Return a new domain of these taps."""
        span = (-self.most, 2 * self.most + 1)
        domain = hl.RDom([span, span], name)
        for offset in (domain.x, domain.y):
            domain.where((offset >= -self.reach) & (offset <= self.reach))
        return domain


@dataclass(kw_only=True)
class TapGrid:
    """The functions that taps read of samples and pixels, and the logarithms of their weights."""

    tap_mask: hl.ImageParam
    mask: hl.ImageParam
    wide: hl.Func
    """Planes and values of shaded pixels, repeated over the width of their blocks."""
    values: hl.Func
    value_count: int
    taps: GuidePlanes
    """Guides and planes of the shaded pixels."""
    own: GuidePlanes
    """Guides and planes of all pixels."""
    log_weight: hl.Func
    weighed: hl.RDom | None
    """Domain of the logarithms; None where each is computed where it is read."""
    stages: list[hl.Func]
    factor: hl.Func | None
    """Product of the features' factors, which no power changes; None if no feature has one."""
    multiplied: hl.RDom | None
    """Domain of the factor; None where each is computed where it is read."""
    pixels: Pixels
    blocks: Blocks
    read: Callable[[hl.Expr, hl.Expr], list[hl.Expr]]
    """Returns the values of the tap at an offset in samples."""


def declare_count(signature: Signature, name: str, least: int = 0) -> hl.Param:
    """Declare a whole number with a known range, which makes simpler loops."""
    count = signature.count(name, least)
    count.set_range(least, 1 << 16)
    return count


def declare_mask(signature: Signature) -> hl.ImageParam:
    """Declare the mask of all pixels."""
    return signature.image("own_mask", "height", "width", type=hl.UInt(8))


class Blocks:
    """The blocks of ``factor`` x ``factor`` pixels, each with a shaded pixel."""

    def __init__(self, signature: Signature, pixels: Pixels) -> None:
        self.factor = declare_count(signature, "factor", 1)
        column, row = (signature.count(name) for name in ("column", "row"))
        self.spacing = signature.number("spacing")
        """Distance of neighbouring samples, pixels."""
        here = pixels.place
        self.block: Place = self.find(here[0]), self.find(here[1])
        """Column and row of the block that a pixel lies in."""
        self.shift: Place = tuple(
            start + block * self.factor - at for start, block, at in zip((column, row), self.block, here, strict=True)
        )
        """Columns and rows from a pixel to the shaded pixel of its block."""

    def find(self, at: hl.Expr) -> hl.Expr:
        """Return the column of the block that a column lies in; rows alike.

        Pixel centres have a fraction of one half, so that rounding cannot lead into another block.
        """
        return hl.i32(hl.floor((hl.f32(at) + hl.f32(0.5)) / hl.f32(self.factor)))

    def find_offset(self, u: hl.Expr, v: hl.Expr) -> Place:
        """Return the offset of a tap, pixels across and down."""
        across, down = (
            self.spacing * hl.f32(step) + hl.f32(shift) for step, shift in zip((u, v), self.shift, strict=True)
        )
        return across, down


def make_tap_grid(
    signature: Signature,
    features: Sequence[Feature],
    grids: tuple[hl.ImageParam, Pixels, Blocks],
    needed: Taps,
    take: Callable[[Place, hl.Expr], Sequence[hl.Expr]],
) -> TapGrid:
    """Declare the guides of shaded pixels and of all pixels, and define the functions that taps read.

    Parameters
    ----------
    signature, features
        Of the kernel.
    grids : tuple
        Mask of all pixels, the pixels, and their blocks.
    needed : Taps
        Taps of which any sum reads the weight.
    take : callable
        Returns the values of a sample, beside the planes of its features.
    """
    mask, pixels, blocks = grids
    tap_mask = signature.image("tap_mask", "rows", "columns", type=hl.UInt(8))
    tap_arrays = declare_features(signature, "tap", features, "rows", "columns")
    arrays = declare_features(signature, "own", features, "height", "width")
    scalars = declare_scalars(signature, features)
    taps = make_guide_planes("tap", tap_mask, features, scalars, arrays=tap_arrays)
    own = make_guide_planes("own", mask, features, scalars, inside=True, arrays=arrays)
    values, wide, value_count = _define_values(tap_mask, taps, blocks, take)
    here = pixels.place

    def read_planes(u: hl.Expr, v: hl.Expr, start: int, stop: int) -> list[hl.Expr]:
        return [wide[here[0] + u * blocks.factor, k, blocks.block[1] + v] for k in range(start, stop)]

    def pair(u: hl.Expr, v: hl.Expr) -> list[tuple[Any, Any]]:
        there = read_planes(u, v, 0, taps.plane_count)
        return [(own.read(layout, *here), layout.read(there.__getitem__)) for layout in taps.layouts]

    stages = list[hl.Func]()
    stage = make_stage(stages, (*pixels.at, U, V)) if pixels.lanes == 1 else (lambda value: value)
    log_weight, weighed = _define_taps(
        "log_weight",
        pixels,
        needed,
        lambda u, v: _compare(features, pair(u, v), scalars, blocks.find_offset(u, v), stage),
    )
    factor, multiplied = None, None
    if any(feature.has_factor for feature in features):
        factor, multiplied = _define_taps(
            "factor", pixels, needed, lambda u, v: _multiply(features, pair(u, v), scalars)
        )

    def read(u: hl.Expr, v: hl.Expr) -> list[hl.Expr]:
        return read_planes(u, v, taps.plane_count, value_count)

    return TapGrid(
        tap_mask=tap_mask,
        mask=mask,
        wide=wide,
        values=values,
        value_count=value_count,
        taps=taps,
        own=own,
        log_weight=log_weight,
        weighed=weighed,
        stages=stages,
        factor=factor,
        multiplied=multiplied,
        pixels=pixels,
        blocks=blocks,
        read=read,
    )


def _define_values(
    tap_mask: hl.ImageParam,
    taps: GuidePlanes,
    blocks: Blocks,
    take: Callable[[Place, hl.Expr], Sequence[hl.Expr]],
) -> tuple[hl.Func, hl.Func, int]:
    """Return the values of shaded pixels by their own column, then by the column of all pixels; and their number."""
    columns, rows = tap_mask.width(), tap_mask.height()
    at = hl.clamp(X, 0, columns - 1), hl.clamp(Y, 0, rows - 1)
    usable = (X >= 0) & (columns > X) & (Y >= 0) & (rows > Y) & (tap_mask[at] != 0)
    planes = [] if taps.planes is None else [taps.planes[X, k, Y] for k in range(taps.plane_count)]
    given = [*planes, *take(at, usable)]
    values, wide = hl.Func("tap_values"), hl.Func("wide")
    values[X, C, Y] = hl.mux(C, given)
    wide[X, C, Y] = values[blocks.find(X), C, Y]
    return values, wide, len(given)


def _define_taps(
    name: str, pixels: Pixels, needed: Taps, compute: Callable[[hl.Expr, hl.Expr], hl.Expr]
) -> tuple[hl.Func, hl.RDom | None]:
    """Return a function of pixels and taps, and its domain of taps; None where each is computed where it is read."""
    func = hl.Func(name)
    if pixels.lanes == 1:
        func[(*pixels.at, U, V)] = compute(U, V)
        return func, None
    domain = needed.make(f"{name}_taps")
    func[(*pixels.at, U, V)] = hl.undef(hl.Float(32))
    func[(*pixels.at, domain.x, domain.y)] = compute(domain.x, domain.y)
    return func, domain


def _multiply(
    features: Sequence[Feature], pairs: Sequence[tuple[Any, Any]], scalars: Sequence[Sequence[hl.Expr]]
) -> hl.Expr:
    """Return the product of the features' factors for a pixel and a tap; at least one feature must have one."""
    factors = [
        feature.make_factor(i, j, parameters)
        for feature, (i, j), parameters in zip(features, pairs, scalars, strict=True)
        if feature.has_factor
    ]
    return reduce(mul, factors)


def _compare(
    features: Sequence[Feature],
    pairs: Sequence[tuple[Any, Any]],
    scalars: Sequence[Sequence[hl.Expr]],
    offset: tuple[hl.Expr, hl.Expr],
    stage: Stage,
) -> hl.Expr:
    """Return the base-2 logarithm of the similarity of a pixel and a tap, given each feature's planes of both."""
    exponent: hl.Expr = hl.f32(0.0)
    for feature, (i, j), parameters in zip(features, pairs, scalars, strict=True):
        exponent = exponent + feature.log2_similarity(i, j, parameters, offset, stage)
    return exponent
