"""Pixels that are no radiance: not finite, or negative."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.frame import FloatArray, Frame


def find_good(image: FloatArray) -> NDArray[np.bool_]:
    """Return where all three channels are finite and not negative.

    Channel by channel: NumPy's reductions over an axis of three are several times slower.
    """
    # Not-finite compares false with everything, so the good side is what is tested.
    each = (image >= 0.0) & (image <= np.finfo(np.float32).max)
    good: NDArray[np.bool_] = each[..., 0] & each[..., 1] & each[..., 2]
    return good


def blacken_bad(image: FloatArray) -> FloatArray:
    """Return ``image`` with 0 where a pixel is not finite or negative."""
    good = find_good(image)
    return image if good.all() else np.where(good[..., None], image, np.float32(0.0))


def find_bad_pixels(frame: Frame) -> NDArray[np.bool_]:
    """Return where any radiance of the frame is NaN, infinite or negative, shape (height, width)."""
    bad = np.zeros(frame.shape, dtype=bool)
    for image in (frame.radiance.color, frame.radiance.diffuse, frame.radiance.specular):
        if image is not None:
            bad |= ~find_good(image)
    return bad


def require_some_good(bad: int, count: int, what: str) -> None:
    """Raise InputError if all of ``count`` are bad; ``what`` they are is a pixel or a sample."""
    if bad == count:
        raise InputError(
            "radiance",
            expected=f"at least one {what} that is finite and not negative",
            got=f"{bad} bad {what}s of {count}",
            action="check the render or the channel mapping",
        )
