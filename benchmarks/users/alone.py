"""Pixels that stand alone: dots that a filter left or made."""

import numpy as np
from numpy.typing import NDArray

from lobewise.records.frame import FloatArray

ALONE = 4.0
"""How many times brighter than all of its neighbours, or darker, a pixel is that stands alone."""
BLACK = 0.02
"""Luminance below which two pixels count as equal, over the mean of the reference."""
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


def count_alone(image: FloatArray, reference: FloatArray) -> dict[str, int]:
    """Return how many pixels are much brighter or darker than all neighbours, where those of the reference are not."""
    level = BLACK * float((reference @ LUMINANCE).mean())
    found = [_mark_alone(picture @ LUMINANCE + level) for picture in (image, reference)]
    bright, dark = (int(np.count_nonzero(own & ~true)) for own, true in zip(*found, strict=True))
    return {"bright": bright, "dark": dark}


def _mark_alone(luminance: NDArray[np.float64]) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    height, width = luminance.shape
    padded = np.pad(luminance, 1, mode="reflect")
    around = np.stack([padded[y : y + height, x : x + width] for y in range(3) for x in range(3) if (y, x) != (1, 1)])
    return luminance > ALONE * around.max(axis=0), ALONE * luminance < around.min(axis=0)
