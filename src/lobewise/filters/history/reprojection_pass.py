"""The kernel that reprojects a history: finds a pixel's place in the frame before, and gathers the sums there.

``out_i = sum_k b_k v(i, k) past_k`` (``v^2`` for squared weights) over the four pixels k of the frame before around the
place that pixel i came from. b are the bilinear weights, v is the product of the features' similarities between pixel i
of this frame and pixel k of the frame before.

The sums are described in `lobewise.filters.history.sums`. The output has one more channel, ``a = sum_k b_k v(i, k)``,
the agreement of the place, 0 to 1 (up to the error of `exp2`).

A pixel may come from two places, that of its surface and that of its reflection. Their sums are mixed by ``a^2``, so
that the place with more agreement counts more. Then all weights are multiplied by the memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Feature
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums
from lobewise.filters.planes import C, GuidePlanes, X, Y, count_inputs, make_guide_planes, neutralize, prepare_planes

AGREEMENT = HISTORY_CHANNELS
"""Channel of the agreement, after the sums."""
REPROJECTED = (*Sums._fields, "agreement")
"""The output planes of a reprojection."""

SNAP_PIXELS = 2e-3
"""Distance from a pixel's centre within which a place is moved to the centre, pixels: rounding must not blur."""


@dataclass(frozen=True)
class Gathered:
    """An image read at the four pixels around a place."""

    func: hl.Func
    channels: int
    shared: bool
    """Whether it is read only at the first place."""


@dataclass
class ReprojectionFuncs:
    """The Halide functions of a reprojection, for its schedules."""

    out: hl.Func
    signature: Signature
    sums: hl.Func
    taps: hl.RDom
    now: GuidePlanes
    """Guides and planes of this frame."""
    past: PastPixels


@dataclass
class PastPixels:
    """The four pixels of the frame before around each place, and the functions computed from them.

    Images of the frame before have one axis for all pixels, row after row, so that one index serves all images.
    """

    width: hl.Param
    height: hl.Param
    way_count: int
    way: hl.Var = field(default_factory=lambda: hl.Var("w"))
    """Index of the place: 0 for the surface, 1 for the reflection."""
    u: hl.Var = field(default_factory=lambda: hl.Var("u"))
    v: hl.Var = field(default_factory=lambda: hl.Var("v"))
    spots: hl.Func = field(default_factory=lambda: hl.Func("spots"))
    near: hl.Func = field(default_factory=lambda: hl.Func("near"))
    stages: list[hl.Func] = field(default_factory=list)
    """Functions of each of the four pixels, each after those that it reads."""
    surface_stages: list[hl.Func] = field(default_factory=list)
    """Like ``stages``, but only for the first place."""
    gathered: list[Gathered] = field(default_factory=list)

    def find(self, places: Sequence[hl.ImageParam]) -> tuple[hl.Expr, hl.Expr]:
        """Define the four pixels around each place; return the fractions of the place's column and row.

        Places far outside the image, and NaN, must not become an index.
        """

        def place(axis: int, length: hl.Expr) -> tuple[hl.Expr, hl.Expr]:
            raw = places[0][axis, X, Y]
            if len(places) > 1:
                raw = hl.select(self.way == 0, raw, places[1][axis, X, Y])
            near = (raw > hl.f32(-1.0)) & (raw < hl.f32(length))
            value = hl.select(near, raw, hl.f32(-2.0))
            whole = hl.floor(value + hl.f32(0.5))
            value = hl.select(hl.abs(value - whole) < hl.f32(SNAP_PIXELS), whole, value)
            first = hl.floor(value)
            return hl.i32(first), value - first

        width, height = self.width, self.height
        self.spots[X, Y, self.way] = hl.Tuple([*place(0, width), *place(1, height)])
        column, right, row, down = (self.spots[X, Y, self.way][k] for k in range(4))
        at_x, at_y = column + self.u, row + self.v
        inside = (at_x >= 0) & (at_x < width) & (at_y >= 0) & (at_y < height)
        index = hl.clamp(at_x, 0, width - 1) + hl.clamp(at_y, 0, height - 1) * width
        self.near[X, Y, self.way, self.u, self.v] = hl.Tuple([hl.select(inside, hl.i32(1), hl.i32(0)), index])
        return right, down

    def stage(self, *values: hl.Expr) -> Any:
        """Compute values of each of the four pixels in a separate loop."""
        return self._keep("stage", self.stages, (X, Y, self.way, self.u, self.v), values)

    def surface_stage(self, *values: hl.Expr) -> Any:
        """Like `stage`, but only for the first place."""
        return self._keep("surface", self.surface_stages, (X, Y, self.u, self.v), values)

    def _keep(self, name: str, stages: list[hl.Func], axes: Sequence[hl.Var], values: Sequence[hl.Expr]) -> Any:
        func = hl.Func(f"{name}{len(stages)}")
        func[tuple(axes)] = hl.Tuple(list(values)) if len(values) > 1 else values[0]
        stages.append(func)
        return func[tuple(axes)]

    def is_inside(self, first_only: bool) -> hl.Expr:
        """Return whether the pixel lies inside the frame before."""
        return self.near[X, Y, self._get_way(first_only), self.u, self.v][0] != 0

    def read(self, image: hl.ImageParam, count: int, first_only: bool = False) -> list[hl.Expr]:
        """Return the channels of an image at a pixel; they lie together in memory and are copied at once."""
        func = hl.Func(f"gathered{len(self.gathered)}")
        axes = [X, Y, self.u, self.v] if first_only else [X, Y, self.way, self.u, self.v]
        index = self.near[X, Y, self._get_way(first_only), self.u, self.v][1]
        index = hl.unsafe_promise_clamped(index, 0, self.width * self.height - 1)
        func[(C, *axes)] = image[C, index] if image.dimensions() == 2 else image[index]
        self.gathered.append(Gathered(func, count, first_only))
        return [func[(k, *axes)] for k in range(count)]

    def _get_way(self, first_only: bool) -> hl.Expr:
        return hl.i32(0) if first_only else self.way


def make_reprojection(features: Sequence[Feature], virtual_from: int | None = None) -> ReprojectionFuncs:
    """Return the algorithm; ``virtual_from`` is the first feature compared at a second place, if there is one.

    A place is the column and row of a pixel in the frame before, pixel centres at whole numbers. Images of this frame
    must be at least as wide as a vector.
    """
    signature = Signature("reprojection")
    # The sums lie channel by channel in memory.
    past_sums = signature.image("past", "pixels", HISTORY_CHANNELS, strides=(1, None))
    names = ("places",) if virtual_from is None else ("places", "virtual_places")
    places = [signature.image(name, "height", "width", 2) for name in names]
    mask_before = signature.image("mask_before", "pixels", type=hl.UInt(8))
    mask_now = signature.image("mask", "height", "width", type=hl.UInt(8))
    arrays_before = declare_features(signature, "before", features, "pixels")
    arrays_now = declare_features(signature, "own", features, "height", "width")
    scalars = declare_scalars(signature, features)
    memory = signature.number("memory")
    width, height = (signature.count(name, 1) for name in ("width_before", "height_before"))
    for name in REPROJECTED:
        signature.output(name, "height", "width")

    past = PastPixels(width, height, len(places))
    now = make_guide_planes("own", mask_now, features, scalars, inside=True, arrays=arrays_now)
    beyond = past.find(places)
    similarity, known = _compare(past, features, scalars, now, (mask_before, arrays_before), virtual_from)
    held = past.read(past_sums, HISTORY_CHANNELS)
    # Drop a history that is not a number: it would spread by a pixel with every frame, even with weight 0.
    usable = known & (mask_now[X, Y] != 0) & ~expressions.is_bad(sum(held[1:], held[0]))
    past.stage(*(hl.select(usable, value, hl.f32(0.0)) for value in (similarity, *held)))
    sums, taps = _gather(past, beyond)
    found, agreement = _mix(past, sums)
    out = hl.Func("out")
    out[X, Y] = hl.Tuple([*found.fade(memory), agreement])
    return ReprojectionFuncs(out, signature, sums, taps, now, past)


def _compare(
    past: PastPixels,
    features: Sequence[Feature],
    scalars: Sequence[Sequence[hl.Expr]],
    now: GuidePlanes,
    before: tuple[hl.ImageParam, Sequence[hl.ImageParam]],
    virtual_from: int | None,
) -> tuple[hl.Expr, hl.Expr]:
    """Return the similarity of a pixel to one of the four, and whether the latter has meaning."""
    mask, arrays = before
    counts = count_inputs(features)
    here = [now.read(layout, X, Y) for layout in now.layouts]
    zero = hl.f32(0.0)

    def compare(part: slice, first_only: bool, keep: Callable[..., Any]) -> tuple[hl.Expr, hl.Expr]:
        """Return the log-similarity of some features, and whether the pixel before has meaning."""
        chosen, own = features[part], scalars[part]
        known = past.is_inside(first_only) & (past.read(mask, 1, first_only)[0] != 0)
        first = len(count_inputs(features[: part.start]))
        inputs = slice(first, first + len(count_inputs(chosen)))
        pairs = zip(arrays[inputs], counts[inputs], strict=True)
        channels = [value for array, count in pairs for value in past.read(array, count, first_only)]
        values, layouts = prepare_planes(chosen, own, neutralize(chosen, channels, known))
        if values:
            seen = keep(*values)
            values = [seen[k] for k in range(len(values))] if len(values) > 1 else [seen]
        exponent: hl.Expr = zero
        for feature, i, layout, parameters in zip(chosen, here[part], layouts, own, strict=True):
            exponent = exponent + feature.log2_similarity(
                i, layout.read(values.__getitem__), parameters, (zero, zero), keep
            )
        return exponent, known

    exponent, known = compare(slice(virtual_from or 0, len(features)), False, past.stage)
    if virtual_from:
        # These features count only at the surface's place, so they are read only there.
        surface = past.surface_stage(compare(slice(0, virtual_from), True, past.surface_stage)[0])
        exponent = exponent + hl.select(past.way == 0, surface, zero)
    return expressions.exp2(exponent), known


def _gather(past: PastPixels, beyond: tuple[hl.Expr, hl.Expr]) -> tuple[hl.Func, hl.RDom]:
    """Return the weighted sums over the four pixels of each place, with the agreement; and the taps."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    taps = hl.RDom([(0, 2), (0, 2)], "taps")
    at = X, Y, past.way
    told = past.stages[-1][(*at, taps.x, taps.y)]
    agrees, held = told[0], Sums(*(told[1 + k] for k in range(HISTORY_CHANNELS)))
    right, down = beyond
    bilinear = hl.select(taps.x == 0, one - right, right) * hl.select(taps.y == 0, one - down, down)
    weight = bilinear * agrees
    taken = Sums(*(weight * value for value in held))
    taken = taken._replace(squared_weight=weight * agrees * held.squared_weight)
    sums = hl.Func("sums")
    sums[at] = hl.Tuple([zero] * len(REPROJECTED))
    sums[at] = hl.Tuple([sums[at][k] + value for k, value in enumerate([*taken, weight * one])])
    return sums, taps


def _mix(past: PastPixels, sums: hl.Func) -> tuple[Sums, hl.Expr]:
    """Return the sums and the agreement, mixed if there are two places."""
    found = [sums[X, Y, 0][k] for k in range(len(REPROJECTED))]
    if past.way_count > 1:
        other = [sums[X, Y, 1][k] for k in range(len(REPROJECTED))]
        square, other_square = (each[AGREEMENT] * each[AGREEMENT] for each in (found, other))
        share = other_square / hl.max(square + other_square, hl.f32(1e-12))
        found = [value + share * (second - value) for value, second in zip(found, other, strict=True)]
    return Sums(*found[:AGREEMENT]), found[AGREEMENT]
