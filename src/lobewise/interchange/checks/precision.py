"""Check of the precision of positions: 16-bit floats are coarser than pixels where coordinates are large."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lobewise.interchange.checks.geometry import MIN_PIXELS, choose_centers
from lobewise.interchange.values import MIN_EMPTY_DISTANCE
from lobewise.records.frame import FloatArray

MAX_COARSENESS = 2.0
"""Largest step between representable numbers of fine positions, over the distance between neighbouring pixels. At a
ratio of 8 the error of a filtered frame is some percent higher."""
MEASURED_PIXEL_STEP = 8
"""Pixels between two positions whose distance is measured. Over one pixel, the steps between numbers would hide it."""
HALF_MANTISSA_BITS, SINGLE_MANTISSA_BITS = 10, 23
"""Bits of the mantissa of 16-bit and 32-bit floats."""
MIN_DISTANCE = 1e-30
"""Smallest distance between neighbouring pixels. Pixels with equal positions get it, so that ratios stay finite."""


@dataclass(frozen=True)
class Grain:
    """Precision of the numbers of an image.

    Parameters
    ----------
    bits : int
        Bits of a number: 16 or 32.
    coarseness : float
        Step between representable numbers, over the distance between neighbouring pixels.
    distance : float
        Distance between neighbouring pixels, in units of the scene.
    """

    bits: int
    coarseness: float
    distance: float

    @property
    def is_coarse(self) -> bool:
        """Whether neighbouring pixels may have equal numbers."""
        return self.coarseness > MAX_COARSENESS

    def tell(self) -> str:
        """Return the coarseness in words that continue "whose steps here are"."""
        if self.distance <= MIN_DISTANCE:
            return "so wide that most neighbouring pixels have the same position"
        times = f"{self.coarseness:.1f}" if self.coarseness < 100.0 else f"{self.coarseness:.0f}"
        return f"{times} times as far apart as neighbouring pixels"


def measure_grain(position: FloatArray, distance: float | None = None) -> Grain:
    """Return the precision with which positions (height, width, 3) or depths (height, width) were stored.

    The values show the precision; the type of the array does not count. ``distance`` is the distance between
    neighbouring pixels; by default it is measured in the image.
    """
    rows, columns = choose_centers((position.shape[0], position.shape[1]), MEASURED_PIXEL_STEP)
    values = position if position.ndim == 3 else position[..., None]
    here, there = values[rows, columns], values[rows, columns + MEASURED_PIXEL_STEP]
    both = (np.stack([np.abs(here), np.abs(there)]) < MIN_EMPTY_DISTANCE).all(axis=(0, 2))
    both &= (here != 0.0).any(axis=-1) & (there != 0.0).any(axis=-1)
    if both.sum() < MIN_PIXELS:
        return Grain(32, 0.0, 1.0)
    here, there = here[both], there[both]
    with np.errstate(over="ignore"):
        half = bool((here.astype(np.float16).astype(np.float32) == here).all())
    steps = np.exp2(
        np.floor(np.log2(np.abs(here).max(axis=-1))) - (HALF_MANTISSA_BITS if half else SINGLE_MANTISSA_BITS)
    )
    if distance is None:
        distance = float(np.median(np.linalg.norm(there - here, axis=-1))) / MEASURED_PIXEL_STEP
    distance = max(distance, MIN_DISTANCE)
    return Grain(16 if half else 32, float(np.median(steps)) / distance, distance)
