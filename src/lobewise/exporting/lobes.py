"""What makes the lobes of an exported filter from its guides: the definition that is compiled, here and elsewhere."""

from __future__ import annotations

import math
from collections.abc import Sequence

import halide as hl

from lobewise.backend.pointwise import Grid, Vector
from lobewise.guides.lobe_fields import define_lobes
from lobewise.lobes.mixture import GGX_MIXTURES, MIN_SHARPNESS


def define_guides(grid: Grid, similarity: str, lobes: int) -> Sequence[Vector]:
    """Return the outputs of the function that makes lobes, in order: the mask, the axis, and what else there is."""
    return define_mixture(grid, lobes) if similarity == "sg_mixture" else define_lobes(grid, similarity, False)


def define_mixture(grid: Grid, lobes: int) -> Sequence[Vector]:
    """Return validity, axis, sharpnesses and amplitudes: `lobewise.lobes.mixture.spread_ggx_mixture`, of albedo 1.

    The variance of the single lobe without its band-limit is the area of the mixture.
    """
    valid, axis, (single,) = define_lobes(grid, "sg", False)
    (noise,) = grid.get("noise")
    one, tiny = hl.f32(1.0), hl.f32(1e-12)
    area = hl.max(one / single - noise, hl.f32(0.0))
    alpha = hl.clamp(grid.read_one("alpha_u"), hl.f32(0.0), one)
    deficit = one - alpha * alpha
    exponents, weights = GGX_MIXTURES[lobes]
    sharpness, shares = [], []
    for exponent, weight in zip(exponents, weights, strict=True):
        steepness = hl.max(hl.f32(exponent) * deficit, hl.f32(MIN_SHARPNESS) * area)
        sharpness.append(steepness / (area + noise * steepness))
        # Beyond 40 nothing of the sphere is missing.
        decay = hl.exp(-hl.min(hl.f32(2.0) * steepness / hl.max(area, tiny), hl.f32(40.0)))
        shares.append(hl.f32(weight) * (one - decay) / steepness)
    reached = sum(weight / exponent for exponent, weight in zip(exponents, weights, strict=True))
    scale = hl.f32(reached) / sum(shares[1:], shares[0])
    there = valid[0] != 0
    amplitude = []
    for value, share in zip(sharpness, shares, strict=True):
        sphere = hl.f32(2.0 * math.pi) * (one - hl.exp(-hl.min(hl.f32(2.0) * value, hl.f32(40.0)))) / value
        amplitude.append(hl.select(there, share * scale / sphere, hl.f32(0.0)))
    return [valid, axis, [hl.select(there, value, one) for value in sharpness], amplitude]
