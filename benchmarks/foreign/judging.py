"""How far an image is from a reference that has noise of its own, without that noise."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.metrics import EPSILON
from lobewise.records.frame import FloatArray

WORST = 0.001
"""Share of the pixels that the second figure leaves out: a few bright dots can be most of the first."""


@dataclass(frozen=True)
class Judge:
    """Two renders of the truth with noise of their own, (height, width, 3) each.

    Parameters
    ----------
    first, second : (height, width, 3)
        Independent.
    clean : (height, width, 3), optional
        Both together without their noise, as well as that can be: what errors are relative to.
    known : (height, width) of bool, optional
        Pixels that count; by default all.
    """

    first: NDArray[np.float64]
    second: NDArray[np.float64]
    clean: NDArray[np.float64] | None = None
    known: NDArray[np.bool_] | None = None

    def measure(self, image: FloatArray) -> tuple[float, float]:
        """Return the relative mean squared error of an image, freed of the noise of the reference.

        The first figure is that of all pixels, the second leaves out those `WORST` that are furthest off.

        It is `lobewise.metrics.rel_mse` but for two estimates of what an endless render would show: the square of the
        difference is the product of the differences to both renders, and the square in the denominator that of
        ``clean``, or without it the product of both. Their noise is independent, so that it leaves nothing in the
        numerator on average; in the quotient without ``clean`` noise of variance v (relative) makes an error of e seem
        one of about e + v. A figure far below the reference's own noise can come out negative.
        """
        errors = np.sort(self.choose(self.make_error_map(image)))
        return float(errors.mean()), float(errors[: len(errors) - round(WORST * len(errors))].mean())

    def make_error_map(self, image: FloatArray) -> NDArray[np.float64]:
        """Return the error of every pixel (height, width): its mean is the first figure of `measure`."""
        return self.compute_errors((image - self.first) * (image - self.second))

    def choose(self, errors: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the errors of the pixels that count, in one row."""
        return errors.ravel() if self.known is None else errors[self.known]

    def measure_noise(self) -> float:
        """Return the error, in the same sense, that the mean of both renders has itself."""
        return float(self.choose(self.compute_errors(0.25 * (self.first - self.second) ** 2)).mean())

    def compute_errors(self, square: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the relative error of every pixel (height, width), of squares (height, width, 3)."""
        scale = np.maximum(self.first * self.second, 0.0) if self.clean is None else self.clean**2
        return np.asarray((square / (scale + EPSILON)).mean(axis=-1))


def make_judge(first: FloatArray, second: FloatArray) -> Judge:
    """Return the judge of two renders."""
    return Judge(first.astype(np.float64), second.astype(np.float64))
