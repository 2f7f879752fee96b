"""Pixels that no filter gave anything to, filled from the nearest others on the screen."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.bad_pixels import find_good
from lobewise.features import Feature, ScreenFeature
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.forms import ATROUS_REACH
from lobewise.frame import FloatArray
from lobewise.sparse_frame import AnyFrame

SIGMAS: tuple[float | None, ...] = (1.0, 16.0, None)
"""Standard deviations, pixels, over which the nearest are looked for, one after the other; at last all that there are
within the kernel."""
REFILL_REACH = len(SIGMAS) * ATROUS_REACH
"""Pixels from which a hole is told anything: each round reads what the one before it filled."""


def refill(image: FloatArray, holes: NDArray[np.bool_], mean: FloatArray, device: str) -> FloatArray:
    """Return ``image`` with the pixels of ``holes`` replaced by the mean of the nearest others on the screen.

    Parameters
    ----------
    image : (height, width, 3)
        What is outside the holes is finite.
    holes : bool array, (height, width)
        What is to be replaced.
    mean : (3,)
        What a hole becomes that has nothing else in its reach.
    device : str
        A name from `list_devices`.
    """
    everywhere = np.ones(holes.shape, dtype=bool)
    source = np.where(holes[..., None], np.float32(np.nan), image)
    for sigma in SIGMAS:
        features: list[Feature] = [] if sigma is None else [ScreenFeature(sigma)]
        filled = run_filter(source, everywhere, features, form="atrous", radius=0, device=device)
        reached = holes & (filled.weight_sum > 0.0)
        source = np.where(reached[..., None], filled.image, source)
        holes = holes & ~reached
        if not holes.any():
            return source
    return np.where(holes[..., None], mean, source)


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
