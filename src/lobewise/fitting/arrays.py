"""Operations on arrays of vectors that the code of measured materials shares."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.floating[Any]]


def as_reals(*values: ArrayLike) -> tuple[Array, ...]:
    """Return ``values`` as arrays of one dtype: float32 if every given array is float32, otherwise float64.

    Python numbers do not count: ``float32 array, 2.0`` gives float32.
    """
    dtypes = [value.dtype for value in values if isinstance(value, np.ndarray | np.generic) and value.dtype.kind == "f"]
    mixed = any(isinstance(value, np.ndarray | np.generic) and value.dtype.kind != "f" for value in values)
    dtype = np.dtype(np.float64) if mixed or not dtypes else np.result_type(np.float32, *dtypes)
    return tuple(np.asarray(value, dtype=dtype) for value in values)


def dot(a: Array, b: Array) -> Array:
    """Return the dot product over the last axis."""
    return np.asarray(np.einsum("...k,...k->...", a, b))


def normalize(a: Array) -> Array:
    """Return ``a`` scaled to unit length; a zero vector stays zero."""
    length = np.sqrt(dot(a, a))
    return np.asarray(a / np.where(length > 0.0, length, 1.0)[..., None])


def make_view(cosine: ArrayLike, azimuth: ArrayLike = 0.0) -> Array:
    """Return unit vectors (..., 3) of which ``cosine`` is z, at an azimuth about z, radians."""
    cosine, azimuth = np.asarray(cosine, np.float64), np.asarray(azimuth, np.float64)
    sine = np.sqrt(np.maximum(0.0, 1.0 - cosine * cosine))
    return np.stack(np.broadcast_arrays(sine * np.cos(azimuth), sine * np.sin(azimuth), cosine), axis=-1)


def make_turn(angle: float) -> Array:
    """Return the matrix (3, 3) that turns vectors about z, counter-clockwise: ``vectors @ matrix``."""
    cosine, sine = math.cos(angle), math.sin(angle)
    return np.asarray([[cosine, sine, 0.0], [-sine, cosine, 0.0], [0.0, 0.0, 1.0]])
