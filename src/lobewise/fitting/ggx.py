"""The GGX reflection BRDF, whose roughness is fitted to measured materials.

A BRDF here is ``f(view, light)`` in 1/sr, without the cosine, in a local frame: z is the normal, x the direction of
``alpha_u``. Both directions are unit vectors of shape (..., 3) that point away from the surface. The BRDF is 0 if
either is below the horizon. Roughness ``alpha`` is the width of the microfacet distribution. There is no Fresnel term.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from lobewise.fitting.arrays import Array, as_reals, normalize


def are_above(view: Array, light: Array) -> Array:
    """Return where both directions are above the horizon."""
    return np.asarray((view[..., 2] > 0.0) & (light[..., 2] > 0.0))


def make_positive(cosine: Array) -> Array:
    """Return cosines that are safe to divide by: 1 in place of values up to 0. The caller masks these out."""
    return np.asarray(np.where(cosine > 0.0, cosine, 1.0))


def ggx_normal_density(half: ArrayLike, alpha_u: ArrayLike, alpha_v: ArrayLike | None = None) -> Array:
    """Return the GGX density of normals, 1/sr. Times the cosine it integrates to 1 (Walter et al. 2007, eq. 33).

    Written as ``1 / (pi au av (hx^2/au^2 + hy^2/av^2 + hz^2)^2)`` (Heitz 2014).
    """
    half, alpha_u, alpha_v = as_reals(half, alpha_u, alpha_u if alpha_v is None else alpha_v)
    stretched = (half[..., 0] / alpha_u) ** 2 + (half[..., 1] / alpha_v) ** 2 + half[..., 2] ** 2
    upper = half[..., 2] > 0.0
    return np.asarray(np.where(upper, 1.0 / (math.pi * alpha_u * alpha_v * np.where(upper, stretched, 1.0) ** 2), 0.0))


def ggx_smith_lambda(direction: ArrayLike, alpha_u: ArrayLike, alpha_v: ArrayLike | None = None) -> Array:
    """Return Smith's Lambda of GGX, so that ``G1 = 1 / (1 + Lambda)`` (Heitz 2014)."""
    direction, alpha_u, alpha_v = as_reals(direction, alpha_u, alpha_u if alpha_v is None else alpha_v)
    slope = ((alpha_u * direction[..., 0]) ** 2 + (alpha_v * direction[..., 1]) ** 2) / direction[..., 2] ** 2
    # (sqrt(1 + s) - 1) / 2 without cancellation
    return np.asarray(0.5 * slope / (1.0 + np.sqrt(1.0 + slope)))


def evaluate_microfacet(view: Array, light: Array, density: Array, lambdas: Array) -> Array:
    """Return ``D / (4 n.v n.l (1 + Lambda(v) + Lambda(l)))``: height-correlated masking (Heitz 2014, eq. 99)."""
    cosines = make_positive(view[..., 2]) * make_positive(light[..., 2])
    return np.asarray(np.where(are_above(view, light), density / (4.0 * cosines * (1.0 + lambdas)), 0.0))


def _raise_above(direction: Array) -> Array:
    raised = direction.copy()
    raised[..., 2] = make_positive(direction[..., 2])
    return raised


def ggx_brdf(view: ArrayLike, light: ArrayLike, alpha_u: ArrayLike, alpha_v: ArrayLike | None = None) -> Array:
    """Return the GGX reflection BRDF with height-correlated Smith masking, single scattering, 1/sr."""
    view, light, alpha_u, alpha_v = as_reals(view, light, alpha_u, alpha_u if alpha_v is None else alpha_v)
    lambdas = ggx_smith_lambda(_raise_above(view), alpha_u, alpha_v)
    lambdas = lambdas + ggx_smith_lambda(_raise_above(light), alpha_u, alpha_v)
    return evaluate_microfacet(view, light, ggx_normal_density(normalize(view + light), alpha_u, alpha_v), lambdas)
