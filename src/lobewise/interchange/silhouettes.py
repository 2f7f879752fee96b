"""Find the pixels that several surfaces share, from Cryptomatte or from alpha."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lobewise.frame import FloatArray
from lobewise.guides.cryptomatte import find_coverage, find_object_share
from lobewise.interchange.imported import ImageReader
from lobewise.interchange.mapping import ChannelMap, Found

MIN_EDGE_SHARE = 1e-4
"""Share of all pixels. Alpha shows silhouettes only if more pixels than this are partly covered."""


class Silhouettes(NamedTuple):
    """Values of `lobewise.GBuffer.coverage` and `object_share`; None if the file does not show silhouettes."""

    coverage: FloatArray | None = None
    object_share: FloatArray | None = None


def take_silhouettes(channels: ChannelMap, read: ImageReader) -> tuple[Silhouettes, list[str]]:
    """Return the silhouettes of a file, and notes that name their source.

    The first usable Cryptomatte counts; it is the finest. Without Cryptomatte, alpha serves. Alpha separates surfaces
    from the background, but not from each other.
    """
    notes = []
    for passes in channels.cryptomatte:
        kinds = {
            channel.pixel_type for one in passes for channel in one.source.part.channels if channel.name in one.channels
        }
        if kinds != {"float"}:
            notes.append(f"{passes[0].label} does not store its ids as 32-bit floats, so it is not used.")
            continue
        planes = [plane for one in passes for plane in read.read_planes(one)]
        ids, shares = [plane.view(np.uint32) for plane in planes[0::2]], planes[1::2]
        if any(plane.any() for plane in shares):
            notes.append(f"Silhouettes are told by Cryptomatte ({passes[0].label} and {len(passes) - 1} more).")
            return Silhouettes(find_coverage(ids, shares), find_object_share(shares)), notes
    silhouettes, told = _take_alpha_silhouettes(channels, read)
    return silhouettes, [*notes, *told]


def _take_alpha_silhouettes(channels: ChannelMap, read: ImageReader) -> tuple[Silhouettes, list[str]]:
    color = channels.roles["color"]
    chosen = color.source.pick(("a",))
    if chosen is None:
        return Silhouettes(), []
    found = Found(color.source, chosen)
    (plane,) = read.read_planes(found)
    alpha = plane.astype(np.float32)
    edges = (alpha > 0.01) & (alpha < 0.99)
    # If most alpha values are partial, alpha is not coverage: it shows glass, volumes or a fade.
    if not MIN_EDGE_SHARE < edges.mean() < 0.5 or not (alpha >= 0.99).any():
        return Silhouettes(), []
    told = f"Silhouettes against the background are told by {found.label}; no Cryptomatte tells the others."
    ids, shares = [np.ones(alpha.shape, np.uint32)], [alpha]
    return Silhouettes(find_coverage(ids, shares), find_object_share(shares)), [told]
