"""What a pixel brings along from the frame before, as a Halide algorithm: the history's sums, found, judged, gathered.

``out_i = sum_k b_k v(i, k) past_k`` (``v^2`` for squared weights) over the four pixels k of the frame before around the
place that pixel i came from: b the bilinear weights, v the product of the features' similarities between i as it is and
k as it was. The features are those of the filter; only the two pixels of a pair belong to two frames.

Channels of the sums, in and out: 0-2 the weighted radiance over albedo, 3 the weight sum, 4 the sum of squared weights,
5 the weighted squared luminance, 6 how many frames they stand for. Out has one more, 7, ``sum_k b_k v(i, k)``: how much
of the place agrees, 0 to 1 (and what `exp2` errs).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import halide as hl

from lobewise.kernels import expressions
from lobewise.kernels.cross_filter import SQUARED_WEIGHT, make_side
from lobewise.kernels.features import Feature

HISTORY_CHANNELS = 7
AGREEMENT = HISTORY_CHANNELS

SNAP = 2e-3
"""Places within this many pixels of a pixel's centre are that pixel: rounding in a projection must not blur."""


@dataclass
class ReprojectionFuncs:
    """The Halide functions of a reprojection, for the schedules."""

    out: hl.Func
    sums: hl.Func
    planes: hl.Func | None
    plane_count: int
    guides: hl.Func | None
    guide_count: int
    stages: list[hl.Func]
    taps: hl.RDom
    x: hl.Var
    y: hl.Var
    c: hl.Var
    arguments: list[Any]


def make_reprojection(features: Sequence[Feature]) -> ReprojectionFuncs:
    """Return the algorithm.

    The arguments of the compiled kernel, in order: past sums (c, x, y); places (2, x, y), the column and row where
    each pixel was, pixel centres at whole numbers; mask of the frame before (x, y) uint8 and the arrays of every
    feature there; the parameters of every feature; mask and arrays of this frame.
    """
    x, y, c = hl.Var("x"), hl.Var("y"), hl.Var("c")
    past = hl.ImageParam(hl.Float(32), 3, "past")
    places = hl.ImageParam(hl.Float(32), 3, "places")
    mask_before = hl.ImageParam(hl.UInt(8), 2, "mask_before")
    mask_now = hl.ImageParam(hl.UInt(8), 2, "mask_now")
    scalars = [
        [hl.Param(hl.Float(32), f"p{number}_{k}") for k in range(len(feature.get_parameters()))]
        for number, feature in enumerate(features)
    ]
    before = make_side("before", mask_before, features, scalars, (x, y, c))
    now = make_side("now", mask_now, features, scalars, (x, y, c))
    width, height = mask_before.width(), mask_before.height()

    # Vectors reach past the last column.
    own_x, own_y = hl.clamp(x, 0, mask_now.width() - 1), hl.clamp(y, 0, mask_now.height() - 1)

    # A place far outside, or none at all (NaN), must not become an index.
    def place(axis: int, length: hl.Expr) -> tuple[hl.Expr, hl.Expr]:
        raw = places[axis, own_x, own_y]
        near = (raw > hl.f32(-1.0)) & (raw < hl.f32(length))
        value = hl.select(near, raw, hl.f32(-2.0))
        whole = hl.floor(value + hl.f32(0.5))
        value = hl.select(hl.abs(value - whole) < hl.f32(SNAP), whole, value)
        first = hl.floor(value)
        return hl.i32(first), value - first

    (column, right), (row, down) = place(0, width), place(1, height)
    taps = hl.RDom([(0, 2), (0, 2)], "taps")
    u, v = hl.Var("u"), hl.Var("v")
    stages: list[hl.Func] = []

    def stage(value: hl.Expr) -> hl.Expr:
        func = hl.Func(f"stage{len(stages)}")
        func[x, y, u, v] = value
        stages.append(func)
        return func[x, y, u, v]

    at_x, at_y = column + u, row + v
    inside = (at_x >= 0) & (at_x < width) & (at_y >= 0) & (at_y < height)
    near_x, near_y = hl.clamp(at_x, 0, width - 1), hl.clamp(at_y, 0, height - 1)
    one = hl.f32(1.0)
    exponent: hl.Expr = hl.f32(0.0)
    nowhere = hl.f32(0.0), hl.f32(0.0)
    for feature, part, own in zip(features, before.slices, scalars, strict=True):
        i, j = now.read(part, x, y), before.read(part, near_x, near_y)
        exponent = exponent + feature.log2_similarity(i, j, own, nowhere, stage)
    usable = inside & (mask_before[near_x, near_y] != 0) & (mask_now[own_x, own_y] != 0)
    # What is no number is no history; it would spread by a pixel with every frame.
    seen = [past[k, near_x, near_y] for k in range(HISTORY_CHANNELS)]
    usable = usable & ~expressions.is_bad(sum(seen[1:], seen[0]))
    stage(hl.select(usable, expressions.exp2(exponent), hl.f32(0.0)))

    sums = hl.Func("sums")
    count = HISTORY_CHANNELS + 1
    sums[x, y] = hl.Tuple([hl.f32(0.0)] * count)
    tap_x = hl.clamp(column + taps.x, 0, width - 1)
    tap_y = hl.clamp(row + taps.y, 0, height - 1)
    taken = [past[k, tap_x, tap_y] for k in range(HISTORY_CHANNELS)]
    agrees = stages[-1][x, y, taps.x, taps.y]
    # 0 times what is no number would be none either.
    taken = [hl.select(agrees > hl.f32(0.0), value, hl.f32(0.0)) for value in taken]
    bilinear = hl.select(taps.x == 0, one - right, right) * hl.select(taps.y == 0, one - down, down)
    weight = bilinear * agrees
    factors = [weight] * (HISTORY_CHANNELS + 1)
    factors[SQUARED_WEIGHT] = weight * agrees
    sums[x, y] = hl.Tuple([sums[x, y][k] + factors[k] * value for k, value in enumerate([*taken, one])])

    out = hl.Func("out")
    out[c, x, y] = hl.mux(c, [sums[x, y][k] for k in range(count)])
    parameters = [p for own in scalars for p in own]
    arguments = [past, places, mask_before, *before.arrays, *parameters, mask_now, *now.arrays]
    return ReprojectionFuncs(
        out=out,
        sums=sums,
        planes=now.planes,
        plane_count=now.plane_count,
        guides=now.guides,
        guide_count=now.guide_count,
        stages=stages,
        taps=taps,
        x=x,
        y=y,
        c=c,
        arguments=arguments,
    )
