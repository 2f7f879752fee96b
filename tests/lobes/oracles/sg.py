"""Spherical Gaussians ``G(w) = exp(log_amplitude + sharpness (w.axis - 1))``: the whole algebra, in float32 or float64.

Axes are unit vectors of shape (..., 3), sharpnesses (...) are >= 0 (0 is the constant 1); leading shapes broadcast.
Everything is written with ``1 - a.b = |a - b|^2 / 2`` and ``expm1`` so that neither sharp nor flat lobes lose digits.
The result has the dtype of the arrays that went in.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from .vectors import Array, as_reals, divide_or, dot, square_distance


class SphericalGaussian(NamedTuple):
    """A spherical Gaussian ``exp(log_amplitude + sharpness (w.axis - 1))``."""

    axis: Array
    """Unit vector, shape (..., 3)."""
    sharpness: Array
    """Shape (...), >= 0, inverse square radians."""
    log_amplitude: Array
    """Natural logarithm of the value at the axis, shape (...)."""


def _average_decay(x: Array) -> Array:
    """Return ``(1 - exp(-x)) / x``, the mean of exp(-t) over [0, x]; 1 at x = 0."""
    return divide_or(-np.expm1(-x), x, 1.0)


def _product_sharpness(axis_i: Array, sharpness_i: Array, axis_j: Array, sharpness_j: Array) -> Array:
    """Return ``|li xi + lj xj|`` as a sum of squares: exact also where nearly opposite axes cancel."""
    difference = sharpness_i - sharpness_j
    total = axis_i + axis_j
    return np.asarray(np.sqrt(difference * difference + sharpness_i * sharpness_j * dot(total, total)))


def _product_log_amplitude(square: Array, sharpness_i: Array, sharpness_j: Array, total: Array) -> Array:
    """Return ``-li lj |xi - xj|^2 / total``; with ``total = lm + li + lj`` this is ``lm - li - lj`` exactly."""
    return -square * sharpness_j * divide_or(sharpness_i, total, 0.0)


def sg_evaluate(direction: ArrayLike, axis: ArrayLike, sharpness: ArrayLike, log_amplitude: ArrayLike = 0.0) -> Array:
    """Return the value of a spherical Gaussian in ``direction`` (unit vectors, shape (..., 3)). Exact."""
    direction, axis, sharpness, log_amplitude = as_reals(direction, axis, sharpness, log_amplitude)
    return np.asarray(np.exp(log_amplitude - 0.5 * sharpness * square_distance(direction, axis)))


def sg_integral(sharpness: ArrayLike) -> Array:
    """Return the integral over the sphere, ``2 pi (1 - exp(-2 l)) / l`` (4 pi at 0). Exact."""
    (sharpness,) = as_reals(sharpness)
    return 4.0 * math.pi * _average_decay(2.0 * sharpness)


def sg_square_integral(sharpness: ArrayLike) -> Array:
    """Return the integral of the square, ``pi (1 - exp(-4 l)) / l`` (4 pi at 0). Exact."""
    (sharpness,) = as_reals(sharpness)
    return 4.0 * math.pi * _average_decay(4.0 * sharpness)


def sg_product(
    axis_i: ArrayLike, sharpness_i: ArrayLike, axis_j: ArrayLike, sharpness_j: ArrayLike
) -> SphericalGaussian:
    """Return the product of two spherical Gaussians, itself one. Exact.

    Source: Wang et al. 2009, section 3; the log amplitude in the form without cancellation that
    Tokuyoshi's public shaders use: ``lm - li - lj = -li lj |xi - xj|^2 / (lm + li + lj)``.
    Where the sum of the two vectors vanishes (equal and opposite lobes) the product is constant and the axis is
    ``axis_i``.
    """
    axis_i, sharpness_i, axis_j, sharpness_j = as_reals(axis_i, sharpness_i, axis_j, sharpness_j)
    sharpness = _product_sharpness(axis_i, sharpness_i, axis_j, sharpness_j)
    vector = sharpness_i[..., None] * axis_i + sharpness_j[..., None] * axis_j
    length = np.sqrt(dot(vector, vector))[..., None]
    axis = divide_or(vector, np.broadcast_to(length, vector.shape), np.broadcast_to(axis_i, vector.shape))
    log_amplitude = _product_log_amplitude(
        square_distance(axis_i, axis_j), sharpness_i, sharpness_j, sharpness + sharpness_i + sharpness_j
    )
    return SphericalGaussian(axis, sharpness, log_amplitude)


def sg_product_integral(axis_i: ArrayLike, sharpness_i: ArrayLike, axis_j: ArrayLike, sharpness_j: ArrayLike) -> Array:
    """Return the integral over the sphere of the product of two spherical Gaussians. Exact."""
    product = sg_product(axis_i, sharpness_i, axis_j, sharpness_j)
    return np.asarray(sg_integral(product.sharpness) * np.exp(product.log_amplitude))


def sg_approx_product_integral(
    axis_i: ArrayLike, sharpness_i: ArrayLike, axis_j: ArrayLike, sharpness_j: ArrayLike
) -> Array:
    """Return ``2 pi / (li + lj) exp(-li lj (1 - c) / (li + lj))``, the product integral of two sharp lobes.

    Source: Iwasaki et al. 2012. Validity: relative error of the order of ``l theta^4`` plus
    ``exp(-2 l)``, an under-estimate while the lobes overlap. Infinite where both lobes are constant.
    """
    axis_i, sharpness_i, axis_j, sharpness_j = as_reals(axis_i, sharpness_i, axis_j, sharpness_j)
    total = sharpness_i + sharpness_j
    exponent = 0.5 * _product_log_amplitude(square_distance(axis_i, axis_j), sharpness_i, sharpness_j, total)
    return np.asarray(divide_or(2.0 * math.pi * np.exp(exponent), total + 0.0 * exponent, np.inf))


def sg_similarity(axis_i: ArrayLike, sharpness_i: ArrayLike, axis_j: ArrayLike, sharpness_j: ArrayLike) -> Array:
    """Return the L2-normalised product integral of two spherical Gaussians, in [0, 1]. Exact.

    ``<Gi, Gj> / (|Gi| |Gj|)``; 1 for equal lobes of any sharpness, 0 included.
    """
    axis_i, sharpness_i, axis_j, sharpness_j = as_reals(axis_i, sharpness_i, axis_j, sharpness_j)
    sharpness = _product_sharpness(axis_i, sharpness_i, axis_j, sharpness_j)
    exponent = _product_log_amplitude(
        square_distance(axis_i, axis_j), sharpness_i, sharpness_j, sharpness + sharpness_i + sharpness_j
    )
    norm = np.sqrt(_average_decay(4.0 * sharpness_i)) * np.sqrt(_average_decay(4.0 * sharpness_j))
    return np.asarray(np.minimum(_average_decay(2.0 * sharpness) / norm * np.exp(exponent), 1.0))


def sg_middle_similarity(axis_i: ArrayLike, sharpness_i: ArrayLike, axis_j: ArrayLike, sharpness_j: ArrayLike) -> Array:
    """Return the similarity with the true product sharpness, but without the self terms ``1 - exp(-4 l)``.

    ``2 sqrt(li lj) (1 - exp(-2 lm)) / lm * exp(lm - li - lj)``. Validity: the absolute error is at most
    ``S exp(-4 l)`` for the smaller sharpness l, below 3.4e-4 from sharpness 2 and 2.1e-9 from 5, at every angle.
    """
    axis_i, sharpness_i, axis_j, sharpness_j = as_reals(axis_i, sharpness_i, axis_j, sharpness_j)
    sharpness = _product_sharpness(axis_i, sharpness_i, axis_j, sharpness_j)
    exponent = _product_log_amplitude(
        square_distance(axis_i, axis_j), sharpness_i, sharpness_j, sharpness + sharpness_i + sharpness_j
    )
    scale = 4.0 * np.sqrt(sharpness_i) * np.sqrt(sharpness_j) * _average_decay(2.0 * sharpness)
    return np.asarray(scale * np.exp(exponent))


def sg_slide_similarity(
    axis_i: ArrayLike,
    sharpness_i: ArrayLike,
    axis_j: ArrayLike,
    sharpness_j: ArrayLike,
    beta: ArrayLike = 1.0,
    *,
    shift: ArrayLike | None = None,
) -> Array:
    """Return ``(2 sqrt(li lj) / (li + lj))^beta exp(-beta li lj (1 - c) / (li + lj))``, in [0, 1].

    Source: Tokuyoshi 2015, the filter weight; it is the similarity of sharp lobes to the power ``beta``.
    ``shift``, shape (..., 3), is added to the difference of the axes (`compute_hit_shift`).
    Validity: at beta = 1 the error is between ``-0.184 / l`` (beside the axis) and ``+0.062 / l`` (at wide angles, and
    at most 0.020) for the smaller sharpness l; at a ratio of 2 it reaches -0.042 at 2, -0.0074 at 10, -0.0007 at 100.
    """
    axis_i, sharpness_i, axis_j, sharpness_j, beta = as_reals(axis_i, sharpness_i, axis_j, sharpness_j, beta)
    total = sharpness_i + sharpness_j
    separation = axis_j - axis_i if shift is None else axis_j - axis_i + as_reals(shift)[0].astype(axis_i.dtype)
    exponent = 0.5 * _product_log_amplitude(dot(separation, separation), sharpness_i, sharpness_j, total)
    ratio = divide_or(2.0 * np.sqrt(sharpness_i) * np.sqrt(sharpness_j), total, 1.0)
    return np.asarray(np.minimum(ratio, 1.0) ** beta * np.exp(beta * exponent))


def sg_convolve(sharpness_i: ArrayLike, sharpness_j: ArrayLike) -> Array:
    """Return the sharpness ``li lj / (li + lj)`` of the convolution of two coaxial lobes. Approximate.

    Validity: against the exact rule of von Mises-Fisher lobes (mean resultant lengths multiply):
    9.5 % too high at (2, 2), 8 % too low at (5, 5), 0.9 % too low at (10, 100), 1 % too low at (50, 50).
    An infinite sharpness is a delta and leaves the other lobe as it is.
    """
    sharpness_i, sharpness_j = as_reals(sharpness_i, sharpness_j)
    small, large = np.minimum(sharpness_i, sharpness_j), np.maximum(sharpness_i, sharpness_j)
    return small / (1.0 + np.minimum(divide_or(small, large, 1.0), 1.0))


def sg_bandlimit(sharpness: ArrayLike, tau: ArrayLike) -> Array:
    """Return ``l / (1 + tau^2 l)``: the sharpness after smoothing with a lobe of variance ``tau^2`` (radians).

    ``1 / tau^2`` for a mirror of infinite sharpness; unchanged for ``tau`` 0. Approximate in the sense of
    `sg_convolve`.
    """
    sharpness, tau = as_reals(sharpness, tau)
    flat = np.minimum(sharpness, 1.0)
    inverse = 1.0 / np.maximum(sharpness, 1.0) + tau * tau
    sharp = divide_or(np.ones_like(inverse), inverse, np.inf)
    return np.asarray(np.where(sharpness > 1.0, sharp, flat / (1.0 + tau * tau * flat)))


def _erf(x: Array) -> Array:
    return np.asarray(np.vectorize(math.erf, otypes=[np.float64])(x), dtype=x.dtype)


def sg_hemisphere_integral(cos_elevation: ArrayLike, sharpness: ArrayLike) -> Array:
    """Return the integral over the hemisphere around n, with ``cos_elevation = axis.n``. Approximate.

    Source: Tokuyoshi 2022, "Accurate diffuse lighting from spherical Gaussian lights" (the fitted error function).
    Validity: within 0.5 % of the integral over the sphere; exact for ``cos_elevation`` -1 and 1 and for sharpness 0.
    """
    cosine, sharpness = as_reals(cos_elevation, sharpness)
    steepness = sharpness * np.sqrt(
        (0.5 * sharpness + 0.65173288) / ((sharpness + 1.34182800) * sharpness + 7.22166878)
    )
    upper = 0.5 + 0.5 * divide_or(_erf(steepness * cosine), _erf(steepness) + 0.0 * cosine, cosine)
    share = (1.0 - upper) * np.exp(-sharpness) + upper
    return np.asarray(2.0 * math.pi * share * _average_decay(sharpness))


def sg_cone_energy(sharpness: ArrayLike, angle: ArrayLike) -> Array:
    """Return the fraction of the integral inside a cone of half-angle ``angle`` (radians) around the axis. Exact."""
    sharpness, angle = as_reals(sharpness, angle)
    height = 2.0 * np.sin(0.5 * angle) ** 2
    return np.asarray(0.5 * height * _average_decay(sharpness * height) / _average_decay(2.0 * sharpness))


def sg_cone_angle(sharpness: ArrayLike, fraction: ArrayLike) -> Array:
    """Return the half-angle (radians) of the cone that holds ``fraction`` (0 to 1) of the integral. Exact inverse."""
    sharpness, fraction = as_reals(sharpness, fraction)
    # Below 1e-6 the quotient is its limit 2 p to float64's last digits but one, and safe from 0 / 0.
    curved = np.maximum(sharpness, 1e-6)
    with np.errstate(divide="ignore"):  # the whole of a lobe so sharp that exp(-2 l) is 0 has no finite height
        height = np.minimum(-np.log1p(fraction * np.expm1(-2.0 * curved)) / curved, 2.0)
    return np.asarray(2.0 * np.arcsin(np.sqrt(0.5 * height)))


def sg_sharpness_from_angle(angle: ArrayLike, value: ArrayLike = 0.5) -> Array:
    """Return the sharpness at which the lobe has fallen to ``value`` (in (0, 1)) at ``angle`` (radians). Exact."""
    angle, value = as_reals(angle, value)
    return np.asarray(-np.log(value) / (2.0 * np.sin(0.5 * angle) ** 2))
