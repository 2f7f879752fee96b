"""Spherical Gaussians ``G(w) = exp(sharpness (w.axis - 1))``: the single lobe of a reflection.

The similarity of two spherical Gaussians is in `lobewise.features.sg`, in the form that taps compute.
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
