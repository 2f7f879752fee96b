"""How finely positions are stored: 16-bit floats are coarser than pixels where coordinates are large."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from lobewise.frame import FloatArray
from lobewise.interchange.checks.geometry import FEWEST_SAMPLES, choose_centers
from lobewise.interchange.values import FARTHEST

COARSE = 2.0
"""Steps of the numbers, over the distance between neighbouring pixels, from which on positions are coarse: at 8 of them
the error of a filtered frame is some percent higher."""
APART = 8
"""Pixels between which the distance of neighbours is measured, so that steps of the numbers do not hide it."""
HALF_BITS, SINGLE_BITS = 10, 23
LEAST_DISTANCE = 1e-30
"""Stands for the distance between pixels whose numbers are the same, so that ratios of grains stay finite."""


@dataclass(frozen=True)
class Grain:
    """How finely numbers are stored.

    Parameters
    ----------
    bits : int
        Of their type: 16 or 32.
    coarseness : float
        Steps between the numbers there are, over the distance between neighbouring pixels.
    distance : float
        That distance.
    """

    bits: int
    coarseness: float
    distance: float

    @property
    def is_coarse(self) -> bool:
        """Whether neighbouring pixels cannot be told apart by them."""
        return self.coarseness > COARSE

    def tell(self) -> str:
        """Return how coarse it is, as what follows "whose steps here are"."""
        if self.distance <= LEAST_DISTANCE:
            return "so wide that most neighbouring pixels have the same position"
        times = f"{self.coarseness:.1f}" if self.coarseness < 100.0 else f"{self.coarseness:.0f}"
        return f"{times} times as far apart as neighbouring pixels"


def measure_grain(position: FloatArray, distance: float | None = None) -> Grain:
    """Return how finely positions (height, width, 3), or depths (height, width), were stored, whatever type they have.

    ``distance`` is that between neighbouring pixels, by default that of the positions.
    """
    rows, columns = choose_centers((position.shape[0], position.shape[1]), APART)
    values = position if position.ndim == 3 else position[..., None]
    here, there = values[rows, columns], values[rows, columns + APART]
    both = (np.stack([np.abs(here), np.abs(there)]) < FARTHEST).all(axis=(0, 2))
    both &= (here != 0.0).any(axis=-1) & (there != 0.0).any(axis=-1)
    if both.sum() < FEWEST_SAMPLES:
        return Grain(32, 0.0, 1.0)
    here, there = here[both], there[both]
    with np.errstate(over="ignore"):
        half = bool((here.astype(np.float16).astype(np.float32) == here).all())
    steps = np.exp2(np.floor(np.log2(np.abs(here).max(axis=-1))) - (HALF_BITS if half else SINGLE_BITS))
    if distance is None:
        distance = float(np.median(np.linalg.norm(there - here, axis=-1))) / APART
    distance = max(distance, LEAST_DISTANCE)
    return Grain(16 if half else 32, float(np.median(steps)) / distance, distance)
