"""One cell of the bench: how far the image of a method is from the truth, how it looks, and how much light it kept."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.foreign.judging import Judge, make_judge
from benchmarks.quality.measure import round_figure
from benchmarks.users.alone import count_alone
from benchmarks.users.methods import call_oidn
from benchmarks.users.summary import UNKNOWN
from lobewise.metrics import flip
from lobewise.records.frame import FloatArray

FIGURES = ("rel_mse", "doubt", "doubt over noisy", "without the worst", "flip", "energy", "bright", "dark")


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

    def measure(self, image: FloatArray) -> dict[str, float]:
        """Return the figures of an image.

        "rel_mse" and "without the worst" are those of `Judge.measure`. "doubt" is the standard error that the
        references' noise leaves in the first, "doubt over noisy" that of its difference to the noisy image's. "flip"
        counts the references' noise. "energy" is the sum of the image over that of the noisy one. "bright" and "dark"
        are the pixels that stand alone, see `benchmarks.users.alone`.
        """
        every, trimmed = self.judge.measure(image)
        values = (
            every,
            self._compute_doubt(image),
            self._compute_doubt_over_noisy(image),
            trimmed,
            flip(image, self.shown),
            float(image.sum(dtype=np.float64) / max(float(self.noisy.sum(dtype=np.float64)), 1e-30)),
            *count_alone(image, self.shown).values(),
        )
        digits = {"energy": 5}
        return {
            name: value
            if isinstance(value, int)
            else round(value, digits[name])
            if name in digits
            else round_figure(value)
            for name, value in zip(FIGURES, values, strict=True)
        }

    def _compute_doubt(self, image: FloatArray) -> float:
        """Return the standard error of the error: of (d - m)(d - n), where d is the true difference to an image and m
        and n are the references' deviations, the variance is 2 d^2 v + v^2, and the square of (m - n)^2 / 2 is 3 v^2.
        """
        square = (image - self.judge.first) * (image - self.judge.second)
        variance = self._reference_variance
        return self._add_up(np.sqrt(2.0 * np.maximum(square, 0.0) * variance + variance**2 / 3.0))

    def _compute_doubt_over_noisy(self, image: FloatArray) -> float:
        """Return that of the difference between two errors, in which the product of the deviations is the same."""
        apart = np.abs(image.astype(np.float64) - self.noisy)
        return self._add_up(apart * np.sqrt(2.0 * self._reference_variance))

    @property
    def _reference_variance(self) -> NDArray[np.float64]:
        return 0.5 * (self.judge.first - self.judge.second) ** 2

    def _add_up(self, deviation: NDArray[np.float64]) -> float:
        """Return the deviation of a mean over independent pixels, whose three channels deviate alike."""
        chosen = self.judge.choose(self.judge.compute_errors(deviation))
        return float(np.sqrt((chosen**2).sum()) / chosen.size)


def make_reference_judge(first: FloatArray, second: FloatArray) -> Judge:
    """Return the judge of two references: errors are relative to both together, filtered by Open Image Denoise.

    The pixels at which the references differ most, a thousandth of all, count for no method: one firefly in one of them
    can be more than the error of all other pixels.
    """
    clean = call_oidn(0.5 * (first + second)).astype(np.float64)
    judge = replace(make_judge(first, second), clean=clean)
    apart = judge.compute_errors((judge.first - judge.second) ** 2)
    order = np.argsort(apart.ravel(), kind="stable")
    known = np.ones(apart.size, dtype=np.bool_)
    known[order[apart.size - round(UNKNOWN * apart.size) :]] = False
    return replace(judge, known=known.reshape(apart.shape))
