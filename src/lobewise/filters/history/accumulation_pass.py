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

from collections.abc import Sequence

from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.signature import Signature
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import ALBEDO_FLOOR, find_luminance
from lobewise.filters.history.accumulation_stages import (
    AccumulationFuncs,
    Gathered,
    KnownPixel,
    Sample,
    SampleImages,
    Summary,
    Trust,
    accumulate,
    compare_with_history,
    find_unit,
    gather_samples,
    gather_trust,
    read_history,
    weigh_gathered,
    weigh_own_sample,
)
from lobewise.filters.history.accumulation_taps import Blocks, Taps, declare_count, declare_mask, make_tap_grid
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums
from lobewise.filters.history.vectors import Pixels, Place

ACCUMULATED = (*Sums._fields, *Summary._fields)
"""The output planes of an accumulation."""
MIN_KNOWN_FRAMES = 0.5
"""Frames in the history of a pixel, trusted and faded, from which the pixel has the kernel of known pixels."""
NO_TAPS = -1
"""Reach of a pixel without a meaning."""
NARROWED = "share", "unit"
"""The output planes of the pass before a filter: trust in the history, and unit."""


def make_accumulation(features: Sequence[Feature], tinted: bool, weighed: bool, lanes: int) -> AccumulationFuncs:
    """Return the pass that gathers samples and adds them to the history.

    ``tinted`` divides samples by an albedo. With ``weighed`` each sample has the weight of its ray.
    The numbers ``column`` and ``row`` place the shaded pixel in its block; ``spacing`` is the distance of samples,
    pixels. In all passes images of the full grid must be at least as wide as a vector of ``lanes`` pixels.
    """
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
    pixels = Pixels(mask.width(), lanes)
    zero, one = hl.f32(0.0), hl.f32(1.0)
    before, usable = read_history(history, pixels.place), mask[pixels.place] != 0

    def take(at: Place, usable: hl.Expr) -> Sample:
        light, weight, good = SampleImages(samples, tap_albedo, weights).read(at, hl.f32(ALBEDO_FLOOR))
        luminance = find_luminance(light)
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
    widest = pixels.find_largest("widest", reach, NO_TAPS)
    # Nothing is gathered where no pixel of a vector has a meaning.
    trust_reach = hl.select(widest < 0, NO_TAPS, trust_radius)
    needed = Taps(hl.max(widest, trust_reach), hl.max(radius, trust_radius))
    grid = make_tap_grid(signature, features, (mask, pixels, blocks), needed, take)
    trusted, share = gather_trust(grid, Taps(trust_reach, trust_radius), lambda tap: Trust(*Sample(*tap)[-2:]))
    faded = before.fade(share)
    unit, *kept = pixels.keep("unit", find_unit(faded.frames, growth), *faded)
    precision = hl.select(is_known, known_precision, zero)
    known = KnownPixel(reach[pixels.at], precision)
    gathered, found = gather_samples(grid, Taps(widest, radius), unit, known)

    shaded = (shift[0] == 0) & (shift[1] == 0) & (block[0] < columns) & (block[1] < rows)
    given = SampleImages(samples, albedo, weights)
    more = weigh_own_sample(pixels, given, nearest, shaded & usable, (own, own - one), unit)
    out, domain = accumulate(pixels, Sums(*kept), weigh_gathered(found, unit, usable), more, unit, albedo)
    _declare_outputs(signature, ACCUMULATED)
    return AccumulationFuncs(out, signature, pixels, domain, [trusted, gathered], grid)


def make_narrowing(features: Sequence[Feature], lanes: int) -> AccumulationFuncs:
    """Return the pass before a filter, which computes trust in the history and the unit."""
    signature = Signature("narrowing")
    trust = signature.image("trust", "rows", "columns")
    frames = signature.image("frames", "height", "width")
    radius, growth = declare_count(signature, "trust_radius"), signature.number("growth")
    mask = declare_mask(signature)
    pixels = Pixels(mask.width(), lanes)

    def take(at: Place, usable: hl.Expr) -> Trust:
        return Trust(*(hl.select(usable, value, hl.f32(0.0)) for value in (trust[at], hl.f32(1.0))))

    taps = Taps(radius, radius)
    grid = make_tap_grid(signature, features, (mask, pixels, Blocks(signature, pixels)), taps, take)
    trusted, share = gather_trust(grid, taps, lambda tap: Trust(*tap))
    kept = frames[pixels.place] * share
    # Use the exact square root for the usual growth 0.5: the filter's results must not depend on an estimate of `pow`.
    unit = hl.select(growth == hl.f32(0.5), hl.sqrt(kept + hl.f32(1.0)), find_unit(kept, growth))
    pixels.keep("result", share, unit)
    out, domain = pixels.write(pixels.once[-1], len(NARROWED))
    _declare_outputs(signature, NARROWED)
    return AccumulationFuncs(out, signature, pixels, domain, [trusted], grid)


def make_filtered_accumulation(tinted: bool, lanes: int) -> AccumulationFuncs:
    """Return the pass after a filter, which adds the filtered frame to the history."""
    signature = Signature("filtered_accumulation")
    samples, mean = (signature.image(name, "height", "width", 3) for name in ("samples", "mean"))
    albedo = signature.image("own_albedo", "height", "width", 3) if tinted else None
    mask = declare_mask(signature)
    history = signature.image("history", HISTORY_CHANNELS, "height", "width")
    names = ("total", "effective", "mean_square", *NARROWED)
    images = [signature.image(name, "height", "width") for name in names]
    own, bonus = signature.number("own"), signature.number("bonus")
    pixels = Pixels(mask.width(), lanes)
    at = pixels.place
    total, effective, moment, share, unit = (image[at] for image in images)
    found = Gathered([mean[(k, *at)] for k in range(3)], moment, total, effective, are_means=True)
    usable = mask[at] != 0
    more = weigh_own_sample(pixels, SampleImages(samples, albedo), at, usable, (own, bonus), unit)
    kept = read_history(history, at).fade(share)
    out, domain = accumulate(pixels, kept, weigh_gathered(found, unit, usable), more, unit, albedo)
    _declare_outputs(signature, ACCUMULATED)
    return AccumulationFuncs(out, signature, pixels, domain)


def make_trust(features: Sequence[Feature], tinted: bool, weighed: bool, lanes: int) -> AccumulationFuncs:
    """Return the pass that computes at each shaded pixel how far the samples confirm the history, 0 to 1.

    Sample and history estimate the same radiance. The lobe-weighted mean of their differences around a pixel is
    compared with its standard error, colour by colour.
    """
    signature = Signature("trust")
    given = SampleImages(*_declare_samples(signature, tinted, weighed))
    history = signature.image("history", HISTORY_CHANNELS, "rows", "columns")
    radius, own = declare_count(signature, "trust_radius"), signature.number("own")
    mask = declare_mask(signature)
    pixels = Pixels(mask.width(), lanes)
    zero, one = hl.f32(0.0), hl.f32(1.0)

    def take(at: Place, usable: hl.Expr) -> list[hl.Expr]:
        light, weight, good = given.read(at, hl.f32(ALBEDO_FLOOR) / own)
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

    taps = Taps(radius, radius)
    grid = make_tap_grid(signature, features, (mask, pixels, Blocks(signature, pixels)), taps, take)
    trusted, trust = compare_with_history(grid, pixels, taps, mask[pixels.place] != 0)
    pixels.keep("result", trust, trust)
    out, domain = pixels.write(pixels.once[-1], 1)
    _declare_outputs(signature, ["trust"])
    return AccumulationFuncs(out, signature, pixels, domain, [trusted], grid)


def _declare_samples(
    signature: Signature, tinted: bool, weighed: bool
) -> tuple[hl.ImageParam, hl.ImageParam | None, hl.ImageParam | None]:
    """Declare radiance, albedo and weights of samples, in the order of `SampleImages`."""
    light = signature.image("samples", "rows", "columns", 3)
    albedo = signature.image("tap_albedo", "rows", "columns", 3) if tinted else None
    return light, albedo, signature.image("weights", "rows", "columns") if weighed else None


def _declare_outputs(signature: Signature, names: Sequence[str]) -> None:
    for name in names:
        signature.output(name, "height", "width")
