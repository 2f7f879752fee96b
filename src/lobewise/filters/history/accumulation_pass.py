"""Accumulation of samples over space and time, as Halide algorithms: from samples and history to sums.

A shaded sample stands for one pixel of a block of ``factor`` times ``factor`` pixels. For every pixel i

- the history's trust is the mean of the samples' trust t: ``sum_j w(i, j) t_j / sum_j w(i, j)`` over a few taps, w the
  product of the features' similarities; the history counts as much less;
- its unit is ``(frames + 1)**growth``, frames those that the history is then worth: what a sample counts that matches
  fully, and the power to which the pixel raises its weights, so that the kernel narrows as the history grows;
- the sums are ``unit sum_j w(i, j)**unit I_j`` over all taps, the history's, and those of the pixel's own sample, where
  it has one, so that it counts ``own`` times as much as one that was borrowed.

Sparse frames have all of it in one pass. The filter of whole frames may be several passes: they have the same stages in
two, trust and unit before the filter, and what follows the sums behind it. What the trust is comes first: a pass of its
own. Channels of a sum: see `lobewise.filters.history.sums`.
"""

from __future__ import annotations

from collections.abc import Sequence

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.signature import Signature
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import ALBEDO_FLOOR, demodulate, find_luminance
from lobewise.filters.history.accumulation_stages import (
    AccumulationFuncs,
    Gathered,
    Pixels,
    Place,
    Sample,
    Summary,
    Trust,
    accumulate,
    compare_with_history,
    declare_count,
    find_unit,
    gather_samples,
    gather_trust,
    make_tap_grid,
    read_history,
    weigh_gathered,
    weigh_own_sample,
)
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums
from lobewise.filters.planes import X, Y

ACCUMULATED = (*Sums._fields, *Summary._fields)
"""The planes that an accumulation writes."""
NARROWED = "share", "unit"
"""Those that are known before a filter: what of the history counts, and what a sample counts that matches fully."""


def make_accumulation(features: Sequence[Feature], tinted: bool) -> AccumulationFuncs:
    """Return the pass that gathers samples and adds them to the history; ``tinted`` ones are divided by an albedo.

    Of its numbers ``column`` and ``row`` place the shaded pixel in its block, and ``spacing`` is in pixels of the
    screen from sample to sample. Images of all pixels are at least as wide as a vector, here and in the other passes.
    """
    signature = Signature("accumulation")
    samples = signature.image("samples", "rows", "columns", 3)
    trust = signature.image("trust", "rows", "columns")
    tap_albedo = signature.image("tap_albedo", "rows", "columns", 3) if tinted else None
    albedo = signature.image("own_albedo", "height", "width", 3) if tinted else None
    history = signature.image("history", HISTORY_CHANNELS, "height", "width")
    radius, trust_radius = declare_count(signature, "radius"), declare_count(signature, "trust_radius")
    growth, own = (signature.number(name) for name in ("growth", "own"))
    pixels = Pixels()
    zero, one = hl.f32(0.0), hl.f32(1.0)

    def take(at: Place, usable: hl.Expr) -> Sample:
        light, good = demodulate(samples, tap_albedo, at, hl.f32(ALBEDO_FLOOR))
        luminance = find_luminance(light)
        seen = (hl.select(good & usable, value, zero) for value in (*light, one, luminance * luminance))
        return Sample(*seen, *(hl.select(usable, value, zero) for value in (trust[at], one)))

    grid = make_tap_grid(signature, features, take)
    trusted, share = gather_trust(grid, trust_radius, lambda tap: Trust(*Sample(*tap)[-2:]))
    faded = read_history(history).fade(share)
    unit, *kept = pixels.keep("unit", find_unit(faded.frames, growth), *faded)
    gathered, found = gather_samples(grid, radius, unit)

    columns, rows = grid.tap_mask.width(), grid.tap_mask.height()
    block, shift = grid.block, grid.shift
    nearest = hl.clamp(block[0], 0, columns - 1), hl.clamp(block[1], 0, rows - 1)
    shaded = (shift[0] == 0) & (shift[1] == 0) & (block[0] < columns) & (block[1] < rows)
    usable = grid.mask[X, Y] != 0
    more = weigh_own_sample(pixels, (samples, albedo), nearest, shaded & usable, (own, own - one), unit)
    out = accumulate(pixels, Sums(*kept), weigh_gathered(found, unit, usable), more, unit, albedo)
    _declare_outputs(signature, ACCUMULATED)
    return AccumulationFuncs(out, signature, pixels, [trusted, gathered], grid)


def make_narrowing(features: Sequence[Feature]) -> AccumulationFuncs:
    """Return the pass that finds what of a history counts, and the unit, before a filter."""
    signature = Signature("narrowing")
    trust = signature.image("trust", "rows", "columns")
    frames = signature.image("frames", "height", "width")
    radius, growth = declare_count(signature, "trust_radius"), signature.number("growth")
    pixels = Pixels()

    def take(at: Place, usable: hl.Expr) -> Trust:
        return Trust(*(hl.select(usable, value, hl.f32(0.0)) for value in (trust[at], hl.f32(1.0))))

    grid = make_tap_grid(signature, features, take)
    trusted, share = gather_trust(grid, radius, lambda tap: Trust(*tap))
    kept = frames[X, Y] * share
    # The usual power is a root, which is exact: what the passes of a filter make of it must not depend on an estimate.
    unit = hl.select(growth == hl.f32(0.5), hl.sqrt(kept + hl.f32(1.0)), find_unit(kept, growth))
    out = hl.Func("out")
    out[X, Y] = hl.Tuple([share, unit])
    _declare_outputs(signature, NARROWED)
    return AccumulationFuncs(out, signature, pixels, [trusted], grid)


def make_filtered_accumulation(tinted: bool) -> AccumulationFuncs:
    """Return the pass that adds to the history what a filter gathered of a whole frame."""
    signature = Signature("filtered_accumulation")
    samples, mean = (signature.image(name, "height", "width", 3) for name in ("samples", "mean"))
    albedo = signature.image("own_albedo", "height", "width", 3) if tinted else None
    mask = signature.image("own_mask", "height", "width", type=hl.UInt(8))
    history = signature.image("history", HISTORY_CHANNELS, "height", "width")
    names = ("total", "effective", "mean_square", *NARROWED)
    images = [signature.image(name, "height", "width") for name in names]
    own, bonus = signature.number("own"), signature.number("bonus")
    pixels = Pixels()
    at = X, Y
    total, effective, moment, share, unit = (image[at] for image in images)
    found = Gathered([mean[k, X, Y] for k in range(3)], moment, total, effective, are_means=True)
    usable = mask[at] != 0
    more = weigh_own_sample(pixels, (samples, albedo), at, usable, (own, bonus), unit)
    kept = read_history(history).fade(share)
    out = accumulate(pixels, kept, weigh_gathered(found, unit, usable), more, unit, albedo)
    _declare_outputs(signature, ACCUMULATED)
    return AccumulationFuncs(out, signature, pixels)


def make_trust(features: Sequence[Feature], tinted: bool) -> AccumulationFuncs:
    """Return the pass that finds how far samples bear out the history of their pixels, at the pixels that were shaded.

    There sample and history are two estimates of one thing, and around each of them the lobe-weighted mean of their
    difference is held against its own deviation, colour by colour.
    """
    signature = Signature("trust")
    samples = signature.image("samples", "rows", "columns", 3)
    albedo = signature.image("tap_albedo", "rows", "columns", 3) if tinted else None
    history = signature.image("history", HISTORY_CHANNELS, "rows", "columns")
    radius, own = declare_count(signature, "trust_radius"), signature.number("own")
    pixels = Pixels()
    zero, one = hl.f32(0.0), hl.f32(1.0)

    def take(at: Place, usable: hl.Expr) -> list[hl.Expr]:
        light, good = demodulate(samples, albedo, at, hl.f32(ALBEDO_FLOOR) / own)
        past = Sums(*(history[(*at, k)] for k in range(HISTORY_CHANNELS)))
        # A history that was only ever borrowed is not held against samples that have no noise.
        known = good & usable & (past.weight > hl.f32(0.5) * own)
        before = [hl.select(past.weight > zero, value / past.weight, zero) for value in past.light]
        steps = [value - old for value, old in zip(light, before, strict=True)]
        squares = [step * step for step in steps]
        for square in squares:
            known = known & ~expressions.is_bad(square)
        parts = [*(hl.max(step, zero) for step in steps), *(hl.max(-step, zero) for step in steps), *squares, one]
        return [*(hl.select(known, part, zero) for part in parts), *before]

    grid = make_tap_grid(signature, features, take)
    trusted, trust = compare_with_history(grid, pixels, radius, grid.mask[X, Y] != 0)
    out = hl.Func("out")
    out[X, Y] = trust
    _declare_outputs(signature, ["trust"])
    return AccumulationFuncs(out, signature, pixels, [trusted], grid)


def _declare_outputs(signature: Signature, names: Sequence[str]) -> None:
    for name in names:
        signature.output(name, "height", "width")
