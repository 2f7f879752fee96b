"""One cell of the bench: how far the image of a method is from the truth, how it looks, and how much light it kept."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from benchmarks.foreign.judging import Judge, make_judge
from benchmarks.quality.measure import round_figure
from benchmarks.users.methods import call_oidn
from lobewise.frame import FloatArray
from lobewise.metrics import flip

FIGURES = ("rel_mse", "without the worst", "doubt", "flip", "energy")


@dataclass(frozen=True)
class Meter:
    """What the images of one noisy frame are measured with.

    Parameters
    ----------
    judge : Judge
    shown : (height, width, 3)
        The image that FLIP compares with: the mean of the references.
    noisy : (height, width, 3)
    """

    judge: Judge
    shown: FloatArray
    noisy: FloatArray

    @cached_property
    def _noisy_errors(self) -> NDArray[np.float64]:
        return self.judge.make_error_map(self.noisy)

    def measure(self, image: FloatArray) -> dict[str, float]:
        """Return the figures of an image.

        "rel_mse" and "without the worst" are those of `Judge.measure`. "doubt" is the standard error, over the pixels,
        of the difference between the image's error and that of the noisy one: below it, neither is known to be the
        better. "flip" counts the references' noise. "energy" is the sum of the image over that of the noisy one.
        """
        every, trimmed = self.judge.measure(image)
        excess = self.judge.make_error_map(image) - self._noisy_errors
        values = (
            every,
            trimmed,
            float(excess.std() / np.sqrt(excess.size)),
            flip(image, self.shown),
            float(image.sum(dtype=np.float64) / max(float(self.noisy.sum(dtype=np.float64)), 1e-30)),
        )
        digits = {"energy": 5}
        return {
            name: round(value, digits[name]) if name in digits else round_figure(value)
            for name, value in zip(FIGURES, values, strict=True)
        }


def make_reference_judge(first: FloatArray, second: FloatArray) -> Judge:
    """Return the judge of two references: errors are relative to both together, filtered by Open Image Denoise."""
    return make_judge(first, second, call_oidn(0.5 * (first + second)))
