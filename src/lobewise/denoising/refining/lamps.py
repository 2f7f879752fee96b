"""Which pixels of lamps and skies the refining network reads and changes.

Light that no surface scatters (emission, background) has noise at its edges alone: there, samples of a pixel also hit
the surface beside it. The network smooths these edges. It does not change the inside, and it does not see small lamps.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.filters.refinement.steps import define_any, define_core, define_shining, define_widened
from lobewise.records.frame import FloatArray

EDGE_PIXELS = 2
"""Width of the edge of a lamp or sky, on both sides: as wide as in `lobewise.guides.lamps`."""
NEAR_PIXELS = 8
"""Largest distance of a pixel to a large lamp that it belongs to. With 5 pixels, edges of windows behind thin bars stay
noisy (``living-room-2`` of the public interiors)."""
LAMPS_REACH = NEAR_PIXELS + 2
"""Pixels that `mark_small_lamps` reads in each direction."""

Mask = NDArray[np.bool_]


def mark_shining(rest: FloatArray, parts: Sequence[FloatArray]) -> Mask:
    """Return which pixels have more light that no surface scatters than other light, (height, width)."""
    images = {"rest": rest, **{f"part{number}": part for number, part in enumerate(parts)}}
    (shining,) = engine.pixels(define_shining, images, {}, names=["shining"], text="pixels of lamps and sky")
    return shining


def mark_small_lamps(shining: Mask) -> Mask:
    """Return which shining pixels are small lamps: further than `NEAR_PIXELS` from 3x3 shining ones.

    The network takes so small a lamp for a firefly. Near a large lamp, single shining pixels are its noisy edge.
    """
    (core,) = engine.pixels(define_core, {"mask": shining}, {}, names=["large_lamps"], text="inside of lamps")
    images = {"shining": shining, "without": widen_mask(core, 1 + NEAR_PIXELS)}
    (small,) = engine.pixels(define_any, images, {}, names=["small_lamps"], text="small lamps")
    return small


def mark_lamp_edges(shining: Mask) -> Mask:
    """Return which pixels are at most `EDGE_PIXELS` from a shining one."""
    return widen_mask(shining, EDGE_PIXELS)


def mark_refined(masks: Sequence[Mask], shining: Mask | None = None) -> Mask:
    """Return which pixels are refined: those of surfaces, and those at most `EDGE_PIXELS` from a surface.

    The inside of a lamp, of a sky or of a photograph behind the scene has no noise. Its edge has, because samples of
    the pixel hit the surface beside it. ``masks`` are those of the layers; shining pixels are no surfaces.
    """
    images = {**{f"mask{number}": mask for number, mask in enumerate(masks)}, "without": shining}
    (surface,) = engine.pixels(define_any, images, {}, names=["surfaces"], text="surfaces that do not shine")
    return widen_mask(surface, EDGE_PIXELS)


def widen_mask(mask: Mask, pixels: int) -> Mask:
    """Return a mask that is so many pixels wider in all eight directions."""
    text = f"wider by {pixels} pixels"
    (wide,) = engine.pixels(define_widened, {"mask": mask}, {}, pixels, names=["wide"], text=text)
    return wide
