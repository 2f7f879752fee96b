"""What the refining network needs to know of a whole image, measured row by row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.denoising.bad_pixels import find_good
from lobewise.frame import Frame
from lobewise.guides.lobe_fields import default_tau

MIN_BRIGHTNESS = 1e-36
"""Smallest brightness of an image, radiance; a black image has none."""
MAX_RATIO_TO_NEXT = 2.0
"""Largest root of the light of a row's brightest pixel, over that of the next."""
Rows = NDArray[np.float64]


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
    return join_measured(levels, measure_rows(frame), frame.camera, frame.height)


def measure_rows(frame: Frame) -> Rows:
    """Return for each row: roots of the light, their number, logarithms of the depth, their number; summed, (rows, 4).

    The sums of rows have the same bits however an image is cut into bands of rows.
    """
    good = find_good(frame.radiance.color)
    # The sum of three channels near the largest number would overflow.
    light = np.where(good[..., None], frame.radiance.color, np.float32(0.0)).astype(np.float64).mean(axis=-1)
    found = np.zeros((frame.height, 4))
    roots = np.sqrt(light)
    if frame.width > 1:
        # One firefly must not decide how bright the image is.
        roots = np.minimum(roots, MAX_RATIO_TO_NEXT * np.partition(roots, -2, axis=1)[:, -2:-1])
    found[:, 0], found[:, 1] = roots.sum(axis=1, dtype=np.float64), frame.width
    depth = frame.gbuffer.depth
    if depth is not None:
        seen = (depth > 0.0) & np.isfinite(depth)
        found[:, 2] = np.log(np.where(seen, depth, np.float32(1.0))).sum(axis=1, dtype=np.float64)
        found[:, 3] = np.count_nonzero(seen, axis=1)
    return found


def join_measured(levels: Sequence[float], rows: Rows, camera: Camera | None, height: int) -> WholeImage:
    """Return what was measured of a whole image from the results of `measure_rows` of all its rows."""
    roots, count, logarithms, seen = rows.sum(axis=0)
    return WholeImage(
        levels=levels,
        brightness=float((roots / max(count, 1.0)) ** 2) + MIN_BRIGHTNESS,
        mean_log_depth=float(logarithms / seen) if seen else 0.0,
        tau=0.0 if camera is None else default_tau(camera, height),
    )
