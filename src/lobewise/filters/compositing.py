"""From one surface per pixel to what the pixel's area shows: silhouettes and edges of textures without steps.

Filters work with the surface at a pixel's centre. Where others share the pixel, `GBuffer.coverage` says how much of its
area the centres around it stand for, and the light that falls on those is mixed by area and albedo.
"""

from __future__ import annotations

from collections.abc import Sequence

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend import expressions
from lobewise.backend.pointwise import Grid, Vector, run_pointwise, select_or_nan
from lobewise.filters.cross_pass import COLORS
from lobewise.frame import FloatArray

SMALLEST_SHARE = 1e-6
"""Sum of shares times albedos below which a pixel keeps the light at its own centre."""
EMISSION_WORTH = 16.0
"""Samples that `lobewise.GBuffer.mean_emission` counts as: its rays are so many. Spread evenly over the pixel they are
worth twice as much at straight edges, and no more than samples where lamps are smaller than a pixel."""
UNKNOWN_SPP = 16.0
"""Samples that emission counts for where nobody told how many there are."""
REACH = 1
"""Pixels to each side whose light may fall on a pixel's area."""


def composite_light(
    images: Sequence[FloatArray],
    lit: NDArray[np.bool_],
    radiance: FloatArray,
    albedo: FloatArray | None = None,
    coverage: FloatArray | None = None,
) -> FloatArray:
    """Return the radiance of every pixel's area, shape (height, width, 3), from the light at pixel centres.

    With ``coverage`` the light is ``L_i = sum_k c_ik a_k L_k / sum_k c_ik a_k`` over the 3x3 neighbours, channel by
    channel; times the albedo of pixel i this is the radiance of its area, exactly where every surface has one albedo
    or all have the same light. Where none of its surfaces is lit a pixel keeps its radiance, NaN if that is bad.

    Parameters
    ----------
    images : sequence of array, shape (height, width, 3)
        One or two, whose mean is the light, radiance over albedo, finite, >= 0.
    lit : bool array, shape (height, width)
        Where it has meaning.
    radiance : array, shape (height, width, 3)
        As it came.
    albedo : array, shape (height, width, 3), optional
        Mean albedo of every pixel's area; without coverage that at its centre will do. Channels that are negative or
        not finite count 0.
    coverage : array, shape (height, width, 9), optional
        As in `lobewise.frame.GBuffer`; needs albedo.
    """
    named = {f"light{k}": image for k, image in enumerate(images)}
    others = {"lit": lit, "radiance": radiance, "albedo": albedo, "coverage": coverage}
    (composite,) = run_pointwise(_define_composite, {**named, **others}, {})
    return np.asarray(composite)


def average_emission(emission: FloatArray, mean: FloatArray, spp: float | None) -> FloatArray:
    """Return the emission of samples averaged with a mean over the pixel's area, (height, width, 3), by their worth.

    Where a pixel shows one lamp or one part of the sky both are equal. At the edge of a lamp the samples are as noisy
    as the choice of what they meet: dots and saw teeth, each as bright as the lamp.

    Parameters
    ----------
    emission : array, shape (height, width, 3)
        Of the samples, finite, >= 0.
    mean : array, shape (height, width, 3)
        As `lobewise.GBuffer.mean_emission`. What is negative or not finite there does not count.
    spp : float or None
        Samples per pixel.
    """
    share = np.float32(EMISSION_WORTH / (EMISSION_WORTH + (UNKNOWN_SPP if spp is None else spp)))
    good = (mean >= 0.0) & (mean <= np.finfo(np.float32).max)
    return np.where(good, emission + share * (np.where(good, mean, np.float32(0.0)) - emission), emission)


def _define_composite(grid: Grid) -> list[Vector]:
    width, height = grid.size
    zero, half = hl.f32(0.0), hl.f32(0.5)

    def read_light(x: hl.Expr, y: hl.Expr) -> Vector:
        first = grid.read("light0", x, y)
        if not grid.has("light1"):
            return first
        return [half * (a + b) for a, b in zip(first, grid.read("light1", x, y), strict=True)]

    def read_albedo(x: hl.Expr, y: hl.Expr) -> Vector:
        return [hl.select(expressions.is_bad(tint), zero, tint) for tint in grid.read("albedo", x, y)]

    light = read_light(grid.x, grid.y)
    known = grid.read_one("lit") != 0
    if grid.has("coverage"):
        sums: list[hl.Expr] = [zero] * COLORS
        weights: list[hl.Expr] = [zero] * COLORS
        area: hl.Expr = zero
        for k, share in enumerate(grid.read("coverage")):
            x = hl.clamp(grid.x + (k % 3 - 1), 0, width - 1)
            y = hl.clamp(grid.y + (k // 3 - 1), 0, height - 1)
            (lit,) = grid.read("lit", x, y)
            counted = hl.select(lit != 0, share, zero)
            area = area + counted
            for channel, (value, tint) in enumerate(zip(read_light(x, y), read_albedo(x, y), strict=True)):
                weight = counted * tint
                sums[channel] = sums[channel] + weight * value
                weights[channel] = weights[channel] + weight
        light = [
            hl.select(weight > hl.f32(SMALLEST_SHARE), total / weight, own)
            for total, weight, own in zip(sums, weights, light, strict=True)
        ]
        known = area > zero
    tints = read_albedo(grid.x, grid.y) if grid.has("albedo") else [hl.f32(1.0)] * COLORS
    raw = grid.read("radiance")
    good = ~(expressions.is_bad(raw[0]) | expressions.is_bad(raw[1]) | expressions.is_bad(raw[2]))
    # Bits, because what is kept may be NaN.
    kept = [hl.reinterpret(hl.UInt(32), select_or_nan(good, value)) for value in raw]
    found = [hl.reinterpret(hl.UInt(32), value * tint) for value, tint in zip(light, tints, strict=True)]
    return [[hl.reinterpret(hl.Float(32), hl.select(known, a, b)) for a, b in zip(found, kept, strict=True)]]
