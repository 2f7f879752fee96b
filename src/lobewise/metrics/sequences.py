"""Errors in motion: flicker from frame to frame, and ghosts in pixels that came into view."""

from __future__ import annotations

from collections.abc import Iterable
from itertools import zip_longest

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError
from lobewise.metrics.images import EPSILON, check_pair, rel_mse
from lobewise.records.images import refuse_size


class Flicker:
    """Computes `flicker` frame by frame. It stores one frame and its reference."""

    def __init__(self) -> None:
        self._before: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None
        self._total = 0.0
        self._steps = 0

    def add(self, image: ArrayLike, reference: ArrayLike, *, cut: bool = False) -> float | None:
        """Add the next frame; return the flicker of the step to it, or None if there is no step.

        Parameters
        ----------
        image, reference : array_like, shape (height, width, 3)
            Linear radiance, finite.
        cut : bool
            Whether there is a cut before this frame, so that the change does not count.

        Raises
        ------
        InputError
            If a size differs from that of the reference or of the previous frame, or a pixel is not finite.
        """
        a, r, _ = check_pair(image, reference, None)
        before, self._before = self._before, (a, r)
        if before is None or cut:
            return None
        if before[0].shape != a.shape:
            raise refuse_size("image", "the frame before", before[0].shape, a.shape, "compare frames of one size")
        change = (a - before[0]) - (r - before[1])
        step = float((change**2 / (0.5 * (r**2 + before[1] ** 2) + EPSILON)).mean())
        self._total += step
        self._steps += 1
        return step

    def get_mean(self) -> float:
        """Return the mean over all steps so far.

        Raises
        ------
        InputError
            If there has been no step.
        """
        if self._steps == 0:
            raise InputError(
                "flicker", expected="at least two frames in a row", got="fewer", action="add another frame"
            )
        return self._total / self._steps


def flicker(images: Iterable[ArrayLike], references: Iterable[ArrayLike]) -> float:
    """Return the relative squared error of the changes from frame to frame, compared with those of the reference.

    It is the mean of ``((a_t - a_s) - (r_t - r_s))^2 / ((r_t^2 + r_s^2) / 2 + 0.01)`` over frames, pixels and colour
    channels, where ``s`` is the frame before ``t``. A constant error does not flicker. Noise that is new in every frame
    has a flicker of twice its `rel_mse`. With a still reference, flicker is the `rel_mse` of the changes. A sequence
    played backwards has the same flicker.

    Parameters
    ----------
    images, references : iterable of array_like, shape (height, width, 3)
        Linear radiance, finite, in the order of time; read one by one.

    Raises
    ------
    InputError
        If there are fewer than two frames, the numbers of frames or their sizes differ, or a pixel is not finite.
    """
    steps = Flicker()
    for image, reference in zip_longest(images, references):
        if image is None or reference is None:
            got = "more" if image is None else "fewer"
            raise InputError(
                "references", expected="one for each image", got=got, action="pass the same frames of both"
            )
        steps.add(image, reference)
    return steps.get_mean()


def ghosting(image: ArrayLike, reference: ArrayLike, mask: ArrayLike) -> float:
    """Return the `rel_mse` of the pixels that came into view, where a wrong history shows ghosts.

    Parameters
    ----------
    image, reference : array_like, shape (height, width, 3)
        Linear radiance, finite.
    mask : array_like of bool, shape (height, width)
        Pixels that came into view; see `find_disoccluded`. If there are none the result is NaN.

    Raises
    ------
    InputError
        If the sizes differ, a pixel is not finite, or the mask is not an array of booleans.
    """
    chosen = np.asarray(mask)
    if chosen.dtype == np.bool_ and chosen.ndim == 2 and not chosen.any():
        # Raise the same errors as for masks that choose pixels.
        check_pair(image, reference, ~chosen)
        return float("nan")
    return rel_mse(image, reference, chosen)
