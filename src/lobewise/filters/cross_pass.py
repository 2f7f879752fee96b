"""The cross-bilateral sum as a Halide algorithm: what each pixel is, not how it is computed.

``out_i = sum_j w(i, j) I_j / sum_j w(i, j)`` with ``w = prod_f similarity_f(i, j)``. One pass sums over the taps of
one form; ``separable`` and ``atrous`` chain passes and hand on the undivided sums, so that bad pixels, image borders
and poorly supported rows are weighted rightly, a constant stays that constant and the weight sum stays testable.

Channels of an undivided image: 0-2 the weighted radiance, 3 the weight sum, 4 the sum of squared weights, and on demand
5 the weighted squared luminance.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, field
from typing import Any

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.expressions import dot
from lobewise.features.base import Feature, Stage
from lobewise.filters.forms import ATROUS_PROFILE, ATROUS_RADIUS, Taps
from lobewise.filters.planes import (
    GuidePlanes,
    Rows,
    begin_at_zero,
    clamp_likely,
    list_inputs,
    make_guide_planes,
    make_image,
)
from lobewise.lobes.vectors import LUMINANCE

SUM_CHANNELS = 5
WEIGHT = 3
SQUARED_WEIGHT = 4

ALBEDO_FLOOR = 1e-3
"""Albedo below which a pixel says nothing about the light it receives; it gets weight 0."""


@dataclass(frozen=True)
class PassKey:
    """Everything that changes a pass's code; what may differ between two calls of it is an argument instead."""

    taps: Taps
    radius: int
    features: tuple[Hashable, ...]
    first: bool
    """Reads radiance, albedo and mask; otherwise undivided sums."""
    last: bool
    """Writes radiance, weight sum and effective samples; otherwise undivided sums."""
    demodulate: bool
    """Divides by an albedo on the way in."""
    modulate: bool = False
    """Multiplies by an albedo on the way out."""
    moment: bool = False
    """Sums squared luminance as well."""
    strict: bool = False
    """Raises the weights of every centre's taps to a power of its own."""
    apart: bool = False
    """Writes what supports the radiance of a last pass into images of their own."""
    mirrored: bool = False
    """Weighs two pixels of a row once, for both: only where `can_mirror` says so, not ``strict``."""

    @property
    def channels(self) -> int:
        """How many channels the sums have."""
        return SUM_CHANNELS + self.moment


@dataclass(frozen=True)
class PassInputs:
    """What a pass reads; a caller may bring its own, to name the arguments or to chain passes in one kernel."""

    source: hl.ImageParam | hl.Func
    albedo: hl.ImageParam
    mask: hl.ImageParam
    arrays: list[hl.ImageParam]
    """Those of every feature."""
    step: hl.Expr
    scalars: list[list[hl.Expr]]
    """The parameters of every feature."""
    strictness: hl.ImageParam


@dataclass
class PassFuncs:
    """The Halide functions of one pass, for the schedules."""

    out: hl.Func
    rest: hl.Func | None
    """What is written beside ``out``, planes of one image each."""
    finish: hl.Func | None
    """What both are read from."""
    last: bool
    sums: hl.Func
    row: hl.Func
    """Sums over one row of taps, or over the column of a vertical pass."""
    weights: hl.Func | None
    """Of a pixel and those to its right, where pairs are weighed once."""
    vertical: bool
    """Whether all taps are above each other."""
    channels: int
    image: hl.Func
    rows: Rows | None
    """What image and planes are made of, on processors."""
    planes: GuidePlanes
    """The planes that taps read."""
    stages: list[hl.Func]
    inner: hl.RDom
    outer: hl.RDom
    arguments: list[Any] = field(default_factory=list)


def describe_structure(feature: Feature) -> Hashable:
    """Return what identifies the code of a feature."""
    return type(feature), feature.structure, tuple(a.shape[2:] for a in feature.get_arrays())


def _tap_profile(offset: hl.Expr) -> hl.Expr:
    """Return log2 of the B-spline weight at -2..2."""
    centre, near, far = (hl.f32(math.log2(weight)) for weight in ATROUS_PROFILE)
    distance = hl.abs(offset)
    return hl.select(distance == 0, centre, distance == 1, near, far)


def make_stage(stages: list[hl.Func], at: Sequence[hl.Var]) -> Stage:
    """Return what keeps a value at pixel and tap in a function of its own, which it adds to ``stages``."""

    def stage(value: hl.Expr) -> hl.Expr:
        func = hl.Func(f"stage{len(stages)}")
        func[tuple(at)] = value
        stages.append(func)
        return func[tuple(at)]

    return stage


def find_luminance(colour: Sequence[hl.Expr]) -> hl.Expr:
    """Return the luminance of a colour."""
    return dot([hl.f32(share) for share in LUMINANCE], colour)


def demodulate(
    source: hl.ImageParam | hl.Func,
    albedo: hl.ImageParam | None,
    at: tuple[hl.Expr, hl.Expr],
    floor: hl.Expr,
    albedo_at: tuple[hl.Expr, hl.Expr] | None = None,
) -> tuple[list[hl.Expr], hl.Expr]:
    """Return the radiance at a pixel over its albedo, which no channel has below ``floor``, and whether it is good."""
    radiance: list[hl.Expr] = [source[k, at[0], at[1]] for k in range(3)]
    good = ~(expressions.is_bad(radiance[0]) | expressions.is_bad(radiance[1]) | expressions.is_bad(radiance[2]))
    if albedo is not None:
        column, row = albedo_at or at
        tints = [albedo[k, column, row] for k in range(3)]
        for k, tint in enumerate(tints):
            good = good & ~expressions.is_bad(tint)
            radiance[k] = radiance[k] / hl.max(tint, floor)
        # A coloured metal may lack a channel altogether; a pixel is dropped when it lacks all of them.
        good = good & (hl.max(tints[0], tints[1], tints[2]) > floor)
    return radiance, good


def make_pass_inputs(features: Sequence[Feature]) -> PassInputs:
    """Return parameters for all that a pass may read."""
    return PassInputs(
        source=hl.ImageParam(hl.Float(32), 3, "source"),
        albedo=hl.ImageParam(hl.Float(32), 3, "albedo"),
        mask=hl.ImageParam(hl.UInt(8), 2, "mask"),
        arrays=list_inputs("tap", features),
        step=hl.Param(hl.Int(32), "step"),
        scalars=[
            [hl.Param(hl.Float(32), f"p{number}_{k}") for k in range(len(feature.get_parameters()))]
            for number, feature in enumerate(features)
        ],
        strictness=hl.ImageParam(hl.Float(32), 2, "strictness"),
    )


def make_pass(
    key: PassKey, features: Sequence[Feature], inputs: PassInputs | None = None, *, lanes: int = 0
) -> PassFuncs:
    """Return the algorithm of one pass, for processors with vectors of ``lanes`` pixels, or 0 for others.

    The arguments of the compiled pass, in order: image (radiance (c, x, y) on a first pass, else sums (x, c, y));
    albedo (c, x, y) where demodulated; mask (x, y) uint8, 1 where a pixel may give and take; the arrays of every
    feature; step (int32); the parameters of every feature; strictness (x, y) where that is asked for.
    """
    x, y, c = hl.Var("x"), hl.Var("y"), hl.Var("c")
    if inputs is None:
        inputs = make_pass_inputs(features)
        for image in (inputs.source, inputs.albedo, inputs.mask, inputs.strictness):
            begin_at_zero(image)
        # Known strides make dense loads, which are shuffled, instead of one load for every lane.
        inputs.albedo.dim(1).set_stride(3)
        if key.first:
            inputs.source.dim(1).set_stride(3)
    source, mask, albedo, step, scalars = inputs.source, inputs.mask, inputs.albedo, inputs.step, inputs.scalars
    width, height = mask.width(), mask.height()

    def take_image(at: tuple[hl.Expr, hl.Expr], usable: hl.Expr) -> hl.Expr:
        """Return radiance over albedo and a weight of 1, or nothing at all where a pixel is bad."""
        if not key.first:
            return hl.select(usable, source[at[0], c, at[1]], hl.f32(0.0))
        radiance, good = demodulate(source, albedo if key.demodulate else None, at, hl.f32(ALBEDO_FLOOR))
        values = [*radiance, hl.f32(1.0), hl.f32(1.0)]
        if key.moment:
            luminance = find_luminance(radiance)
            values.append(luminance * luminance)
        return hl.select(good & usable, hl.mux(c, values), hl.f32(0.0))

    # Taps.
    r = key.radius
    across, down = {
        Taps.SQUARE: (r, r),
        Taps.HORIZONTAL: (r, 0),
        Taps.VERTICAL: (0, r),
        Taps.ATROUS: (ATROUS_RADIUS, ATROUS_RADIUS),
    }[key.taps]
    u, v = hl.Var("u"), hl.Var("v")
    spread: hl.Expr = step if key.taps is Taps.ATROUS else hl.i32(1)
    offset = hl.f32(u * spread), hl.f32(v * spread)
    rows = Rows(width, spread * across, lanes) if lanes else None
    image = make_image("image", mask, rows, take_image)
    side = make_guide_planes("tap", mask, features, scalars, arrays=inputs.arrays, rows=rows)
    stages: list[hl.Func] = []
    stage = make_stage(stages, (x, y, u, v))

    exponent: hl.Expr = hl.f32(0.0)
    if key.taps is Taps.ATROUS:
        exponent = _tap_profile(u) + _tap_profile(v)
    for feature, layout, own in zip(features, side.layouts, scalars, strict=True):
        i, j = side.read(layout, x, y), side.read(layout, x + u * spread, y + v * spread)
        exponent = exponent + feature.log2_similarity(i, j, own, offset, stage)
    if key.strict:
        exponent = exponent * inputs.strictness[clamp_likely(x, width), hl.clamp(y, 0, height - 1)]
    log_weight = hl.Func("log_weight")
    log_weight[x, y, u, v] = exponent
    stages.append(log_weight)

    # A row of taps (or the column that a vertical pass has) is summed by itself, so that its sums stay in registers.
    outer = hl.RDom([(-down, 2 * down + 1)] if across else [(0, 1)], "outer")
    row = hl.Func("row")
    at = x, y, v
    zeros = [hl.f32(0.0)] * key.channels

    def take(weight: hl.Expr, column: hl.Expr, line: hl.Expr) -> list[hl.Expr]:
        # Radiance counts once: its weight and squared weight are one plane.
        planes = [min(k, WEIGHT) if key.first and k < SUM_CHANNELS else k for k in range(key.channels)]
        factors = [weight] * key.channels
        factors[SQUARED_WEIGHT] = weight * weight
        return [factor * image[column, k, line] for factor, k in zip(factors, planes, strict=True)]

    weights = None
    if key.mirrored:
        weights = hl.Func("weights")
        weights[x, y, u] = expressions.exp2(log_weight[x, y, u, 0])
        inner = hl.RDom([(1, across)], "inner")
        row[at] = hl.Tuple(take(weights[x, y, 0], x, y))
        after = take(weights[x, y, inner.x], x + inner.x, y)
        before = take(weights[x - inner.x, y, inner.x], x - inner.x, y)
        taken = [after[k] + before[k] for k in range(key.channels)]
    else:
        inner = hl.RDom([(-across, 2 * across + 1)] if across else [(-down, 2 * down + 1)], "inner")
        u_tap, v_tap = (inner.x, v) if across else (v, inner.x)
        row[at] = hl.Tuple(zeros)
        weight = expressions.exp2(log_weight[x, y, u_tap, v_tap])
        taken = take(weight, x + u_tap * spread, y + v_tap * spread)
    row[at] = hl.Tuple([row[at][k] + taken[k] for k in range(key.channels)])
    sums = hl.Func("sums")
    sums[x, y] = hl.Tuple(zeros)
    sums[x, y] = hl.Tuple([sums[x, y][k] + row[x, y, outer.x][k] for k in range(key.channels)])

    out = hl.Func("out")
    finish = rest = None
    if key.last:
        total, squares = sums[x, y][WEIGHT], sums[x, y][SQUARED_WEIGHT]
        moments: list[hl.Expr] = []
        alive = (mask[x, y] != 0) & (total > hl.f32(0.0))
        mean = [sums[x, y][k] / total for k in range(3)]
        if key.modulate:
            tints = [albedo[k, x, y] for k in range(3)]
            mean = [mean[k] * hl.select(expressions.is_bad(tints[k]), hl.f32(0.0), tints[k]) for k in range(3)]
        # The squares underflow before the sum does: then one far tap decides, which is one sample.
        effective = hl.select(squares > hl.f32(0.0), total * total / squares, hl.f32(1.0))
        if key.moment:
            moments = [sums[x, y][SUM_CHANNELS] / total]
        results = [*mean, total, effective, *moments]
        if key.apart:
            finish, rest = hl.Func("finish"), hl.Func("rest")
            finish[x, y] = hl.Tuple([hl.select(alive, value, hl.f32(0.0)) for value in results])
            out[c, x, y] = hl.mux(c, [finish[x, y][k] for k in range(len(mean))])
            rest[x, y] = hl.Tuple([finish[x, y][k] for k in range(len(mean), len(results))])
        else:
            out[c, x, y] = hl.select(alive, hl.mux(c, results), hl.f32(0.0))
    else:
        out[x, c, y] = hl.mux(c, [sums[x, y][k] for k in range(key.channels)])
    arguments = [
        source,
        *([albedo] if key.demodulate or key.modulate else []),
        mask,
        *side.arrays,
        step,
        *(p for own in scalars for p in own),
    ]
    arguments += [inputs.strictness] if key.strict else []
    return PassFuncs(
        out=out,
        rest=rest,
        finish=finish,
        last=key.last,
        sums=sums,
        row=row,
        weights=weights,
        vertical=key.taps is Taps.VERTICAL,
        channels=key.channels,
        image=image,
        rows=rows,
        planes=side,
        stages=stages,
        inner=inner,
        outer=outer,
        arguments=arguments,
    )
