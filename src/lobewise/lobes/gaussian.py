"""Spherical Gaussians ``G(w) = exp(sharpness (w.axis - 1))``: a single lobe of a reflection, and sums of several.

The GGX distribution of normals is ``(1 + q)^-2`` with ``q = (1 / alpha^2 - 1) sin^2`` for every roughness, so one table
of exponents and weights serves all. The similarity of lobes, in the form that taps compute, is in
`lobewise.features.sg`.
"""

from __future__ import annotations

import math
from typing import Any

from lobewise.lobes.numbers import Namespace
from lobewise.lobes.vectors import Vector

MIN_WARP_COSINE = 0.1
"""Smallest n.v in the warp of a single lobe; at smaller ones the lobe would be sharper than any of a surface."""
LAMBERT_SIMILARITY_SHARPNESS = 2.0
"""Sharpness of spherical Gaussians whose similarity equals that of Lambert lobes, 1 - d^2 / 2, for small angles d."""
_SHARP = 40.0
"""Exponent above which ``1 - exp(-x)`` rounds to 1, in double precision too."""


def compute_ggx_variance(xp: Namespace, cosine: Any, alphas: Vector, noise: Any) -> Any:
    """Return ``1 / sharpness`` of the single spherical Gaussian of a GGX reflection, square radians. Approximate.

    Source: Wang et al. 2009: normals of sharpness ``2 / alpha^2``, and the spherical warp, which divides it by
    ``4 n.v``.
    Departs: ``n.v`` is at least `MIN_WARP_COSINE`; of two alphas the geometric mean counts; the variance ``noise``, the
    band-limit, is added. The true lobe is ``1 / n.v`` times longer in the plane of incidence than across it.
    """
    warp = 2.0 * xp.maximum(cosine, xp.number(MIN_WARP_COSINE))
    return warp * (alphas[0] * alphas[1]) + noise


def compute_share_on_sphere(xp: Namespace, sharpness: Any) -> Any:
    """Return ``1 - exp(-2 l)``: the integral of a lobe over the sphere, over the limit ``2 pi / l`` of sharp lobes."""
    return -xp.expm1(-xp.minimum(2.0 * sharpness, _SHARP))


def integrate_gaussian(xp: Namespace, sharpness: Any) -> Any:
    """Return the integral over the sphere, ``2 pi (1 - exp(-2 l)) / l``, of a sharpness above 0.

    Exact. In float32 a sharpness below 0.01 loses digits, but lobes of reflections are sharper.
    """
    return xp.number(4.0 * math.pi) * (compute_share_on_sphere(xp, sharpness) / (2.0 * sharpness))


GGX_MIXTURES = {
    1: ((1.13114,), (0.85981,)),
    2: ((1.99292, 0.38284), (0.76456, 0.20460)),
    3: ((2.72034, 0.79279, 0.15495), (0.56175, 0.38771, 0.04203)),
    4: ((3.36676, 1.19570, 0.35641, 0.06981), (0.39312, 0.47419, 0.12070, 0.00929)),
}
"""Exponents b and weights w of ``(1 + q)^-2 ~ sum w exp(-b q)``, by the number of lobes: least squares over q >= 0, the
area of the plane. Relative L2 errors 0.140, 0.031, 0.0085, 0.0027."""

MIN_SHARPNESS = 1.5
"""Smallest sharpness of a GGX lobe before its band-limit, as wide as the hemisphere (fitted to quadrature)."""

LAMBERT_SHARPNESS = 2.1438
LAMBERT_AMPLITUDE = 1.1766
"""The least-squares spherical Gaussian of ``max(n.w, 0)`` over the sphere; relative L2 error 0.177."""

MIN_AREA = 1e-12
"""Smallest divisor for the area of a lobe, square radians. A smaller lobe lies entirely on the sphere."""


def spread_ggx_mixture(
    xp: Namespace, area: Any, alpha_square: Any, albedo: Any, *, lobes: int, noise: Any
) -> tuple[list[Any], list[Any]]:
    """Return the sharpnesses and amplitudes of the coaxial mixture for a GGX reflection of albedo 1. Approximate.

    Parameters
    ----------
    xp : Namespace
    area : number
        Variance of the reflected lobe without band-limit, ``2 n.v alpha^2``, square radians; 0 for a mirror.
    alpha_square : number
        Product of the two alphas, in [0, 1].
    lobes : {1, 2, 3, 4}
        Number of lobes.
    noise : number
        Band-limit, added to every ``1 / sharpness``, square radians, > 0; the integral of each lobe is preserved.

    Returns
    -------
    two lists of ``lobes`` numbers
        Sharpness, inverse square radians, and amplitude, 1/sr. The integral over the sphere is ``sum w / b``: 0.760,
        0.918, 0.967 or 0.985 of that of GGX for 1 to 4 lobes.

    Notes
    -----
    Normals of sharpness ``2 b k``, ``k = 1 / alpha^2 - 1``, reflected by the warp of Wang et al. 2009, are lobes of
    sharpness ``b k / (2 n.v)``, which is at least `MIN_SHARPNESS`. Their amplitudes are ``w`` times a common peak.
    Common denominators avoid divisions by 0 for alpha from 0 to 1.
    Validity: with three lobes the similarity of lobes with the shape of GGX normals has an error of 0.003; that of GGX
    reflections is limited by the shape and the axis of the lobe, see docs/developers/theory.md.
    """
    deficit = 1.0 - alpha_square
    rows = [[xp.number(value) for value in row] for row in zip(*GGX_MIXTURES[lobes], strict=True)]
    sharpness, shares = [], []
    for exponent, weight in rows:
        # 1 / sharpness = area / (b (1 - alpha^2)) + tau^2
        steepness = xp.maximum(exponent * deficit, MIN_SHARPNESS * area)
        sharpness.append(steepness / (area + noise * steepness))
        # Compute the integral of the lobe before the band-limit, over ``area``, which is 0 for a mirror.
        inside = compute_share_on_sphere(xp, steepness / xp.maximum(area, xp.number(MIN_AREA)))
        shares.append(weight * inside / steepness)
    total, reached = sum(shares), sum(weight / exponent for exponent, weight in rows)
    amplitude = [
        albedo * (share / total * reached) / integrate_gaussian(xp, value)
        for value, share in zip(sharpness, shares, strict=True)
    ]
    return sharpness, amplitude
