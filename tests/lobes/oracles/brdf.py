"""Reference BRDFs beside `lobewise.fitting.ggx`, and how normals become single lobes.

A BRDF here is ``f(view, light)`` in 1/sr, without the cosine, in a local frame: z is the normal, x the direction of
``alpha_u``; both directions are unit vectors of shape (..., 3) that point away from the surface. It is 0 where either
is below the horizon. Roughness ``alpha`` is the microfacet width. There is no Fresnel term.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from lobewise.fitting.ggx import are_above, evaluate_microfacet, make_positive
from lobewise.lobes.covariance import compute_dominant_normal
from lobewise.lobes.gaussian import MIN_WARP_COSINE
from lobewise.lobes.numbers import NUMPY

from .vectors import Array, as_reals, divide_or, dot, normalize, reflect


def beckmann_normal_density(half: ArrayLike, alpha_u: ArrayLike, alpha_v: ArrayLike | None = None) -> Array:
    """Return the Beckmann density of normals, 1/sr (Walter et al. 2007, eq. 25; anisotropic: Heitz 2014)."""
    half, alpha_u, alpha_v = as_reals(half, alpha_u, alpha_u if alpha_v is None else alpha_v)
    cosine = make_positive(half[..., 2])
    exponent = ((half[..., 0] / alpha_u) ** 2 + (half[..., 1] / alpha_v) ** 2) / cosine**2
    density = np.exp(-exponent) / (math.pi * alpha_u * alpha_v * cosine**4)
    return np.asarray(np.where(half[..., 2] > 0.0, density, 0.0))


def beckmann_smith_lambda(direction: ArrayLike, alpha_u: ArrayLike, alpha_v: ArrayLike | None = None) -> Array:
    """Return Smith's Lambda of Beckmann, with the error function and not its rational fit (Heitz 2014)."""
    direction, alpha_u, alpha_v = as_reals(direction, alpha_u, alpha_u if alpha_v is None else alpha_v)
    slope = np.sqrt((alpha_u * direction[..., 0]) ** 2 + (alpha_v * direction[..., 1]) ** 2)
    steepness = np.minimum(divide_or(np.abs(direction[..., 2]), slope, 30.0), 30.0)  # erfc(30) is 0 in float64
    tail = np.asarray(np.vectorize(math.erfc, otypes=[np.float64])(steepness), dtype=steepness.dtype)
    decay = np.exp(-(steepness**2)) / math.sqrt(math.pi)
    return np.asarray(np.maximum(0.5 * (divide_or(decay, steepness, np.inf) - tail), 0.0))


def beckmann_brdf(view: ArrayLike, light: ArrayLike, alpha_u: ArrayLike, alpha_v: ArrayLike | None = None) -> Array:
    """Return the Beckmann reflection BRDF with height-correlated Smith masking, single scattering, 1/sr."""
    view, light, alpha_u, alpha_v = as_reals(view, light, alpha_u, alpha_u if alpha_v is None else alpha_v)
    lambdas = beckmann_smith_lambda(view, alpha_u, alpha_v) + beckmann_smith_lambda(light, alpha_u, alpha_v)
    return evaluate_microfacet(view, light, beckmann_normal_density(normalize(view + light), alpha_u, alpha_v), lambdas)


def lambert_brdf(view: ArrayLike, light: ArrayLike) -> Array:
    """Return the Lambert BRDF of albedo 1, ``1 / pi`` above the horizon."""
    view, light = as_reals(view, light)
    return np.asarray(np.where(are_above(view, light), 1.0 / math.pi, 0.0), dtype=view.dtype)


def lambert_similarity(normal_i: ArrayLike, normal_j: ArrayLike) -> Array:
    """Return the similarity of two Lambert lobes: ``((pi - d) cos d + sin d) / pi``, d the normals' angle. Exact."""
    normal_i, normal_j = as_reals(normal_i, normal_j)
    difference, total = normal_i - normal_j, normal_i + normal_j
    half_sine, half_cosine = np.sqrt(dot(difference, difference)), np.sqrt(dot(total, total))
    angle = 2.0 * np.arctan2(half_sine, half_cosine)
    return np.asarray(np.maximum(((math.pi - angle) * np.cos(angle) + np.sin(angle)) / math.pi, 0.0))


def oren_nayar_brdf(view: ArrayLike, light: ArrayLike, sigma: ArrayLike) -> Array:
    """Return the qualitative Oren-Nayar BRDF of albedo 1, 1/sr (Oren and Nayar 1994); ``sigma`` in radians."""
    view, light, sigma = as_reals(view, light, sigma)
    square = sigma * sigma
    a = 1.0 - 0.5 * square / (square + 0.33)
    b = 0.45 * square / (square + 0.09)
    # cos(phi_v - phi_l) sin(theta_v) sin(theta_l); dividing by the larger cosine makes it sin(larger) tan(smaller)
    across = view[..., 0] * light[..., 0] + view[..., 1] * light[..., 1]
    steepest = make_positive(np.maximum(view[..., 2], light[..., 2]))
    value = (a + b * np.maximum(across, 0.0) / steepest) / math.pi
    return np.asarray(np.where(are_above(view, light), value, 0.0))


def ggx_dominant_visible_normal(view: ArrayLike, alpha_u: ArrayLike, alpha_v: ArrayLike | None = None) -> Array:
    """Return `lobewise.lobes.covariance.compute_dominant_normal` of arrays of vectors, (..., 3).

    Parameters
    ----------
    view : array_like, shape (..., 3)
        Local direction to the viewer, z the normal, vz >= 0.
    alpha_u, alpha_v : array_like
        Roughness in [0, 1].
    """
    view, alpha_u, alpha_v = as_reals(view, alpha_u, alpha_u if alpha_v is None else alpha_v)
    m = compute_dominant_normal(NUMPY, [view[..., k] for k in range(3)], [alpha_u, alpha_v])
    return np.stack(np.broadcast_arrays(*m), axis=-1)


def reflect_sg(view: ArrayLike, sharpness: ArrayLike, normal: ArrayLike) -> tuple[Array, Array]:
    """Return (axis, sharpness) of the reflected lobe of a spherical Gaussian of normals around ``normal``.

    Source: Wang et al. 2009, the spherical warp: axis ``2 (n.v) n - v``, sharpness ``l / (4 |n.v|)``, the amplitude
    unchanged.
    Departs: ``n.v`` is not taken below 0.1. Approximate: the true lobe is ``1 / n.v`` times longer in the plane of
    incidence than across it.
    """
    view, sharpness, normal = as_reals(view, sharpness, normal)
    cosine = np.maximum(np.abs(dot(normal, view)), MIN_WARP_COSINE)
    return reflect(view, normal), np.asarray(sharpness / (4.0 * cosine))


def reflect_ggx_sg(view: ArrayLike, alpha_u: ArrayLike, alpha_v: ArrayLike | None = None) -> tuple[Array, Array]:
    """Return (axis, sharpness), local, of the single spherical Gaussian for a GGX reflection lobe.

    The normals have sharpness ``2 / alpha^2 - 2``, which keeps peak and projected area (Tokuyoshi and Harada 2019).
    The lobe is reflected about the dominant visible normal m, with sharpness ``l m.z / (4 |v.m|)``.

    Parameters
    ----------
    view : array_like, shape (..., 3)
        Local direction to the viewer, z the normal.
    alpha_u, alpha_v : array_like
        Roughness above 0; the lobe takes the geometric mean.
    """
    view, alpha_u, alpha_v = as_reals(view, alpha_u, alpha_u if alpha_v is None else alpha_v)
    normal = ggx_dominant_visible_normal(view, alpha_u, alpha_v)
    return reflect_sg(view, (2.0 / (alpha_u * alpha_v) - 2.0) * normal[..., 2], normal)
