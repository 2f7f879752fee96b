"""Bad pixels, whose radiance is not finite or negative, and holes, to which no filter gave a value: both are filled."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.features import Feature, ScreenFeature
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.forms import ATROUS_REACH
from lobewise.frame import FloatArray, Frame
from lobewise.sparse_frame import AnyFrame

SIGMAS: tuple[float | None, ...] = (1.0, 16.0, None)
"""Standard deviations of the rounds that fill holes, pixels. None weighs all pixels of the kernel alike."""
MAX_WINDOWS_SHARE = 0.5
"""Area of the windows around single holes over that of the image, above which the whole image is filtered instead."""
MAX_SHARE_BAD = 0.01
"""Share of the pixels above which bad ones are no accident, and the user is asked."""
REFILL_REACH = len(SIGMAS) * ATROUS_REACH
"""Reach of the filling, pixels: each round reads the pixels that the round before filled."""


def find_good(image: FloatArray) -> NDArray[np.bool_]:
    """Return where all three channels are finite and not negative.

    Channel by channel: NumPy's reductions over an axis of three are several times slower.
    """
    # Two reductions tell that every pixel is good, as in most images. With a NaN both are NaN.
    if image.size and image.min() >= 0.0 and image.max() <= np.finfo(np.float32).max:
        return np.ones(image.shape[:-1], np.bool_)
    # NaN compares false with everything, so the test asks for good pixels.
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
    """Raise InputError if all of ``count`` are bad; ``what`` is the word for one of them, "pixel" or "sample"."""
    if bad == count:
        raise InputError(
            "radiance",
            expected=f"at least one {what} that is finite and not negative",
            got=f"{bad} bad {what}s of {count}",
            action="check the render or the channel mapping",
        )


def describe_bad(bad: int, count: int) -> tuple[str, ...]:
    """Return the question that many bad pixels raise, or nothing; ``bad`` of ``count`` pixels are bad."""
    if bad <= MAX_SHARE_BAD * count:
        return ()
    return (
        f"{100.0 * bad / count:.2g} % of the pixels are NaN, infinite or far below the light around them, and are "
        "filled from their neighbours: is this channel the picture, and did its render end?",
    )


def refill(image: FloatArray, holes: NDArray[np.bool_], mean: FloatArray) -> FloatArray:
    """Return ``image`` with the pixels of ``holes`` replaced by the mean of the nearest others on the screen.

    Parameters
    ----------
    image : (height, width, 3)
        What is outside the holes is finite.
    holes : bool array, (height, width)
        What is to be replaced.
    mean : (3,)
        What a hole becomes that has nothing else in its reach.
    """
    source, holes = image.copy(), holes.copy()
    source[holes] = np.nan
    for sigma in SIGMAS:
        found = []
        for rows, columns in _list_windows(holes):
            window = source[rows, columns]
            features: list[Feature] = [] if sigma is None else [ScreenFeature(sigma)]
            everywhere = np.ones(window.shape[:2], dtype=bool)
            filled = run_filter(window, everywhere, features, form="atrous", radius=0)
            found.append((rows, columns, filled))
        for rows, columns, filled in found:
            # A pixel is exact in the window whose middle it is.
            reached = _find_middle(holes, rows, columns) & (filled.weight_sum > 0.0)
            source[rows, columns][reached] = filled.image[reached]
            holes[rows, columns] &= ~reached
        if not holes.any():
            return source
    source[holes] = mean
    return source


def _list_windows(holes: NDArray[np.bool_]) -> list[tuple[slice, slice]]:
    """Return the parts of an image that are filtered to fill its holes: a window for each of a few, or all of it."""
    height, width = holes.shape
    rows, columns = np.nonzero(holes)
    side = 2 * ATROUS_REACH + 1
    if len(rows) * side**2 > MAX_WINDOWS_SHARE * holes.size:
        return [(slice(0, height), slice(0, width))]

    def surround(at: int, size: int) -> slice:
        return slice(max(0, at - ATROUS_REACH), min(size, at + ATROUS_REACH + 1))

    return [(surround(y, height), surround(x, width)) for y, x in zip(rows.tolist(), columns.tolist(), strict=True)]


def _find_middle(holes: NDArray[np.bool_], rows: slice, columns: slice) -> NDArray[np.bool_]:
    """Return the holes of a window whose whole reach lies inside the window or outside the image."""
    inside = []
    for window, size in zip((rows, columns), holes.shape, strict=True):
        at = np.arange(window.start, window.stop)
        first = np.maximum(at - ATROUS_REACH, 0) >= window.start
        inside.append(first & (np.minimum(at + ATROUS_REACH + 1, size) <= window.stop))
    return np.asarray(holes[rows, columns] & inside[0][:, None] & inside[1])


def fill_holes(image: FloatArray, holes: NDArray[np.bool_], frame: AnyFrame) -> FloatArray:
    """Return ``image`` with its holes refilled, at last with the mean colour of the frame's good pixels."""
    return refill(image, holes, find_mean_color(sum_colors(frame))) if holes.any() else image


def sum_colors(frame: AnyFrame) -> NDArray[np.float64]:
    """Return the colours of every row's good pixels, summed, and how many there are, (height, 4)."""
    color = frame.radiance.color
    good = find_good(color)
    lit = np.where(good[..., None], color, np.float32(0.0))
    # Row by row, so that rows add up to the same bits however an image was cut into bands of them.
    rows = [[row[:, k].sum(dtype=np.float64) for k in range(3)] for row in lit]
    return np.concatenate([rows, np.count_nonzero(good, axis=1)[:, None]], axis=1)


def find_mean_color(rows: NDArray[np.float64]) -> FloatArray:
    """Return the mean colour of the good pixels of all rows, (3,), from what `sum_colors` gave; 0 without any."""
    *sums, count = rows.sum(axis=0)
    return np.asarray(np.array(sums) / max(count, 1.0), dtype=np.float32)
