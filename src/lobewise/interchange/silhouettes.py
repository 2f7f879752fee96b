"""Which surfaces share a pixel, where a foreign file tells: by Cryptomatte, or by how much of it is background."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lobewise.frame import FloatArray
from lobewise.guides.cryptomatte import find_coverage, find_object_share
from lobewise.interchange.imported import ImageReader
from lobewise.interchange.mapping import ChannelMap, Found

FEWEST_EDGES = 1e-4
"""Share of the pixels that alpha must find between 0 and 1 before it tells of silhouettes."""


class Silhouettes(NamedTuple):
    """What a file tells of silhouettes: `lobewise.GBuffer.coverage` and `object_share`; None for nothing."""

    coverage: FloatArray | None = None
    object_share: FloatArray | None = None


def take_silhouettes(channels: ChannelMap, read: ImageReader) -> tuple[Silhouettes, list[str]]:
    """Return what a file tells of silhouettes, and sentences that say by what.

    Of several Cryptomattes the first counts, which is the finest. Without any there may be alpha: it tells surfaces
    from the background, not from each other.
    """
    notes = []
    for passes in channels.cryptomatte:
        kinds = {
            channel.pixel_type for one in passes for channel in one.source.part.channels if channel.name in one.channels
        }
        if kinds != {"float"}:
            notes.append(f"{passes[0].label} has ids of 16 bits, which are none, so it is not used.")
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
    # Where all is between, it is no share of the area: glass, volumes, a fade.
    if not FEWEST_EDGES < edges.mean() < 0.5 or not (alpha >= 0.99).any():
        return Silhouettes(), []
    told = f"Silhouettes against the background are told by {found.label}; no Cryptomatte tells the others."
    ids, shares = [np.ones(alpha.shape, np.uint32)], [alpha]
    return Silhouettes(find_coverage(ids, shares), find_object_share(shares)), [told]
