"""A denoiser's memory of the frames before, behind the call of one that has none."""

from __future__ import annotations

from typing import Any

import numpy as np

from lobewise.errors import InputError
from lobewise.frame import FloatArray, Frame
from lobewise.settings import DenoiseSettings
from lobewise.temporal import TemporalFilter

HALF_FLOAT = 2e-3
"""Relative difference within which two images are the same one, so that it may have been stored in 16 bits."""


class History:
    """What a temporal denoiser remembers.

    The history of a pixel is more than the image that was shown (how many samples it stands for, whether it is the same
    surface), so it is kept here; the image of the frame before that is handed in tells whether the sequence goes on.

    Parameters
    ----------
    settings, changes
        As `lobewise.TemporalFilter` takes them.
    """

    def __init__(self, settings: DenoiseSettings | None, changes: Any) -> None:
        self._filter = TemporalFilter(settings, **changes)
        self._last: FloatArray | None = None

    def add(self, frame: Frame, previous: FloatArray, noisy: FloatArray) -> FloatArray:
        """Return the next frame, denoised, (height, width, 3).

        Parameters
        ----------
        frame : Frame
            With its motion.
        previous : array, shape (height, width, 1 or 3)
            The image before: what `remember` was told last, or to begin anew the noisy image or black.
        noisy : array, shape (height, width, 1 or 3)
            The image of this frame.

        Raises
        ------
        InputError
            If the image before is none of these.
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
        """Take note of what was returned for a frame."""
        self._last = image.copy()


def _is_same(image: FloatArray, other: FloatArray) -> bool:
    return image.shape == other.shape and np.allclose(image, other, rtol=HALF_FLOAT, atol=1e-6, equal_nan=True)
