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
from lobewise.interchange.values import clip_share
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
    """Values of `lobewise.GBuffer.coverage`; None if the file does not show silhouettes.

    ``source`` is what shows them: the passes of a Cryptomatte, or alpha.
    """

    coverage: FloatArray | None = None
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
    (coverage,) = crop_columns((compute_coverage(ids, shares),), width)
    return Silhouettes(coverage, source)


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
    around = np.full((owner.shape[0] + 2, owner.shape[1] + 2), -1, np.int64)
    around[1:-1, 1:-1] = owner

    def fill(chunk: Chunk) -> None:
        here = rows[chunk[1]], columns[chunk[1]]
        objects, parts = _list_objects(_gather(ids, *here), _gather(shares, *here))
        neighbours = np.stack([around[here[0] + 1 + dy, here[1] + 1 + dx] for dy, dx in NEAREST_FIRST])
        coverage[here] = _spread(objects, parts, neighbours, owner[here])

    run_chunks(fill, 1, len(rows))
    return coverage


def _gather(planes: Sequence[NDArray[Any]], rows: NDArray[np.intp], columns: NDArray[np.intp]) -> NDArray[Any]:
    return np.stack([plane[rows, columns] for plane in planes], axis=-1)


def _list_objects(ids: NDArray[np.uint32], shares: FloatArray) -> tuple[NDArray[np.uint32], FloatArray]:
    """Return the objects of some pixels, the background as the last one, and their shares, whose sum is 1."""
    shares = clip_share(shares)
    total = shares.sum(axis=-1, keepdims=True)
    rest = np.maximum(1.0 - total, 0.0)
    parts = np.concatenate([shares, rest], axis=-1)
    return np.concatenate([ids, np.zeros_like(ids[:, :1])], axis=-1), parts / np.maximum(total + rest, np.float32(1e-6))


def _choose_owners(
    ids: Sequence[NDArray[np.uint32]], shares: Sequence[FloatArray]
) -> tuple[NDArray[np.uint32], NDArray[np.bool_]]:
    """Return the object with the largest share of every pixel, or background; and whether the pixel shows several."""
    size = ids[0].shape
    owner, edges = np.empty(size, np.uint32), np.empty(size, np.bool_)

    def find(chunk: Chunk) -> None:
        largest = total = np.zeros(owner[chunk].shape, np.float32)
        own = np.zeros(owner[chunk].shape, np.uint32)
        for objects, plane in zip(ids, shares, strict=True):
            share = clip_share(plane[chunk])
            own = np.where(share > largest, objects[chunk], own)
            largest, total = np.maximum(largest, share), total + share
        owner[chunk] = np.where(1.0 - total > largest, np.uint32(0), own)
        edges[chunk] = largest < MIN_WHOLE_SHARE

    run_chunks(find, *size)
    return owner, edges


def _spread(
    objects: NDArray[np.uint32], parts: FloatArray, neighbours: NDArray[np.int64], own: NDArray[np.uint32]
) -> FloatArray:
    """Return the coverage of some pixels, (count, 9), by their ranks, (count, ranks), and neighbours, (8, count)."""
    filled = np.zeros((len(own), 9), np.float32)
    for rank in range(objects.shape[1]):
        # Few pixels show more than two objects.
        (there,) = np.nonzero(parts[:, rank])
        one, part = objects[there, rank], parts[there, rank]
        shows = (neighbours[:, there] == one) & (one != own[there])
        shows[4:] &= ~shows[:4].any(axis=0)
        count = shows.sum(axis=0)
        filled[there, 4] += np.where(count == 0, part, 0.0)
        mean = part / np.maximum(count, 1)
        for shown, (dy, dx) in zip(shows, NEAREST_FIRST, strict=True):
            filled[there, 3 * (dy + 1) + dx + 1] += np.where(shown, mean, 0.0)
    return filled
