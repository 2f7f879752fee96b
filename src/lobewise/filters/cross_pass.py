"""The cross-bilateral sum as a Halide algorithm, without a schedule.

``out_i = sum_j w(i, j) I_j / sum_j w(i, j)`` with ``w = prod_f similarity_f(i, j)``. One pass sums over the taps of
one form; ``separable`` and ``atrous`` chain passes and pass on the undivided sums. Bad pixels, image borders and poorly
supported rows are then weighted correctly, a constant stays the constant, and tests can read the weight sum.

Channels of undivided sums: 0-2 the weighted radiance, 3 the weight sum, 4 the sum of squared weights, and optionally
5 the weighted squared luminance.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from lobewise.backend import expressions
from lobewise.backend.compiler import declare_vars, hl
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Feature, Stage
from lobewise.filters.forms import ATROUS_PROFILE, ATROUS_RADIUS, Taps
from lobewise.filters.planes import C, GuidePlanes, Rows, X, Y, clamp_likely, make_guide_planes, make_image
from lobewise.lobes.vectors import LUMINANCE, dot
from lobewise.settings import LARGEST_RADIUS

COLORS = 3
SUM_CHANNELS = 5
WEIGHT = 3
SQUARED_WEIGHT = 4

ALBEDO_FLOOR = 1e-3
"""Albedo below which a pixel does not reveal the light that it receives; its weight is 0."""

U, V = declare_vars("u", "v")
"""Offset of a tap, in steps to the right and down."""


class Reads(Enum):
    """The input of a pass."""

    RADIANCE = "radiance"
    DEMODULATED = "demodulated"
    """Radiance, divided by an albedo."""
    SUMS = "sums"
    """Undivided sums of a pass before."""


class Writes(Enum):
    """The output of a pass."""

    SUMS = "sums"
    PIXELS = "pixels"
    """One image with the channels radiance, weight sum, effective samples, and optionally moment."""
    IMAGES = "images"
    """Radiance, weight sum, effective samples and moment, each as an image of its own."""


@dataclass(frozen=True)
class PassKey:
    """Everything that changes the code of a pass. Values that may differ from call to call are arguments instead."""

    taps: Taps
    features: tuple[Hashable, ...]
    reads: Reads
    writes: Writes
    modulate: bool = False
    """Multiply the result by the albedo; only for passes that do not write sums."""
    moment: bool = False
    """Also sum the squared luminance."""
    strict: bool = False
    """Raise the weights of each centre's taps to the centre's power."""
    mirrored: bool = False
    """Compute each weight of two pixels of a row once, for both: only horizontal taps, not with ``strict``."""

    @property
    def channels(self) -> int:
        """Number of channels of the sums."""
        return SUM_CHANNELS + self.moment

    @property
    def reads_albedo(self) -> bool:
        """Whether the pass reads an albedo."""
        return self.modulate or self.reads is Reads.DEMODULATED


def chain_passes(whole: PassKey, taps: Sequence[Taps], *, mirror: bool) -> list[PassKey]:
    """Return the keys of passes over ``taps`` that pass on sums and together compute ``whole``.

    ``mirror`` if the device gains from `PassKey.mirrored`; only rows do (docs/performance.md).
    """
    last = len(taps) - 1
    return [
        replace(
            whole,
            taps=each,
            reads=whole.reads if number == 0 else Reads.SUMS,
            writes=whole.writes if number == last else Writes.SUMS,
            modulate=whole.modulate and number == last,
            mirrored=mirror and not whole.strict and each is Taps.HORIZONTAL,
        )
        for number, each in enumerate(taps)
    ]


@dataclass(frozen=True)
class PassInputs:
    """The inputs of a pass. A caller may give its own, to name the arguments or to chain passes in one kernel."""

    source: hl.ImageParam | hl.Func
    """Radiance (c, x, y), or sums (x, c, y)."""
    albedo: hl.ImageParam | None
    mask: hl.ImageParam
    """1 where a pixel has meaning, else 0."""
    arrays: list[hl.ImageParam]
    """The arrays of every feature."""
    radius: hl.Expr
    """Taps from the centre to the edge of the kernel; ``ATROUS_RADIUS`` stands for it in the form "atrous"."""
    step: hl.Expr
    scalars: list[list[hl.Expr]]
    """The parameters of every feature."""
    strictness: hl.ImageParam | None = None


@dataclass(kw_only=True)
class PassFuncs:
    """The Halide functions of one pass, for its schedules."""

    key: PassKey
    signature: Signature
    image: hl.Func
    planes: GuidePlanes
    """Guides and planes that taps read."""
    rows: Rows | None
    """Parts of rows that image and planes are computed in, on processors."""
    stages: list[hl.Func]
    weights: hl.Func | None
    """Weights of a pixel with its right-hand neighbours, if the pass is mirrored."""
    row: hl.Func
    """Sums over one row of taps, or over the column of taps of a vertical pass."""
    inner: hl.RDom
    sums: hl.Func
    outer: hl.RDom
    out: hl.Func
    rest: hl.Func | None
    """Further outputs beside ``out``, one image each."""
    finish: hl.Func | None
    """The results that ``out`` and ``rest`` read."""


def make_stage(stages: list[hl.Func], at: Sequence[hl.Var]) -> Stage:
    """Return a `Stage` that computes a value of pixel and tap in a function of its own and adds it to ``stages``."""

    def stage(value: hl.Expr) -> hl.Expr:
        func = hl.Func(f"stage{len(stages)}")
        func[tuple(at)] = value
        stages.append(func)
        return func[tuple(at)]

    return stage


def find_luminance(colour: Sequence[hl.Expr]) -> hl.Expr:
    return dot([hl.f32(share) for share in LUMINANCE], colour)


def demodulate(
    source: hl.ImageParam | hl.Func,
    albedo: hl.ImageParam | hl.Func | None,
    at: tuple[hl.Expr, hl.Expr],
    floor: hl.Expr,
    albedo_at: tuple[hl.Expr, hl.Expr] | None = None,
) -> tuple[list[hl.Expr], hl.Expr]:
    """Return a pixel's radiance over its albedo, raised to ``floor`` where it is smaller, and whether both are good."""
    radiance: list[hl.Expr] = [source[k, at[0], at[1]] for k in range(3)]
    good = expressions.is_good(radiance)
    if albedo is not None:
        column, row = albedo_at or at
        tints = [albedo[k, column, row] for k in range(3)]
        for k, tint in enumerate(tints):
            good = good & ~expressions.is_bad(tint)
            radiance[k] = radiance[k] / hl.max(tint, floor)
        # A coloured metal may have albedo 0 in a channel. A pixel is dropped if all its channels are below the floor.
        good = good & (hl.max(tints[0], tints[1], tints[2]) > floor)
    return radiance, good


def declare_pass(signature: Signature, key: PassKey, features: Sequence[Feature]) -> PassInputs:
    """Declare the inputs and outputs of a pass."""
    size = "height", "width"
    axes = ("height", key.channels, "width") if key.reads is Reads.SUMS else (*size, COLORS)
    inputs = PassInputs(
        source=signature.image("source", *axes),
        albedo=signature.image("albedo", *size, COLORS) if key.reads_albedo else None,
        mask=signature.image("mask", *size, type=hl.UInt(8)),
        arrays=declare_features(signature, "tap", features, *size),
        radius=signature.count("radius", most=LARGEST_RADIUS),
        step=signature.count("step", 1),
        scalars=declare_scalars(signature, features),
        strictness=signature.image("strictness", *size) if key.strict else None,
    )
    if key.writes is Writes.SUMS:
        signature.output("sums", "height", key.channels, "width")
    elif key.writes is Writes.PIXELS:
        signature.output("pixels", *size, key.channels)
    else:
        signature.output("image", *size, COLORS)
        for name in ("weight_sum", "effective_samples", "moment")[: key.channels - COLORS]:
            signature.output(name, *size)
    return inputs


def make_pass(
    key: PassKey, features: Sequence[Feature], inputs: PassInputs | None = None, *, lanes: int = 0
) -> PassFuncs:
    """Return the algorithm of one pass, for processors with vectors of ``lanes`` pixels; 0 lanes for graphics cards.

    Without ``inputs`` they are the parameters of the pass's signature.
    """
    signature = Signature("cross pass")
    inputs = inputs or declare_pass(signature, key, features)
    reach = hl.i32(ATROUS_RADIUS) if key.taps is Taps.ATROUS else inputs.radius
    spread: hl.Expr = inputs.step if key.taps is Taps.ATROUS else hl.i32(1)
    is_column = key.taps is Taps.VERTICAL
    rows = Rows(inputs.mask.width(), hl.i32(0) if is_column else spread * reach, lanes) if lanes else None
    image = _read_image(key, inputs, rows)
    planes = make_guide_planes("tap", inputs.mask, features, inputs.scalars, arrays=inputs.arrays, rows=rows)
    stages = _compare(key, features, inputs, planes, spread)
    weights = hl.Func("weights") if key.mirrored else None
    if weights is None:
        row, inner = _sum_row(key, image, stages[-1], reach, spread)
    else:
        # Weights of a pixel with its right-hand neighbours. Each weight serves both pixels of the pair.
        weights[X, Y, U] = expressions.exp2(stages[-1][X, Y, U, 0])
        row, inner = _sum_pairs(key, image, weights, reach)
    # A vertical pass has its whole column of taps in ``row``.
    outer = hl.RDom([(-reach, 2 * reach + 1)] if key.taps in (Taps.SQUARE, Taps.ATROUS) else [(0, 1)], "outer")
    sums = hl.Func("sums")
    sums[X, Y] = hl.Tuple([hl.f32(0.0)] * key.channels)
    _add(sums, (X, Y), [row[X, Y, outer.x][k] for k in range(key.channels)])
    out, rest, finish = _write(key, inputs, sums)
    return PassFuncs(
        key=key,
        signature=signature,
        image=image,
        planes=planes,
        rows=rows,
        stages=stages,
        weights=weights,
        row=row,
        inner=inner,
        sums=sums,
        outer=outer,
        out=out,
        rest=rest,
        finish=finish,
    )


def _read_image(key: PassKey, inputs: PassInputs, rows: Rows | None) -> hl.Func:
    """Return the summands of taps: radiance over albedo and weight 1, or sums as they are; all 0 for a bad pixel."""

    def take(at: tuple[hl.Expr, hl.Expr], usable: hl.Expr) -> hl.Expr:
        if key.reads is Reads.SUMS:
            return hl.select(usable, inputs.source[at[0], C, at[1]], hl.f32(0.0))
        albedo = inputs.albedo if key.reads is Reads.DEMODULATED else None
        radiance, good = demodulate(inputs.source, albedo, at, hl.f32(ALBEDO_FLOOR))
        values = [*radiance, hl.f32(1.0), hl.f32(1.0)]
        if key.moment:
            luminance = find_luminance(radiance)
            values.append(luminance * luminance)
        return hl.select(good & usable, hl.mux(C, values), hl.f32(0.0))

    return make_image("image", inputs.mask, rows, take)


def _tap_profile(offset: hl.Expr) -> hl.Expr:
    """Return log2 of the B-spline weight at an offset from -2 to 2."""
    centre, near, far = (hl.f32(math.log2(weight)) for weight in ATROUS_PROFILE)
    distance = hl.abs(offset)
    return hl.select(distance == 0, centre, distance == 1, near, far)


def _compare(
    key: PassKey, features: Sequence[Feature], inputs: PassInputs, planes: GuidePlanes, spread: hl.Expr
) -> list[hl.Func]:
    """Return the stages of the logarithm of a tap's weight; the last one is the logarithm."""
    stages: list[hl.Func] = []
    stage = make_stage(stages, (X, Y, U, V))
    offset = hl.f32(U * spread), hl.f32(V * spread)
    exponent: hl.Expr = hl.f32(0.0)
    if key.taps is Taps.ATROUS:
        exponent = _tap_profile(U) + _tap_profile(V)
    for feature, layout, own in zip(features, planes.layouts, inputs.scalars, strict=True):
        i, j = planes.read(layout, X, Y), planes.read(layout, X + U * spread, Y + V * spread)
        exponent = exponent + feature.log2_similarity(i, j, own, offset, stage)
    if inputs.strictness is not None:
        exponent = (
            exponent * inputs.strictness[clamp_likely(X, inputs.mask.width()), hl.clamp(Y, 0, inputs.mask.height() - 1)]
        )
    log_weight = hl.Func("log_weight")
    log_weight[X, Y, U, V] = exponent
    return [*stages, log_weight]


def _take(key: PassKey, image: hl.Func, weight: hl.Expr, column: hl.Expr, line: hl.Expr) -> list[hl.Expr]:
    """Return the summand of a tap for every sum."""
    # Radiance has weight 1 and squared weight 1: both read one plane.
    single = key.reads is not Reads.SUMS
    planes = [min(k, WEIGHT) if single and k < SUM_CHANNELS else k for k in range(key.channels)]
    factors = [weight] * key.channels
    factors[SQUARED_WEIGHT] = weight * weight
    return [factor * image[column, k, line] for factor, k in zip(factors, planes, strict=True)]


def _add(sums: hl.Func, at: tuple[hl.Expr, ...], values: Sequence[hl.Expr]) -> None:
    sums[at] = hl.Tuple([sums[at][k] + value for k, value in enumerate(values)])


def _sum_row(
    key: PassKey, image: hl.Func, log_weight: hl.Func, reach: hl.Expr, spread: hl.Expr
) -> tuple[hl.Func, hl.RDom]:
    """Return the sums over a row of taps, or over the column of taps of a vertical pass, and the taps.

    The function is separate so that its sums stay in registers.
    """
    inner = hl.RDom([(-reach, 2 * reach + 1)], "inner")
    u, v = (V, inner.x) if key.taps is Taps.VERTICAL else (inner.x, V)
    row = hl.Func("row")
    row[X, Y, V] = hl.Tuple([hl.f32(0.0)] * key.channels)
    weight = expressions.exp2(log_weight[X, Y, u, v])
    _add(row, (X, Y, V), _take(key, image, weight, X + u * spread, Y + v * spread))
    return row, inner


def _sum_pairs(key: PassKey, image: hl.Func, weights: hl.Func, reach: hl.Expr) -> tuple[hl.Func, hl.RDom]:
    """Return the sums over a row of taps, added in pairs left and right of the pixel, and the pairs' distances."""
    inner = hl.RDom([(1, reach)], "inner")
    row = hl.Func("row")
    row[X, Y, V] = hl.Tuple(_take(key, image, weights[X, Y, 0], X, Y))
    after = _take(key, image, weights[X, Y, inner.x], X + inner.x, Y)
    before = _take(key, image, weights[X - inner.x, Y, inner.x], X - inner.x, Y)
    _add(row, (X, Y, V), [p + q for p, q in zip(after, before, strict=True)])
    return row, inner


def _write(key: PassKey, inputs: PassInputs, sums: hl.Func) -> tuple[hl.Func, hl.Func | None, hl.Func | None]:
    """Return the outputs of a pass, ``out``, ``rest`` and ``finish`` of `PassFuncs`."""
    values = [sums[X, Y][k] for k in range(key.channels)]
    out = hl.Func("out")
    if key.writes is Writes.SUMS:
        out[X, C, Y] = hl.mux(C, values)
        return out, None, None
    alive = (inputs.mask[X, Y] != 0) & (values[WEIGHT] > hl.f32(0.0))
    results = _divide(key, inputs, values)
    if key.writes is Writes.PIXELS:
        out[C, X, Y] = hl.select(alive, hl.mux(C, results), hl.f32(0.0))
        return out, None, None
    finish, rest = hl.Func("finish"), hl.Func("rest")
    finish[X, Y] = hl.Tuple([hl.select(alive, value, hl.f32(0.0)) for value in results])
    out[C, X, Y] = hl.mux(C, [finish[X, Y][k] for k in range(COLORS)])
    rest[X, Y] = hl.Tuple([finish[X, Y][k] for k in range(COLORS, len(results))])
    return out, rest, finish


def _divide(key: PassKey, inputs: PassInputs, sums: Sequence[hl.Expr]) -> list[hl.Expr]:
    """Return a pixel's radiance, weight sum, effective samples and, if it was summed, moment."""
    weight = sums[WEIGHT]
    mean = [value / weight for value in sums[:COLORS]]
    if key.modulate and inputs.albedo is not None:
        tints = [inputs.albedo[k, X, Y] for k in range(COLORS)]
        mean = [value * hl.select(expressions.is_bad(t), hl.f32(0.0), t) for value, t in zip(mean, tints, strict=True)]
    effective = count_samples(weight, sums[SQUARED_WEIGHT])
    return [*mean, weight, effective, *(value / weight for value in sums[SUM_CHANNELS:])]


def count_samples(total: hl.Expr, squares: hl.Expr) -> hl.Expr:
    """Return the effective number of samples, ``(sum w)^2 / sum w^2``.

    If the squares underflow before the sum does, one far tap dominates, which is one sample.
    """
    return hl.select(squares > hl.f32(0.0), total * total / squares, hl.f32(1.0))
