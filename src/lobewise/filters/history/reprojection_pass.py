"""The kernels that reproject: they find a pixel's place in the frame before, and gather its planes there.

``out_i = sum_k b_k v(i, k) past_k`` (``v^2`` for squared weights) over the four pixels k of the frame before around the
place that pixel i came from. b are the bilinear weights, v is the product of the features' similarities between pixel i
of this frame and pixel k of the frame before.

The planes are the channels of images, or the sums of a history (`lobewise.filters.history.sums`). The output has one
more plane, ``a = sum_k b_k v(i, k)``, the agreement of the place, 0 to 1 (up to the error of `exp2`).

A pixel may come from two places, that of its surface and that of its reflection. Their sums are mixed by ``a^2``, so
that the place with more agreement counts more. Then all weights are multiplied by the memory.

On processors the pixels of a vector are examined together. They are cut into runs: neighbours that moved by the same
whole number of pixels. Under a camera that moves smoothly most vectors are one run. The pixels of the frame before are
loaded as vectors, once for each run. Only near the border of the image they are loaded one by one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.pointwise import is_finite
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Feature
from lobewise.filters.history.sums import HISTORY_CHANNELS
from lobewise.filters.history.vectors import LANE, VECTOR, Pixels, Place
from lobewise.filters.planes import Layout, X, Y, count_inputs, make_guide_planes, prepare_planes
from lobewise.filters.scheduling import count_lanes, keep_rows, spread_pixels
from lobewise.filters.weigh import U, V

AGREEMENT = HISTORY_CHANNELS
"""Channel of the agreement, after the sums of a history."""
SQUARED_WEIGHT = "squared_weight"
"""Name of the plane that counts by the square of the similarity and of the memory."""

SNAP_PIXELS = 2e-3
"""Distance from a pixel's centre within which a place is moved to the centre, pixels: rounding must not blur."""
OUTSIDE = -2.0
"""Column or row of a place that is not near the image."""
NEAR = 1 << 8
"""What each pixel of a vector whose place is near the image adds to the vector's code; a stray pixel adds 1."""
NOWHERE, IN_RUNS, APART = range(3)
"""No pixel of a vector has a place near the image; the pixels are loaded as vectors, run by run, or one by one."""

TAPS = ((0, 0), (1, 0), (0, 1), (1, 1))
"""The four pixels of a place."""
ROWS_PER_TASK = 8
"""Rows that a thread of a processor takes at a time."""


@dataclass(frozen=True)
class Runs:
    """The functions that cut vectors into runs."""

    code: hl.Func
    """Number of stray pixels, plus `NEAR` times the number of pixels whose place is near the image."""
    run: hl.Func
    """For each pixel the number of its run, and the column of lane 0 and the row that its run has."""
    starts: hl.Func
    """For each run the column of lane 0, and the row."""
    outside: hl.Func
    """Number of pixels whose run cannot be loaded as a vector inside the image."""
    way: hl.Func
    """One of `NOWHERE`, `IN_RUNS`, `APART`."""


@dataclass
class Way:
    """The functions of one place of each pixel."""

    spots: hl.Func
    """Column and row of the place's first pixel, and the fractions beyond it."""
    sums: hl.Func
    """Of the planes; an update for each of ``agrees`` that adds nothing where the vector is loaded another way."""
    runs: Runs | None = None
    """How the pixels of a vector moved; None where each pixel has a thread."""
    agrees: list[hl.Func] = field(default_factory=list)
    """Similarity to each of the four pixels, 0 where a pixel has no history."""


def _lay_out(features: Sequence[Feature]) -> tuple[list[hl.Expr], list[Layout]]:
    """Return the planes of a pixel without meaning, and each feature's place among the planes."""
    neutral = [hl.f32(value) for feature in features for value in feature.neutral]
    scalars = [[hl.f32(1.0)] * len(feature.get_parameters()) for feature in features]
    return prepare_planes(features, scalars, neutral)


def make_preparation(features: Sequence[Feature], target: hl.Target) -> Scheduled:
    """Return the kernel that computes the planes of every pixel, for processors; a feature has an array."""
    # Signature
    signature = Signature("preparation")
    mask = signature.image("mask", "height", "width", type=hl.UInt(8))
    arrays = declare_features(signature, "own", features, "height", "width")
    scalars = declare_scalars(signature, features)

    # Algorithm
    own, out = make_guide_planes("own", mask, features, scalars, arrays, inside=True), hl.Func("out")
    planes = own.planes
    assert planes is not None and sum(count_inputs(features)) > 0
    out[X, Y] = hl.Tuple([planes[X, k, Y] for k in range(own.plane_count)])
    for k in range(own.plane_count):
        signature.output(f"plane{k}", "height", "width")

    # Schedule: rows in parallel, columns in vectors
    xi, xo, lanes = hl.Var("xi"), hl.Var("xo"), int(target.natural_vector_size(hl.Float(32)))
    out.split(X, xo, xi, lanes, hl.TailStrategy.ShiftInwards).reorder(xi, xo, Y).vectorize(xi)
    out.parallel(Y, ROWS_PER_TASK, hl.TailStrategy.GuardWithIf).never_partition_all()
    for func, channels in ((own.guides, own.guide_count), (planes, own.plane_count)):
        if func is not None:
            keep_rows(func.compute_at(out, xo), channels, lanes)
    return Scheduled([out], signature)


class _Frames:
    """The parameters of a reprojection: images of both frames, and the size of the frame before."""

    def __init__(self, features: Sequence[Feature], way_count: int, past: Sequence[str]) -> None:
        self.signature = signature = Signature("reprojection")
        names = ("places", "virtual_places")[:way_count]
        self.places = [signature.image(name, "height", "width", 2) for name in names]
        self.mask = signature.image("mask", "height", "width", type=hl.UInt(8))
        # Planes lie one after the other in memory.
        before = "height_before", "width_before"
        self.names = past
        self.past = signature.image("past", len(past), *before)
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
        for name in (*past, "agreement"):
            signature.output(name, "height", "width")

    def compare(self, first: int, here: Place, there: Place) -> hl.Expr:
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

    def read_past(self, at: Place) -> list[hl.Expr]:
        """Return the planes of a pixel of the frame before."""
        return [self.past[(*at, k)] for k in range(len(self.names))]

    def scale_squared(self, values: Sequence[hl.Expr], factor: hl.Expr) -> list[hl.Expr]:
        """Return a value of each plane, times ``factor`` for squared weights."""
        pairs = zip(self.names, values, strict=True)
        return [value * factor if name == SQUARED_WEIGHT else value for name, value in pairs]


def make_reprojection(
    features: Sequence[Feature], virtual_from: int | None, past: Sequence[str], target: hl.Target
) -> Scheduled:
    """Return the kernel that gathers the planes of a frame before.

    A place is the column and row of a pixel in the frame before, pixel centres at whole numbers. All images must be at
    least as wide as a vector.

    Parameters
    ----------
    features : sequence of Feature
        Features whose planes are compared.
    virtual_from : int, optional
        Index of the first feature that is compared at a second place, if there is one.
    past : sequence of str
        Names of the planes.
    target : halide.Target
    """
    # Signature
    frames = _Frames(features, 1 if virtual_from is None else 2, past)

    # Algorithm
    pixels = Pixels(frames.mask.width(), max(count_lanes(target), 1))
    starts = [0] if virtual_from is None else [0, virtual_from]
    ways = [
        _make_way(frames, place, start, pixels, name)
        for place, start, name in zip(frames.places, starts, ("surface", "virtual"), strict=False)
    ]
    *mixed, agreement = _mix([[way.sums[pixels.at][k] for k in range(len(past) + 1)] for way in ways])
    faded = frames.scale_squared([value * frames.memory for value in mixed], frames.memory)
    out = pixels.write(*faded, agreement)

    # Schedule
    if pixels.lanes == 1:
        _spread(out, pixels, ways)
    else:
        _vectorize(out, pixels, ways)
    return Scheduled([out], frames.signature)


def _spread(out: hl.Func, pixels: Pixels, ways: Sequence[Way]) -> None:
    """On graphics cards give each pixel a thread, which gathers the four pixels of each place."""
    thread = spread_pixels(out, X, Y)
    for func in (*pixels.once, *(each for way in ways for each in (way.sums, way.spots, *way.agrees))):
        func.compute_at(out, thread)


def _vectorize(out: hl.Func, pixels: Pixels, ways: Sequence[Way]) -> None:
    """Run rows in parallel and columns in vectors. Every value of a vector stays in registers or the nearest cache."""
    lane, vector = out.rvars()
    # No two vectors of a row differ where they overlap.
    update = out.update().reorder(lane, vector, Y).allow_race_conditions().vectorize(lane)
    update.parallel(Y, ROWS_PER_TASK, hl.TailStrategy.GuardWithIf).never_partition_all()

    def keep(func: hl.Func) -> hl.Func:
        return func.compute_at(out, vector).bound(LANE, 0, pixels.lanes).vectorize(LANE)

    for func in (*pixels.once, *(each for way in ways for each in (way.spots, way.sums))):
        keep(func)
    for way in ways:
        for number, agrees in enumerate(way.agrees):
            keep(agrees).update().vectorize(LANE)
            way.sums.update(number).reorder(LANE, *way.sums.rvars(number), VECTOR, Y).vectorize(LANE)
        if way.runs is None:
            continue
        for func in (way.runs.code, way.runs.outside):
            func.compute_at(out, vector).update().atomic().vectorize(func.rvars()[0])
        for func in (way.runs.run, way.runs.starts):
            # Each pixel needs the one before it.
            keep(func).update().unscheduled()
        way.runs.way.compute_at(out, vector)


def _split_place(raw: hl.Expr, length: hl.Expr, usable: hl.Expr) -> tuple[hl.Expr, hl.Expr]:
    """Return the column or row of a place's first pixel, and the fraction beyond it.

    Places far outside the image, and NaN, must not become an index. A pixel that is not usable has no place.
    """
    # Comparisons do not tell NaN from numbers: the compiler may assume that there is none.
    near = usable & is_finite(raw) & (raw > hl.f32(-1.0)) & (raw < hl.f32(length))
    value = hl.select(near, raw, hl.f32(OUTSIDE))
    whole = hl.floor(value + hl.f32(0.5))
    value = hl.select(hl.abs(value - whole) < hl.f32(SNAP_PIXELS), whole, value)
    first = hl.floor(value)
    return hl.i32(first), value - first


def _make_way(frames: _Frames, place: hl.ImageParam, start: int, pixels: Pixels, name: str) -> Way:
    """Return the sums at one place of each pixel, by the features from ``start`` on."""
    at, own, lanes = pixels.at, pixels.place, pixels.lanes
    spots = hl.Func(f"{name}_spots")
    extents = frames.columns, frames.rows
    usable = frames.mask[own] != 0
    spots[at] = hl.Tuple([value for k in range(2) for value in _split_place(place[(k, *own)], extents[k], usable)])
    sums = hl.Func(f"{name}_sums")
    sums[at] = hl.Tuple([hl.f32(0.0)] * (len(frames.names) + 1))
    way = Way(spots, sums)
    if lanes > 1:
        way.runs = _cut_vectors(frames, spots, lanes, name)
        _add_runs(frames, way, (start, own), lanes, name)
    _add_apart(frames, way, (start, own), name)
    return way


def _add_runs(frames: _Frames, way: Way, compared: tuple[int, Place], lanes: int, name: str) -> None:
    """Add the pixels of vectors that are loaded run by run to the sums."""
    at = LANE, VECTOR, Y
    judged = way.runs
    assert judged is not None
    runs = hl.RDom([(0, lanes)], f"{name}_runs")
    # The test stands outside the arithmetic, so that a vector is loaded in one way only.
    runs.where((judged.way[VECTOR, Y] == IN_RUNS) & (runs.x <= judged.run[lanes - 1, VECTOR, Y][0]))
    here = (judged.run[at][0] == runs.x) & _is_near(way.spots[at])
    first_column, row = (judged.starts[runs.x, VECTOR, Y][k] for k in range(2))
    width, height = frames.mask_before.width(), frames.mask_before.height()
    column = hl.unsafe_promise_clamped(first_column, 0, width - (lanes + 1)) + LANE
    row = hl.unsafe_promise_clamped(row, 0, height - 2)
    there = [(column + u, row + v) for u, v in TAPS]
    # The similarities are a function of their own: each of the sums would compute them again.
    agrees = hl.Func(f"{name}_agrees_in_runs")
    agrees[at] = hl.Tuple([hl.f32(0.0)] * len(TAPS))
    similar = [_compare_tap(frames, *compared, place, hl.Expr(True)) for place in there]
    agrees[at] = hl.Tuple([hl.select(here, value, agrees[at][k]) for k, value in enumerate(similar)])
    similar = [hl.select(here, agrees[at][k], hl.f32(0.0)) for k in range(len(TAPS))]
    _add_taps(frames, way, similar, there)
    way.agrees.append(agrees)


def _add_apart(frames: _Frames, way: Way, compared: tuple[int, Place], name: str) -> None:
    """Add the pixels that are loaded one by one to the sums."""
    at = LANE, VECTOR, Y
    # One entry, 0, so that the update has a condition.
    once = hl.RDom([(0, 1)], f"{name}_once")
    if way.runs is not None:
        once.where(way.runs.way[VECTOR, Y] + once.x == APART)
    width, height = frames.mask_before.width(), frames.mask_before.height()
    spot = way.spots[at]

    def find(u: Any, v: Any) -> tuple[Place, hl.Expr]:
        column, row = spot[0] + u + once.x, spot[2] + v
        inside = (column >= 0) & (column < frames.columns) & (row >= 0) & (row < frames.rows)
        return (
            hl.unsafe_promise_clamped(hl.clamp(column, 0, frames.columns - 1), 0, width - 1),
            hl.unsafe_promise_clamped(hl.clamp(row, 0, frames.rows - 1), 0, height - 1),
        ), inside

    # A loop over the four pixels, because loads one by one are much code.
    agrees = hl.Func(f"{name}_agrees_apart")
    agrees[(*at, U, V)] = hl.undef(hl.Float(32))
    agrees[(*at, U, V)] = _compare_tap(frames, *compared, *find(U, V))
    _add_taps(frames, way, [agrees[(*at, *tap)] for tap in TAPS], [find(*tap)[0] for tap in TAPS])
    way.agrees.append(agrees)


def _cut_vectors(frames: _Frames, spots: hl.Func, lanes: int, name: str) -> Runs:
    """Return the functions that cut vectors into runs."""
    at = VECTOR, Y
    domains = [
        hl.RDom([(0, lanes)], f"{name}_{part}") for part in ("code_lanes", "run_lanes", "starts_lanes", "outside_lanes")
    ]
    code, run, starts, outside, way = (
        hl.Func(f"{name}_{part}") for part in ("code", "run", "starts", "outside", "way")
    )
    first = spots[(0, *at)]

    lane = domains[0].x
    here = spots[(lane, *at)]
    stray = (here[0] - lane != first[0]) | (here[2] != first[2])
    code[at] = 0
    code[at] = code[at] + hl.select(stray, 1, 0) + hl.select(_is_near(here), NEAR, 0)
    is_cut = (code[at] > NEAR) & (code[at] % NEAR != 0)

    # A vector whose pixels moved together is run 0.
    run[LANE, VECTOR, Y] = hl.Tuple([0, first[0], first[2]])
    domains[1].where(is_cut)
    lane = domains[1].x
    here, before = spots[(lane, *at)], run[(hl.max(lane - 1, 0), *at)]
    number = hl.select(lane == 0, -1, before[0])
    column = here[0] - lane
    begins = _is_near(here) & ((number < 0) | (column != before[1]) | (here[2] != before[2]))
    # A pixel without a place belongs to any run.
    places = (hl.select(begins, new, old) for new, old in ((column, before[1]), (here[2], before[2])))
    run[(lane, *at)] = hl.Tuple([number + hl.select(begins, 1, 0), *places])

    starts[LANE, VECTOR, Y] = hl.Tuple([first[0], first[2]])
    domains[2].where(is_cut)
    mine = run[(domains[2].x, *at)]
    # Pixels before the first run write to its place first.
    starts[(hl.clamp(mine[0], 0, lanes - 1), *at)] = hl.Tuple([mine[1], mine[2]])

    mine = run[(domains[3].x, *at)]
    fits = (mine[1] >= 0) & (mine[1] + lanes < frames.columns) & (mine[2] >= 0) & (mine[2] + 1 < frames.rows)
    outside[at] = 0
    outside[at] = outside[at] + hl.select(fits | (mine[0] < 0), 0, 1)
    way[at] = hl.select(code[at] < NEAR, NOWHERE, outside[at] == 0, IN_RUNS, APART)
    return Runs(code, run, starts, outside, way)


def _is_near(spot: Sequence[hl.Expr]) -> hl.Expr:
    """Return whether a place is near the image."""
    return (spot[0] > int(OUTSIDE)) & (spot[2] > int(OUTSIDE))


def _compare_tap(frames: _Frames, start: int, own: Place, there: Place, inside: hl.Expr) -> hl.Expr:
    """Return the similarity to a pixel of the frame before; 0 if that pixel has no meaning or a plane is no number."""
    held = frames.read_past(there)
    usable = inside & (frames.mask_before[there] != 0)
    # A history that is not a number would spread by a pixel with every frame, even with weight 0.
    usable = usable & ~expressions.is_bad(sum(held[1:], held[0]))
    return hl.select(usable, frames.compare(start, own, there), hl.f32(0.0))


def _add_taps(frames: _Frames, way: Way, similar: Sequence[hl.Expr], there: Sequence[Place]) -> None:
    """Add the weighted planes of the four pixels of a place to the sums, with the weights."""
    at = LANE, VECTOR, Y
    zero, one = hl.f32(0.0), hl.f32(1.0)
    _, right, _, down = (way.spots[at][k] for k in range(4))
    totals = [way.sums[at][k] for k in range(len(frames.names) + 1)]
    for agrees, (u, v), place in zip(similar, TAPS, there, strict=True):
        weight = (right if u else one - right) * (down if v else one - down) * agrees
        factors = frames.scale_squared([weight] * len(frames.names), agrees)
        # A pixel with a plane that is not a number has similarity 0.
        pairs = zip(factors, frames.read_past(place), strict=True)
        taken = [*(hl.select(agrees > zero, factor * value, zero) for factor, value in pairs), weight]
        totals = [total + value for total, value in zip(totals, taken, strict=True)]
    way.sums[at] = hl.Tuple(totals)


def _mix(ways: Sequence[Sequence[hl.Expr]]) -> list[hl.Expr]:
    """Return the planes and the agreement, mixed if there are two places."""
    mixed = list(ways[0])
    if len(ways) > 1:
        other = ways[1]
        square, other_square = (each[-1] * each[-1] for each in (mixed, other))
        share = other_square / hl.max(square + other_square, hl.f32(1e-12))
        mixed = [value + share * (second - value) for value, second in zip(mixed, other, strict=True)]
    return mixed
