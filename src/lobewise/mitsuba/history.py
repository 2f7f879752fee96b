"""Memory of previous frames, for a denoiser whose caller passes only the previous image, as Mitsuba's does."""

from __future__ import annotations

from typing import Any

import numpy as np

from lobewise.errors import InputError
from lobewise.recipes.temporal import TemporalFilter
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import DenoiseSettings

MAX_RELATIVE_DIFFERENCE = 2e-3
"""Largest relative difference of equal images. It allows for storage in 16-bit floats."""


class History:
    """Memory of a temporal denoiser.

    The history of a pixel holds more than the previous image, such as its number of samples and its surface. It is kept
    here. The previous image that the caller passes only shows whether the sequence goes on.

    Parameters
    ----------
    settings, changes
        Settings of `lobewise.TemporalFilter`.
    """

    def __init__(self, settings: DenoiseSettings | None, changes: Any) -> None:
        self._filter = TemporalFilter(settings, **changes)
        self._last: FloatArray | None = None

    def add(self, frame: Frame, previous: FloatArray, noisy: FloatArray) -> FloatArray:
        """Return the denoised image of the next frame, (height, width, 3).

        Parameters
        ----------
        frame : Frame
            The frame, with motion.
        previous : array, shape (height, width, 1 or 3)
            The last image passed to `remember`. The noisy image or black begins a new sequence.
        noisy : array, shape (height, width, 1 or 3)
            The noisy image of this frame.

        Raises
        ------
        InputError
            If ``previous`` is any other image.
        """
        goes_on = self._last is not None and _is_same(previous, self._last)
        if not goes_on and previous.any() and not _is_same(previous, noisy):
            raise InputError(
                "previous_denoised",
                expected="what this denoiser returned last, or the noisy image to begin anew",
                got="another image",
                action="pass one of them, and flow beside it: the history itself stays in the denoiser",
            )
        if not goes_on:
            self._filter.reset()
        return self._filter.add(frame).image

    def remember(self, image: FloatArray) -> None:
        """Store the image that was returned for a frame."""
        self._last = image.copy()


def _is_same(image: FloatArray, other: FloatArray) -> bool:
    return image.shape == other.shape and np.allclose(
        image, other, rtol=MAX_RELATIVE_DIFFERENCE, atol=1e-6, equal_nan=True
    )
