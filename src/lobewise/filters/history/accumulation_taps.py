"""The taps of an accumulation: which samples a pixel compares itself with, and the logarithms of their weights."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from lobewise.backend.compiler import hl
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Feature
from lobewise.filters.history.vectors import LANE, VECTOR, Pixels, Place
from lobewise.filters.planes import C, X, Y, make_guide_planes
from lobewise.filters.scheduling import keep_planes, keep_rows
from lobewise.filters.weigh import U, V


@dataclass(frozen=True)
class TapDomain:
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

    def compute_tap_offset(self, u: hl.Expr, v: hl.Expr) -> Place:
        """Return the offset of a tap, pixels across and down."""
        across, down = (
            self.spacing * hl.f32(step) + hl.f32(shift) for step, shift in zip((u, v), self.shift, strict=True)
        )
        return across, down


class TapGrid:
    """What taps read of samples and pixels, the logarithms of their weights, and the sums over them.

    Parameters
    ----------
    signature, features
        Of the kernel. The guides of shaded pixels and of all pixels are declared in the signature.
    grids : tuple
        Mask of all pixels, the pixels, and their blocks.
    needed : TapDomain
        Taps of which any sum reads the weight.
    take : callable
        Returns the values of a sample, beside the planes of its features.
    """

    def __init__(
        self,
        signature: Signature,
        features: Sequence[Feature],
        grids: tuple[hl.ImageParam, Pixels, Blocks],
        needed: TapDomain,
        take: Callable[[Place, hl.Expr], Sequence[hl.Expr]],
    ) -> None:
        mask, self.pixels, self.blocks = grids
        tap_mask = signature.image("tap_mask", "rows", "columns", type=hl.UInt(8))
        tap_arrays = declare_features(signature, "tap", features, "rows", "columns")
        arrays = declare_features(signature, "own", features, "height", "width")
        scalars = declare_scalars(signature, features)
        self._taps = make_guide_planes("tap", tap_mask, features, scalars, arrays=tap_arrays)
        self._own = make_guide_planes("own", mask, features, scalars, inside=True, arrays=arrays)
        self._define_values(tap_mask, take)
        self._sums: list[tuple[hl.Func, hl.Func]] = []
        here = self.pixels.place

        def pair(u: hl.Expr, v: hl.Expr) -> list[tuple[Any, Any]]:
            there = self._read_planes(u, v, 0, self._taps.plane_count)
            return [(self._own.read(layout, *here), layout.read(there.__getitem__)) for layout in self._taps.layouts]

        def compare(u: hl.Expr, v: hl.Expr) -> hl.Expr:
            return _compare(features, pair(u, v), scalars, self.blocks.compute_tap_offset(u, v))

        self.log_weight = self._define_taps("log_weight", needed, compare)

    def _define_values(self, tap_mask: hl.ImageParam, take: Callable[[Place, hl.Expr], Sequence[hl.Expr]]) -> None:
        """Define the values of shaded pixels by their own column, then repeated over the width of their blocks."""
        taps, columns, rows = self._taps, tap_mask.width(), tap_mask.height()
        at = hl.clamp(X, 0, columns - 1), hl.clamp(Y, 0, rows - 1)
        usable = (X >= 0) & (columns > X) & (Y >= 0) & (rows > Y) & (tap_mask[at] != 0)
        planes = [] if taps.planes is None else [taps.planes[X, k, Y] for k in range(taps.plane_count)]
        values = [*planes, *take(at, usable)]
        self._value_count, self._values, self._wide = len(values), hl.Func("tap_values"), hl.Func("wide")
        self._values[X, C, Y] = hl.mux(C, values)
        self._wide[X, C, Y] = self._values[self.blocks.find(X), C, Y]

    def _read_planes(self, u: hl.Expr, v: hl.Expr, start: int, stop: int) -> list[hl.Expr]:
        column, row = self.pixels.place[0] + u * self.blocks.factor, self.blocks.block[1] + v
        return [self._wide[column, k, row] for k in range(start, stop)]

    def read(self, u: hl.Expr, v: hl.Expr) -> list[hl.Expr]:
        """Return the values of the tap at an offset in samples."""
        return self._read_planes(u, v, self._taps.plane_count, self._value_count)

    def _define_taps(self, name: str, taps: TapDomain, compute: Callable[[hl.Expr, hl.Expr], hl.Expr]) -> hl.Func:
        """Return a function of pixels and taps. Without vectors each value is computed where it is read."""
        func, at = hl.Func(name), self.pixels.at
        if self.pixels.lanes == 1:
            func[(*at, U, V)] = compute(U, V)
            return func
        domain = taps.make(f"{name}_taps")
        func[(*at, U, V)] = hl.undef(hl.Float(32))
        func[(*at, domain.x, domain.y)] = compute(domain.x, domain.y)
        return func

    def add(
        self,
        name: str,
        taps: TapDomain,
        weigh: Callable[[hl.Expr, hl.Expr], hl.Expr],
        take: Callable[[hl.Expr, list[hl.Expr]], Sequence[hl.Expr]],
    ) -> list[hl.Expr]:
        """Return the sums over taps of ``take(weight, values)``; ``weigh`` returns the weight of an offset."""
        # The weights are a function of their own, because each of the sums would compute them again.
        at, weights, func = self.pixels.at, self._define_taps(f"{name}_weights", taps, weigh), hl.Func(name)
        domain = taps.make(f"{name}_taps")
        taken = take(weights[(*at, domain.x, domain.y)], self.read(domain.x, domain.y))
        func[at] = hl.Tuple([hl.f32(0.0)] * len(taken))
        func[at] = hl.Tuple([func[at][k] + value for k, value in enumerate(taken)])
        self._sums.append((func, weights))
        return [func[at][k] for k in range(len(taken))]

    # Schedule

    def spread(self, out: hl.Func, thread: hl.Var) -> None:
        """On graphics cards sum in the thread of a pixel. Keep planes of samples and of all pixels in memory."""
        for func, weights in self._sums:
            func.compute_at(out, thread)
            weights.compute_at(func, func.rvars()[0])
        keep_planes(self._values, self._value_count)
        keep_planes(self._own.planes, self._own.plane_count)

    def vectorize(self, out: hl.Func, vector: hl.Var, tile: hl.RVar, strip: hl.Var) -> None:
        """On processors keep the log-weights of a vector's taps in cache; they serve both trust and samples.

        A row of samples is repeated over the width of its blocks once per tile, so that the taps of a vector of pixels
        are plain loads at any scale.
        """
        lanes = self.pixels.lanes
        for func in (self.log_weight, *(each for pair in self._sums for each in pair)):
            func.compute_at(out, vector).bound(LANE, 0, lanes).vectorize(LANE)
            func.update().reorder(LANE, *func.rvars(), VECTOR, Y).vectorize(LANE)
        for func in (self.log_weight, *(weights for _, weights in self._sums)):
            func.hoist_storage(out, strip)
        for func, count in ((self._own.planes, self._own.plane_count), (self._own.guides, self._own.guide_count)):
            if func is not None:
                keep_rows(func.compute_at(out, vector), count, lanes)
        self._wide.compute_at(out, tile).reorder_storage(X, C, Y).align_storage(X, lanes)
        self._wide.reorder(X, C, Y).vectorize(X, lanes).never_partition_all()
        keep_rows(self._values.compute_at(out, tile), self._value_count, lanes)
        if self._taps.guides is not None:
            keep_rows(self._taps.guides.compute_at(self._values, X), self._taps.guide_count, lanes)


def _compare(
    features: Sequence[Feature],
    pairs: Sequence[tuple[Any, Any]],
    scalars: Sequence[Sequence[hl.Expr]],
    offset: tuple[hl.Expr, hl.Expr],
) -> hl.Expr:
    """Return the base-2 logarithm of the similarity of a pixel and a tap, given each feature's planes of both."""
    exponent: hl.Expr = hl.f32(0.0)
    for feature, (i, j), parameters in zip(features, pairs, scalars, strict=True):
        exponent = exponent + feature.log2_similarity(i, j, parameters, offset, lambda value: value)
    return exponent
