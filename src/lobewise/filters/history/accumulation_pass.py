"""Accumulate samples over space and time, as Halide algorithms: from samples and history to sums.

One pixel in each block of ``factor`` x ``factor`` pixels is shaded and has a sample. For every pixel i

- the trust in its history is the mean trust t of samples around, ``sum_j w(i, j) t_j / sum_j w(i, j)`` over a few taps,
  w the product of the features' similarities; the weights of the history are multiplied by it;
- its unit is ``(frames + 1)**growth``, frames being the number in the history after that. The unit is the weight of a
  sample that matches fully, and the power to which the pixel raises its weights: the kernel narrows as the history
  grows;
- a pixel that has a history may have a smaller radius and a narrower Gaussian of the screen distance than the others;
- the sums are ``unit sum_j w(i, j)**unit I_j`` over all taps, plus the history, plus a bonus if the pixel has a sample
  of its own, which then counts ``own`` times as much as a sample of another pixel.

Sparse frames compute all of this in one pass. For whole frames a filter of several passes gathers the samples: one pass
before the filter computes trust and unit, one pass after it adds up the sums. In both cases a first pass computes the
trust of the samples. Channels of the sums: see `lobewise.filters.history.sums`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import ALBEDO_FLOOR, compute_expression_luminance, count_samples, demodulate
from lobewise.filters.history.accumulation_taps import Blocks, TapDomain, TapGrid, declare_count, declare_mask
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums
from lobewise.filters.history.vectors import LANE, Pixels, Place
from lobewise.filters.planes import X, Y
from lobewise.filters.scheduling import STRIP_ROWS, count_lanes, spread_pixels

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


ACCUMULATED = (*Sums._fields, *Summary._fields)
"""The output planes of an accumulation."""
MIN_KNOWN_FRAMES = 0.5
"""Frames in the history of a pixel, trusted and faded, from which the pixel has the kernel of known pixels."""
NO_TAPS = -1
"""Reach of a pixel without a meaning."""
SAMPLE_TILE_ROWS, SAMPLE_TILE_COLUMNS = 8, 256
"""Size of the tiles whose samples are repeated over the width of their blocks together, pixels."""
NARROWED = "share", "unit"
"""The output planes of the pass before a filter: trust in the history, and unit."""


def make_accumulation(features: Sequence[Feature], tinted: bool, weighed: bool, target: hl.Target) -> Scheduled:
    """Return the pass that gathers samples and adds them to the history.

    ``tinted`` divides samples by an albedo. With ``weighed`` each sample has the weight of its ray.
    The numbers ``column`` and ``row`` place the shaded pixel in its block; ``spacing`` is the distance of samples,
    pixels. In all passes images of the full grid must be at least as wide as a vector of ``lanes`` pixels.
    """
    # Signature
    signature = Signature("accumulation")
    samples, tap_albedo, weights = _declare_samples(signature, tinted, weighed)
    trust = signature.image("trust", "rows", "columns")
    albedo = signature.image("own_albedo", "height", "width", 3) if tinted else None
    history = signature.image("history", HISTORY_CHANNELS, "height", "width")
    radius, known_radius, trust_radius = (
        declare_count(signature, name) for name in ("radius", "known_radius", "trust_radius")
    )
    growth, own, known_precision = (signature.number(name) for name in ("growth", "own", "known_precision"))
    mask = declare_mask(signature)

    # Algorithm
    pixels = _make_pixels(mask, target)
    zero, one = hl.f32(0.0), hl.f32(1.0)
    before, usable = read_history(history, pixels.place), mask[pixels.place] != 0

    def take(at: Place, usable: hl.Expr) -> Sample:
        light, weight, good = SampleImages(samples, tap_albedo, weights).read(at, hl.f32(ALBEDO_FLOOR))
        luminance = compute_expression_luminance(light)
        values = (*light, one, luminance * luminance)
        seen = (hl.select(good & usable, weight * value, zero) for value in values)
        return Sample(*seen, *(hl.select(usable, value, zero) for value in (trust[at], one)))

    blocks = Blocks(signature, pixels)
    columns, rows = trust.width(), trust.height()
    block, shift = blocks.block, blocks.shift
    nearest = hl.clamp(block[0], 0, columns - 1), hl.clamp(block[1], 0, rows - 1)
    is_known = before.frames * trust[nearest] >= hl.f32(MIN_KNOWN_FRAMES)
    reach = hl.Func("reach")
    reach[pixels.at] = hl.select(usable, hl.select(is_known, known_radius, radius), NO_TAPS)
    pixels.once.append(reach)
    widest = pixels.compute_largest("widest", reach, NO_TAPS)
    # Nothing is gathered where no pixel of a vector has a meaning.
    trust_reach = hl.select(widest < 0, NO_TAPS, trust_radius)
    needed = TapDomain(hl.max(widest, trust_reach), hl.max(radius, trust_radius))
    grid = TapGrid(signature, features, (mask, pixels, blocks), needed, take)
    share = gather_trust(grid, TapDomain(trust_reach, trust_radius))
    faded = before.fade(share)
    unit, *faded_sums = pixels.keep("unit", compute_full_weight(faded.frames, growth), *faded)
    precision = hl.select(is_known, known_precision, zero)
    known = KnownPixel(reach[pixels.at], precision)
    gathered = gather_samples(grid, TapDomain(widest, radius), unit, known)

    shaded = (shift[0] == 0) & (shift[1] == 0) & (block[0] < columns) & (block[1] < rows)
    sample_images = SampleImages(samples, albedo, weights)
    own_sums = weigh_own_sample(pixels, sample_images, nearest, shaded & usable, (own, own - one), unit)
    results = accumulate(pixels, Sums(*faded_sums), weigh_gathered(gathered, unit, usable), own_sums, unit, albedo)
    return _finish(signature, pixels, dict(zip(ACCUMULATED, results, strict=True)), grid)


def make_narrowing(features: Sequence[Feature], target: hl.Target) -> Scheduled:
    """Return the pass before a filter, which computes trust in the history and the unit."""
    # Signature
    signature = Signature("narrowing")
    trust = signature.image("trust", "rows", "columns")
    frames = signature.image("frames", "height", "width")
    radius, growth = declare_count(signature, "trust_radius"), signature.number("growth")
    mask = declare_mask(signature)

    # Algorithm
    pixels = _make_pixels(mask, target)

    def take(at: Place, usable: hl.Expr) -> Trust:
        return Trust(*(hl.select(usable, value, hl.f32(0.0)) for value in (trust[at], hl.f32(1.0))))

    taps = TapDomain(radius, radius)
    grid = TapGrid(signature, features, (mask, pixels, Blocks(signature, pixels)), taps, take)
    share = gather_trust(grid, taps)
    faded_frames = frames[pixels.place] * share
    # Use the exact square root for the usual growth 0.5: the filter's results must not depend on an estimate of `pow`.
    unit = hl.select(
        growth == hl.f32(0.5), hl.sqrt(faded_frames + hl.f32(1.0)), compute_full_weight(faded_frames, growth)
    )
    return _finish(signature, pixels, dict(zip(NARROWED, (share, unit), strict=True)), grid)


def make_filtered_accumulation(tinted: bool, target: hl.Target) -> Scheduled:
    """Return the pass after a filter, which adds the filtered frame to the history."""
    # Signature
    signature = Signature("filtered_accumulation")
    samples, mean = (signature.image(name, "height", "width", 3) for name in ("samples", "mean"))
    albedo = signature.image("own_albedo", "height", "width", 3) if tinted else None
    mask = declare_mask(signature)
    history = signature.image("history", HISTORY_CHANNELS, "height", "width")
    names = ("total", "effective", "mean_square", *NARROWED)
    images = [signature.image(name, "height", "width") for name in names]
    own, bonus = signature.number("own"), signature.number("bonus")

    # Algorithm
    pixels = _make_pixels(mask, target)
    at = pixels.place
    total, effective, moment, share, unit = (image[at] for image in images)
    gathered = Gathered([mean[(k, *at)] for k in range(3)], moment, total, effective, are_means=True)
    usable = mask[at] != 0
    own_sums = weigh_own_sample(pixels, SampleImages(samples, albedo), at, usable, (own, bonus), unit)
    faded = read_history(history, at).fade(share)
    results = accumulate(pixels, faded, weigh_gathered(gathered, unit, usable), own_sums, unit, albedo)
    return _finish(signature, pixels, dict(zip(ACCUMULATED, results, strict=True)))


def make_trust(features: Sequence[Feature], tinted: bool, weighed: bool, target: hl.Target) -> Scheduled:
    """Return the pass that computes at each shaded pixel how far the samples confirm the history, 0 to 1.

    Sample and history estimate the same radiance. The lobe-weighted mean of their differences around a pixel is
    compared with its standard error, colour by colour.
    """
    # Signature
    signature = Signature("trust")
    sample_images = SampleImages(*_declare_samples(signature, tinted, weighed))
    history = signature.image("history", HISTORY_CHANNELS, "rows", "columns")
    radius, own = declare_count(signature, "trust_radius"), signature.number("own")
    mask = declare_mask(signature)

    # Algorithm
    pixels = _make_pixels(mask, target)
    zero, one = hl.f32(0.0), hl.f32(1.0)

    def take(at: Place, usable: hl.Expr) -> list[hl.Expr]:
        light, weight, good = sample_images.read(at, hl.f32(ALBEDO_FLOOR) / own)
        past = read_history(history, at)
        # Ignore a history without own samples of the pixel: it is blurred, and samples without noise would reject it.
        known = good & usable & (past.weight > hl.f32(0.5) * own)
        before = [hl.select(past.weight > zero, value / past.weight, zero) for value in past.light]
        steps = [value - old for value, old in zip(light, before, strict=True)]
        squares = [step * step for step in steps]
        for square in squares:
            known = known & ~expressions.is_bad(square)
        parts = [*(hl.max(step, zero) for step in steps), *(hl.max(-step, zero) for step in steps), *squares, one]
        return [*(hl.select(known, weight * part, zero) for part in parts), *before]

    taps = TapDomain(radius, radius)
    grid = TapGrid(signature, features, (mask, pixels, Blocks(signature, pixels)), taps, take)
    return _finish(signature, pixels, {"trust": compare_with_history(grid, taps, mask[pixels.place] != 0)}, grid)


def _declare_samples(
    signature: Signature, tinted: bool, weighed: bool
) -> tuple[hl.ImageParam, hl.ImageParam | None, hl.ImageParam | None]:
    """Declare radiance, albedo and weights of samples, in the order of `SampleImages`."""
    light = signature.image("samples", "rows", "columns", 3)
    albedo = signature.image("tap_albedo", "rows", "columns", 3) if tinted else None
    return light, albedo, signature.image("weights", "rows", "columns") if weighed else None


def _make_pixels(mask: hl.ImageParam, target: hl.Target) -> Pixels:
    return Pixels(mask.width(), max(count_lanes(target), 1))


def read_history(history: hl.ImageParam, at: Place) -> Sums:
    """Return the history of a pixel."""
    return Sums(*(history[(*at, k)] for k in range(HISTORY_CHANNELS)))


def _weigh_tap(grid: TapGrid, u: hl.Expr, v: hl.Expr, exponent: hl.Expr | None = None) -> hl.Expr:
    """Return the weight of the tap at an offset; ``exponent`` takes the place of its logarithm."""
    at = (*grid.pixels.at, u, v)
    return expressions.exp2(grid.log_weight[at] if exponent is None else exponent)


def gather_trust(grid: TapGrid, taps: TapDomain) -> hl.Expr:
    """Return the mean trust of the samples near a pixel, the factor of its history; 1 without samples.

    The last values that taps read are those of `Trust`.
    """

    def take(weight: hl.Expr, tap: list[hl.Expr]) -> list[hl.Expr]:
        return [weight * value for value in tap[-len(Trust._fields) :]]

    trust, total = grid.add("trusted", taps, partial(_weigh_tap, grid), take)
    return hl.select(total > hl.f32(0.0), trust / total, hl.f32(1.0))


def compute_full_weight(frames: hl.Expr, growth: hl.Expr) -> hl.Expr:
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


def gather_samples(grid: TapGrid, taps: TapDomain, power: hl.Expr, known: KnownPixel) -> Gathered:
    """Return this frame's sums over taps; weights without their factors are raised to ``power``."""

    def weigh(u: hl.Expr, v: hl.Expr) -> hl.Expr:
        across, down = grid.blocks.compute_tap_offset(u, v)
        exponent = grid.log_weight[(*grid.pixels.at, u, v)]
        exponent = exponent - known.precision * (across * across + down * down)
        exponent = hl.select(hl.max(hl.abs(u), hl.abs(v)) <= known.radius, exponent, hl.f32(NO_WEIGHT_LOG2))
        return _weigh_tap(grid, u, v, exponent * power)

    def take(weight: hl.Expr, values: list[hl.Expr]) -> list[hl.Expr]:
        tap = Sample(*values)
        light = [weight * value for value in (tap.red, tap.green, tap.blue)]
        total = weight * tap.weight
        return [*light, total, total * total, weight * tap.squared_luminance]

    *light, total, squares, moment = grid.add("sums", taps, weigh, take)
    return Gathered(light, moment, total, count_samples(total, squares), are_means=False)


def compare_with_history(grid: TapGrid, taps: TapDomain, usable: hl.Expr) -> hl.Expr:
    """Return the trust of a shaded pixel, 0 to 1: 1 if samples and history around differ by no more than noise."""
    zero, one = hl.f32(0.0), hl.f32(1.0)

    def take(weight: hl.Expr, tap: list[hl.Expr]) -> list[hl.Expr]:
        total = weight * tap[9]
        return [*(weight * value for value in tap[:9]), total, total * total]

    *parts, total, squares = grid.add("compared", taps, partial(_weigh_tap, grid), take)
    *_, known, red, green, blue = grid.read(hl.i32(0), hl.i32(0))
    excess: hl.Expr = zero
    for k, old in enumerate((red, green, blue)):
        gathered = Gathered(parts[k::3], zero, total, count_samples(total, squares), are_means=False)
        mean, effective, _ = summarize(weigh_gathered(gathered, one, usable))
        above, below, square, count = grid.pixels.keep(f"mean{k}", *mean, effective)
        step = hl.abs(above - below)
        error = hl.sqrt(hl.max(square - step * step, zero) / (count - one))
        high = hl.strict_float(step / (error + hl.f32(IGNORED_DIFFERENCE) * (old + step)))
        # A single sample does not show its deviation.
        tells = ~expressions.is_bad(high) & (count > hl.f32(1.5)) & (known != zero)
        excess = hl.select(tells, hl.max(excess, high), excess)
    share = (hl.f32(NO_TRUST_ERRORS) - excess) / hl.f32(NO_TRUST_ERRORS - FULL_TRUST_ERRORS)
    return hl.clamp(hl.strict_float(share), zero, one)


def weigh_gathered(gathered: Gathered, unit: hl.Expr, usable: hl.Expr) -> Sums:
    """Return this frame's contribution to the history as sums in which a full match has weight ``unit``."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    weight = gathered.total * unit
    alive = usable & (weight > zero)
    weight = hl.max(weight, hl.f32(MIN_WEIGHT))
    # Strict: rearranged, a product of two small numbers would come first and underflow.
    scale = weight if gathered.are_means else hl.strict_float(weight / gathered.total)
    light = [value * scale for value in gathered.light]
    squares = weight * weight / hl.max(gathered.effective, one)
    new = Sums._make([*light, weight, squares, gathered.moment * scale, one])
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
    sample_images: SampleImages,
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
    light, weight, good = sample_images.read(at, hl.f32(ALBEDO_FLOOR) / own, pixels.place)
    own_weight = bonus * unit * weight
    good = good & usable & (own_weight > zero)
    own_weight, *light = pixels.keep("sample", *(hl.select(good, value, zero) for value in (own_weight, *light)))
    luminance = compute_expression_luminance(light)
    weighted = [own_weight * value for value in light]
    return Sums._make(
        [*weighted, own_weight, own_weight * (own_weight + unit + unit), own_weight * luminance * luminance, zero]
    )


def accumulate(
    pixels: Pixels, history: Sums, new: Sums, bonus: Sums, unit: hl.Expr, albedo: hl.ImageParam | None
) -> list[hl.Expr]:
    """Return the sums of history, frame and own sample, and their `Summary`, times the albedo if there is one."""
    sums = Sums(*pixels.keep("joined", *(p + q + r for p, q, r in zip(history, new, bonus, strict=True))))
    mean, effective, variance = summarize(sums)
    if albedo is not None:
        tints = [albedo[(k, *pixels.place)] for k in range(3)]
        bad = ~expressions.is_good(tints)
        tints = pixels.keep("tint", *(hl.select(bad, hl.f32(0.0), value) for value in tints))
        mean = [value * tint for value, tint in zip(mean, tints, strict=True)]
        luminance = compute_expression_luminance(tints)
        variance = variance * luminance * luminance
    return [*sums, *mean, sums.weight / unit, effective, variance]


def summarize(sums: Sums) -> tuple[list[hl.Expr], hl.Expr, hl.Expr]:
    """Return mean radiance over albedo, effective samples and variance of the mean's luminance; 0 without weight."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    some = sums.weight > zero
    mean = [hl.select(some, value / sums.weight, zero) for value in sums.light]
    luminance = compute_expression_luminance(mean)
    spread = hl.select(some, sums.moment / sums.weight - luminance * luminance, zero)
    # Divide before multiplying, because the square of a large weight overflows. Bound the number below by 1, because
    # interpolation between pixels of a history may take it lower.
    effective = hl.max(sums.weight / hl.max(sums.squared_weight, hl.f32(1e-30)) * sums.weight, one)
    variance = hl.max(spread, zero) / effective
    return mean, hl.select(some, effective, zero), variance


def _finish(
    signature: Signature, pixels: Pixels, results: Mapping[str, hl.Expr], grid: TapGrid | None = None
) -> Scheduled:
    """Return a pass that writes results of each pixel as planes; ``grid`` has its taps, if there are any."""
    for name in results:
        signature.output(name, "height", "width")
    out = pixels.write(*results.values())

    # Schedule
    if pixels.lanes == 1:
        thread = spread_pixels(out, X, Y)
        for func in pixels.once:
            func.compute_at(out, thread)
        if grid is not None:
            grid.spread(out, thread)
        return Scheduled([out], signature)
    # Tiles of rows run in parallel and columns in vectors. Values that only one pixel reads are computed where it reads
    # them. The last vector of a row ends with the row, so a row has at least one vector of pixels.
    (lane, column), tail = out.rvars(), hl.TailStrategy.GuardWithIf
    vector, tile = hl.RVar("vector_in_tile"), hl.RVar("tile")
    yi, yo, yt, ys = (hl.Var(name) for name in ("yi", "yo", "yt", "ys"))
    # No two vectors of a row differ where they overlap.
    update = out.update().allow_race_conditions()
    update.split(column, tile, vector, SAMPLE_TILE_COLUMNS // pixels.lanes, tail)
    update.split(Y, ys, yt, STRIP_ROWS, tail).split(yt, yo, yi, SAMPLE_TILE_ROWS, tail)
    update.reorder(lane, yi, vector, yo, tile, ys).vectorize(lane).parallel(ys).never_partition_all()
    for func in pixels.judged:
        func.compute_at(out, yi).update().atomic().vectorize(func.rvars()[0])
    for func in pixels.once:
        func.compute_at(out, yi).bound(LANE, 0, pixels.lanes).vectorize(LANE)
    if grid is not None:
        grid.vectorize(out, yi, tile, ys)
    return Scheduled([out], signature)
