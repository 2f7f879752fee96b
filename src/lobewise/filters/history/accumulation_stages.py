"""The stages of an accumulation, from which `accumulation_pass` builds its passes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars
from lobewise.features.base import Feature, Stage
from lobewise.filters.cross_pass import ALBEDO_FLOOR, count_samples, demodulate, find_luminance, make_stage
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums
from lobewise.filters.planes import C, GuidePlanes, X, Y, make_guide_planes

NO_TRUST_ERRORS, FULL_TRUST_ERRORS = 6.0, 2.0
"""Difference of samples and history, in standard errors: from the first on the trust is 0, up to the second it is 1."""
IGNORED_DIFFERENCE = 0.02
"""Relative difference that does not count as a change; it is added to the standard error."""
MIN_WEIGHT = 1e-12
"""Smallest weight sum. Smaller ones above 0 are raised to it, so that a pixel unlike all samples keeps its light."""

Place = tuple[hl.Expr, hl.Expr]
"""Column and row of a pixel."""


class Summary(NamedTuple):
    """The results of a pixel. The weight sum is over the unit; the variance is that of the mean's luminance."""

    mean_red: Any
    mean_green: Any
    mean_blue: Any
    weight_sum: Any
    effective_samples: Any
    variance: Any


class Trust(NamedTuple):
    """The values of a sample that taps read for the trust: its trust, and 1; both 0 if the sample has no meaning."""

    trust: hl.Expr
    told: hl.Expr


class Sample(NamedTuple):
    """The values of a sample that taps read: radiance over albedo, and 1, all 0 if it is bad; and its `Trust`."""

    red: hl.Expr
    green: hl.Expr
    blue: hl.Expr
    good: hl.Expr
    squared_luminance: hl.Expr
    trust: hl.Expr
    told: hl.Expr


@dataclass
class Pixels:
    """Collects the functions that a pass computes once per pixel."""

    once: list[hl.Func] = field(default_factory=list)
    """The functions, each after those that it reads."""

    def keep(self, name: str, *values: hl.Expr) -> list[hl.Expr]:
        """Compute values once per pixel. Expressions that repeat them would compile slowly."""
        func = hl.Func(name)
        func[X, Y] = hl.Tuple(list(values))
        self.once.append(func)
        return [func[X, Y][k] for k in range(len(values))]


@dataclass(frozen=True)
class TapSum:
    """A sum over taps, the taps, and their weights."""

    func: hl.Func
    taps: hl.RDom
    weights: hl.Func


@dataclass
class AccumulationFuncs:
    """The Halide functions of a pass, for its schedules."""

    out: hl.Func
    signature: Signature
    pixels: Pixels
    sums: list[TapSum] = field(default_factory=list)
    grid: TapGrid | None = None
    """The functions that taps read, if the pass has taps."""


@dataclass(kw_only=True)
class TapGrid:
    """The functions that taps read of samples and pixels, and the logarithms of their weights."""

    tap_mask: hl.ImageParam
    mask: hl.ImageParam
    wide: hl.Func
    """Planes and values of shaded pixels, repeated over the width of their blocks."""
    values: hl.Func
    value_count: int
    taps: GuidePlanes
    """Guides and planes of the shaded pixels."""
    own: GuidePlanes
    """Guides and planes of all pixels."""
    log_weight: hl.Func
    stages: list[hl.Func]
    read: Callable[[hl.Expr, hl.Expr], list[hl.Expr]]
    """Returns the values of the tap at an offset in samples."""
    block: Place
    """Column and row of the block that a pixel lies in."""
    shift: Place
    """Columns and rows from a pixel to the shaded pixel of its block."""


def read_history(history: hl.ImageParam) -> Sums:
    """Return the history of a pixel."""
    return Sums(*(history[X, Y, k] for k in range(HISTORY_CHANNELS)))


def declare_count(signature: Signature, name: str, least: int = 0) -> hl.Param:
    """Declare a whole number with a known range, which makes simpler loops."""
    count = signature.count(name, least)
    count.set_range(least, 1 << 16)
    return count


def make_tap_grid(
    signature: Signature, features: Sequence[Feature], take: Callable[[Place, hl.Expr], Sequence[hl.Expr]]
) -> TapGrid:
    """Declare the grids of shaded pixels and of all pixels, and define the functions that taps read.

    ``take`` returns the values of a sample, beside the planes of its features.
    """
    tap_mask = signature.image("tap_mask", "rows", "columns", type=hl.UInt(8))
    mask = signature.image("own_mask", "height", "width", type=hl.UInt(8))
    tap_arrays = declare_features(signature, "tap", features, "rows", "columns")
    arrays = declare_features(signature, "own", features, "height", "width")
    scalars = declare_scalars(signature, features)
    factor = declare_count(signature, "factor", 1)
    column, row = (signature.count(name) for name in ("column", "row"))
    spacing = signature.number("spacing")
    columns, rows = tap_mask.width(), tap_mask.height()
    taps = make_guide_planes("tap", tap_mask, features, scalars, arrays=tap_arrays)
    own = make_guide_planes("own", mask, features, scalars, inside=True, arrays=arrays)
    at = hl.clamp(X, 0, columns - 1), hl.clamp(Y, 0, rows - 1)
    usable = (X >= 0) & (columns > X) & (Y >= 0) & (rows > Y) & (tap_mask[at] != 0)
    planes = [] if taps.planes is None else [taps.planes[X, k, Y] for k in range(taps.plane_count)]
    given = [*planes, *take(at, usable)]
    values, wide = hl.Func("tap_values"), hl.Func("wide")
    values[X, C, Y] = hl.mux(C, given)

    # Divide pixel centres, which have a fraction of one half: rounding cannot lead into another block.
    def find_block(at: hl.Expr) -> hl.Expr:
        return hl.i32(hl.floor((hl.f32(at) + hl.f32(0.5)) / hl.f32(factor)))

    wide[X, C, Y] = values[find_block(X), C, Y]
    block = find_block(X), find_block(Y)
    shift = column + block[0] * factor - X, row + block[1] * factor - Y

    u, v = hl.Var("u"), hl.Var("v")
    offset = spacing * hl.f32(u) + hl.f32(shift[0]), spacing * hl.f32(v) + hl.f32(shift[1])
    stages: list[hl.Func] = []
    tap_planes = [wide[X + u * factor, k, block[1] + v] for k in range(taps.plane_count)]
    pairs = [(own.read(layout, X, Y), layout.read(tap_planes.__getitem__)) for layout in taps.layouts]
    log_weight = hl.Func("log_weight")
    log_weight[X, Y, u, v] = _compare(features, pairs, scalars, offset, make_stage(stages, (X, Y, u, v)))

    def read(u: hl.Expr, v: hl.Expr) -> list[hl.Expr]:
        return [wide[X + u * factor, k, block[1] + v] for k in range(taps.plane_count, len(given))]

    return TapGrid(
        tap_mask=tap_mask,
        mask=mask,
        wide=wide,
        values=values,
        value_count=len(given),
        taps=taps,
        own=own,
        log_weight=log_weight,
        stages=stages,
        read=read,
        block=block,
        shift=shift,
    )


def _compare(
    features: Sequence[Feature],
    pairs: Sequence[tuple[Any, Any]],
    scalars: Sequence[Sequence[hl.Expr]],
    offset: tuple[hl.Expr, hl.Expr],
    stage: Stage,
) -> hl.Expr:
    """Return the base-2 logarithm of the similarity of a pixel and a tap, given each feature's planes of both."""
    exponent: hl.Expr = hl.f32(0.0)
    for feature, (i, j), parameters in zip(features, pairs, scalars, strict=True):
        exponent = exponent + feature.log2_similarity(i, j, parameters, offset, stage)
    return exponent


def _sum_taps(
    name: str,
    grid: TapGrid,
    radius: hl.Expr,
    power: hl.Expr | None,
    take: Callable[[hl.Expr, list[hl.Expr]], Sequence[hl.Expr]],
) -> tuple[TapSum, list[hl.Expr]]:
    """Return the sums over taps of ``take(weight, values)``; weights are raised to ``power``."""
    u, v = grid.log_weight.args()[2:]
    exponent = grid.log_weight[X, Y, u, v]
    weights = hl.Func(f"{name}_weights")
    weights[X, Y, u, v] = expressions.exp2(exponent if power is None else exponent * power)
    taps = hl.RDom([(-radius, 2 * radius + 1), (-radius, 2 * radius + 1)], f"{name}_taps")
    taken = take(weights[X, Y, taps.x, taps.y], grid.read(taps.x, taps.y))
    func = hl.Func(name)
    func[X, Y] = hl.Tuple([hl.f32(0.0)] * len(taken))
    func[X, Y] = hl.Tuple([func[X, Y][k] + value for k, value in enumerate(taken)])
    return TapSum(func, taps, weights), [func[X, Y][k] for k in range(len(taken))]


def gather_trust(grid: TapGrid, radius: hl.Expr, get_trust: Callable[[list[hl.Expr]], Trust]) -> tuple[TapSum, hl.Expr]:
    """Return the mean trust of the samples near a pixel, the factor of its history; 1 without samples."""

    def take(weight: hl.Expr, tap: list[hl.Expr]) -> list[hl.Expr]:
        return [weight * value for value in get_trust(tap)]

    trusted, (trust, told) = _sum_taps("trusted", grid, radius, None, take)
    return trusted, hl.select(told > hl.f32(0.0), trust / told, hl.f32(1.0))


def find_unit(frames: hl.Expr, growth: hl.Expr) -> hl.Expr:
    """Return the weight of a sample that matches fully, for a history of so many frames."""
    one = hl.f32(1.0)
    return hl.select(frames == hl.f32(0.0), one, hl.pow(frames + one, growth))


class Gathered(NamedTuple):
    """The contribution of this frame to a pixel."""

    light: list[hl.Expr]
    moment: hl.Expr
    total: hl.Expr
    """Sum of weights."""
    effective: hl.Expr
    """Effective number of samples."""
    are_means: bool
    """Whether light and moment are weighted means; otherwise they are sums."""


def gather_samples(grid: TapGrid, radius: hl.Expr, power: hl.Expr) -> tuple[TapSum, Gathered]:
    """Return this frame's sums over taps."""

    def take(weight: hl.Expr, values: list[hl.Expr]) -> list[hl.Expr]:
        tap = Sample(*values)
        light = [weight * value for value in (tap.red, tap.green, tap.blue)]
        return [*light, weight * tap.good, weight * weight * tap.good, weight * tap.squared_luminance]

    gathered, (*light, total, squares, moment) = _sum_taps("sums", grid, radius, power, take)
    return gathered, Gathered(light, moment, total, count_samples(total, squares), are_means=False)


def compare_with_history(grid: TapGrid, pixels: Pixels, radius: hl.Expr, usable: hl.Expr) -> tuple[TapSum, hl.Expr]:
    """Return the trust of a shaded pixel, 0 to 1: 1 if samples and history around differ by no more than noise."""
    zero, one = hl.f32(0.0), hl.f32(1.0)

    def take(weight: hl.Expr, tap: list[hl.Expr]) -> list[hl.Expr]:
        return [*(weight * value for value in tap[:10]), weight * weight * tap[9]]

    compared, (*parts, total, squares) = _sum_taps("compared", grid, radius, None, take)
    *_, known, red, green, blue = grid.read(hl.i32(0), hl.i32(0))
    excess: hl.Expr = zero
    for k, old in enumerate((red, green, blue)):
        found = Gathered(parts[k::3], zero, total, count_samples(total, squares), are_means=False)
        mean, effective, _ = summarize(weigh_gathered(found, one, usable))
        above, below, square, count = pixels.keep(f"mean{k}", *mean, effective)
        step = hl.abs(above - below)
        error = hl.sqrt(hl.max(square - step * step, zero) / (count - one))
        high = hl.strict_float(step / (error + hl.f32(IGNORED_DIFFERENCE) * (old + step)))
        # A single sample does not show its deviation.
        tells = ~expressions.is_bad(high) & (count > hl.f32(1.5)) & (known != zero)
        excess = hl.select(tells, hl.max(excess, high), excess)
    share = (hl.f32(NO_TRUST_ERRORS) - excess) / hl.f32(NO_TRUST_ERRORS - FULL_TRUST_ERRORS)
    return compared, hl.clamp(hl.strict_float(share), zero, one)


def weigh_gathered(found: Gathered, unit: hl.Expr, usable: hl.Expr) -> Sums:
    """Return this frame's contribution to the history as sums in which a full match has weight ``unit``."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    weight = found.total * unit
    alive = usable & (weight > zero)
    weight = hl.max(weight, hl.f32(MIN_WEIGHT))
    # Strict: rearranged, a product of two small numbers would come first and underflow.
    scale = weight if found.are_means else hl.strict_float(weight / found.total)
    light = [value * scale for value in found.light]
    squares = weight * weight / hl.max(found.effective, one)
    new = Sums._make([*light, weight, squares, found.moment * scale, one])
    return Sums(*(hl.select(alive, value, zero) for value in new))


def weigh_own_sample(
    pixels: Pixels,
    given: tuple[hl.ImageParam, hl.ImageParam | None],
    at: Place,
    usable: hl.Expr,
    counts: tuple[hl.Expr, hl.Expr],
    unit: hl.Expr,
) -> Sums:
    """Return the bonus of the pixel's own sample, beyond its weight among the gathered samples.

    ``counts`` are the total weight of an own sample, and the total minus 1. A larger weight lowers the smallest usable
    albedo, because the sample then is less noisy.
    """
    zero = hl.f32(0.0)
    own, bonus = counts
    light, good = demodulate(*given, at, hl.f32(ALBEDO_FLOOR) / own, (X, Y))
    more = bonus * unit
    good = good & usable & (more > zero)
    more, *light = pixels.keep("sample", *(hl.select(good, value, zero) for value in (more, *light)))
    luminance = find_luminance(light)
    weighted = [more * value for value in light]
    return Sums._make([*weighted, more, more * (more + unit + unit), more * luminance * luminance, zero])


def accumulate(
    pixels: Pixels, kept: Sums, new: Sums, bonus: Sums, unit: hl.Expr, albedo: hl.ImageParam | None
) -> hl.Func:
    """Return the sums of history, frame and own sample, and their `Summary`, times the albedo if there is one."""
    sums = Sums(*pixels.keep("joined", *(p + q + r for p, q, r in zip(kept, new, bonus, strict=True))))
    mean, effective, variance = summarize(sums)
    if albedo is not None:
        tints = [albedo[k, X, Y] for k in range(3)]
        bad = ~expressions.is_good(tints)
        tints = pixels.keep("tint", *(hl.select(bad, hl.f32(0.0), value) for value in tints))
        mean = [value * tint for value, tint in zip(mean, tints, strict=True)]
        luminance = find_luminance(tints)
        variance = variance * luminance * luminance
    out = hl.Func("out")
    out[X, Y] = hl.Tuple([*sums, *mean, sums.weight / unit, effective, variance])
    return out


def summarize(sums: Sums) -> tuple[list[hl.Expr], hl.Expr, hl.Expr]:
    """Return mean radiance over albedo, effective samples and variance of the mean's luminance; 0 without weight."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    some = sums.weight > zero
    mean = [hl.select(some, value / sums.weight, zero) for value in sums.light]
    luminance = find_luminance(mean)
    spread = hl.select(some, sums.moment / sums.weight - luminance * luminance, zero)
    # Divide before multiplying, because the square of a large weight overflows. Bound the number below by 1, because
    # interpolation between pixels of a history may take it lower.
    effective = hl.max(sums.weight / hl.max(sums.squared_weight, hl.f32(1e-30)) * sums.weight, one)
    variance = hl.max(spread, zero) / effective
    return mean, hl.select(some, effective, zero), variance
