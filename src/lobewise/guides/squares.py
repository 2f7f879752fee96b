"""Sums, means and maxima over a square around each pixel, in NumPy. Of a pixel at a border, the square is cut off."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from lobewise.records.frame import FloatArray

Array = TypeVar("Array", bound=NDArray[Any])


def compute_square_maximum(image: Array, radius: int) -> Array:
    """Return the maximum over the square from ``radius`` pixels before each pixel to ``radius`` pixels after it."""
    largest: Array = _join(image, radius, np.maximum, "edge")
    return largest


def sum_square(image: Array, radius: int) -> Array:
    """Return the sum over the same square."""
    sums: Array = _join(image, radius, np.add, "constant")
    return sums


def count_neighbours(mask: NDArray[np.bool_], radius: int) -> NDArray[np.intp]:
    """Return how many other pixels of the same square lie in a mask."""
    return sum_square(mask.astype(np.intp), radius) - mask


def _join(image: Array, radius: int, join: Callable[[Any, Any], Any], border: Any) -> Any:
    around = np.pad(image, [(radius, radius)] * 2 + [(0, 0)] * (image.ndim - 2), mode=border)
    rows = _join_rows(around, 2 * radius + 1, join)
    return _join_rows(rows.swapaxes(0, 1), 2 * radius + 1, join).swapaxes(0, 1)


def _join_rows(image: Any, count: int, join: Callable[[Any, Any], Any]) -> Any:
    """Return each row joined with those after it, ``count`` rows in all; the last ``count - 1`` rows are left out.

    Pairs of rows are joined, then pairs of pairs, and so on. The binary digits of the count tell which of them to take.
    """
    length, joined, first, size = len(image) - count + 1, None, 0, 1
    while True:
        if count & size:
            some = image[first : first + length]
            joined = some if joined is None else join(joined, some)
            first += size
        size *= 2
        if size > count:
            return joined
        image = join(image[: -size // 2], image[size // 2 :])


def average_square(image: FloatArray, radius: int) -> FloatArray:
    """Return the mean over the same square. It takes no longer if the square is large."""
    result = image.astype(np.float64)
    for axis in (0, 1):
        length = result.shape[axis]
        sums = np.concatenate([np.zeros_like(np.take(result, [0], axis)), np.cumsum(result, axis=axis)], axis=axis)
        place = np.arange(length)
        low, high = np.maximum(place - radius, 0), np.minimum(place + radius + 1, length)
        count = (high - low).reshape((-1, 1) if axis == 0 else (1, -1))
        result = (np.take(sums, high, axis) - np.take(sums, low, axis)) / count
    return np.asarray(result, dtype=np.float32)
