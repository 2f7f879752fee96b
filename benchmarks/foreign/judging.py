"""How far an image is from a reference that has noise of its own, without that noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.metrics import EPSILON

WORST = 0.001
"""Share of the pixels that the second figure leaves out: a few bright dots can be most of the first."""


@dataclass(frozen=True)
class Judge:
    """Two renders of the truth with noise of their own, (height, width, 3) each."""

    first: NDArray[np.float64]
    second: NDArray[np.float64]

    def measure(self, image: FloatArray) -> tuple[float, float]:
        """Return the relative mean squared error of an image, freed of the noise of the reference.

        The first figure is that of all pixels, the second leaves out those `WORST` that are furthest off.

        It is `lobewise.metrics.rel_mse` but for two estimates of what an endless render would show: the square of the
        difference is the product of the differences to both renders, and the square in the denominator the product of
        both. Their noise is independent, so that it leaves nothing in the numerator on average; in the quotient noise
        of variance v (relative) makes an error of e seem one of about e + v. A figure far below the reference's own
        noise can come out negative.
        """
        errors = np.sort(self._find_errors((image - self.first) * (image - self.second)).ravel())
        return float(errors.mean()), float(errors[: len(errors) - round(WORST * len(errors))].mean())

    def measure_noise(self) -> float:
        """Return the error, in the same sense, that the mean of both renders has itself."""
        return float(self._find_errors(0.25 * (self.first - self.second) ** 2).mean())

    def _find_errors(self, square: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the error of every pixel (height, width)."""
        return np.asarray((square / (np.maximum(self.first * self.second, 0.0) + EPSILON)).mean(axis=-1))


def make_judge(first: FloatArray, second: FloatArray) -> Judge:
    """Return the judge of two renders."""
    return Judge(first.astype(np.float64), second.astype(np.float64))
