"""The cross-bilateral sum over two halves of the samples, both with the same weights.

For both halves X, ``out_X(i) = sum_j w(i, j) I_X(j) / sum_j w(i, j)``, ``w = a_j place lobes^p exp(-E)``. a_j is
the luminance of the albedo, so that the mean is the ratio of reflected radiance to albedo. ``place`` and ``lobes`` are
the products of the similarities of two groups of features. E is the distance of the two pixels in a guide, an image
that was filtered before. The difference of the filtered halves then shows their noise.

The distance in the guide is equation 2 of Rousselle, Knaus and Zwicker 2012, "Adaptive Rendering with Non-Local Means
Filtering": squared differences minus the part that noise explains, over the noise. Departs: compares pixels instead of
patches, because the guide is a filtered image; uses one guide for both halves instead of each half's for the other,
because a filtered pilot hardly depends on the noise of a single pixel, and one weight is less work than two
(docs/research/quality_trials.md).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Stage
from lobewise.filters.cross_pass import (
    ALBEDO_FLOOR,
    COLORS,
    U,
    V,
    demodulate,
    find_luminance,
    make_stage,
)
from lobewise.filters.planes import C, Rows, X, Y, make_guide_planes, make_image
from lobewise.settings import LARGEST_RADIUS

HALVES = 2
GUIDE_CHANNELS = COLORS + 1
"""Channels of a guide: three colours and their variance."""
SUMS = COLORS + 2
"""Sums of one half: weighted radiance, weight, squared weight."""
PLANES = HALVES * (COLORS + 1)
"""Planes of the images that taps read: the summands and the weight of each half."""
NOISE_FLOOR = 1e-4
"""Added to the variance that squared differences are divided by."""


class Groups(NamedTuple):
    """Features, or something for each feature, by group. The similarity of the lobes alone has an exponent."""

    place: Any
    lobes: Any


@dataclass(frozen=True)
class DualBufferKey:
    """Everything that changes the code of a dual-buffer pass."""

    groups: tuple[tuple[Hashable, ...], ...]
    """Structures of the features of `Groups`."""
    guided: bool


@dataclass(frozen=True)
class _Inputs:
    """The inputs of a dual-buffer pass."""

    halves: list[hl.ImageParam]
    albedo: hl.Func
    """The albedo, 1 where the light is not divided."""
    mask: hl.ImageParam
    arrays: Groups
    scalars: Groups
    radius: hl.Expr
    step: hl.Expr
    guide: hl.ImageParam | None
    noise: hl.Expr
    """Factor of the variance in the distance."""
    exponent: hl.Expr
    """Exponent of the similarity of the lobes."""


class HalfSums(NamedTuple):
    """The sums over the taps of a pixel, of one half."""

    light: list[hl.Expr]
    weight: hl.Expr
    squared_weight: hl.Expr


@dataclass(kw_only=True)
class DualBufferFuncs:
    """The Halide functions of a dual-buffer pass, for its schedules."""

    key: DualBufferKey
    signature: Signature
    images: hl.Func
    guide: hl.Func | None
    planes: Groups
    """`GuidePlanes` of every group of features."""
    rows: Rows | None
    """Parts of rows that images, guide and planes are computed in, on processors."""
    stages: list[hl.Func]
    row: hl.Func
    across: hl.RDom
    sums: hl.Func
    down: hl.RDom
    out: hl.Func


def _declare(signature: Signature, key: DualBufferKey, groups: Groups) -> _Inputs:
    """Declare the inputs and outputs of a pass."""
    size = "height", "width"
    named = groups._asdict().items()
    tints, divided = signature.image("albedo", *size, COLORS), signature.count("divided", most=1)
    albedo = hl.Func("albedo_or_one")
    albedo[C, X, Y] = hl.select(divided != 0, tints[C, X, Y], hl.f32(1.0))
    inputs = _Inputs(
        halves=[signature.image(name, *size, COLORS) for name in ("half_a", "half_b")],
        albedo=albedo,
        mask=signature.image("mask", *size, type=hl.UInt(8)),
        arrays=Groups(*(declare_features(signature, name, features, *size) for name, features in named)),
        scalars=Groups(*(declare_scalars(signature, features, name) for name, features in named)),
        radius=signature.count("radius", most=LARGEST_RADIUS),
        step=signature.count("step", 1),
        guide=signature.image("guide", *size, GUIDE_CHANNELS) if key.guided else None,
        noise=signature.number("noise"),
        exponent=signature.number("exponent"),
    )
    for name in ("a", "b", "support"):
        signature.output(name, *size, COLORS)
    return inputs


def make_dual_buffer_pass(key: DualBufferKey, groups: Groups, *, lanes: int = 0) -> DualBufferFuncs:
    """Return the algorithm of a dual-buffer pass; ``lanes`` pixels make a processor's vector, 0 for graphics cards."""
    signature = Signature("dual buffer")
    inputs = _declare(signature, key, groups)
    mask = inputs.mask
    rows = Rows(mask.width(), inputs.step * inputs.radius, lanes) if lanes else None
    images = _read_images(inputs, rows)
    sides = zip(Groups._fields, groups, inputs.scalars, inputs.arrays, strict=True)
    planes = Groups(
        *(make_guide_planes(name, mask, each, own, arrays=arrays, rows=rows) for name, each, own, arrays in sides)
    )
    stages: list[hl.Func] = []
    stage = make_stage(stages, (X, Y, U, V))
    logs = _compare(groups, inputs, planes, stage)
    guide, given = None, inputs.guide
    if given is not None:
        guide = make_image("guide", mask, rows, lambda at, _: given[C, at[0], at[1]])
    distance = None if guide is None else stage(_find_distance(guide, inputs))
    log_weight = _weigh(inputs, logs, distance)

    # Sum each row of taps in a separate function, so that its sums stay in registers.
    span = [(-inputs.radius, 2 * inputs.radius + 1)]
    across, down = hl.RDom(span, "across"), hl.RDom(span, "down")
    row, sums = hl.Func("row"), hl.Func("sums")
    zeros = [hl.f32(0.0)] * (HALVES * SUMS)
    row[X, Y, V] = hl.Tuple(zeros)
    taken = _take(images, log_weight, inputs.step, across)
    row[X, Y, V] = hl.Tuple([row[X, Y, V][k] + value for k, value in enumerate(taken)])
    sums[X, Y] = hl.Tuple(zeros)
    sums[X, Y] = hl.Tuple([sums[X, Y][k] + row[X, Y, down.x][k] for k in range(len(zeros))])

    found = _find_means([_name_sums(sums, half) for half in range(HALVES)], _find_share(inputs.albedo, (X, Y)))
    results = [hl.select(mask[X, Y] != 0, hl.mux(C, image), hl.f32(0.0)) for image in found]
    out = hl.Func("out")
    out[C, X, Y] = hl.Tuple(results)
    return DualBufferFuncs(
        key=key,
        signature=signature,
        images=images,
        guide=guide,
        planes=planes,
        rows=rows,
        stages=[*stages, log_weight],
        row=row,
        across=across,
        sums=sums,
        down=down,
        out=out,
    )


def _read_images(inputs: _Inputs, rows: Rows | None) -> hl.Func:
    """Return the summands of taps: radiance over albedo times the albedo's luminance, and the luminance as weight.

    All are 0 for a bad pixel. They are planes of each half.
    """

    def take(at: tuple[hl.Expr, hl.Expr], usable: hl.Expr) -> hl.Expr:
        values: list[hl.Expr] = []
        for half in inputs.halves:
            radiance, good = demodulate(half, inputs.albedo, at, hl.f32(ALBEDO_FLOOR))
            share = _find_share(inputs.albedo, at)
            radiance = _fill_unknown(radiance, [inputs.albedo[k, at[0], at[1]] for k in range(COLORS)])
            values += [hl.select(good & usable, value * share, hl.f32(0.0)) for value in (*radiance, hl.f32(1.0))]
        return hl.mux(C, values)

    return make_image("images", inputs.mask, rows, take)


def _compare(groups: Groups, inputs: _Inputs, planes: Groups, stage: Stage) -> Groups:
    """Return the base-2 logarithm of a tap's similarity for each group of features."""
    step = inputs.step
    offset = hl.f32(U * step), hl.f32(V * step)
    logs: list[hl.Expr] = []
    for features, each, scalars in zip(groups, planes, inputs.scalars, strict=True):
        total: hl.Expr = hl.f32(0.0)
        for feature, layout, own in zip(features, each.layouts, scalars, strict=True):
            i, j = each.read(layout, X, Y), each.read(layout, X + U * step, Y + V * step)
            total = total + feature.log2_similarity(i, j, own, offset, stage)
        logs.append(total)
    return Groups(*logs)


def _find_distance(guide: hl.Func, inputs: _Inputs) -> hl.Expr:
    """Return the distance of a pixel and a tap in the guide: beyond noise, in units of noise, times log2(e)."""
    there = X + U * inputs.step, Y + V * inputs.step
    own_noise, other_noise = (guide[at[0], COLORS, at[1]] for at in ((X, Y), there))
    explained = hl.f32(COLORS) * (own_noise + hl.min(own_noise, other_noise))
    scale = hl.f32(LOG2_E / COLORS) / (hl.f32(NOISE_FLOOR) + inputs.noise * (own_noise + other_noise))
    changes = [guide[X, k, Y] - guide[there[0], k, there[1]] for k in range(COLORS)]
    squares = sum((change * change for change in changes), hl.f32(0.0))
    return hl.max(squares - explained, hl.f32(0.0)) * scale


def _weigh(inputs: _Inputs, logs: Groups, distance: hl.Expr | None) -> hl.Func:
    """Return the base-2 logarithm of a tap's weight."""
    alike = logs.place + inputs.exponent * logs.lobes
    log_weight = hl.Func("log_weight")
    log_weight[X, Y, U, V] = alike if distance is None else alike - distance
    return log_weight


def _take(images: hl.Func, log_weight: hl.Func, step: hl.Expr, across: hl.RDom) -> list[hl.Expr]:
    """Return the summands of a tap, in the order of `HalfSums`, for each half."""
    weight = expressions.exp2(log_weight[X, Y, across.x, V])
    tap = [images[X + across.x * step, k, Y + V * step] for k in range(PLANES)]
    taken: list[hl.Expr] = []
    for first in range(0, PLANES, COLORS + 1):
        *light, share = tap[first : first + COLORS + 1]
        counted = weight * share
        taken += [*(weight * value for value in light), counted, counted * counted]
    return taken


def _name_sums(sums: hl.Func, number: int) -> HalfSums:
    own = [sums[X, Y][number * SUMS + k] for k in range(SUMS)]
    return HalfSums(own[:COLORS], own[COLORS], own[COLORS + 1])


def _fill_unknown(light: Sequence[hl.Expr], tints: Sequence[hl.Expr]) -> list[hl.Expr]:
    """Return light whose channels with an albedo of almost 0 are replaced by the mean of the other channels."""
    known = [tint > hl.f32(ALBEDO_FLOOR) for tint in tints]
    count = sum((hl.f32(each) for each in known), hl.f32(0.0))
    told = [hl.select(each, value, hl.f32(0.0)) for each, value in zip(known, light, strict=True)]
    mean = sum(told, hl.f32(0.0)) / hl.max(count, hl.f32(1.0))
    return [hl.select(each, value, mean) for each, value in zip(known, light, strict=True)]


def _find_share(albedo: hl.Func, at: tuple[hl.Expr, hl.Expr]) -> hl.Expr:
    """Return the luminance of the albedo at a pixel; bad channels count as 0."""
    tints = [albedo[k, at[0], at[1]] for k in range(COLORS)]
    return find_luminance([hl.select(expressions.is_bad(tint), hl.f32(0.0), tint) for tint in tints])


def _find_means(halves: Sequence[HalfSums], share: hl.Expr) -> list[list[hl.Expr]]:
    """Return the output images. A half whose weights are all 0 takes the mean of the other half."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    totals = [half.weight for half in halves]
    means = [[hl.select(half.weight > zero, value / half.weight, zero) for value in half.light] for half in halves]
    # If the squares underflow before the sum does, one far tap dominates, which is one sample.
    spreads = [
        hl.select(
            (half.weight > zero) & (half.squared_weight > zero),
            half.squared_weight / (half.weight * half.weight),
            one,
        )
        for half in halves
    ]
    found = [
        [hl.select(totals[half] > zero, means[half][k], means[1 - half][k]) for k in range(COLORS)]
        for half in range(HALVES)
    ]
    weight = hl.f32(0.5) * (totals[0] + totals[1]) / hl.max(share, hl.f32(ALBEDO_FLOOR))
    # If one half is empty, both means are the other half's. The empty half has the larger spread.
    some, both = (totals[0] > zero) | (totals[1] > zero), (totals[0] > zero) & (totals[1] > zero)
    alone = hl.select(some, one / hl.min(spreads[0], spreads[1]), zero)
    worth = hl.select(both, hl.f32(4.0) / (spreads[0] + spreads[1]), alone)
    return [*found, [weight, worth, zero]]
