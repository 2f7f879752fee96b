"""Whether an image clearly lost light with its fireflies: the change of its mean against the noise of that mean.

Fireflies are light that the scene has, found by few samples: a mean without them is too dark, one with them is noisy.
Which it is, their share alone does not tell: one of them may hold 4 % of an image whose mean is right by chance. So
the change of the mean is compared with its standard error, from the squared residuals of all pixels; what k equal
fireflies add to a mean is sqrt(k) of its errors. Source of the residual: `lobewise.filters.noise.residuals`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.bad_pixels import find_good
from lobewise.filters.noise.residuals import DIFFERENCES, SHARED, SHARED_STEP
from lobewise.frame import FloatArray, Frame

MIN_SHARE_BOUNDED = 1e-3
"""Share of the light that was taken from fireflies, below which they are not the cause of a change."""
MIN_SHARE_LOST = 0.01
"""Share of the mean below which nobody misses it: a seventieth of a stop."""
MIN_STANDARD_ERRORS = 2.5
"""Of the noisy image's mean: below, its noise may be the change. Measured on 87 frames of Blender, LuxCore and Mitsuba
with references (benchmarks/foreign): the 12 that are told lack 5 to 25 % of their reference's light (LuxCore's
``sparks``), no other lacks more than 3 %; at 2 one more would be told, which lacks 1.9 %."""
ROWS_AT_ONCE = 128

Rows = NDArray[np.float64]


def sum_light(frame: Frame, image: FloatArray, bad: NDArray[np.bool_], rows: slice = slice(None)) -> Rows:
    """Return for some rows, over good pixels, the sums of the noisy light, of the result's and of squared residuals.

    Parameters
    ----------
    frame : Frame
        Noisy; rows around those that are asked for tell their residuals.
    image : array, shape (height, width, 3)
        The result.
    bad : bool array, shape (height, width)
        Where a pixel is no radiance.
    rows : slice
        Which rows.

    Returns
    -------
    array, shape (rows, 3)
        Light is the sum of the three channels. The residuals are those of the mean: where neighbours share their noise,
        as much larger.
    """
    first, stop, _ = rows.indices(frame.height)
    color, step = frame.radiance.color, _get_step(frame)
    found: list[list[np.float64]] = []
    # A block at a time: in 64 bits a whole image would take as much memory as its filter.
    for top in range(first, stop, ROWS_AT_ONCE):
        end = min(top + ROWS_AT_ONCE, stop)
        begin = max(top - step, 0)
        wide, core = slice(begin, min(end + step, frame.height)), slice(top - begin, end - begin)
        good = find_good(color[wide]) & ~bad[wide]
        noisy = np.where(good, _add_channels(color[wide]), np.nan)
        squared = _find_squared_residual(noisy, step)[core]
        sums = (noisy[core], _add_channels(image[top:end]), squared if step == 1 else SHARED * squared)
        lit = [np.where(good[core], one, 0.0) for one in sums]
        # Row by row, so that rows add up to the same bits however an image was cut into bands of them.
        found += [[one[row].sum(dtype=np.float64) for one in lit] for row in range(end - top)]
    return np.array(found, np.float64).reshape(-1, 3)


def describe_loss(rows: Rows, share_bounded: float) -> tuple[str, ...]:
    """Return the sentence that light was lost, or none where the noise explains the change.

    Parameters
    ----------
    rows : array, shape (height, 3)
        What `sum_light` gave.
    share_bounded : float
        Share of the light that was taken from fireflies, in [0, 1].
    """
    noisy, done, squared = rows.sum(axis=0) if len(rows) else (0.0, 0.0, 0.0)
    if share_bounded < MIN_SHARE_BOUNDED or not noisy > 0.0:
        return ()
    lost, error = (noisy - done) / noisy, math.sqrt(squared) / noisy
    if not (lost >= MIN_SHARE_LOST and lost >= MIN_STANDARD_ERRORS * error):
        return ()
    return (
        f"The result is {100.0 * lost:.2g} % darker than the noisy image, more than its noise explains "
        f"({100.0 * error:.2g} %): very bright pixels that few samples hit (fireflies, as of caustics and small lamps) "
        "were bounded; to keep their light, render more samples, or use larger lamps or an integrator that finds them.",
    )


def _add_channels(image: FloatArray) -> NDArray[np.float64]:
    return image[..., 0].astype(np.float64) + image[..., 1] + image[..., 2]


def _get_step(frame: Frame) -> int:
    """Return from how many pixels away residuals are taken."""
    return SHARED_STEP if frame.noise_is_shared else 1


def _find_squared_residual(light: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Return the squared residual of every pixel, which stands for neighbours that are bad (NaN) or outside."""
    height, width = light.shape
    around = np.pad(light, step, mode="edge")
    total = np.zeros_like(light)
    for row, down in enumerate(DIFFERENCES):
        for column, across in enumerate(DIFFERENCES):
            there = around[row * step : row * step + height, column * step : column * step + width]
            total += down * across / 6.0 * np.where(np.isnan(there), light, there)
    return total * total
