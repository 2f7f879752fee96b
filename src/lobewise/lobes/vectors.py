"""Directions and dtypes: the few vector operations that the lobes share."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating[Any]]

LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue (ITU-R BT.709)."""

_SIX_WEIGHTS = np.array([1.0, 2.0, 2.0, 1.0, 2.0, 1.0], dtype=np.float32)
"""How often xx, xy, xz, yy, yz, zz stand in a symmetric matrix."""


def as_reals(*values: ArrayLike) -> tuple[Array, ...]:
    """Return ``values`` as arrays of one real dtype: float32 where every given array is float32, else float64.

    Python numbers do not count, so that ``float32 array, 2.0`` stays float32.
    """
    given = [value.dtype for value in values if isinstance(value, np.ndarray | np.generic) and value.dtype.kind == "f"]
    mixed = any(isinstance(value, np.ndarray | np.generic) and value.dtype.kind != "f" for value in values)
    dtype = np.dtype(np.float64) if mixed or not given else np.result_type(np.float32, *given)
    return tuple(np.asarray(value, dtype=dtype) for value in values)


def dot(a: Array, b: Array) -> Array:
    """Return the dot product over the last axis."""
    return np.asarray(np.einsum("...k,...k->...", a, b))


def contract(m: Array, n: Array) -> Array:
    """Return ``M:N``, the sum of the products of all nine components, of symmetric matrices of shape (..., 6)."""
    return dot(m * _SIX_WEIGHTS.astype(m.dtype), n)


def square_distance(a: Array, b: Array) -> Array:
    """Return ``|a - b|^2``, which for unit vectors is ``2 (1 - a.b)`` without its cancellation."""
    difference = a - b
    return dot(difference, difference)


def normalize(a: Array) -> Array:
    """Return ``a`` scaled to unit length; a zero vector stays zero."""
    length = np.sqrt(dot(a, a))
    return np.asarray(a / np.where(length > 0.0, length, 1.0)[..., None])


def reflect(view: Array, normal: Array) -> Array:
    """Return the mirror direction ``2 (n.v) n - v`` of a direction ``view`` that points away from the surface."""
    return np.asarray(2.0 * dot(normal, view)[..., None] * normal - view)


def divide_or(numerator: Array, denominator: Array, fallback: float | Array) -> Array:
    """Return ``numerator / denominator``, and ``fallback`` where the denominator is 0."""
    zero = denominator == 0.0
    return np.asarray(np.where(zero, fallback, numerator / np.where(zero, 1.0, denominator)), dtype=numerator.dtype)
