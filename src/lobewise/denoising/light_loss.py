"""Whether an image clearly lost light with its fireflies: the change of its mean against the noise of that mean.

Fireflies are light that the scene has, found by few samples: a mean without them is too dark, one with them is noisy.
Which it is, their share alone does not tell: one of them may hold 4 % of an image whose mean is right by chance. So
the change of the mean is compared with its standard error, from the squared residuals of all pixels; what k equal
fireflies add to a mean is sqrt(k) of its errors. Source of the residual: `lobewise.filters.residuals`.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.bad_pixels import find_good
from lobewise.filters.residuals import DIFFERENCES, SHARED, SHARED_STEP
from lobewise.frame import FloatArray, Frame

MIN_SHARE_BOUNDED = 1e-3
"""Share of the light that was taken from fireflies, below which they are not the cause of a change."""
MIN_SHARE_LOST = 0.01
"""Share of the mean below which nobody misses it: a seventieth of a stop."""
MIN_STANDARD_ERRORS = 2.5
"""Of the noisy image's mean: below, its noise may be the change. Measured on 77 frames of Blender, LuxCore and Mitsuba
with references: all that are told lack 5 to 25 % of their reference's light (the ``sparks`` of LuxCore), none that
lacks less than 4 %; at 2 one would be, which lacks 1.9 % (benchmarks/foreign)."""

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
    good = find_good(frame.radiance.color) & ~bad
    noisy = np.where(good, _add_channels(frame.radiance.color), np.nan)
    squared = _find_squared_residual(noisy, shared=frame.noise_is_shared)[rows]
    kept, noisy, done = good[rows], noisy[rows], _add_channels(image[rows])
    found = [np.where(kept, one, 0.0) for one in (noisy, done, squared)]
    # Row by row, so that rows add up to the same bits however an image was cut into bands of them.
    return np.array([[row.sum(dtype=np.float64) for row in one] for one in found]).T


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


def _find_squared_residual(light: NDArray[np.float64], *, shared: bool) -> NDArray[np.float64]:
    """Return the squared residual of every pixel, which stands for neighbours that are bad (NaN) or outside."""
    step = SHARED_STEP if shared else 1
    height, width = light.shape
    around = np.pad(light, step, mode="edge")
    total = np.zeros_like(light)
    for row, down in enumerate(DIFFERENCES):
        for column, across in enumerate(DIFFERENCES):
            there = around[row * step : row * step + height, column * step : column * step + width]
            total += down * across / 6.0 * np.where(np.isnan(there), light, there)
    return (SHARED if shared else 1.0) * total * total
