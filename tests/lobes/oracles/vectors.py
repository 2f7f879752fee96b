"""Operations on arrays of vectors that the oracles share, beside `lobewise.fitting.arrays`."""

import numpy as np

from lobewise.fitting.arrays import Array, as_reals, dot, normalize

__all__ = ["Array", "as_reals", "contract", "divide_or", "dot", "normalize", "reflect", "square_distance"]

_SIX_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0, 2.0, 1.0], dtype=np.float32)
"""How often xx, xy, xz, yy, yz, zz stand in a symmetric matrix."""


def contract(m: Array, n: Array) -> Array:
    """Return ``M:N``, the sum of the products of all nine components, of symmetric matrices of shape (..., 6)."""
    return dot(m * _SIX_WEIGHTS.astype(m.dtype), n)


def square_distance(a: Array, b: Array) -> Array:
    """Return ``|a - b|^2``, which for unit vectors is ``2 (1 - a.b)`` without its cancellation."""
    difference = a - b
    return dot(difference, difference)


def reflect(view: Array, normal: Array) -> Array:
    """Return the mirror direction ``2 (n.v) n - v`` of a direction ``view`` that points away from the surface."""
    return np.asarray(2.0 * dot(normal, view)[..., None] * normal - view)


def divide_or(numerator: Array, denominator: Array, fallback: float | Array) -> Array:
    """Return ``numerator / denominator``, and ``fallback`` where the denominator is 0."""
    zero = denominator == 0.0
    return np.asarray(np.where(zero, fallback, numerator / np.where(zero, 1.0, denominator)), dtype=numerator.dtype)
