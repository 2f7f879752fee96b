"""The stages of an accumulation, from which `accumulation_pass` builds its passes."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.signature import Signature
from lobewise.filters.cross_pass import ALBEDO_FLOOR, count_samples, demodulate, find_luminance
from lobewise.filters.history.accumulation_taps import TapGrid, Taps, U, V
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums
from lobewise.filters.history.vectors import Pixels, Place

NO_TRUST_ERRORS, FULL_TRUST_ERRORS = 6.0, 2.0
"""Difference of samples and history, in standard errors: from the first on the trust is 0, up to the second it is 1."""
IGNORED_DIFFERENCE = 0.02
"""Relative difference that does not count as a change; it is added to the standard error."""
MIN_WEIGHT = 1e-12
"""Smallest weight sum. Smaller ones above 0 are raised to it, so that a pixel unlike all samples keeps its light."""
MIN_RAY_WEIGHT = 1e-6
"""Smallest weight of a ray that counts."""
NO_WEIGHT_LOG2 = -1e4
"""Base-2 logarithm of a weight that is 0, also after it is raised to a power of 1 or more."""


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
    """The values of a sample that taps read, all times its weight, and all 0 if it is bad; and its `Trust`.

    The weight is that of its ray, or 1. Without rays the colours are radiance over albedo; with rays they are also over
    the ray's weight: the radiance along the ray.
    """

    red: hl.Expr
    green: hl.Expr
    blue: hl.Expr
    weight: hl.Expr
    squared_luminance: hl.Expr
    trust: hl.Expr
    told: hl.Expr


@dataclass(frozen=True)
class TapSum:
    """A sum over taps, the taps, and their weights."""

    func: hl.Func
    taps: hl.RDom
    weights: hl.Func
    weighed: hl.RDom | None
    """Domain of the weights; None where each is computed where it is read."""


@dataclass
class AccumulationFuncs:
    """The Halide functions of a pass, for its schedules."""

    out: hl.Func
    signature: Signature
    pixels: Pixels
    domain: hl.RDom | None
    """Domain of the output, by lane and vector; None where each pixel has a thread."""
    sums: list[TapSum] = field(default_factory=list)
    grid: TapGrid | None = None
    """The functions that taps read, if the pass has taps."""


def read_history(history: hl.ImageParam, at: Place) -> Sums:
    """Return the history of a pixel."""
    return Sums(*(history[(*at, k)] for k in range(HISTORY_CHANNELS)))


def _sum_taps(
    name: str,
    grid: TapGrid,
    taps: Taps,
    power: hl.Expr | None,
    take: Callable[[hl.Expr, list[hl.Expr]], Sequence[hl.Expr]],
    known: KnownPixel | None = None,
) -> tuple[TapSum, list[hl.Expr]]:
    """Return the sums over taps of ``take(weight, values)``; weights without their factors are raised to ``power``."""
    at = grid.pixels.at

    def weigh(u: hl.Expr, v: hl.Expr) -> hl.Expr:
        exponent = grid.log_weight[(*at, u, v)]
        if known is not None:
            across, down = grid.blocks.find_offset(u, v)
            exponent = exponent - known.precision * (across * across + down * down)
            exponent = hl.select(hl.max(hl.abs(u), hl.abs(v)) <= known.radius, exponent, hl.f32(NO_WEIGHT_LOG2))
        weight = expressions.exp2(exponent if power is None else exponent * power)
        return weight if grid.factor is None else weight * grid.factor[(*at, u, v)]

    weights, weighed = hl.Func(f"{name}_weights"), None
    if grid.pixels.lanes == 1:
        weights[(*at, U, V)] = weigh(U, V)
    else:
        # A function of its own, because each of the sums would compute it again.
        weighed = taps.make(f"{name}_weighed")
        weights[(*at, U, V)] = hl.undef(hl.Float(32))
        weights[(*at, weighed.x, weighed.y)] = weigh(weighed.x, weighed.y)
    domain = taps.make(f"{name}_taps")
    taken = take(weights[(*at, domain.x, domain.y)], grid.read(domain.x, domain.y))
    func = hl.Func(name)
    func[at] = hl.Tuple([hl.f32(0.0)] * len(taken))
    func[at] = hl.Tuple([func[at][k] + value for k, value in enumerate(taken)])
    return TapSum(func, domain, weights, weighed), [func[at][k] for k in range(len(taken))]


def gather_trust(grid: TapGrid, taps: Taps, get_trust: Callable[[list[hl.Expr]], Trust]) -> tuple[TapSum, hl.Expr]:
    """Return the mean trust of the samples near a pixel, the factor of its history; 1 without samples."""

    def take(weight: hl.Expr, tap: list[hl.Expr]) -> list[hl.Expr]:
        return [weight * value for value in get_trust(tap)]

    trusted, (trust, told) = _sum_taps("trusted", grid, taps, None, take)
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


class KnownPixel(NamedTuple):
    """The kernel of a pixel, which is narrower where the pixel has a history."""

    radius: hl.Expr
    """Samples."""
    precision: hl.Expr
    """Subtracted from the base-2 logarithm of a weight, times the squared screen distance in pixels."""


def gather_samples(grid: TapGrid, taps: Taps, power: hl.Expr, known: KnownPixel) -> tuple[TapSum, Gathered]:
    """Return this frame's sums over taps."""

    def take(weight: hl.Expr, values: list[hl.Expr]) -> list[hl.Expr]:
        tap = Sample(*values)
        light = [weight * value for value in (tap.red, tap.green, tap.blue)]
        total = weight * tap.weight
        return [*light, total, total * total, weight * tap.squared_luminance]

    gathered, (*light, total, squares, moment) = _sum_taps("sums", grid, taps, power, take, known)
    return gathered, Gathered(light, moment, total, count_samples(total, squares), are_means=False)


def compare_with_history(grid: TapGrid, pixels: Pixels, taps: Taps, usable: hl.Expr) -> tuple[TapSum, hl.Expr]:
    """Return the trust of a shaded pixel, 0 to 1: 1 if samples and history around differ by no more than noise."""
    zero, one = hl.f32(0.0), hl.f32(1.0)

    def take(weight: hl.Expr, tap: list[hl.Expr]) -> list[hl.Expr]:
        total = weight * tap[9]
        return [*(weight * value for value in tap[:9]), total, total * total]

    compared, (*parts, total, squares) = _sum_taps("compared", grid, taps, None, take)
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


@dataclass(frozen=True)
class SampleImages:
    """The images of samples: radiance, the albedo that divides it, and the weights of their rays, if there are any."""

    light: hl.ImageParam
    albedo: hl.ImageParam | None
    weights: hl.ImageParam | None = None

    def read(self, at: Place, floor: hl.Expr, albedo_at: Place | None = None) -> tuple[list[hl.Expr], hl.Expr, hl.Expr]:
        """Return a sample's radiance over albedo and over weight, its weight, and whether it is good and has weight."""
        light, good = demodulate(self.light, self.albedo, at, floor, albedo_at)
        if self.weights is None:
            return light, hl.f32(1.0), good
        weight = self.weights[at]
        # A smaller weight is that of a ray which the lobe does not see, and the quotient may overflow.
        good = good & (weight > hl.f32(MIN_RAY_WEIGHT))
        return [value / hl.max(weight, hl.f32(MIN_RAY_WEIGHT)) for value in light], weight, good


def weigh_own_sample(
    pixels: Pixels,
    given: SampleImages,
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
    light, weight, good = given.read(at, hl.f32(ALBEDO_FLOOR) / own, pixels.place)
    more = bonus * unit * weight
    good = good & usable & (more > zero)
    more, *light = pixels.keep("sample", *(hl.select(good, value, zero) for value in (more, *light)))
    luminance = find_luminance(light)
    weighted = [more * value for value in light]
    return Sums._make([*weighted, more, more * (more + unit + unit), more * luminance * luminance, zero])


def accumulate(
    pixels: Pixels, kept: Sums, new: Sums, bonus: Sums, unit: hl.Expr, albedo: hl.ImageParam | None
) -> tuple[hl.Func, hl.RDom | None]:
    """Return the sums of history, frame and own sample, and their `Summary`, times the albedo if there is one."""
    sums = Sums(*pixels.keep("joined", *(p + q + r for p, q, r in zip(kept, new, bonus, strict=True))))
    mean, effective, variance = summarize(sums)
    if albedo is not None:
        tints = [albedo[(k, *pixels.place)] for k in range(3)]
        bad = ~expressions.is_good(tints)
        tints = pixels.keep("tint", *(hl.select(bad, hl.f32(0.0), value) for value in tints))
        mean = [value * tint for value, tint in zip(mean, tints, strict=True)]
        luminance = find_luminance(tints)
        variance = variance * luminance * luminance
    values = *sums, *mean, sums.weight / unit, effective, variance
    pixels.keep("result", *values)
    return pixels.write(pixels.once[-1], len(values))


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
