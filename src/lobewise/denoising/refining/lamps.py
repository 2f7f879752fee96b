"""Which pixels of lamps and skies the refining network reads and changes.

Light that no surface scatters (emission, background) has noise at its edges alone: there, samples of a pixel also hit
the surface beside it. The network smooths these edges. It does not change the inside.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.filters.refinement.steps import define_any, define_shining, define_widened
from lobewise.records.frame import FloatArray

EDGE_PIXELS = 2
"""Width of the edge of a lamp or sky, on both sides: as wide as in `lobewise.guides.lamps`."""
Mask = NDArray[np.bool_]


def mark_shining(rest: FloatArray, parts: Sequence[FloatArray]) -> Mask:
    """Return which pixels have more light that no surface scatters than other light, (height, width)."""
    images = {"rest": rest, **{f"part{number}": part for number, part in enumerate(parts)}}
    (shining,) = engine.pixels(define_shining, images, {}, names=["shining"], text="pixels of lamps and sky")
    return shining


def mark_refined(masks: Sequence[Mask], shining: Mask | None = None) -> Mask:
    """Return which pixels are refined: those of surfaces, and those at most `EDGE_PIXELS` from a surface.

    The inside of a lamp, of a sky or of a photograph behind the scene has no noise. Its edge has, because samples of
    the pixel hit the surface beside it. ``masks`` are those of the layers; shining pixels are no surfaces.
    """
    images = {**{f"mask{number}": mask for number, mask in enumerate(masks)}, "without": shining}
    (surface,) = engine.pixels(define_any, images, {}, names=["surfaces"], text="surfaces that do not shine")
    text = f"wider by {EDGE_PIXELS} pixels"
    (wide,) = engine.pixels(define_widened, {"mask": surface}, {}, EDGE_PIXELS, names=["wide"], text=text)
    return wide
