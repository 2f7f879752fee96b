"""Operations on vectors given as lists of components, which may be numbers of any kind."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.lobes.numbers import Namespace

Vector = Sequence[Any]
"""The components of a vector: three, or the six ``xx, xy, xz, yy, yz, zz`` of a symmetric matrix."""
LUMINANCE = (0.2126, 0.7152, 0.0722)
"""Weights of linear red, green and blue (ITU-R BT.709)."""


def dot(a: Vector, b: Vector) -> Any:
    """Return the scalar product of two vectors, added up from the first component on."""
    first, *others = (a[k] * b[k] for k in range(len(a)))
    return sum(others, first)


def subtract(a: Vector, b: Vector) -> list[Any]:
    """Return a - b, component by component."""
    return [p - q for p, q in zip(a, b, strict=True)]


def cross(a: Vector, b: Vector) -> list[Any]:
    """Return the cross product of two 3-vectors."""
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]


def scale(vector: Vector, factor: Any) -> list[Any]:
    """Return every component times ``factor``."""
    return [component * factor for component in vector]


def compute_luminance(xp: Namespace, colour: Vector) -> Any:
    """Return the luminance of linear red, green and blue."""
    return dot([xp.number(share) for share in LUMINANCE], colour)


def compute_image_luminance(image: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the luminance, shape (...), of an image in NumPy, linear, shape (..., 3)."""
    return np.asarray(image @ np.array(LUMINANCE, np.float32))


def combine(*terms: tuple[Any, Vector]) -> list[Any]:
    """Return the sum of vectors, each times its weight."""
    (first, vector), *others = terms
    return [sum((weight * more[k] for weight, more in others), first * vector[k]) for k in range(len(vector))]
