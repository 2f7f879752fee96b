"""Sums of spherical Gaussians: one to four lobes per pixel, each with an amplitude, 0 for a lobe that is absent.

Product integrals are bilinear, so a pair of pixels costs the product of their numbers of lobes (Iwasaki et al. 2012).
The similarity divides by the norms, which belong to one pixel each and are computed by the same formula as the product.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lobewise.errors import InputError, describe_problem
from lobewise.lobes.asg import MIN_VARIANCE
from lobewise.lobes.brdf import MIN_WARP_COSINE
from lobewise.lobes.sg import sg_approx_product_integral, sg_evaluate, sg_integral, sg_product_integral
from lobewise.lobes.vectors import Array, as_reals, divide_or, dot, reflect

GGX_MIXTURES = {
    1: ((1.13114,), (0.85981,)),
    2: ((1.99292, 0.38284), (0.76456, 0.20460)),
    3: ((2.72034, 0.79279, 0.15495), (0.56175, 0.38771, 0.04203)),
    4: ((3.36676, 1.19570, 0.35641, 0.06981), (0.39312, 0.47419, 0.12070, 0.00929)),
}
"""Exponents b and weights w of ``(1 + q)^-2 ~ sum w exp(-b q)``, by the number of lobes: least squares over q >= 0, the
area of the plane. Relative L2 errors 0.140, 0.031, 0.0085, 0.0027. As GGX is ``(1 + q)^-2`` for every roughness, with
``q = (1 / alpha^2 - 1) sin^2``, they serve all of them."""

MIN_SHARPNESS = 1.5
"""Floor of the sharpness of a GGX lobe before its band-limit: the hemisphere is no wider (fitted to quadrature)."""

LAMBERT_SHARPNESS = 2.1438
LAMBERT_AMPLITUDE = 1.1766
"""The least-squares spherical Gaussian of ``max(n.w, 0)`` over the sphere; relative L2 error 0.177."""


class SgMixture(NamedTuple):
    """A sum of N spherical Gaussians ``amplitude exp(sharpness (w.axis - 1))``."""

    axis: Array
    """Unit vectors, shape (..., N, 3), or (..., 1, 3) where all lobes share one."""
    sharpness: Array
    """Shape (..., N), >= 0, inverse square radians."""
    amplitude: Array
    """Value at the axis, shape (..., N), >= 0, linear; 0 for a lobe that is absent."""


ProductIntegral = Callable[[Array, Array, Array, Array], Array]


def mixture_evaluate(direction: ArrayLike, mixture: SgMixture) -> Array:
    """Return the value of a mixture in ``direction`` (unit vectors, shape (..., 3)). Exact."""
    direction, axis, sharpness, amplitude = as_reals(direction, *mixture)
    return np.asarray(np.sum(amplitude * sg_evaluate(direction[..., None, :], axis, sharpness), axis=-1))


def mixture_integral(mixture: SgMixture) -> Array:
    """Return the integral of a mixture over the sphere, shape (...). Exact."""
    sharpness, amplitude = as_reals(mixture.sharpness, mixture.amplitude)
    return np.asarray(np.sum(amplitude * sg_integral(sharpness), axis=-1))


def _sum_products(mixture_i: SgMixture, mixture_j: SgMixture, integral: ProductIntegral) -> Array:
    """Return the sum over all pairs of lobes; a pair with an absent lobe counts 0 whatever its sharpness."""
    axis_i, sharpness_i, amplitude_i, axis_j, sharpness_j, amplitude_j = as_reals(*mixture_i, *mixture_j)
    # an absent lobe may have any sharpness, also 0, for which the sharp form is infinite
    sharpness_i = np.where(amplitude_i > 0.0, sharpness_i, sharpness_i.dtype.type(1.0))
    sharpness_j = np.where(amplitude_j > 0.0, sharpness_j, sharpness_j.dtype.type(1.0))
    pairs = integral(
        axis_i[..., :, None, :], sharpness_i[..., :, None], axis_j[..., None, :, :], sharpness_j[..., None, :]
    )
    weights = amplitude_i[..., :, None] * amplitude_j[..., None, :]
    return np.asarray(np.sum(weights * pairs, axis=(-2, -1)))


def mixture_product_integral(mixture_i: SgMixture, mixture_j: SgMixture) -> Array:
    """Return the integral over the sphere of the product of two mixtures, shape (...). Exact.

    ``sum_ab A_a B_b <g_a, g_b>`` with `lobewise.lobes.sg.sg_product_integral`.
    """
    return _sum_products(mixture_i, mixture_j, sg_product_integral)


def mixture_approx_product_integral(mixture_i: SgMixture, mixture_j: SgMixture) -> Array:
    """Return the same with ``2 pi / (la + lb) exp(-la lb (1 - c) / (la + lb))`` for each pair. Approximate.

    Source: Iwasaki et al. 2012. Validity: see `lobewise.lobes.sg.sg_approx_product_integral`.
    """
    return _sum_products(mixture_i, mixture_j, sg_approx_product_integral)


def mixture_norm(mixture: SgMixture) -> Array:
    """Return the L2 norm of a mixture over the sphere, shape (...). Exact."""
    return np.asarray(np.sqrt(mixture_product_integral(mixture, mixture)))


def mixture_approx_norm(mixture: SgMixture) -> Array:
    """Return the L2 norm by `mixture_approx_product_integral`."""
    return np.asarray(np.sqrt(mixture_approx_product_integral(mixture, mixture)))


def mixture_similarity(mixture_i: SgMixture, mixture_j: SgMixture) -> Array:
    """Return the L2-normalised product integral of two mixtures, in [0, 1]. Exact; 0 where one has no lobe at all."""
    norms = mixture_norm(mixture_i) * mixture_norm(mixture_j)
    value = divide_or(mixture_product_integral(mixture_i, mixture_j), norms, 0.0)
    return np.asarray(np.clip(value, 0.0, 1.0))


def mixture_approx_similarity(mixture_i: SgMixture, mixture_j: SgMixture, beta: ArrayLike = 1.0) -> Array:
    """Return the similarity of sharp mixtures to the power ``beta``, in [0, 1]: what the image kernels compute.

    `mixture_approx_product_integral` over the norms by the same formula; one lobe each is
    `lobewise.lobes.sg.sg_slide_similarity`. 0 where one mixture has no lobe at all.
    """
    (beta,) = as_reals(beta)
    norms = mixture_approx_norm(mixture_i) * mixture_approx_norm(mixture_j)
    value = np.clip(divide_or(mixture_approx_product_integral(mixture_i, mixture_j), norms, 0.0), 0.0, 1.0)
    return np.asarray(value ** beta.astype(value.dtype))


def spread_ggx_mixture(
    area: ArrayLike, alpha_square: ArrayLike, albedo: ArrayLike, *, lobes: int, noise: float
) -> tuple[Array, Array]:
    """Return sharpness and amplitude (..., ``lobes``) of the mixture for GGX; see `make_ggx_mixture`.

    Parameters
    ----------
    area : array_like
        Variance of the reflected lobe, ``2 n.v alpha^2``, square radians; 0 for a mirror.
    alpha_square : array_like
        Product of the two alphas, in [0, 1].
    albedo : array_like
        Directional albedo.
    lobes : {1, 2, 3, 4}
        How many.
    noise : float
        Added to every ``1 / sharpness``, square radians, > 0.
    """
    area, square, albedo = as_reals(area, alpha_square, albedo)
    exponent, weight = (np.asarray(column, dtype=square.dtype) for column in GGX_MIXTURES[lobes])
    # 1 / sharpness = area / (b (1 - alpha^2)) + tau^2
    area = area[..., None]
    steepness = np.maximum(exponent * np.maximum(1.0 - square, 0.0)[..., None], MIN_SHARPNESS * area)
    sharpness = steepness / (area + np.asarray(noise, dtype=square.dtype) * steepness)
    # the integrals of the lobes before the band-limit, over the area, which is 0 for a mirror
    share = weight * -np.expm1(-2.0 * divide_or(steepness, area + 0.0 * steepness, np.inf)) / steepness
    share = share / np.sum(share, axis=-1, keepdims=True) * np.sum(weight / exponent)
    return np.asarray(sharpness), np.asarray(albedo[..., None] * share / sg_integral(sharpness))


def make_ggx_mixture(
    view: ArrayLike,
    normal: ArrayLike,
    alpha: ArrayLike,
    *,
    lobes: int = 3,
    albedo: ArrayLike = 1.0,
    dominant: bool = False,
    tau: float = 0.0,
) -> SgMixture:
    """Return the coaxial mixture for an isotropic GGX reflection.

    Parameters
    ----------
    view, normal : array_like, shape (..., 3)
        Unit vectors away from the surface.
    alpha : array_like
        Roughness in [0, 1].
    lobes : {1, 2, 3, 4}
        How many, see `GGX_MIXTURES`.
    albedo : array_like
        Directional albedo, the scale of the lobe: the integral over the sphere is ``albedo sum w / b``, which is all
        of GGX but what no number of lobes reaches, 0.760, 0.918, 0.967 or 0.985 of it.
    dominant : bool
        False: mirror about the normal (Wang et al. 2009). True: about the dominant visible normal m, with sharpnesses
        times ``m.n`` over ``v.m`` (see `lobewise.lobes.brdf.ggx_dominant_visible_normal`).
    tau : float
        Radians; ``tau^2`` is added to every ``1 / sharpness`` (band-limit), the integral of each lobe kept. At least
        1e-9 is added, so that a mirror is finite.

    Returns
    -------
    SgMixture
        ``axis`` (..., 1, 3), the others (..., ``lobes``).

    Raises
    ------
    InputError
        If ``lobes`` is none of the four.

    Notes
    -----
    Normals of sharpness ``2 b k``, ``k = 1 / alpha^2 - 1``, reflected by the warp of Wang et al. 2009 (n.v not taken
    below 0.1), are lobes of sharpness ``b k / (2 n.v)``, which is not taken below `MIN_SHARPNESS`. Their amplitudes
    are ``w`` times one peak. Written over common denominators nothing is divided by 0 from alpha 0 to 1.
    Validity: the similarity of lobes with the shape of GGX normals is right to 0.003 with three lobes; that of GGX
    reflections is limited by the shape and the axis of the lobe, see the theory page.
    """
    if lobes not in GGX_MIXTURES:
        problem = describe_problem("lobes", expected="1, 2, 3 or 4", got=repr(lobes), action="choose one of them")
        raise InputError(problem)
    view, normal, alpha, albedo = as_reals(view, normal, alpha, albedo)
    square = alpha * alpha
    cosine = dot(normal, view)
    m, slope = normal, np.ones_like(cosine)
    if dominant:
        # the corrected dominant visible normal lies in the plane of n and v: m = normalize(a v + b n)
        a = np.minimum(0.7 + 0.6 * alpha, 1.0) * square
        b = np.sqrt(a + (1.0 - a) * cosine * cosine) + (1.0 - a) * cosine
        inverse = 1.0 / np.sqrt(a * a + b * b + 2.0 * a * b * cosine)
        m = (a * inverse)[..., None] * view + (b * inverse)[..., None] * normal
        slope = (a * cosine + b) * inverse
        cosine = (a + b * cosine) * inverse
    warp = np.maximum(np.abs(cosine), MIN_WARP_COSINE) / slope
    area = 2.0 * warp * square
    sharpness, amplitude = spread_ggx_mixture(area, square, albedo, lobes=lobes, noise=max(tau * tau, MIN_VARIANCE))
    return SgMixture(reflect(view, m)[..., None, :], sharpness, amplitude)


def make_lambert_lobe(normal: ArrayLike, albedo: ArrayLike) -> SgMixture:
    """Return one lobe for a Lambert surface: the least-squares spherical Gaussian of ``albedo max(n.w, 0) / pi``."""
    normal, albedo = as_reals(normal, albedo)
    albedo = np.broadcast_to(albedo, normal.shape[:-1])[..., None]
    return SgMixture(
        normal[..., None, :], np.full_like(albedo, LAMBERT_SHARPNESS), albedo * (LAMBERT_AMPLITUDE / math.pi)
    )


def combine_mixtures(mixture_i: SgMixture, mixture_j: SgMixture) -> SgMixture:
    """Return the sum of two mixtures: all lobes of both, leading shapes broadcast."""
    values = as_reals(*mixture_i, *mixture_j)
    counts = [
        np.broadcast_shapes(axis.shape[:-1], sharpness.shape, amplitude.shape)
        for axis, sharpness, amplitude in (values[:3], values[3:])
    ]
    leading = np.broadcast_shapes(*(shape[:-1] for shape in counts))
    shapes = [(*leading, shape[-1]) for shape in counts]

    def join(k: int, tail: tuple[int, ...]) -> Array:
        halves = [np.broadcast_to(values[k + 3 * side], shapes[side] + tail) for side in (0, 1)]
        return np.concatenate(halves, axis=len(leading))

    return SgMixture(join(0, (3,)), join(1, ()), join(2, ()))
