"""Silhouettes from Cryptomatte: its ranks are the shares of a pixel that objects cover.

Source: Friedman and Jones 2015, "Fully automatic ID mattes with support for motion blur and transparency" (an object's
id is the bit pattern of a 32-bit float; every two ranks, id and share, fill one RGBA image, the largest share first).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.chunks import Chunk, run_chunks
from lobewise.errors import InputError
from lobewise.frame import FloatArray

WHOLE = 0.999
"""Share from which on a pixel shows one object alone."""
NEAREST_FIRST = ((-1, 0), (0, -1), (0, 1), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1))
"""Rows and columns to the neighbours, those that share a side first."""


def find_coverage(ids: Sequence[NDArray[np.uint32]], shares: Sequence[FloatArray]) -> FloatArray:
    """Return which shares of every pixel's area the surfaces at the centres around it stand for.

    A neighbour stands for the object that has the largest share of it. What other objects cover of a pixel goes to the
    neighbours that stand for them, in equal parts: those that share a side with the pixel, else those at its corners,
    else the pixel itself. What no rank tells of is background, an object as well.

    Parameters
    ----------
    ids : sequence of array of uint32, shape (height, width)
        Objects, 0 for none, a plane for every rank.
    shares : sequence of array, shape (height, width)
        Of the pixel's area, in [0, 1].

    Returns
    -------
    array, shape (height, width, 9)
        As `lobewise.GBuffer.coverage`.

    Raises
    ------
    InputError
        If the arrays do not have that shape.
    """
    planes = [*ids, *shares]
    if not planes or len(ids) != len(shares) or any(each.shape != planes[0].shape[:2] for each in planes):
        raise InputError(
            "Cryptomatte",
            expected="ids and shares in planes of one shape (height, width), as many of each",
            got=f"{len(ids)} ids and {len(shares)} shares of the shapes {sorted({each.shape for each in planes})}",
            action="read id and share of every rank",
        )
    owner, edges = _find_owners(ids, shares)
    coverage = np.zeros((*owner.shape, 9), np.float32)
    coverage[..., 4] = 1.0
    rows, columns = np.nonzero(edges)
    if not len(rows):
        return coverage
    here, parts = _list_objects(_gather(ids, rows, columns), _gather(shares, rows, columns))
    around = np.pad(owner.astype(np.int64), 1, constant_values=-1)
    neighbours = np.stack([around[rows + 1 + dy, columns + 1 + dx] for dy, dx in NEAREST_FIRST], axis=-1)
    found = np.zeros((len(rows), 9), np.float32)
    for rank in range(here.shape[1]):
        _spread(found, here[:, rank], parts[:, rank], neighbours, owner[rows, columns])
    coverage[rows, columns] = found
    return coverage


def find_object_share(shares: Sequence[FloatArray]) -> FloatArray:
    """Return the largest share of every pixel's area that one object, or the background, has; see `find_coverage`.

    Parameters
    ----------
    shares : sequence of array, shape (height, width)
        Of the pixel's area, in [0, 1], a plane for every rank; what they leave is background.

    Returns
    -------
    array, shape (height, width)
        As `lobewise.GBuffer.object_share`.
    """
    largest = np.empty(shares[0].shape, np.float32)

    def find(chunk: Chunk) -> None:
        ranks = np.clip(np.nan_to_num(np.stack([plane[chunk] for plane in shares])), 0.0, 1.0)
        total = ranks.sum(axis=0)
        rest = np.maximum(1.0 - total, 0.0)
        largest[chunk] = np.maximum(ranks.max(axis=0), rest) / np.maximum(total + rest, np.float32(1e-6))

    run_chunks(find, *shares[0].shape[:2])
    return largest


def _gather(planes: Sequence[NDArray[Any]], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[Any]:
    return np.stack([plane[rows, columns] for plane in planes], axis=-1)


def _list_objects(ids: NDArray[np.uint32], shares: FloatArray) -> tuple[NDArray[np.uint32], FloatArray]:
    """Return the objects of some pixels with the background as the last, and their shares, sum 1."""
    shares = np.clip(np.nan_to_num(shares), 0.0, 1.0)
    total = shares.sum(axis=-1, keepdims=True)
    rest = np.maximum(1.0 - total, 0.0)
    parts = np.concatenate([shares, rest], axis=-1)
    return np.concatenate([ids, np.zeros_like(ids[:, :1])], axis=-1), parts / np.maximum(total + rest, np.float32(1e-6))


def _find_owners(
    ids: Sequence[NDArray[np.uint32]], shares: Sequence[FloatArray]
) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
    """Return the object with the largest share of every pixel, the background among them, and where it shows others."""
    height, width = ids[0].shape
    owner, edges = np.empty((height, width), np.uint32), np.empty((height, width), np.bool_)

    def find(chunk: Chunk) -> None:
        largest = total = np.zeros(owner[chunk].shape, np.float32)
        own = np.zeros(owner[chunk].shape, np.uint32)
        for objects, plane in zip(ids, shares, strict=True):
            share = np.clip(np.nan_to_num(plane[chunk]), 0.0, 1.0)
            own = np.where(share > largest, objects[chunk], own)
            largest, total = np.maximum(largest, share), total + share
        owner[chunk] = np.where(1.0 - total > largest, np.uint32(0), own)
        edges[chunk] = largest < WHOLE

    run_chunks(find, height, width)
    return owner, edges


def _spread(
    found: FloatArray,
    objects: NDArray[np.uint32],
    parts: FloatArray,
    neighbours: NDArray[np.int64],
    own: NDArray[np.uint32],
) -> None:
    """Add one rank of some pixels to their coverage, (count, 9)."""
    shows = (neighbours == objects[:, None].astype(np.int64)) & (objects != own)[:, None]
    sides = shows[:, :4].any(axis=1)
    shows[sides, 4:] = False
    count = shows.sum(axis=1)
    found[:, 4] += np.where(count == 0, parts, 0.0)
    each = np.where(count > 0, parts / np.maximum(count, 1), 0.0)
    for number, (dy, dx) in enumerate(NEAREST_FIRST):
        found[:, 3 * (dy + 1) + dx + 1] += np.where(shows[:, number], each, 0.0)
