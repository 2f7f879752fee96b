"""The kernel of a pass of the cross filter: the cross-bilateral sum.

``out_i = sum_j w(i, j) I_j / sum_j w(i, j)`` with ``w = prod_f similarity_f(i, j)``. One pass sums over the taps of
one form; ``separable`` and ``atrous`` chain passes and pass on the undivided sums. Bad pixels, image borders and poorly
supported rows are then weighted correctly, a constant stays the constant, and tests can read the weight sum.

Channels of undivided sums: 0-2 the weighted radiance, 3 the weight sum, 4 the sum of squared weights, and optionally
5 the weighted squared luminance. Further images that are averaged by the same weights have four channels each: the
weighted radiance and the sum of the weights of their own good pixels.
"""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from dataclasses import dataclass, replace
from enum import Enum

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Feature
from lobewise.filters.forms import ATROUS_PROFILE, ATROUS_RADIUS, Taps
from lobewise.filters.planes import C, X, Y, clamp_likely
from lobewise.filters.scheduling import count_lanes
from lobewise.filters.weigh import TapSums, U, V
from lobewise.lobes import vectors
from lobewise.settings import LARGEST_RADIUS

COLORS = 3
SUM_CHANNELS = 5
WEIGHT = 3
SQUARED_WEIGHT_CHANNEL = 4

ALBEDO_FLOOR = 1e-3
"""Albedo below which a pixel does not reveal the light that it receives; its weight is 0."""


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
    """One image with the channels radiance, weight sum, effective samples, optionally moment, and further images."""
    IMAGES = "images"
    """Radiance, further images, weight sum, effective samples and moment, each as an image of its own."""


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
    other_count: int = 0
    """Further images that are averaged by the same weights."""

    @property
    def own_channels(self) -> int:
        """Number of channels of the sums without those of further images."""
        return SUM_CHANNELS + self.moment

    @property
    def channels(self) -> int:
        """Number of channels of the sums."""
        return self.own_channels + self.other_count * (COLORS + 1)


def chain_passes(whole: PassKey, taps: Sequence[Taps], *, mirror: bool) -> list[PassKey]:
    """Return the keys of passes over ``taps`` that pass on sums and together compute ``whole``.

    ``mirror`` if the device gains from `PassKey.mirrored`; only rows do (docs/developers/performance.md).
    """
    last = len(taps) - 1
    return [
        replace(
            whole,
            taps=kind,
            reads=whole.reads if number == 0 else Reads.SUMS,
            writes=whole.writes if number == last else Writes.SUMS,
            modulate=whole.modulate and number == last,
            mirrored=mirror and not whole.strict and kind is Taps.HORIZONTAL,
        )
        for number, kind in enumerate(taps)
    ]


@dataclass(frozen=True)
class PassInputs:
    """The inputs of a pass."""

    source: hl.ImageParam
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
    others: Sequence[hl.ImageParam] = ()
    """Further images, as ``source`` is; none where it holds sums."""


def compute_expression_luminance(colour: Sequence[hl.Expr]) -> hl.Expr:
    return vectors.compute_luminance(expressions.HALIDE, colour)


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
        albedo=signature.image("albedo", *size, COLORS) if key.modulate or key.reads is Reads.DEMODULATED else None,
        mask=signature.image("mask", *size, type=hl.UInt(8)),
        arrays=declare_features(signature, "tap", features, *size),
        radius=signature.count("radius", most=LARGEST_RADIUS),
        step=signature.count("step", 1),
        scalars=declare_scalars(signature, features),
        strictness=signature.image("strictness", *size) if key.strict else None,
        others=[
            signature.image(f"more{number}", *size, COLORS)
            for number in range(key.other_count if key.reads is not Reads.SUMS else 0)
        ],
    )
    if key.writes is Writes.SUMS:
        signature.output("sums", "height", key.channels, "width")
    elif key.writes is Writes.PIXELS:
        signature.output("pixels", *size, key.own_channels + key.other_count * COLORS)
    else:
        for name in ("image", *(f"filtered{number}" for number in range(key.other_count))):
            signature.output(name, *size, COLORS)
        for name in ("weight_sum", "effective_samples", "moment")[: key.own_channels - COLORS]:
            signature.output(name, *size)
    return inputs


def make_pass(key: PassKey, features: Sequence[Feature], target: hl.Target) -> Scheduled:
    """Return a pass."""
    # Signature
    signature = Signature("cross pass")
    inputs = declare_pass(signature, key, features)

    # Algorithm
    is_sparse = key.taps is Taps.ATROUS
    reach, step = (hl.i32(ATROUS_RADIUS), inputs.step) if is_sparse else (inputs.radius, hl.i32(1))
    taps = TapSums(inputs.mask, key.taps, reach, step, count_lanes(target))
    image = _read_image(key, inputs, taps)
    profile = _compute_log_spline(U) + _compute_log_spline(V) if is_sparse else None
    log_weight = taps.compare("tap", features, inputs.scalars, inputs.arrays, profile)
    if inputs.strictness is not None:
        width, height = inputs.mask.width(), inputs.mask.height()
        log_weight = log_weight * inputs.strictness[clamp_likely(X, width), hl.clamp(Y, 0, height - 1)]

    def take(weight: hl.Expr, column: hl.Expr, line: hl.Expr) -> list[hl.Expr]:
        # Radiance has weight 1 and squared weight 1: both read one plane.
        single = key.reads is not Reads.SUMS
        planes = [min(k, WEIGHT) if single and k < SUM_CHANNELS else k for k in range(key.channels)]
        factors = [weight] * key.channels
        factors[SQUARED_WEIGHT_CHANNEL] = weight * weight
        return [factor * image[column, k, line] for factor, k in zip(factors, planes, strict=True)]

    out, *others = _write(key, inputs, taps.add(log_weight, take, mirrored=key.mirrored))

    # Schedule
    pixels = key.own_channels + key.other_count * COLORS if key.writes is Writes.PIXELS else key.channels
    taps.schedule(out, COLORS if others else pixels, *others)
    return Scheduled([out, *others[:1]], signature)


def _read_image(key: PassKey, inputs: PassInputs, taps: TapSums) -> hl.Func:
    """Return the summands of taps: radiance over albedo and weight 1, or sums as they are; all 0 for a bad pixel."""

    def take(at: tuple[hl.Expr, hl.Expr], usable: hl.Expr) -> hl.Expr:
        if key.reads is Reads.SUMS:
            return hl.select(usable, inputs.source[at[0], C, at[1]], hl.f32(0.0))
        albedo = inputs.albedo if key.reads is Reads.DEMODULATED else None
        radiance, good = demodulate(inputs.source, albedo, at, hl.f32(ALBEDO_FLOOR))
        values = [*radiance, hl.f32(1.0), hl.f32(1.0)]
        if key.moment:
            luminance = compute_expression_luminance(radiance)
            values.append(luminance * luminance)
        if not key.other_count:
            return hl.select(good & usable, hl.mux(C, values), hl.f32(0.0))
        values = [hl.select(good, value, hl.f32(0.0)) for value in values]
        for image in inputs.others:
            radiance, good = demodulate(image, albedo, at, hl.f32(ALBEDO_FLOOR))
            values += [hl.select(good, value, hl.f32(0.0)) for value in (*radiance, hl.f32(1.0))]
        return hl.select(usable, hl.mux(C, values), hl.f32(0.0))

    return taps.read("image", key.channels, take)


def _compute_log_spline(offset: hl.Expr) -> hl.Expr:
    """Return log2 of the B-spline weight at an offset from -2 to 2."""
    centre, near, far = (hl.f32(math.log2(weight)) for weight in ATROUS_PROFILE)
    distance = hl.abs(offset)
    return hl.select(distance == 0, centre, distance == 1, near, far)


def _write(key: PassKey, inputs: PassInputs, sums: Sequence[hl.Expr]) -> list[hl.Func]:
    """Return the output of a pass; if it writes several images, then the radiance, the others, and what all read."""
    out, numbers, finish = (hl.Func(name) for name in ("out", "rest", "finish"))
    if key.writes is Writes.SUMS:
        out[X, C, Y] = hl.mux(C, sums)
        return [out]
    alive = (inputs.mask[X, Y] != 0) & (sums[WEIGHT] > hl.f32(0.0))
    results = _divide(key, inputs, sums)
    if key.writes is Writes.PIXELS:
        out[C, X, Y] = hl.select(alive, hl.mux(C, results), hl.f32(0.0))
        return [out]
    finish[X, Y] = hl.Tuple([hl.select(alive, value, hl.f32(0.0)) for value in results])
    firsts = [0, *range(key.own_channels, len(results), COLORS)]
    images = [hl.mux(C, [finish[X, Y][first + k] for k in range(COLORS)]) for first in firsts]
    out[C, X, Y] = hl.Tuple(images) if key.other_count else images[0]
    numbers[X, Y] = hl.Tuple([finish[X, Y][k] for k in range(COLORS, key.own_channels)])
    return [out, numbers, finish]


def _divide(key: PassKey, inputs: PassInputs, sums: Sequence[hl.Expr]) -> list[hl.Expr]:
    """Return a pixel's radiance, weight sum, effective samples, moment if it was summed, and further images."""
    weight = sums[WEIGHT]
    tints: list[hl.Expr] | None = None
    if key.modulate and inputs.albedo is not None:
        tints = [inputs.albedo[k, X, Y] for k in range(COLORS)]
        tints = [hl.select(expressions.is_bad(tint), hl.f32(0.0), tint) for tint in tints]

    def divide(values: Sequence[hl.Expr], total: hl.Expr) -> list[hl.Expr]:
        mean = [value / total for value in values]
        return mean if tints is None else [value * tint for value, tint in zip(mean, tints, strict=True)]

    effective, own = count_samples(weight, sums[SQUARED_WEIGHT_CHANNEL]), key.own_channels
    results = [*divide(sums[:COLORS], weight), weight, effective, *(value / weight for value in sums[SUM_CHANNELS:own])]
    for first in range(own, len(sums), COLORS + 1):
        *values, total = sums[first : first + COLORS + 1]
        results += [hl.select(total > hl.f32(0.0), value, hl.f32(0.0)) for value in divide(values, total)]
    return results


def count_samples(total: hl.Expr, squares: hl.Expr) -> hl.Expr:
    """Return the effective number of samples, ``(sum w)^2 / sum w^2``.

    If the squares underflow before the sum does, one far tap dominates, which is one sample.
    """
    return hl.select(squares > hl.f32(0.0), total * total / squares, hl.f32(1.0))
