"""The cross-bilateral sum over two halves of the samples, both by the same weights.

For both halves X at once, ``out_X(i) = sum_j w(i, j) I_X(j) / sum_j w(i, j)`` with
``w = a_j place^p lobes^l seen^s exp(-r E)``: a_j the luminance of the albedo (so that the mean is that of light
received, as a ratio of sums is), ``place``, ``lobes`` and ``seen`` the products of the similarities of three groups of
features, and E how far apart the two pixels are in a guide, an image filtered before. How far the filtered halves are
apart then tells how noisy they are. Several variants (p, l, r, s) share all that is the same for them.

The distance in the guide is equation 2 of Rousselle, Knaus and Zwicker 2012, "Adaptive Rendering with Non-Local Means
Filtering": squared differences less what the noise explains, over the noise. Departs: of pixels, not of patches,
because the guide is a filtered image already; and one guide for both halves, not each half by the other's: what a pilot
averages hardly knows the noise of a single pixel, and one weight is less work than two (docs/quality.md).
"""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.expressions import LOG2_E
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import ALBEDO_FLOOR, demodulate, find_luminance, make_stage
from lobewise.filters.planes import GuidePlanes, Rows, begin_at_zero, make_guide_planes, make_image

COLORS = 3
HALVES = 2
GUIDE_CHANNELS = COLORS + 1
"""Colours and their variance."""
SUMS = COLORS + 2
"""Of one half in one variant: weighted radiance, weight, squared weight."""
OUTPUTS = HALVES + 1
"""Images of one variant, three channels each: the mean of each half, or of both where they are joined; weight sum,
effective samples and nothing."""
NOISE_FLOOR = 1e-4
"""Added to the noise that differences are divided by."""


@dataclass(frozen=True)
class DualBufferKey:
    """Everything that changes the code of a dual-buffer pass."""

    radius: int
    place: tuple[Hashable, ...]
    lobes: tuple[Hashable, ...]
    seen: tuple[Hashable, ...]
    demodulate: bool
    guided: bool
    joined: bool
    """Whether only the mean of both halves is wanted."""
    variants: int

    @property
    def plane_count(self) -> int:
        """Planes of the images that taps read."""
        return COLORS + 2 if self.joined else HALVES * (COLORS + 1)


@dataclass
class DualBufferFuncs:
    """The Halide functions of a dual-buffer pass, for the schedules."""

    out: hl.Func
    sums: hl.Func
    row: hl.Func
    images: hl.Func
    image_count: int
    guide: hl.Func | None
    planes: list[GuidePlanes]
    """Of every group of features."""
    rows: Rows | None
    """What images, guide and planes are made of, on processors."""
    stages: list[hl.Func]
    across: hl.RDom
    down: hl.RDom
    variants: int
    arguments: list[Any]


def make_dual_buffer_pass(
    key: DualBufferKey, groups: Sequence[Sequence[Feature]], *, lanes: int = 0
) -> DualBufferFuncs:
    """Return the algorithm of a dual-buffer pass for the features of place, of lobes and of what is seen.

    For processors with vectors of ``lanes`` pixels, or 0 for others.

    The arguments of the compiled pass, in order: both halves (c, x, y); albedo (c, x, y) where demodulated; mask
    (x, y) uint8; guide (c, x, y) where guided, with `GUIDE_CHANNELS`; the arrays of every feature;
    step (int32) from tap to tap; noise, the factor of the variance in the distance; the parameters of every feature;
    the exponents of place, lobes, range and what is seen of every variant; out the images of every variant (c, x, y).
    """
    x, y, c, u, v = (hl.Var(name) for name in ("x", "y", "c", "u", "v"))
    halves = [_make_image(f"half{number}", COLORS) for number in range(HALVES)]
    albedo, guide_input = _make_image("albedo", COLORS), _make_image("guide_input", GUIDE_CHANNELS)
    mask = hl.ImageParam(hl.UInt(8), 2, "mask")
    noise, step = hl.Param(hl.Float(32), "noise"), hl.Param(hl.Int(32), "step")
    rows = Rows(mask.width(), step * key.radius, lanes) if lanes else None
    there = x + u * step, y + v * step

    def take_images(at: tuple[hl.Expr, hl.Expr], usable: hl.Expr) -> hl.Expr:
        """Return radiance over albedo, times its luminance, which is the weight; nothing where a pixel is bad."""
        values: list[hl.Expr] = []
        for half in halves:
            radiance, good = demodulate(half, albedo if key.demodulate else None, at, hl.f32(ALBEDO_FLOOR))
            share: hl.Expr = hl.f32(1.0)
            if key.demodulate:
                share = _find_share(albedo, at)
                radiance = _fill_unknown(radiance, [albedo[k, at[0], at[1]] for k in range(COLORS)])
            values += [hl.select(good & usable, value * share, hl.f32(0.0)) for value in (*radiance, hl.f32(1.0))]
        if key.joined:
            # Of both halves together; then the weight of one, for the sum of squares.
            a, b = values[: COLORS + 1], values[COLORS + 1 :]
            values = [*(p + q for p, q in zip(a, b, strict=True)), hl.max(a[COLORS], b[COLORS])]
        return hl.mux(c, values)

    images = make_image("images", mask, rows, take_images)

    scalars = [
        [
            [hl.Param(hl.Float(32), f"g{group}p{number}_{k}") for k in range(len(feature.get_parameters()))]
            for number, feature in enumerate(features)
        ]
        for group, features in enumerate(groups)
    ]
    sides = [
        make_guide_planes(name, mask, features, own, rows=rows)
        for name, features, own in zip(("place", "lobes", "seen"), groups, scalars, strict=True)
    ]
    stages: list[hl.Func] = []
    stage = make_stage(stages, (x, y, u, v))

    logs: list[hl.Expr] = []
    for features, side, own in zip(groups, sides, scalars, strict=True):
        total: hl.Expr = hl.f32(0.0)
        for feature, layout, parameters in zip(features, side.layouts, own, strict=True):
            i, j = side.read(layout, x, y), side.read(layout, *there)
            total = total + feature.log2_similarity(i, j, parameters, (hl.f32(u * step), hl.f32(v * step)), stage)
        logs.append(total)

    guide = None
    distance: hl.Expr = hl.f32(0.0)
    if key.guided:
        guide = make_image("guide", mask, rows, lambda at, _: guide_input[c, at[0], at[1]])
        own_noise, other_noise = (guide[at[0], COLORS, at[1]] for at in ((x, y), there))
        explained = hl.f32(COLORS) * (own_noise + hl.min(own_noise, other_noise))
        scale = hl.f32(LOG2_E / COLORS) / (hl.f32(NOISE_FLOOR) + noise * (own_noise + other_noise))
        changes = [guide[x, k, y] - guide[there[0], k, there[1]] for k in range(COLORS)]
        squares = sum((change * change for change in changes), hl.f32(0.0))
        distance = stage(hl.max(squares - explained, hl.f32(0.0)) * scale)

    exponents = [[hl.Param(hl.Float(32), f"{name}{k}") for name in ("p", "l", "r", "s")] for k in range(key.variants)]
    log_weights: list[hl.Expr] = []
    for of_place, of_lobes, of_range, of_seen in exponents:
        shared = of_place * logs[0] + of_lobes * logs[1] + of_seen * logs[2]
        log_weights.append(shared - of_range * distance if key.guided else shared)
    log_weight = hl.Func("log_weight")
    log_weight[x, y, u, v] = hl.Tuple(log_weights) if len(log_weights) > 1 else log_weights[0]

    # A row of taps is summed by itself, so that its sums stay in registers.
    r = key.radius
    across, down = hl.RDom([(-r, 2 * r + 1)], "across"), hl.RDom([(-r, 2 * r + 1)], "down")
    row = hl.Func("row")
    summed = 1 if key.joined else HALVES
    zeros = [hl.f32(0.0)] * (key.variants * summed * SUMS)
    row[x, y, v] = hl.Tuple(zeros)
    at = log_weight[x, y, across.x, v]
    taken = [images[x + across.x * step, k, y + v * step] for k in range(key.plane_count)]
    updates: list[hl.Expr] = []
    for variant in range(key.variants):
        weight = expressions.exp2(at[variant] if key.variants > 1 else at)
        for first in range(0, summed * (COLORS + 1), COLORS + 1):
            *light, share = taken[first : first + COLORS + 1]
            counted = weight * share
            square = counted * (weight * taken[-1]) if key.joined else counted * counted
            for value in (*(weight * value for value in light), counted, square):
                updates.append(row[x, y, v][len(updates)] + value)
    row[x, y, v] = hl.Tuple(updates)
    sums = hl.Func("sums")
    sums[x, y] = hl.Tuple(zeros)
    sums[x, y] = hl.Tuple([sums[x, y][k] + row[x, y, down.x][k] for k in range(len(zeros))])

    results: list[hl.Expr] = []
    own_share = _find_share(albedo, (x, y)) if key.demodulate else hl.f32(1.0)
    for variant in range(key.variants):
        own_sums = [sums[x, y][variant * summed * SUMS + k] for k in range(summed * SUMS)]
        found = (_find_mean if key.joined else _find_means)(own_sums, own_share)
        results += [hl.select(mask[x, y] != 0, hl.mux(c, image), hl.f32(0.0)) for image in found]
    out = hl.Func("out")
    out[c, x, y] = hl.Tuple(results)
    arguments: list[Any] = [*halves]
    arguments += [albedo] if key.demodulate else []
    arguments += [mask]
    arguments += [guide_input] if key.guided else []
    arguments += [array for side in sides for array in side.arrays]
    arguments += [step, noise]
    arguments += [parameter for own in scalars for each in own for parameter in each]
    arguments += [parameter for each in exponents for parameter in each]
    return DualBufferFuncs(
        out=out,
        sums=sums,
        row=row,
        images=images,
        image_count=key.plane_count,
        guide=guide,
        planes=sides,
        rows=rows,
        stages=[*stages, log_weight],
        across=across,
        down=down,
        variants=key.variants,
        arguments=arguments,
    )


def _make_image(name: str, channels: int) -> hl.ImageParam:
    image = hl.ImageParam(hl.Float(32), 3, name)
    image.dim(1).set_stride(channels)
    begin_at_zero(image)
    return image


def _fill_unknown(light: Sequence[hl.Expr], tints: Sequence[hl.Expr]) -> list[hl.Expr]:
    """Return the light with the mean of its known channels where the albedo has no such channel to tell it by."""
    known = [tint > hl.f32(ALBEDO_FLOOR) for tint in tints]
    count = sum((hl.f32(each) for each in known), hl.f32(0.0))
    told = [hl.select(each, value, hl.f32(0.0)) for each, value in zip(known, light, strict=True)]
    mean = sum(told, hl.f32(0.0)) / hl.max(count, hl.f32(1.0))
    return [hl.select(each, value, mean) for each, value in zip(known, light, strict=True)]


def _find_share(albedo: hl.ImageParam, at: tuple[hl.Expr, hl.Expr]) -> hl.Expr:
    """Return the luminance of the albedo at a pixel; bad channels count 0."""
    tints = [albedo[k, at[0], at[1]] for k in range(COLORS)]
    return find_luminance([hl.select(expressions.is_bad(tint), hl.f32(0.0), tint) for tint in tints])


def _find_means(sums: Sequence[hl.Expr], share: hl.Expr) -> list[list[hl.Expr]]:
    """Return the images of a variant; a half that gathered nothing takes the other's mean."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    means: list[list[hl.Expr]] = []
    totals: list[hl.Expr] = []
    spreads: list[hl.Expr] = []
    for half in range(HALVES):
        total, square = sums[half * SUMS + COLORS], sums[half * SUMS + COLORS + 1]
        means.append([hl.select(total > zero, sums[half * SUMS + k] / total, zero) for k in range(COLORS)])
        totals.append(total)
        # The squares underflow before the sum does: then one far tap decides, which is one sample.
        spreads.append(hl.select((total > zero) & (square > zero), square / (total * total), one))
    found = [
        [hl.select(totals[half] > zero, means[half][k], means[1 - half][k]) for k in range(COLORS)]
        for half in range(HALVES)
    ]
    weight = hl.f32(0.5) * (totals[0] + totals[1]) / hl.max(share, hl.f32(ALBEDO_FLOOR))
    # The mean of a half and itself is worth that half; the spread of one that gathered nothing is the larger.
    some, both = (totals[0] > zero) | (totals[1] > zero), (totals[0] > zero) & (totals[1] > zero)
    alone = hl.select(some, one / hl.min(spreads[0], spreads[1]), zero)
    worth = hl.select(both, hl.f32(4.0) / (spreads[0] + spreads[1]), alone)
    return [*found, [weight, worth, zero]]


def _find_mean(sums: Sequence[hl.Expr], share: hl.Expr) -> list[list[hl.Expr]]:
    """Return the images of a variant whose halves were added up: their mean, and how it is supported."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    total, square = sums[COLORS], sums[COLORS + 1]
    mean = [hl.select(total > zero, sums[k] / total, zero) for k in range(COLORS)]
    worth = hl.select(square > zero, total * total / square, one)
    weight = hl.f32(0.5) * total / hl.max(share, hl.f32(ALBEDO_FLOOR))
    return [mean, [weight, hl.select(total > zero, worth, zero), zero]]
