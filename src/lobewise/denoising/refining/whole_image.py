"""What the refining network needs to know of a whole image, measured row by row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.denoising.bad_pixels import mark_good
from lobewise.guides.lobe_fields import default_tau
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Frame

MIN_BRIGHTNESS = 1e-36
"""Smallest brightness of an image, radiance; a black image has none."""
MAX_RATIO_TO_NEXT = 2.0
"""Largest root of the light of a row's brightest pixel, over that of the next."""
MAX_ROWS_IN_64_BITS = 64
"""Rows of an image whose values are held in 64 bits at once."""
RowSums = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class WholeImage:
    """What was measured of a whole image, of which a frame may be a part.

    Parameters
    ----------
    levels : sequence of float
        Mean light of every layer, over the albedo.
    brightness : float
        Squared mean of the root of the light, > 0.
    mean_log_depth : float
        Mean natural logarithm of the depth of all surfaces.
    tau : float
        Band-limit of lobes, radians; 0 without a camera.
    """

    levels: Sequence[float]
    brightness: float
    mean_log_depth: float
    tau: float


def measure_whole(frame: Frame, levels: Sequence[float]) -> WholeImage:
    """Return what the network needs to know of a whole image."""
    depth, camera = frame.gbuffer.depth, frame.camera
    return WholeImage(
        levels=levels,
        brightness=engine.total(measure_brightness, [frame.radiance.color], name="brightness"),
        mean_log_depth=0.0 if depth is None else engine.total(measure_log_depth, [depth], name="mean_log_depth"),
        tau=0.0 if camera is None else default_tau(camera, frame.height),
    )


def measure_brightness(color: FloatArray) -> float:
    """Return the brightness of an image: the squared mean of the root of its light."""
    return _compute_brightness(_sum_rows(_sum_roots, color))


def measure_log_depth(depth: FloatArray) -> float:
    """Return the mean logarithm of the depth of surfaces."""
    return _compute_mean_log_depth(_sum_rows(_sum_logarithms, depth))


def measure_rows(frame: Frame) -> RowSums:
    """Return for each row: roots of the light, their number, logarithms of the depth, their number; summed, (rows, 4).

    The sums of rows have the same bits however an image is cut into bands of rows.
    """
    depth = frame.gbuffer.depth
    logarithms = np.zeros((frame.height, 2)) if depth is None else _sum_rows(_sum_logarithms, depth)
    return np.concatenate([_sum_rows(_sum_roots, frame.radiance.color), logarithms], axis=1)


def _sum_rows(compute: Callable[[FloatArray], RowSums], image: FloatArray) -> RowSums:
    """Return sums of the rows of an image, computed some rows at a time, because values of 64 bits take much memory."""
    parts = [compute(image[top : top + MAX_ROWS_IN_64_BITS]) for top in range(0, len(image), MAX_ROWS_IN_64_BITS)]
    return np.concatenate(parts)


def _sum_roots(color: FloatArray) -> RowSums:
    height, width = color.shape[:2]
    good = mark_good(color)
    # The sum of three channels near the largest number would overflow.
    light = np.where(good[..., None], color, np.float32(0.0)).astype(np.float64).mean(axis=-1)
    roots = np.sqrt(light)
    if width > 1:
        # One firefly must not decide how bright the image is.
        roots = np.minimum(roots, MAX_RATIO_TO_NEXT * np.partition(roots, -2, axis=1)[:, -2:-1])
    return np.stack([roots.sum(axis=1, dtype=np.float64), np.full(height, float(width))], axis=1)


def _sum_logarithms(depth: FloatArray) -> RowSums:
    seen = (depth > 0.0) & np.isfinite(depth)
    logarithms = np.log(np.where(seen, depth, np.float32(1.0))).sum(axis=1, dtype=np.float64)
    return np.stack([logarithms, np.count_nonzero(seen, axis=1)], axis=1)


def _compute_brightness(rows: RowSums) -> float:
    roots, count = rows.sum(axis=0)
    return float((roots / max(count, 1.0)) ** 2) + MIN_BRIGHTNESS


def _compute_mean_log_depth(rows: RowSums) -> float:
    logarithms, seen = rows.sum(axis=0)
    return float(logarithms / seen) if seen else 0.0


def join_measured(levels: Sequence[float], rows: RowSums, camera: Camera | None, height: int) -> WholeImage:
    """Return what was measured of a whole image from the results of `measure_rows` of all its rows."""
    return WholeImage(
        levels=levels,
        brightness=_compute_brightness(rows[:, :2]),
        mean_log_depth=_compute_mean_log_depth(rows[:, 2:]),
        tau=0.0 if camera is None else default_tau(camera, height),
    )
