"""Which pixels of lamps and skies the refining network reads and changes.

Light that no surface scatters (emission, background) has noise at its edges alone: there, samples of a pixel also hit
the surface beside it. The network smooths these edges. It does not change the inside, and it does not see small lamps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.refining.inputs import sum_light
from lobewise.frame import FloatArray

EDGE_PIXELS = 2
"""Width of the edge of a lamp or sky, on both sides: as wide as in `lobewise.guides.lamps`."""
NEAR_PIXELS = 8
"""Largest distance of a pixel to a large lamp that it belongs to. With 5 pixels, edges of windows behind thin bars stay
noisy (``living-room-2`` of the public interiors)."""
REACH = NEAR_PIXELS + 2
"""Pixels that `find_small` reads in each direction."""

Mask = NDArray[np.bool_]


def find_shining(rest: FloatArray, parts: Sequence[FloatArray]) -> Mask:
    """Return which pixels have more light that no surface scatters than other light, (height, width)."""
    return np.asarray(rest.sum(axis=-1) > sum_light(parts).sum(axis=-1))


def find_small(shining: Mask) -> Mask:
    """Return which shining pixels are small lamps: further than `NEAR_PIXELS` from 3x3 shining ones.

    The network takes so small a lamp for a firefly. Near a large lamp, single shining pixels are its noisy edge.
    """
    return shining & ~widen_mask(~widen_mask(~shining, 1), 1 + NEAR_PIXELS)


def find_edges(shining: Mask) -> Mask:
    """Return which pixels are at most `EDGE_PIXELS` from a shining one."""
    return widen_mask(shining, EDGE_PIXELS)


def find_refined(surface: Mask) -> Mask:
    """Return which pixels are refined: those of surfaces, and those at most `EDGE_PIXELS` from a surface.

    The inside of a lamp, of a sky or of a photograph behind the scene has no noise. Its edge has, because samples of
    the pixel hit the surface beside it.
    """
    return widen_mask(surface, EDGE_PIXELS)


def widen_mask(mask: Mask, pixels: int) -> Mask:
    """Return a mask that is so many pixels wider in all eight directions."""
    for axis in (0, 1):
        reached = 0
        while reached < pixels:
            # A mask that is wider by n pixels on both sides has no gap when it is moved by 2 n + 1.
            step = min(2 * reached + 1, pixels - reached)
            before, after = np.swapaxes(mask, 0, axis), np.swapaxes(mask.copy(), 0, axis)
            after[step:] |= before[:-step]
            after[:-step] |= before[step:]
            mask, reached = np.swapaxes(after, 0, axis), reached + step
    return mask
