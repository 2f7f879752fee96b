"""Whether a history still holds: what this frame's samples say of it.

Guides tell that a surface or a lobe is another one; they do not tell that a light went out, or that something else is
reflected. Samples do, through their noise: the mean of many differences between sample and history must be as small as
their deviation allows.
"""

from __future__ import annotations

import numpy as np

from lobewise.filters.runs import SampleGrid
from lobewise.frame import FloatArray
from lobewise.temporal.sums import WEIGHT, Samples, divide

TRUST_RADIUS = 2
"""Samples from the centre to the edge of the window in which history and samples are compared."""
TRUST_FROM, TRUST_TO = 6.0, 2.0
"""Standard errors of that comparison from which a history counts nothing, and up to which it counts whole."""
TRUST_FLOOR = 0.02
"""Relative difference that is no change."""


def find_trust(grid: SampleGrid, samples: Samples, history: FloatArray, own: float) -> FloatArray:
    """Return how far this frame's samples bear out the history, 0 to 1, at the pixels that were shaded.

    There sample and history are two estimates of one thing, and around each of them the lobe-weighted mean of their
    difference is held against its own deviation, colour by colour. What holds for the samples holds for the pixels
    that resemble them.

    Parameters
    ----------
    grid : SampleGrid
        Which pixels were shaded, and by which features they resemble each other.
    samples : Samples
        Those of this frame.
    history : array, shape (height, width, 7)
        Sums; see `lobewise.filters.reprojection`.
    own : float
        What a pixel's own sample counts in the sums, >= 1.
    """
    there = np.ascontiguousarray(history[samples.where])
    # A history that was only ever borrowed is not held against samples that have no noise.
    known = samples.good & (there[..., WEIGHT] > 0.5 * own)
    excess = np.zeros(known.shape, np.float32)
    if not known.any():
        return np.ones(known.shape, np.float32)
    before = divide(there)
    pieces = np.empty((*known.shape, 3), np.float32)
    for channel in range(3):
        old = before[..., channel]
        # What is no number weighs nothing.
        difference = np.where(known, samples.radiance[..., channel] - old, np.float32(np.nan))
        with np.errstate(over="ignore"):
            np.maximum(difference, 0.0, out=pieces[..., 0])
            np.maximum(-difference, 0.0, out=pieces[..., 1])
            np.square(difference, out=pieces[..., 2])
        near = grid.join(pieces, radius=TRUST_RADIUS, demodulate=False, modulate=False, shaded_only=True)
        mean = np.abs(near.image[..., 0] - near.image[..., 1])
        count = near.effective_samples
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            error = np.sqrt(np.maximum(near.image[..., 2] - mean**2, 0.0) / (count - 1.0))
            high = mean / (error + TRUST_FLOOR * (old + mean))
        # One sample alone tells nothing of its deviation.
        excess = np.where(np.isfinite(high) & (count > 1.5) & known, np.maximum(excess, high), excess)
    return np.asarray(np.clip((TRUST_FROM - excess) / (TRUST_FROM - TRUST_TO), 0.0, 1.0), dtype=np.float32)


def spread_trust(grid: SampleGrid, trust: FloatArray) -> FloatArray:
    """Return the trust of every pixel, (height, width), from that of the shaded ones; 1 where none resembles it."""
    three = np.repeat(trust[..., None], 3, axis=-1)
    radius = find_trust_radius(grid)
    spreading = grid.join(three, radius=radius, demodulate=False, modulate=False)
    return np.where(spreading.weight_sum > 0.0, spreading.image[..., 0], np.float32(1.0))


def find_trust_radius(grid: SampleGrid) -> int:
    """Return the samples from the centre to the edge of the window from which a pixel takes its trust."""
    return TRUST_RADIUS if grid.size == grid.shape else 1
