"""Operations on arrays of vectors that the code of measured materials shares."""

from __future__ import annotations

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
