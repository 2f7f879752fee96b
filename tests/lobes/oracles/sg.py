"""Spherical Gaussians ``G(w) = exp(sharpness (w.axis - 1))``.

Axes are unit vectors of shape (..., 3), sharpnesses (...) are >= 0 (0 is the constant 1); leading shapes broadcast.
Everything is written with ``1 - a.b = |a - b|^2 / 2`` and ``expm1`` so that neither sharp nor flat lobes lose digits.
The result has the dtype of the arrays that went in.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from .vectors import Array, as_reals, divide_or, dot, square_distance


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


def sg_evaluate(direction: ArrayLike, axis: ArrayLike, sharpness: ArrayLike) -> Array:
    """Return the value of a spherical Gaussian in ``direction`` (unit vectors, shape (..., 3)). Exact."""
    direction, axis, sharpness = as_reals(direction, axis, sharpness)
    return np.asarray(np.exp(-0.5 * sharpness * square_distance(direction, axis)))


def sg_integral(sharpness: ArrayLike) -> Array:
    """Return the integral over the sphere, ``2 pi (1 - exp(-2 l)) / l`` (4 pi at 0). Exact."""
    (sharpness,) = as_reals(sharpness)
    return 4.0 * math.pi * _average_decay(2.0 * sharpness)


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


def sg_slide_similarity(
    axis_i: ArrayLike,
    sharpness_i: ArrayLike,
    axis_j: ArrayLike,
    sharpness_j: ArrayLike,
    beta: ArrayLike = 1.0,
) -> Array:
    """Return ``(2 sqrt(li lj) / (li + lj))^beta exp(-beta li lj (1 - c) / (li + lj))``, in [0, 1].

    Source: Tokuyoshi 2015, the filter weight; it is the similarity of sharp lobes to the power ``beta``.
    Validity: at beta = 1 the error is between ``-0.184 / l`` (beside the axis) and ``+0.062 / l`` (at wide angles, and
    at most 0.020) for the smaller sharpness l; at a ratio of 2 it reaches -0.042 at 2, -0.0074 at 10, -0.0007 at 100.
    """
    axis_i, sharpness_i, axis_j, sharpness_j, beta = as_reals(axis_i, sharpness_i, axis_j, sharpness_j, beta)
    total = sharpness_i + sharpness_j
    separation = axis_j - axis_i
    exponent = 0.5 * _product_log_amplitude(dot(separation, separation), sharpness_i, sharpness_j, total)
    ratio = divide_or(2.0 * np.sqrt(sharpness_i) * np.sqrt(sharpness_j), total, 1.0)
    return np.asarray(np.minimum(ratio, 1.0) ** beta * np.exp(beta * exponent))


def sg_bandlimit(sharpness: ArrayLike, tau: ArrayLike) -> Array:
    """Return ``l / (1 + tau^2 l)``: the sharpness after smoothing with a lobe of variance ``tau^2`` (radians).

    ``1 / tau^2`` for a mirror of infinite sharpness; unchanged for ``tau`` 0.
    """
    sharpness, tau = as_reals(sharpness, tau)
    flat = np.minimum(sharpness, 1.0)
    inverse = 1.0 / np.maximum(sharpness, 1.0) + tau * tau
    sharp = divide_or(np.ones_like(inverse), inverse, np.inf)
    return np.asarray(np.where(sharpness > 1.0, sharp, flat / (1.0 + tau * tau * flat)))
