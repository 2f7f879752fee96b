"""The kernels that reproject a history: they find a pixel's place in the frame before, and gather the sums there.

``out_i = sum_k b_k v(i, k) past_k`` (``v^2`` for squared weights) over the four pixels k of the frame before around the
place that pixel i came from. b are the bilinear weights, v is the product of the features' similarities between pixel i
of this frame and pixel k of the frame before.

The sums are described in `lobewise.filters.history.sums`. The output has one more channel, ``a = sum_k b_k v(i, k)``,
the agreement of the place, 0 to 1 (up to the error of `exp2`).

A pixel may come from two places, that of its surface and that of its reflection. Their sums are mixed by ``a^2``, so
that the place with more agreement counts more. Then all weights are multiplied by the memory.

On processors the pixels of a vector are examined together. Where all of them moved by the same whole number of pixels,
as most do under a camera that moves smoothly, the pixels of the frame before are loaded as vectors too. Elsewhere they
are loaded one by one, and a place that no pixel of the vector has is skipped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Feature
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums
from lobewise.filters.planes import GuidePlanes, Layout, X, Y, count_inputs, make_guide_planes, prepare_planes

AGREEMENT = HISTORY_CHANNELS
"""Channel of the agreement, after the sums."""
REPROJECTED = (*Sums._fields, "agreement")
"""The output planes of a reprojection."""

SNAP_PIXELS = 2e-3
"""Distance from a pixel's centre within which a place is moved to the centre, pixels: rounding must not blur."""
OUTSIDE = -2.0
"""Column or row of a place that is not near the image."""
NEAR = 1 << 8
"""What each pixel of a vector whose place is near the image adds to the vector's code; a stray pixel adds 1."""
NOWHERE, TOGETHER, APART = range(3)
"""No pixel of a vector has a place near the image; all moved by the same whole number of pixels; or neither."""

LANE, VECTOR = hl.Var("lane"), hl.Var("vector")
"""Pixel within a vector, and number of the vector within its row."""


@dataclass
class PreparationFuncs:
    """The Halide functions that compute planes, for their schedules."""

    out: hl.Func
    signature: Signature
    own: GuidePlanes


@dataclass
class VectorFuncs:
    """The Halide functions that tell how the pixels of a vector moved."""

    code: hl.Func
    """Number of stray pixels, plus `NEAR` times the number of pixels whose place is near the image."""
    lanes: hl.RDom
    """Domain of the code."""
    way: hl.Func
    """One of `NOWHERE`, `TOGETHER`, `APART`."""


@dataclass
class WayFuncs:
    """The Halide functions of one place of each pixel."""

    spots: hl.Func
    """Column and row of the place's first pixel, and the fractions beyond it."""
    sums: hl.Func
    judged: VectorFuncs | None = None
    """How the pixels of a vector moved; None where each pixel has a thread."""
    taps: list[hl.RDom] = field(default_factory=list)
    """The four pixels of the place, once for each way of loading them: as vectors, then one by one."""


@dataclass
class ReprojectionFuncs:
    """The Halide functions of a reprojection, for its schedules."""

    out: hl.Func
    signature: Signature
    pixels: hl.RDom | None
    """Domain of the output, by lane and vector; None where each pixel has a thread."""
    found: hl.Func
    ways: list[WayFuncs]


def _lay_out(features: Sequence[Feature]) -> tuple[list[hl.Expr], list[Layout]]:
    """Return the planes of a pixel without meaning, and each feature's place among the planes."""
    neutral = [hl.f32(value) for feature in features for value in feature.neutral]
    scalars = [[hl.f32(1.0)] * len(feature.get_parameters()) for feature in features]
    return prepare_planes(features, scalars, neutral)


def make_preparation(features: Sequence[Feature]) -> PreparationFuncs:
    """Return the kernel that computes the planes of every pixel; ``features`` have at least one array."""
    signature = Signature("preparation")
    mask = signature.image("mask", "height", "width", type=hl.UInt(8))
    arrays = declare_features(signature, "own", features, "height", "width")
    scalars = declare_scalars(signature, features)
    own = make_guide_planes("own", mask, features, scalars, arrays, inside=True)
    out = hl.Func("out")
    planes = own.planes
    assert planes is not None and sum(count_inputs(features)) > 0
    out[X, Y] = hl.Tuple([planes[X, k, Y] for k in range(own.plane_count)])
    for k in range(own.plane_count):
        signature.output(f"plane{k}", "height", "width")
    return PreparationFuncs(out, signature, own)


class _Frames:
    """The parameters of a reprojection: images of both frames, and the size of the frame before."""

    def __init__(self, features: Sequence[Feature], way_count: int) -> None:
        self.signature = signature = Signature("reprojection")
        names = ("places", "virtual_places")[:way_count]
        self.places = [signature.image(name, "height", "width", 2) for name in names]
        self.mask = signature.image("mask", "height", "width", type=hl.UInt(8))
        # Planes lie one after the other in memory.
        before = "height_before", "width_before"
        self.past = signature.image("past", HISTORY_CHANNELS, *before)
        self.mask_before = signature.image("mask_before", *before, type=hl.UInt(8))
        neutral, self.layouts = _lay_out(features)
        self.planes: Any = None
        self.planes_before: Any = None
        if neutral:
            self.planes = signature.image("planes", len(neutral), "height", "width")
            self.planes_before = signature.image("planes_before", len(neutral), *before)
        self.features = features
        self.scalars = declare_scalars(signature, features)
        self.memory = signature.number("memory")
        self.columns, self.rows = (signature.count(name, 1) for name in ("columns", "rows"))
        for name in REPROJECTED:
            signature.output(name, "height", "width")

    def compare(self, first: int, here: tuple[hl.Expr, hl.Expr], there: tuple[hl.Expr, hl.Expr]) -> hl.Expr:
        """Return the similarity of a pixel and a pixel of the frame before by the features from ``first`` on."""
        zero = hl.f32(0.0)
        exponent: hl.Expr = zero
        now, before = self.planes, self.planes_before
        chosen = zip(self.features[first:], self.layouts[first:], self.scalars[first:], strict=True)
        for feature, layout, parameters in chosen:
            i = layout.read(lambda k: now[(*here, k)])
            j = layout.read(lambda k: before[(*there, k)])
            exponent = exponent + feature.log2_similarity(i, j, parameters, (zero, zero), lambda value: value)
        return expressions.exp2(exponent)

    def read_past(self, at: tuple[hl.Expr, hl.Expr]) -> list[hl.Expr]:
        """Return the sums of a pixel of the frame before."""
        return [self.past[(*at, k)] for k in range(HISTORY_CHANNELS)]


def make_reprojection(features: Sequence[Feature], virtual_from: int | None, lanes: int) -> ReprojectionFuncs:
    """Return the kernel that gathers histories.

    A place is the column and row of a pixel in the frame before, pixel centres at whole numbers. All images must be at
    least as wide as a vector.

    Parameters
    ----------
    features : sequence of Feature
        Features whose planes are compared.
    virtual_from : int, optional
        Index of the first feature that is compared at a second place, if there is one.
    lanes : int
        Pixels of a vector; 1 for devices on which each pixel has a thread.
    """
    frames = _Frames(features, 1 if virtual_from is None else 2)
    width = frames.mask.width()

    def find_column(lane: hl.Expr, vector: hl.Expr) -> hl.Expr:
        """Return the column of a pixel. The last vector of a row ends with the row."""
        return hl.min(vector * lanes, width - lanes) + lane if lanes > 1 else vector

    own = find_column(LANE, VECTOR), Y
    starts = [0] if virtual_from is None else [0, virtual_from]
    ways = [
        _make_way(frames, place, start, own, lanes, name)
        for place, start, name in zip(frames.places, starts, ("surface", "virtual"), strict=False)
    ]
    at = LANE, VECTOR, Y
    mixed, agreement = _mix([[way.sums[at][k] for k in range(len(REPROJECTED))] for way in ways])
    found = hl.Func("found")
    found[at] = hl.Tuple([*mixed.fade(frames.memory), agreement])
    out, pixels = hl.Func("out"), None
    count = len(REPROJECTED)
    if lanes == 1:
        out[X, Y] = hl.Tuple([found[0, X, Y][k] for k in range(count)])
    else:
        pixels = hl.RDom([(0, lanes), (0, (width + (lanes - 1)) / lanes)], "pixels")
        out[X, Y] = hl.Tuple([hl.undef(hl.Float(32))] * count)
        result = found[pixels.x, pixels.y, Y]
        out[find_column(pixels.x, pixels.y), Y] = hl.Tuple([result[k] for k in range(count)])
    return ReprojectionFuncs(out, frames.signature, pixels, found, ways)


def _find_spot(raw: hl.Expr, length: hl.Expr) -> tuple[hl.Expr, hl.Expr]:
    """Return the column or row of a place's first pixel, and the fraction beyond it.

    Places far outside the image, and NaN, must not become an index.
    """
    near = (raw > hl.f32(-1.0)) & (raw < hl.f32(length))
    value = hl.select(near, raw, hl.f32(OUTSIDE))
    whole = hl.floor(value + hl.f32(0.5))
    value = hl.select(hl.abs(value - whole) < hl.f32(SNAP_PIXELS), whole, value)
    first = hl.floor(value)
    return hl.i32(first), value - first


def _make_way(
    frames: _Frames, place: hl.ImageParam, start: int, own: tuple[hl.Expr, hl.Expr], lanes: int, name: str
) -> WayFuncs:
    """Return the sums at one place of each pixel, by the features from ``start`` on."""
    at = LANE, VECTOR, Y
    spots = hl.Func(f"{name}_spots")
    extents = frames.columns, frames.rows
    spots[at] = hl.Tuple([value for k in range(2) for value in _find_spot(place[(k, *own)], extents[k])])
    sums = hl.Func(f"{name}_sums")
    count = len(REPROJECTED)
    sums[at] = hl.Tuple([hl.f32(0.0)] * count)
    way = WayFuncs(spots, sums)
    if lanes > 1:
        way.judged = _judge_vectors(frames, spots, lanes, name)
    for loading in (TOGETHER, APART) if way.judged is not None else (APART,):
        taps = hl.RDom([(0, 2), (0, 2)], f"{name}_taps{loading}")
        if way.judged is not None:
            # The test stands outside the arithmetic, so that a vector computes one of the two ways only.
            taps.where(way.judged.way[VECTOR, Y] == loading)
        taken = _weigh_tap(frames, spots, (start, own), (taps.x, taps.y), lanes if loading == TOGETHER else 0)
        sums[at] = hl.Tuple([sums[at][k] + taken[k] for k in range(count)])
        way.taps.append(taps)
    return way


def _judge_vectors(frames: _Frames, spots: hl.Func, lanes: int, name: str) -> VectorFuncs:
    """Return the functions that tell how the pixels of a vector moved."""
    at = VECTOR, Y
    domain = hl.RDom([(0, lanes)], f"{name}_lanes")
    first, here = spots[(0, *at)], spots[(domain.x, *at)]
    stray = (here[0] - domain.x != first[0]) | (here[2] != first[2])
    near = (here[0] > int(OUTSIDE)) & (here[2] > int(OUTSIDE))
    code, way = hl.Func(f"{name}_code"), hl.Func(f"{name}_way")
    code[at] = 0
    code[at] = code[at] + hl.select(stray, 1, 0) + hl.select(near, NEAR, 0)
    inside = (first[0] >= 0) & (first[0] + lanes < frames.columns) & (first[2] >= 0) & (first[2] + 1 < frames.rows)
    together = (code[at] % NEAR == 0) & inside
    way[at] = hl.select(code[at] < NEAR, NOWHERE, together, TOGETHER, APART)
    return VectorFuncs(code, domain, way)


def _weigh_tap(
    frames: _Frames,
    spots: hl.Func,
    compared: tuple[int, tuple[hl.Expr, hl.Expr]],
    step: tuple[hl.Expr, hl.Expr],
    lanes: int,
) -> list[hl.Expr]:
    """Return the weighted sums of one of the four pixels of a place, and the weight.

    With ``lanes`` the pixels of a vector lie side by side in the frame before, inside it.
    """
    start, own = compared
    (u, v), zero, one = step, hl.f32(0.0), hl.f32(1.0)
    column, right, row, down = (spots[LANE, VECTOR, Y][k] for k in range(4))
    width, height = frames.mask_before.width(), frames.mask_before.height()
    if lanes:
        first = spots[0, VECTOR, Y]
        inside = hl.Expr(True)
        there = (
            hl.unsafe_promise_clamped(first[0], 0, width - (lanes + 1)) + LANE + u,
            hl.unsafe_promise_clamped(first[2], 0, height - 2) + v,
        )
    else:
        inside = (column + u >= 0) & (column + u < frames.columns) & (row + v >= 0) & (row + v < frames.rows)
        there = (
            hl.unsafe_promise_clamped(hl.clamp(column + u, 0, frames.columns - 1), 0, width - 1),
            hl.unsafe_promise_clamped(hl.clamp(row + v, 0, frames.rows - 1), 0, height - 1),
        )
    held = frames.read_past(there)
    # Drop a history that is not a number: it would spread by a pixel with every frame, even with weight 0.
    usable = inside & (frames.mask_before[there] != 0) & (frames.mask[own] != 0)
    usable = usable & ~expressions.is_bad(sum(held[1:], held[0]))
    agrees = hl.select(usable, frames.compare(start, own, there), zero)
    weight = hl.select(u == 0, one - right, right) * hl.select(v == 0, one - down, down) * agrees
    factors = Sums(*[weight] * HISTORY_CHANNELS)._replace(squared_weight=weight * agrees)
    return [*(hl.select(usable, factor * value, zero) for factor, value in zip(factors, held, strict=True)), weight]


def _mix(ways: Sequence[Sequence[hl.Expr]]) -> tuple[Sums, hl.Expr]:
    """Return the sums and the agreement, mixed if there are two places."""
    found = list(ways[0])
    if len(ways) > 1:
        other = ways[1]
        square, other_square = (each[AGREEMENT] * each[AGREEMENT] for each in (found, other))
        share = other_square / hl.max(square + other_square, hl.f32(1e-12))
        found = [value + share * (second - value) for value, second in zip(found, other, strict=True)]
    return Sums(*found[:AGREEMENT]), found[AGREEMENT]
