"""Samples brought to every pixel and joined with its history, as a Halide algorithm: one pass from samples to sums.

A shaded sample stands for one pixel of a block of ``factor`` times ``factor`` pixels. For every pixel i

- the history's trust is the mean of the samples' trust t: ``sum_j w(i, j) t_j / sum_j w(i, j)`` over a few taps, w the
  product of the features' similarities; the history counts as much less;
- its unit is ``(frames + 1)**growth``, frames those that the history is then worth: what a sample counts that matches
  fully, and the power to which the pixel raises its weights, so that the kernel narrows as the history grows;
- the sums are ``unit sum_j w(i, j)**(unit s_i) I_j`` over all taps, the history's, and those of the pixel's own sample,
  where it has one, so that it counts ``own`` times as much as one that was borrowed; s_i is a power of its own.

Channels of a sum: see `lobewise.filters.reprojection`. Written out in NumPy: `lobewise.temporal.sums`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import halide as hl

from lobewise.backend import expressions
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import ALBEDO_FLOOR, SQUARED_WEIGHT, WEIGHT, demodulate, find_luminance, make_stage
from lobewise.filters.planes import begin_at_zero, make_guide_planes
from lobewise.filters.reprojection import FRAMES, HISTORY_CHANNELS, MOMENT

SMALLEST_WEIGHT = 1e-12
"""Weight sum to which a smaller one is raised: a pixel that resembles nothing keeps the little that it has."""

SUMMARY = HISTORY_CHANNELS
"""First plane of the summary: radiance (3), weight sum over unit, effective samples, variance of the luminance."""
PLANES = SUMMARY + 6
"""How many planes the pass writes."""


@dataclass
class JoiningFuncs:
    """The Halide functions of the pass, for the schedules."""

    out: hl.Func
    once: list[hl.Func]
    """What many expressions of a pixel have in common, in the order in which they need it."""
    weights: tuple[tuple[hl.Func, hl.RDom, hl.Func], ...]
    """Each sum over taps, its taps and its weights."""
    log_weight: hl.Func
    stages: list[hl.Func]
    wide: hl.Func
    """Planes and values of the samples' pixels, repeated for every pixel of a block's width."""
    wide_count: int
    tap_guides: hl.Func | None
    tap_guide_count: int
    tap_planes: hl.Func
    own_guides: hl.Func | None
    own_planes: hl.Func | None
    own_plane_count: int
    x: hl.Var
    y: hl.Var
    c: hl.Var
    arguments: list[Any]


def make_joining(features: Sequence[Feature], tinted: bool) -> JoiningFuncs:
    """Return the algorithm; ``tinted`` samples are divided by an albedo.

    The arguments of the compiled kernel, in order: samples (3, X, Y); of their pixels the albedo (3, X, Y) if tinted,
    the mask (X, Y) uint8, the arrays of every feature and the trust (X, Y); of all pixels albedo, mask and arrays,
    power s (x, y) and history (x, y, 7); the parameters of every feature; int32 radius, radius of the trust's taps,
    factor, column and row of the samples' pixels in their blocks; float32 spacing (pixels of the screen from sample to
    sample), growth, own, and whether to multiply by the albedo on the way out (1). Images of all pixels are at least as
    wide as a vector.
    """
    x, y, c = hl.Var("x"), hl.Var("y"), hl.Var("c")
    source = hl.ImageParam(hl.Float(32), 3, "source")
    trust = hl.ImageParam(hl.Float(32), 2, "trust")
    tap_mask, own_mask = hl.ImageParam(hl.UInt(8), 2, "tap_mask"), hl.ImageParam(hl.UInt(8), 2, "own_mask")
    tap_albedo, own_albedo = (hl.ImageParam(hl.Float(32), 3, f"{name}_albedo") for name in ("tap", "own"))
    power = hl.ImageParam(hl.Float(32), 2, "power")
    history = hl.ImageParam(hl.Float(32), 3, "history")
    radius, trust_radius, factor, place_x, place_y = (
        hl.Param(hl.Int(32), name) for name in ("radius", "trust_radius", "factor", "place_x", "place_y")
    )
    spacing, growth, own, modulate = (hl.Param(hl.Float(32), name) for name in ("spacing", "growth", "own", "modulate"))
    scalars = [
        [hl.Param(hl.Float(32), f"p{number}_{k}") for k in range(len(feature.get_parameters()))]
        for number, feature in enumerate(features)
    ]
    for image in (source, tap_albedo, own_albedo):
        image.dim(1).set_stride(3)
    for image in (source, trust, tap_mask, own_mask, tap_albedo, own_albedo, power, history):
        begin_at_zero(image)
    # What is known not to be negative makes plainer loops.
    factor.set_range(1, 1 << 16)
    radius.set_range(0, 1 << 16)
    trust_radius.set_range(0, 1 << 16)
    zero, one = hl.f32(0.0), hl.f32(1.0)
    columns, rows = tap_mask.width(), tap_mask.height()

    # Samples: the planes of every feature, radiance over albedo, 1 where it counts, its squared luminance, the trust
    # and where that counts.
    side = make_guide_planes("tap", tap_mask, features, scalars)
    at = hl.clamp(x, 0, columns - 1), hl.clamp(y, 0, rows - 1)
    usable = (x >= 0) & (x < columns) & (y >= 0) & (y < rows) & (tap_mask[at] != 0)
    floor = hl.f32(ALBEDO_FLOOR)
    light, good = demodulate(source, tap_albedo if tinted else None, at, floor)
    good = good & usable
    luminance = find_luminance(light)
    values = [*light, one, luminance * luminance]
    values = [hl.select(good, value, zero) for value in values]
    values += [hl.select(usable, value, zero) for value in (trust[at], one)]
    count = side.plane_count + len(values)
    planes = [] if side.planes is None else [side.planes[x, k, y] for k in range(side.plane_count)]
    tap_planes = hl.Func("tap_values")
    tap_planes[x, c, y] = hl.mux(c, [*planes, *values])

    # Pixels centres have halves, so that rounding cannot lead into another block.
    def find_block(at: hl.Expr) -> hl.Expr:
        return hl.i32(hl.floor((hl.f32(at) + hl.f32(0.5)) / hl.f32(factor)))

    wide = hl.Func("wide")
    wide[x, c, y] = tap_planes[find_block(x), c, y]

    # The logarithm of the weights, by tap.
    centre = make_guide_planes("own", own_mask, features, scalars, inside=True)
    u, v = hl.Var("u"), hl.Var("v")
    block = find_block(x), find_block(y)
    shift = place_x + block[0] * factor - x, place_y + block[1] * factor - y
    offset = spacing * hl.f32(u) + hl.f32(shift[0]), spacing * hl.f32(v) + hl.f32(shift[1])
    stages: list[hl.Func] = []
    stage = make_stage(stages, (x, y, u, v))

    exponent: hl.Expr = zero
    for feature, layout, parameters in zip(features, side.layouts, scalars, strict=True):
        i = centre.read(layout, x, y)
        j = layout.read(lambda k: wide[x + u * factor, k, block[1] + v])
        exponent = exponent + feature.log2_similarity(i, j, parameters, offset, stage)
    log_weight = hl.Func("log_weight")
    log_weight[x, y, u, v] = exponent

    def read_tap(channel: int, taps: hl.RDom) -> hl.Expr:
        return wide[x + taps.x * factor, side.plane_count + channel, block[1] + taps.y]

    # The history, as far as the samples here bear it out.
    once: list[hl.Func] = []

    def keep(name: str, *values: hl.Expr) -> Any:
        """Compute values once for each pixel; what many expressions repeat takes the compiler long."""
        func = hl.Func(name)
        func[x, y] = hl.Tuple(list(values))
        once.append(func)
        return func[x, y]

    near = hl.RDom([(-trust_radius, 2 * trust_radius + 1), (-trust_radius, 2 * trust_radius + 1)], "near")
    trusted = hl.Func("trusted")
    trusted[x, y] = hl.Tuple([zero, zero])
    similarity = hl.Func("similarity")
    similarity[x, y, u, v] = expressions.exp2(log_weight[x, y, u, v])
    weight = similarity[x, y, near.x, near.y]
    trusted[x, y] = hl.Tuple([trusted[x, y][k] + weight * read_tap(5 + k, near) for k in range(2)])
    told = trusted[x, y][1]
    share = hl.select(told > zero, trusted[x, y][0] / told, one)
    known = [history[x, y, k] * share for k in range(HISTORY_CHANNELS)]
    known[SQUARED_WEIGHT] = known[SQUARED_WEIGHT] * share
    frames = known[FRAMES]
    unit = keep("unit", hl.select(frames == zero, one, hl.pow(frames + one, growth)), *known)
    worth, known = unit[0], [unit[1 + k] for k in range(HISTORY_CHANNELS)]

    # This frame's sums.
    taps = hl.RDom([(-radius, 2 * radius + 1), (-radius, 2 * radius + 1)], "taps")
    weights = hl.Func("weights")
    weights[x, y, u, v] = expressions.exp2(log_weight[x, y, u, v] * (power[x, y] * worth))
    weight = weights[x, y, taps.x, taps.y]
    sums = hl.Func("sums")
    sums[x, y] = hl.Tuple([zero] * 6)
    taken = [read_tap(k, taps) for k in (0, 1, 2, 3, 3, 4)]
    factors = [weight] * 6
    factors[SQUARED_WEIGHT] = weight * weight
    sums[x, y] = hl.Tuple([sums[x, y][k] + factors[k] * taken[k] for k in range(6)])

    # The pixel's own sample, beside what it counts in them. Without noise a lower albedo still tells of the light.
    sample = hl.clamp(block[0], 0, columns - 1), hl.clamp(block[1], 0, rows - 1)
    light, good = demodulate(source, own_albedo if tinted else None, sample, floor / own, (x, y))
    shaded = (shift[0] == 0) & (shift[1] == 0) & (block[0] < columns) & (block[1] < rows)
    more = (own - one) * worth
    good = good & shaded & (own_mask[x, y] != 0) & (more > zero)
    sample = keep("sample", *(hl.select(good, value, zero) for value in (more, *light)))
    more, light = sample[0], [sample[k] for k in (1, 2, 3)]
    luminance = find_luminance(light)
    bonus = [
        *(more * value for value in light),
        more,
        more * (more + worth + worth),
        more * luminance * luminance,
        zero,
    ]

    # Joined.
    total, squares = sums[x, y][WEIGHT], sums[x, y][SQUARED_WEIGHT]
    # The squares underflow before the sum does: then one far tap decides, which is one sample.
    effective = hl.select(squares > zero, total * total / squares, one)
    gathered = total * worth
    alive = (own_mask[x, y] != 0) & (gathered > zero)
    gathered = hl.max(gathered, hl.f32(SMALLEST_WEIGHT))
    # Rearranged, a product of two small numbers would come first and vanish.
    scale = hl.strict_float(gathered / total)
    new = [sums[x, y][k] * scale for k in range(3)]
    new += [gathered, gathered * gathered / hl.max(effective, one), sums[x, y][MOMENT] * scale, one]
    joined = keep(
        "joined",
        *(p + hl.select(alive, q, zero) + r for p, q, r in zip(known, new, bonus, strict=True)),
    )

    # The summary.
    weight = joined[WEIGHT]
    some = weight > zero
    mean = [hl.select(some, joined[k] / weight, zero) for k in range(3)]
    luminance = find_luminance(mean)
    spread = hl.select(some, joined[MOMENT] / weight - luminance * luminance, zero)
    # In two steps, because the square of a large weight overflows; between the pixels of a history the sums are
    # interpolated one by one, which does not keep the count at 1.
    effective = hl.max(weight / hl.max(joined[SQUARED_WEIGHT], hl.f32(1e-30)) * weight, one)
    variance = hl.max(spread, zero) / effective
    if tinted:
        tints = [own_albedo[k, x, y] for k in range(3)]
        bad = expressions.is_bad(tints[0]) | expressions.is_bad(tints[1]) | expressions.is_bad(tints[2])
        tint = keep("tint", *(hl.select(modulate == one, hl.select(bad, zero, value), one) for value in tints))
        tints = [tint[k] for k in range(3)]
        mean = [value * tint for value, tint in zip(mean, tints, strict=True)]
        luminance = find_luminance(tints)
        variance = variance * luminance * luminance
    summary = [*mean, weight / worth, hl.select(some, effective, zero), variance]
    out = hl.Func("out")
    out[x, y] = hl.Tuple([*(joined[k] for k in range(HISTORY_CHANNELS)), *summary])
    pixels = [[mask, *side.arrays] for mask, side in ((tap_mask, side), (own_mask, centre))]
    return JoiningFuncs(
        out=out,
        once=once,
        weights=((trusted, near, similarity), (sums, taps, weights)),
        log_weight=log_weight,
        stages=stages,
        wide=wide,
        wide_count=count,
        tap_guides=side.guides,
        tap_guide_count=side.guide_count,
        tap_planes=tap_planes,
        own_guides=centre.guides,
        own_planes=centre.planes,
        own_plane_count=centre.plane_count,
        x=x,
        y=y,
        c=c,
        arguments=[
            source,
            *([tap_albedo] if tinted else []),
            *pixels[0],
            trust,
            *([own_albedo] if tinted else []),
            *pixels[1],
            power,
            history,
            *(parameter for own_scalars in scalars for parameter in own_scalars),
            *(radius, trust_radius, factor, place_x, place_y),
            *(spacing, growth, own, modulate),
        ],
    )
