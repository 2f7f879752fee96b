"""How far a lens blurs the surfaces of a pixel, told by the positions that its neighbours have.

A pinhole sees the position of a pixel within the pixel. Through an open lens, and with a moving camera, the rays of a
pixel spread: the positions of neighbours lie off their pixels, each elsewhere. Positions that lie off alike tell of a
camera that is not known exactly, and of no blur.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.records.frame import FloatArray
from lobewise.work.chunks import Chunk, run_chunks

NEAR, FAR = 1, 5
"""Radii of windows, rows or columns: the second counts where the first has too few pixels with a position, as where
lamps stand before the sky."""
MIN_KNOWN = {NEAR: 3, FAR: 2}
"""Fewest pixels of a window that must have a position."""
MIN_FAR_RADIUS = 1.0
"""Pixels; less in the second window tells nothing."""
RADIUS_OVER_MEDIAN = {NEAR: 1.63, FAR: 2.0**0.5}
"""Radius of an evenly filled disc over a median of distances: of nine of its points from their own median, measured; of
any number from its centre."""


def estimate_blur_radius(offset: FloatArray) -> FloatArray | None:
    """Return the radius of the area that the lens blurs each pixel over, None if all neighbours agree.

    It is measured around a pixel by medians: at the edge of a thing in focus, what lies behind does not count.

    Parameters
    ----------
    offset : array, shape (height, width, 2)
        Where the camera sees the position of a pixel, minus the pixel's centre, pixels; NaN where that is not known.

    Returns
    -------
    array, shape (height, width), or None
        Pixels; NaN where no position tells it; as `lobewise.GBuffer.blur_radius`.
    """
    if not is_blurred(offset):
        return None
    height, width, _ = offset.shape
    around = np.pad(offset, ((FAR, FAR), (FAR, FAR), (0, 0)), constant_values=np.nan)
    radius = np.empty((height, width), np.float32)

    def find(chunk: Chunk) -> None:
        rows, columns = (each.ravel() for each in np.mgrid[chunk])
        measured = _measure(around, rows, columns, NEAR)
        few = np.isnan(measured)
        far = _measure(around, rows[few], columns[few], FAR)
        # Sharp things nearby do not make sharp what has no position.
        measured[few] = np.where(far >= MIN_FAR_RADIUS, far, np.float32(np.nan))
        radius[chunk] = measured.reshape(radius[chunk].shape)

    run_chunks(find, height, width)
    return radius


def is_blurred(offset: FloatArray) -> bool:
    """Return whether some neighbours disagree, so that a lens blurs the image; ``offset`` is as above."""
    return any((np.abs(np.diff(offset, axis=axis)) > 1.0).any() for axis in (0, 1))


def _measure(around: FloatArray, rows: NDArray[np.intp], columns: NDArray[np.intp], reach: int) -> FloatArray:
    """Return the radius at some pixels by the window around each, NaN where too few positions are known."""
    steps = range(FAR - reach, FAR + reach + 1)
    seen = np.stack([around[rows + y, columns + x] for y in steps for x in steps])
    # Few positions have no median of their own that is worth much: the camera counts as exact.
    away = np.linalg.norm(seen - _compute_median(seen) if reach == NEAR else seen, axis=-1)
    known = np.count_nonzero(np.isfinite(away), axis=0) >= MIN_KNOWN[reach]
    return np.where(known, np.float32(RADIUS_OVER_MEDIAN[reach]) * _compute_median(away), np.float32(np.nan))


def _compute_median(values: FloatArray) -> FloatArray:
    """Return the lower median over the first axis of what is not NaN; NaN of nothing."""
    ordered = np.sort(values, axis=0)  # NaN comes last
    middle = (np.count_nonzero(~np.isnan(values), axis=0) - 1) // 2
    median: FloatArray = np.take_along_axis(ordered, np.maximum(middle, 0)[None], axis=0)[0]
    return median
