"""From one surface per pixel to what the pixel's area shows: silhouettes and edges of textures without steps.

Filters work with the surface at a pixel's centre. Where others share the pixel, `GBuffer.coverage` says how much of its
area the centres around it stand for, and the light that falls on those is mixed by area and albedo.
"""

from __future__ import annotations

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.kernels.pointwise import Grid, Vector, run_pointwise

SMALLEST_SHARE = 1e-6
"""Sum of shares times albedos below which a pixel keeps the light at its own centre."""


def resolve_coverage(
    light: FloatArray, lit: NDArray[np.bool_], albedo: FloatArray, coverage: FloatArray
) -> tuple[FloatArray, NDArray[np.bool_]]:
    """Return the light over the area of every pixel, and where any of its surfaces is lit.

    ``L_i = sum_k c_ik a_k L_k / sum_k c_ik a_k`` over the 3x3 neighbours, channel by channel; times the albedo of pixel
    i this is the radiance of its area, exactly where every surface has one albedo or all have the same light.

    Parameters
    ----------
    light : array, shape (height, width, 3)
        Radiance over albedo at the pixel centres, finite, >= 0.
    lit : bool array, shape (height, width)
        Where ``light`` has meaning.
    albedo : array, shape (height, width, 3)
        Mean albedo of every pixel's area.
    coverage : array, shape (height, width, 9)
        As in `lobewise.frame.GBuffer`.
    """
    images = {"light": light, "lit": lit, "albedo": albedo, "coverage": coverage}
    resolved, known = run_pointwise(_define_resolved, images, {})
    return np.asarray(resolved), np.asarray(known)


def _define_resolved(grid: Grid) -> list[Vector]:
    width, height = grid.size
    shares = grid.read("coverage")
    own = grid.read("light")
    zero = hl.f32(0.0)
    sums: list[hl.Expr] = [zero] * 3
    weights: list[hl.Expr] = [zero] * 3
    area: hl.Expr = zero
    for k, share in enumerate(shares):
        x = hl.clamp(grid.x + (k % 3 - 1), 0, width - 1)
        y = hl.clamp(grid.y + (k // 3 - 1), 0, height - 1)
        (lit,) = grid.read("lit", x, y)
        counted = hl.select(lit != 0, share, zero)
        area = area + counted
        for channel, (value, tint) in enumerate(zip(grid.read("light", x, y), grid.read("albedo", x, y), strict=True)):
            weight = counted * tint
            sums[channel] = sums[channel] + weight * value
            weights[channel] = weights[channel] + weight
    resolved = [
        hl.select(weight > hl.f32(SMALLEST_SHARE), total / weight, mine)
        for total, weight, mine in zip(sums, weights, own, strict=True)
    ]
    return [resolved, [hl.u8(area > zero)]]
