"""Spherical Gaussians ``G(w) = exp(sharpness (w.axis - 1))``: the single lobe of a reflection.

The similarity of two is in `lobewise.features.lobe`, in the form that taps compute.
"""

from __future__ import annotations

import math
from typing import Any

from lobewise.lobes.numbers import Namespace
from lobewise.lobes.vectors import Vector

MIN_WARP_COSINE = 0.1
"""Floor of n.v in the warp of a single lobe; below it the lobe would become sharper than any that a surface has."""
LAMBERT_SIMILARITY_SHARPNESS = 2.0
"""The similarity of two Lambert lobes falls as 1 - d^2 / 2 for small angles d, as that of two SGs of this sharpness."""
_SHARP = 40.0
"""Beyond this nothing is left of an exponential beside 1, in double precision too."""


def find_ggx_variance(xp: Namespace, cosine: Any, alphas: Vector, noise: Any) -> Any:
    """Return ``1 / sharpness`` of the single spherical Gaussian of a GGX reflection, square radians. Approximate.

    Source: Wang et al. 2009: normals of sharpness ``2 / alpha^2``, and the spherical warp, which divides it by
    ``4 n.v``.
    Departs: ``n.v`` is not taken below `MIN_WARP_COSINE`; two alphas count as their geometric mean; ``noise``, a
    variance, is added (band-limit). The true lobe is ``1 / n.v`` times longer in the plane of incidence than across it.
    """
    warp = 2.0 * xp.maximum(cosine, xp.number(MIN_WARP_COSINE))
    return warp * (alphas[0] * alphas[1]) + noise


def find_share_on_sphere(xp: Namespace, sharpness: Any) -> Any:
    """Return ``1 - exp(-2 l)``: what the sphere holds of the integral ``2 pi / l`` of a sharp lobe."""
    return -xp.expm1(-xp.minimum(2.0 * sharpness, _SHARP))


def integrate_gaussian(xp: Namespace, sharpness: Any) -> Any:
    """Return the integral over the sphere, ``2 pi (1 - exp(-2 l)) / l``, of a sharpness above 0.

    Exact; in float32 a sharpness below 0.01 loses digits, and no lobe of a reflection has one.
    """
    return xp.number(4.0 * math.pi) * (find_share_on_sphere(xp, sharpness) / (2.0 * sharpness))
