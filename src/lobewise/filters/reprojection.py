"""What a pixel brings along from the frame before, as a Halide algorithm: the history's sums, found, judged, gathered.

``out_i = sum_k b_k v(i, k) past_k`` (``v^2`` for squared weights) over the four pixels k of the frame before around the
place that pixel i came from: b the bilinear weights, v the product of the features' similarities between i as it is and
k as it was. The features are those of the filter; only the two pixels of a pair belong to two frames.

Channels of the sums, in and out: 0-2 the weighted radiance over albedo, 3 the weight sum, 4 the sum of squared weights,
5 the weighted squared luminance, 6 how many frames they stand for. Out has one more, 7, ``a = sum_k b_k v(i, k)``: how
much of the place agrees, 0 to 1 (and what `exp2` errs).

Where a pixel may have come from two places, its surface's and its reflection's, what agrees better counts more: both
are mixed by ``a^2``. Then all weights are scaled by the memory.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import halide as hl

from lobewise.backend import expressions
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import SQUARED_WEIGHT
from lobewise.filters.planes import (
    begin_at_zero,
    count_inputs,
    list_inputs,
    make_guide_planes,
    neutralize,
    prepare_planes,
)

HISTORY_CHANNELS = 7
MOMENT, FRAMES = 5, 6
AGREEMENT = HISTORY_CHANNELS

SNAP = 2e-3
"""Places within this many pixels of a pixel's centre are that pixel: rounding in a projection must not blur."""


@dataclass(frozen=True)
class Gathered:
    """What is read at four pixels."""

    func: hl.Func
    channels: int
    shared: bool
    """Whether it is read at the first place alone."""


@dataclass
class ReprojectionFuncs:
    """The Halide functions of a reprojection, for the schedules."""

    out: hl.Func
    sums: hl.Func
    ways: hl.Var
    """The place that a sum is gathered at."""
    way_count: int
    spots: hl.Func
    planes: hl.Func | None
    plane_count: int
    guides: hl.Func | None
    guide_count: int
    near: hl.Func
    stages: list[hl.Func]
    """What is computed for each of the four pixels, in the order in which it is needed."""
    surface_stages: list[hl.Func]
    """As ``stages``, of what counts at the first place alone."""
    gathered: list[Gathered]
    """What is read at each of them."""
    taps: hl.RDom
    x: hl.Var
    y: hl.Var
    c: hl.Var
    arguments: list[Any]


def make_reprojection(features: Sequence[Feature], virtual_from: int | None = None) -> ReprojectionFuncs:
    """Return the algorithm; ``virtual_from`` is the first feature that counts at a second place, if there is one.

    Images of the frame before have one axis for all pixels, row after row, so that one index serves all of them. The
    arguments of the compiled kernel, in order: past sums (c, i); places (2, x, y), the column and row where each pixel
    was, pixel centres at whole numbers, and the second places; mask of the frame before (i) uint8 and the arrays of
    every feature there; the parameters of every feature; mask and arrays of this frame; memory; width and height of the
    frame before. Images of this frame are at least as wide as a vector.
    """
    x, y, c, w = hl.Var("x"), hl.Var("y"), hl.Var("c"), hl.Var("w")
    past = hl.ImageParam(hl.Float(32), 2, "past")
    places = [hl.ImageParam(hl.Float(32), 3, f"places{k}") for k in range(1 if virtual_from is None else 2)]
    mask_before = hl.ImageParam(hl.UInt(8), 1, "mask_before")
    mask_now = hl.ImageParam(hl.UInt(8), 2, "mask_now")
    memory = hl.Param(hl.Float(32), "memory")
    for image in (past, *places, mask_before, mask_now):
        begin_at_zero(image)
    for image in places:
        image.dim(1).set_stride(2)
    # Sums lie channel by channel.
    past.dim(0).set_stride(hl.Expr())
    past.dim(1).set_stride(1)
    scalars = [
        [hl.Param(hl.Float(32), f"p{number}_{k}") for k in range(len(feature.get_parameters()))]
        for number, feature in enumerate(features)
    ]
    now = make_guide_planes("now", mask_now, features, scalars, inside=True)
    width, height = hl.Param(hl.Int(32), "width"), hl.Param(hl.Int(32), "height")
    zero, one = hl.f32(0.0), hl.f32(1.0)

    # A place far outside, or none at all (NaN), must not become an index.
    def place(axis: int, length: hl.Expr) -> tuple[hl.Expr, hl.Expr]:
        raw = places[0][axis, x, y]
        if virtual_from is not None:
            raw = hl.select(w == 0, raw, places[1][axis, x, y])
        near = (raw > hl.f32(-1.0)) & (raw < hl.f32(length))
        value = hl.select(near, raw, hl.f32(-2.0))
        whole = hl.floor(value + hl.f32(0.5))
        value = hl.select(hl.abs(value - whole) < hl.f32(SNAP), whole, value)
        first = hl.floor(value)
        return hl.i32(first), value - first

    spots = hl.Func("spots")
    spots[x, y, w] = hl.Tuple([*place(0, width), *place(1, height)])
    column, right, row, down = (spots[x, y, w][k] for k in range(4))
    taps = hl.RDom([(0, 2), (0, 2)], "taps")
    u, v = hl.Var("u"), hl.Var("v")
    surface_stages: list[hl.Func] = []
    stages: list[hl.Func] = []
    gathered: list[Gathered] = []
    first_way = hl.i32(0)

    def stage(*values: hl.Expr) -> Any:
        func = hl.Func(f"stage{len(stages)}")
        func[x, y, w, u, v] = hl.Tuple(list(values)) if len(values) > 1 else values[0]
        stages.append(func)
        return func[x, y, w, u, v]

    def surface_stage(*values: hl.Expr) -> Any:
        func = hl.Func(f"surface{len(surface_stages)}")
        func[x, y, u, v] = hl.Tuple(list(values)) if len(values) > 1 else values[0]
        surface_stages.append(func)
        return func[x, y, u, v]

    def gather(image: hl.ImageParam, count: int, way: hl.Expr) -> list[hl.Expr]:
        """Return the channels of an image at a tap, which are copied pixel by pixel: they lie together."""
        func = hl.Func(f"gathered{len(gathered)}")
        shared = way is first_way
        axes = [x, y, u, v] if shared else [x, y, w, u, v]
        index = hl.unsafe_promise_clamped(nearest[x, y, way, u, v][1], 0, width * height - 1)
        func[(c, *axes)] = image[c, index] if image.dimensions() == 2 else image[index]
        gathered.append(Gathered(func, count, shared))
        return [func[(k, *axes)] for k in range(count)]

    at_x, at_y = column + u, row + v
    inside = (at_x >= 0) & (at_x < width) & (at_y >= 0) & (at_y < height)
    near_x, near_y = hl.clamp(at_x, 0, width - 1), hl.clamp(at_y, 0, height - 1)
    nearest = hl.Func("near")
    nearest[x, y, w, u, v] = hl.Tuple([hl.select(inside, hl.i32(1), hl.i32(0)), near_x + near_y * width])
    arrays = list_inputs("before", features, flat=True)
    counts = count_inputs(features)
    here = [now.read(layout, x, y) for layout in now.layouts]
    nowhere = zero, zero

    def compare(part: slice, way: hl.Expr, keep: Callable[..., Any]) -> tuple[hl.Expr, hl.Expr]:
        """Return the log-similarity of some features at the taps of a place, and whether there is anything."""
        chosen, own = features[part], scalars[part]
        known = (nearest[x, y, way, u, v][0] != 0) & (gather(mask_before, 1, way)[0] != 0)
        first = len(count_inputs(features[: part.start]))
        inputs = slice(first, first + len(count_inputs(chosen)))
        pairs = zip(arrays[inputs], counts[inputs], strict=True)
        channels = [value for array, count in pairs for value in gather(array, count, way)]
        values, layouts = prepare_planes(chosen, own, neutralize(chosen, channels, known))
        if values:
            seen = keep(*values)
            values = [seen[k] for k in range(len(values))] if len(values) > 1 else [seen]
        exponent: hl.Expr = zero
        for feature, i, layout, parameters in zip(chosen, here[part], layouts, own, strict=True):
            exponent = exponent + feature.log2_similarity(i, layout.read(values.__getitem__), parameters, nowhere, keep)
        return exponent, known

    exponent, known = compare(slice(virtual_from or 0, len(features)), w, stage)
    if virtual_from:
        # What counts at the surface's place alone is read there alone.
        surface = surface_stage(compare(slice(0, virtual_from), first_way, surface_stage)[0])
        exponent = exponent + hl.select(w == 0, surface, zero)
    held = gather(past, HISTORY_CHANNELS, w)
    # What is no number is no history; it would spread by a pixel with every frame. 0 times it would be none either.
    usable = known & (mask_now[x, y] != 0) & ~expressions.is_bad(sum(held[1:], held[0]))
    stage(*(hl.select(usable, value, zero) for value in (expressions.exp2(exponent), *held)))
    told = stages[-1][x, y, w, taps.x, taps.y]

    sums = hl.Func("sums")
    count = HISTORY_CHANNELS + 1
    sums[x, y, w] = hl.Tuple([zero] * count)
    agrees, *taken = (told[k] for k in range(count))
    bilinear = hl.select(taps.x == 0, one - right, right) * hl.select(taps.y == 0, one - down, down)
    weight = bilinear * agrees
    factors = [weight] * count
    factors[SQUARED_WEIGHT] = weight * agrees
    sums[x, y, w] = hl.Tuple([sums[x, y, w][k] + factors[k] * value for k, value in enumerate([*taken, one])])

    found = [sums[x, y, 0][k] for k in range(count)]
    if virtual_from is not None:
        square, other = (sums[x, y, k][AGREEMENT] * sums[x, y, k][AGREEMENT] for k in range(2))
        share = other / hl.max(square + other, hl.f32(1e-12))
        found = [value + share * (sums[x, y, 1][k] - value) for k, value in enumerate(found)]
    kept = [value * memory for value in found[:HISTORY_CHANNELS]]
    kept[SQUARED_WEIGHT] = kept[SQUARED_WEIGHT] * memory
    out = hl.Func("out")
    out[x, y] = hl.Tuple([*kept, found[AGREEMENT]])
    parameters = [p for own in scalars for p in own]
    return ReprojectionFuncs(
        out=out,
        sums=sums,
        ways=w,
        way_count=len(places),
        spots=spots,
        planes=now.planes,
        plane_count=now.plane_count,
        guides=now.guides,
        guide_count=now.guide_count,
        near=nearest,
        stages=stages,
        surface_stages=surface_stages,
        gathered=gathered,
        taps=taps,
        x=x,
        y=y,
        c=c,
        arguments=[past, *places, mask_before, *arrays, *parameters, mask_now, *now.arrays, memory, width, height],
    )
