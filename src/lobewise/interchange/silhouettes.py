"""Find the pixels that several surfaces share, from Cryptomatte or from alpha.

The ranks of Cryptomatte hold the shares of a pixel that objects cover. Source: Friedman and Jones 2015, "Fully
automatic ID mattes with support for motion blur and transparency". The id of an object is the bit pattern of a 32-bit
float. One RGBA image holds id and share of two ranks, the largest share first.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.interchange.imported import ImageReader
from lobewise.interchange.mapping import ChannelMap, Found
from lobewise.records.frame import FloatArray
from lobewise.records.images import crop_columns, wrap_columns
from lobewise.work.chunks import Chunk, run_chunks

MIN_EDGE_SHARE = 1e-4
"""Share of all pixels. Alpha shows silhouettes only if more pixels than this are partly covered."""
MIN_WHOLE_SHARE = 0.999
"""Share of a pixel's area. An object that covers at least this share covers the whole pixel."""
NEAREST_FIRST = ((-1, 0), (0, -1), (0, 1), (1, 0), (-1, -1), (-1, 1), (1, -1), (1, 1))
"""Steps in rows and columns to the eight neighbours; the four neighbours that share a side come first."""


class Silhouettes(NamedTuple):
    """Values of `lobewise.GBuffer.coverage` and `object_share`; None if the file does not show silhouettes.

    ``source`` is what shows them: the passes of a Cryptomatte, or alpha.
    """

    coverage: FloatArray | None = None
    object_share: FloatArray | None = None
    source: tuple[Found, ...] = ()


def take_silhouettes(channels: ChannelMap, read: ImageReader, *, wraps: bool = False) -> tuple[Silhouettes, list[str]]:
    """Return the silhouettes of a file, and notes that name their source.

    The first usable Cryptomatte counts; it is the finest. Without Cryptomatte, alpha serves. Alpha separates surfaces
    from the background, but not from each other. ``wraps`` is as of `lobewise.Frame`.
    """
    notes = []
    for passes in channels.cryptomatte:
        kinds = {
            channel.pixel_type for one in passes for channel in one.source.part.channels if channel.name in one.channels
        }
        if kinds != {"float"}:
            notes.append(f"{passes[0].label} does not store its ids as 32-bit floats, so it is not used.")
            continue
        if any(plane.any() for one in passes for plane in read.read_planes(one)[1::2]):
            notes.append(f"Silhouettes are told by Cryptomatte ({passes[0].label} and {len(passes) - 1} more).")
            return compute_silhouettes(passes, read, wraps=wraps), notes
    silhouettes, alpha_notes = _take_alpha_silhouettes(channels, read, wraps=wraps)
    return silhouettes, [*notes, *alpha_notes]


def _take_alpha_silhouettes(channels: ChannelMap, read: ImageReader, *, wraps: bool) -> tuple[Silhouettes, list[str]]:
    color = channels.roles["color"]
    chosen = color.source.pick(("a",))
    if chosen is None:
        return Silhouettes(), []
    alpha_pass = Found(color.source, chosen)
    (plane,) = read.read_planes(alpha_pass)
    alpha = plane.astype(np.float32)
    edges = (alpha > 0.01) & (alpha < 0.99)
    # If most alpha values are partial, alpha is not coverage: it shows glass, volumes or a fade.
    if not MIN_EDGE_SHARE < edges.mean() < 0.5 or not (alpha >= 0.99).any():
        return Silhouettes(), []
    note = f"Silhouettes against the background are told by {alpha_pass.label}; no Cryptomatte tells the others."
    return compute_silhouettes((alpha_pass,), read, wraps=wraps), [note]


def compute_silhouettes(source: tuple[Found, ...], read: ImageReader, *, wraps: bool = False) -> Silhouettes:
    """Return the silhouettes that the passes of a Cryptomatte show, or alpha, which is one channel.

    ``wraps`` is as of `lobewise.Frame`.
    """
    planes = tuple(plane for one in source for plane in read.read_planes(one))
    width = planes[0].shape[1]
    planes = wrap_columns(planes, 1 if wraps else 0)
    if len(planes) == 1:
        ids, shares = [np.ones(planes[0].shape, np.uint32)], [planes[0].astype(np.float32)]
    else:
        ids, shares = [plane.view(np.uint32) for plane in planes[0::2]], planes[1::2]
    coverage, object_share = crop_columns((compute_coverage(ids, shares), compute_object_share(shares)), width)
    return Silhouettes(coverage, object_share, source)


def compute_coverage(ids: Sequence[NDArray[np.uint32]], shares: Sequence[FloatArray]) -> FloatArray:
    """Return the shares of every pixel's area that belong to the surfaces of its 3x3 neighbours.

    A pixel is owned by the object with the largest share of it. The share of any other object goes, in equal parts, to
    the neighbours that this object owns: to those that share a side with the pixel, else to those at its corners, else
    to the pixel itself. Area that no rank covers belongs to the background, which counts as an object.

    Parameters
    ----------
    ids : sequence of array of uint32, shape (height, width)
        Ids of objects, 0 for none; one plane for every rank.
    shares : sequence of array, shape (height, width)
        Shares of the pixel's area, in [0, 1]; one plane for every rank.

    Returns
    -------
    array, shape (height, width, 9)
        As `lobewise.GBuffer.coverage`.

    Raises
    ------
    InputError
        If the arrays do not have these shapes.
    """
    planes = [*ids, *shares]
    if not planes or len(ids) != len(shares) or any(each.shape != planes[0].shape[:2] for each in planes):
        raise InputError(
            "Cryptomatte",
            expected="ids and shares in planes of one shape (height, width), as many of each",
            got=f"{len(ids)} ids and {len(shares)} shares of the shapes {sorted({each.shape for each in planes})}",
            action="read id and share of every rank",
        )
    owner, edges = _choose_owners(ids, shares)
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


def compute_object_share(shares: Sequence[FloatArray]) -> FloatArray:
    """Return the largest share of every pixel's area that belongs to one object or to the background.

    Parameters
    ----------
    shares : sequence of array, shape (height, width)
        Shares of the pixel's area, in [0, 1]; one plane for every rank. The rest of the area is background.

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
    """Return the objects of some pixels, the background as the last one, and their shares, whose sum is 1."""
    shares = np.clip(np.nan_to_num(shares), 0.0, 1.0)
    total = shares.sum(axis=-1, keepdims=True)
    rest = np.maximum(1.0 - total, 0.0)
    parts = np.concatenate([shares, rest], axis=-1)
    return np.concatenate([ids, np.zeros_like(ids[:, :1])], axis=-1), parts / np.maximum(total + rest, np.float32(1e-6))


def _choose_owners(
    ids: Sequence[NDArray[np.uint32]], shares: Sequence[FloatArray]
) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
    """Return the object, or background, with the largest share of every pixel, and which pixels show several."""
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
        edges[chunk] = largest < MIN_WHOLE_SHARE

    run_chunks(find, height, width)
    return owner, edges


def _spread(
    filled: FloatArray,
    objects: NDArray[np.uint32],
    parts: FloatArray,
    neighbours: NDArray[np.int64],
    own: NDArray[np.uint32],
) -> None:
    """Add the shares of one rank to the coverage of some pixels, (count, 9)."""
    shows = (neighbours == objects[:, None].astype(np.int64)) & (objects != own)[:, None]
    sides = shows[:, :4].any(axis=1)
    shows[sides, 4:] = False
    count = shows.sum(axis=1)
    filled[:, 4] += np.where(count == 0, parts, 0.0)
    mean = np.where(count > 0, parts / np.maximum(count, 1), 0.0)
    for number, (dy, dx) in enumerate(NEAREST_FIRST):
        filled[:, 3 * (dy + 1) + dx + 1] += np.where(shows[:, number], mean, 0.0)
