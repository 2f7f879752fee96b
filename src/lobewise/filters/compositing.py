"""Composite filtered light over the area of each pixel, so that silhouettes and texture edges have no steps.

Filters use the surface at a pixel's centre. Where several surfaces share a pixel, `GBuffer.coverage` holds the share of
its area that the surface at each neighbouring centre covers. The light of the surfaces is mixed by area and albedo.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend import expressions
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, give_channels, select_bits, select_or_nan
from lobewise.filters.cross_pass import ALBEDO_FLOOR, COLORS
from lobewise.records.frame import FloatArray

MIN_TINTED_AREA = 1e-6
"""Smallest sum of area times albedo; below it a channel keeps the light at the pixel's own centre."""
MEAN_EMISSION_SPP = 16.0
"""Samples that `lobewise.GBuffer.mean_emission` counts as, its number of rays. The rays are spread evenly over the
pixel: at straight edges they are worth twice as many samples, at lamps smaller than a pixel no more."""
UNKNOWN_SPP = 16.0
"""Samples per pixel of a frame whose number of samples is not known."""
COVERAGE_REACH = 1
"""Distance of the farthest pixel whose light is mixed in, rows or columns."""


def composite_light(
    images: Sequence[FloatArray],
    lit: NDArray[np.bool_],
    radiance: FloatArray,
    albedo: FloatArray | None = None,
    coverage: FloatArray | None = None,
) -> FloatArray:
    """Return the radiance of every pixel's area, shape (height, width, 3), from the light at pixel centres.

    With ``coverage`` the light is ``L_i = sum_k c_ik a_k L_k / sum_k c_ik a_k`` over the 3x3 neighbours, channel by
    channel; times the albedo of pixel i it is the radiance of its area. This is exact if all surfaces have one albedo
    or receive the same light. A pixel without a lit surface keeps its radiance, NaN if its radiance is bad.

    Parameters
    ----------
    images : sequence of array, shape (height, width, 3)
        One or two images, radiance over albedo, finite, >= 0; their mean is the light.
    lit : bool array, shape (height, width)
        True where the light is defined.
    radiance : array, shape (height, width, 3)
        Unfiltered radiance.
    albedo : array, shape (height, width, 3), optional
        Mean albedo of every pixel's area, or without coverage the albedo at its centre. Channels that are negative or
        not finite count as 0.
    coverage : array, shape (height, width, 9), optional
        See `lobewise.records.frame.GBuffer`; needs albedo.
    """
    named = {f"light{k}": image for k, image in enumerate(images)}
    others = {"lit": lit, "radiance": radiance, "albedo": albedo, "coverage": coverage}
    (composite,) = engine.pixels(
        define_composite, {**named, **others}, {}, names=["composite"], text="light times albedo"
    )
    return composite


def composite_parts(
    part: FloatArray,
    weight_sum: FloatArray,
    albedo: FloatArray,
    mean_albedo: FloatArray,
    coverage: FloatArray,
) -> FloatArray:
    """Return the radiance of every pixel's area from the radiance of the surfaces at pixel centres.

    With the shares c of the 3x3 surfaces and their albedos a it is ``sum_k c_k part_k / sum_k c_k a_k`` times the mean
    albedo of the pixel, channel by channel. Only neighbours that are lit and have an albedo count. A pixel that no such
    surface covers keeps its radiance.

    Parameters
    ----------
    part : array, shape (height, width, 3)
        Radiance of one layer, as if the surface at the centre filled the pixel; finite, >= 0.
    weight_sum : array, shape (height, width)
        Above 0 where the radiance is defined.
    albedo, mean_albedo : array, shape (height, width, 3)
        Albedo at the centre, and its mean over the pixel's area.
    coverage : array, shape (height, width, 9)
        See `lobewise.records.frame.GBuffer`.
    """
    images = {"weight": weight_sum, "albedo": albedo, "mean": mean_albedo, "coverage": coverage}
    images |= give_channels("part", part)
    (composite,) = engine.pixels(define_part, images, {}, names=["area"], text="light of pixel areas")
    return composite


def define_part(grid: Grid) -> list[Vector]:
    """Return the radiance of pixel areas; see `composite_parts`."""
    zero = hl.f32(0.0)
    # The values of every pixel, 0 where it does not count, are computed once for all of its neighbours.
    at = grid.inside
    lit = grid.read("weight", *at)[0] > hl.f32(0.0)
    tints, lights = [], []
    for value, albedo in zip(grid.read_channels("part", *at), grid.read("albedo", *at), strict=True):
        known = lit & (albedo > hl.f32(ALBEDO_FLOOR))
        tints.append(hl.select(known, albedo, zero))
        lights.append(hl.select(known, value, zero))
    read = grid.keep([*tints, *lights])
    weights: list[hl.Expr] = [zero] * COLORS
    sums: list[hl.Expr] = [zero] * COLORS
    for k, share in enumerate(grid.read("coverage")):
        there = read(grid.x + (k % 3 - 1), grid.y + (k // 3 - 1))
        weights = [weight + share * tint for weight, tint in zip(weights, there[:COLORS], strict=True)]
        sums = [total + share * light for total, light in zip(sums, there[COLORS:], strict=True)]
    own = zip(grid.read_channels("part"), grid.read("mean"), sums, weights, strict=True)
    return [
        [
            hl.select((weight > hl.f32(MIN_TINTED_AREA)) & ~expressions.is_bad(mean), total / weight * mean, value)
            for value, mean, total, weight in own
        ]
    ]


def average_emission(emission: FloatArray, mean: FloatArray, spp: float | None) -> FloatArray:
    """Return the average of the emission of samples and the mean emission of the pixel's area, by number of samples.

    Where a pixel shows one lamp or one part of the sky, both are equal. At the edge of a lamp few samples choose
    between lamp and background, so the emission of samples shows dots and saw teeth as bright as the lamp.

    Parameters
    ----------
    emission : array, shape (height, width, 3)
        Emission of the samples, finite, >= 0.
    mean : array, shape (height, width, 3)
        See `lobewise.GBuffer.mean_emission`. Values that are negative or not finite do not count.
    spp : float or None
        Samples per pixel.
    """
    share = np.float32(MEAN_EMISSION_SPP / (MEAN_EMISSION_SPP + (UNKNOWN_SPP if spp is None else spp)))
    images = {"emission": emission, "mean": mean}
    (average,) = engine.pixels(define_averaged_emission, images, {"share": share}, names=["rest"])
    return average


def define_averaged_emission(grid: Grid) -> list[Vector]:
    """Return the emission of samples averaged with that of the pixel's area; see `average_emission`."""
    (share,) = grid.get("share")
    pairs = zip(grid.read("emission"), grid.read("mean"), strict=True)
    return [[hl.select(expressions.is_bad(mean), value, value + share * (mean - value)) for value, mean in pairs]]


def define_composite(grid: Grid) -> list[Vector]:
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
        at = grid.inside
        read = grid.keep([*read_light(*at), *read_albedo(*at)])
        read_lit = grid.keep(grid.read("lit", *at))
        sums: list[hl.Expr] = [zero] * COLORS
        weights: list[hl.Expr] = [zero] * COLORS
        area: hl.Expr = zero
        for k, share in enumerate(grid.read("coverage")):
            near = grid.x + (k % 3 - 1), grid.y + (k // 3 - 1)
            counted = hl.select(read_lit(*near)[0] != 0, share, zero)
            area = area + counted
            there = read(*near)
            for channel, (value, tint) in enumerate(zip(there[:COLORS], there[COLORS:], strict=True)):
                weight = counted * tint
                sums[channel] = sums[channel] + weight * value
                weights[channel] = weights[channel] + weight
        light = [
            hl.select(weight > hl.f32(MIN_TINTED_AREA), total / weight, own)
            for total, weight, own in zip(sums, weights, light, strict=True)
        ]
        known = area > zero
    tints = read_albedo(grid.x, grid.y) if grid.has("albedo") else [hl.f32(1.0)] * COLORS
    raw = grid.read("radiance")
    good = expressions.is_good(raw)
    mixed = zip(light, tints, raw, strict=True)
    return [[select_bits(known, value * tint, select_or_nan(good, kept)) for value, tint, kept in mixed]]
