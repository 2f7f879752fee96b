"""Sums of spherical Gaussians: one to four lobes per pixel, each with an amplitude, 0 for a lobe that is absent.

Product integrals are bilinear, so a pair of pixels costs the product of their numbers of lobes (Iwasaki et al. 2012).
The similarity divides by the norms, which belong to one pixel each and are computed by the same formula as the product.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lobewise.lobes.gaussian import LAMBERT_AMPLITUDE, LAMBERT_SHARPNESS, MIN_WARP_COSINE
from lobewise.lobes.gaussian import spread_ggx_mixture as spread
from lobewise.lobes.numbers import NUMPY, NUMPY_SINGLE

from .sg import sg_approx_product_integral
from .vectors import Array, as_reals, divide_or, dot, reflect


class SgMixture(NamedTuple):
    """A sum of N spherical Gaussians ``amplitude exp(sharpness (w.axis - 1))``."""

    axis: Array
    """Unit vectors, shape (..., N, 3), or (..., 1, 3) where all lobes share one."""
    sharpness: Array
    """Shape (..., N), >= 0, inverse square radians."""
    amplitude: Array
    """Value at the axis, shape (..., N), >= 0, linear; 0 for a lobe that is absent."""


MIN_VARIANCE = 1e-9
"""Square radians; the least variance of a lobe made from a roughness, so that a mirror without band-limit is finite."""


def mixture_approx_product_integral(mixture_i: SgMixture, mixture_j: SgMixture) -> Array:
    """Return the sum of `sg.sg_approx_product_integral` over all pairs of lobes, 0 for a pair with an absent lobe.

    Source: Iwasaki et al. 2012.
    """
    axis_i, sharpness_i, amplitude_i, axis_j, sharpness_j, amplitude_j = as_reals(*mixture_i, *mixture_j)
    # an absent lobe may have any sharpness, also 0, for which the sharp form is infinite
    sharpness_i = np.where(amplitude_i > 0.0, sharpness_i, sharpness_i.dtype.type(1.0))
    sharpness_j = np.where(amplitude_j > 0.0, sharpness_j, sharpness_j.dtype.type(1.0))
    pairs = sg_approx_product_integral(
        axis_i[..., :, None, :], sharpness_i[..., :, None], axis_j[..., None, :, :], sharpness_j[..., None, :]
    )
    weights = amplitude_i[..., :, None] * amplitude_j[..., None, :]
    return np.asarray(np.sum(weights * pairs, axis=(-2, -1)))


def mixture_approx_norm(mixture: SgMixture) -> Array:
    """Return the L2 norm by `mixture_approx_product_integral`."""
    return np.asarray(np.sqrt(mixture_approx_product_integral(mixture, mixture)))


def mixture_approx_similarity(mixture_i: SgMixture, mixture_j: SgMixture, beta: ArrayLike = 1.0) -> Array:
    """Return the similarity of sharp mixtures to the power ``beta``, in [0, 1]: what the image kernels compute.

    `mixture_approx_product_integral` over the norms by the same formula; one lobe each is
    `sg.sg_slide_similarity`. 0 where one mixture has no lobe at all.
    """
    (beta,) = as_reals(beta)
    norms = mixture_approx_norm(mixture_i) * mixture_approx_norm(mixture_j)
    value = np.clip(divide_or(mixture_approx_product_integral(mixture_i, mixture_j), norms, 0.0), 0.0, 1.0)
    return np.asarray(value ** beta.astype(value.dtype))


def spread_ggx_mixture(
    area: ArrayLike, alpha_square: ArrayLike, albedo: ArrayLike, *, lobes: int, noise: float
) -> tuple[Array, Array]:
    """Return `lobewise.lobes.gaussian.spread_ggx_mixture` as two arrays (..., ``lobes``)."""
    area, square, albedo = as_reals(area, alpha_square, albedo)
    numbers = NUMPY_SINGLE if square.dtype == np.float32 else NUMPY
    found = spread(numbers, area, square, albedo, lobes=lobes, noise=noise)
    sharpness, amplitude = (np.stack(np.broadcast_arrays(*each), axis=-1) for each in found)
    return sharpness, amplitude


def make_ggx_mixture(
    view: ArrayLike, normal: ArrayLike, alpha: ArrayLike, *, lobes: int = 3, albedo: ArrayLike = 1.0, tau: float = 0.0
) -> SgMixture:
    """Return the coaxial mixture for an isotropic GGX reflection about the mirror direction (Wang et al. 2009).

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
        of GGX times 0.760, 0.918, 0.967 or 0.985 for 1 to 4 lobes.
    tau : float
        Radians; ``tau^2`` is added to every ``1 / sharpness`` (band-limit), the integral of each lobe kept. At least
        1e-9 is added, so that a mirror is finite.

    Returns
    -------
    SgMixture
        ``axis`` (..., 1, 3), the others (..., ``lobes``).
    """
    view, normal, alpha, albedo = as_reals(view, normal, alpha, albedo)
    square = alpha * alpha
    cosine = dot(normal, view)
    warp = np.maximum(np.abs(cosine), MIN_WARP_COSINE)
    area = 2.0 * warp * square
    sharpness, amplitude = spread_ggx_mixture(area, square, albedo, lobes=lobes, noise=max(tau * tau, MIN_VARIANCE))
    return SgMixture(reflect(view, normal)[..., None, :], sharpness, amplitude)


def make_lambert_lobe(normal: ArrayLike, albedo: ArrayLike) -> SgMixture:
    """Return one lobe for a Lambert surface: the least-squares spherical Gaussian of ``albedo max(n.w, 0) / pi``."""
    normal, albedo = as_reals(normal, albedo)
    albedo = np.broadcast_to(albedo, normal.shape[:-1])[..., None]
    return SgMixture(
        normal[..., None, :], np.full_like(albedo, LAMBERT_SHARPNESS), albedo * (LAMBERT_AMPLITUDE / math.pi)
    )
