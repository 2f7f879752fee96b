"""Whether a history still holds: what this frame's samples say of it.

Guides tell that a surface or a lobe is another one; they do not tell that a light went out, or that something else is
reflected. Samples do, through their noise: the mean of many differences between sample and history must be as small as
their deviation allows.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lobewise.denoising.layers import Layer
from lobewise.frame import FloatArray
from lobewise.kernels.engine import run_upsampling
from lobewise.temporal.sums import WEIGHT, Samples, divide

TRUST_RADIUS = 2
"""Samples from the centre to the edge of the window in which history and samples are compared."""
TRUST_FROM, TRUST_TO = 6.0, 2.0
"""Standard errors of that comparison from which a history counts nothing, and up to which it counts whole."""
TRUST_FLOOR = 0.02
"""Relative difference that is no change."""


def find_trust(
    layer: Layer,
    samples: Samples,
    history: FloatArray,
    scale: int,
    place: tuple[int, int],
    own: float,
    device: str,
) -> FloatArray:
    """Return how far this frame's samples bear out the history, 0 to 1, shape (height, width).

    At the shaded pixels sample and history are two estimates of one thing, and around each of them the
    lobe-weighted mean of their difference is held against its own deviation, colour by colour. What holds for the
    samples holds for the pixels that resemble them.

    Parameters
    ----------
    layer : Layer
        What is filtered, and by which features.
    samples : Samples
        Those of this frame.
    history : array, shape (height, width, 7)
        Sums; see `lobewise.kernels.history`.
    scale, place : int and (int, int)
        Which pixels were shaded; 1 and (0, 0) for a whole frame.
    own : float
        What a pixel's own sample counts in the sums, >= 1.
    device : str
        Where the kernels run.
    """
    there = history[samples.where]
    # A history that was only ever borrowed is not held against samples that have no noise.
    known = samples.good & (there[..., WEIGHT] > 0.5 * own)
    if not known.any():
        return np.ones(layer.mask.shape, np.float32)
    before = divide(there)
    grid: dict[str, Any] = {"scale": scale, "place": place, "device": device}
    excess = np.zeros(known.shape, np.float32)
    for channel in range(3):
        old = before[..., channel]
        difference = np.where(known, samples.radiance[..., channel] - old, np.float32(0.0))
        with np.errstate(over="ignore"):
            pieces = np.stack([np.maximum(difference, 0.0), np.maximum(-difference, 0.0), difference**2], axis=-1)
        pieces = np.where(known[..., None], pieces, np.float32(np.nan))
        near = run_upsampling(pieces, layer.mask, layer.features, radius=TRUST_RADIUS, shaded_only=True, **grid)
        mean = np.abs(near.image[..., 0] - near.image[..., 1])
        count = near.effective_samples
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            error = np.sqrt(np.maximum(near.image[..., 2] - mean**2, 0.0) / (count - 1.0))
            high = mean / (error + TRUST_FLOOR * (old + mean))
        # One sample alone tells nothing of its deviation.
        excess = np.where(np.isfinite(high) & (count > 1.5) & known, np.maximum(excess, high), excess)
    low = np.clip((TRUST_FROM - excess) / (TRUST_FROM - TRUST_TO), 0.0, 1.0).astype(np.float32)
    trusted = np.repeat(low[..., None], 3, axis=-1)
    spreading = run_upsampling(trusted, layer.mask, layer.features, radius=TRUST_RADIUS if scale == 1 else 1, **grid)
    return np.where(spreading.weight_sum > 0.0, spreading.image[..., 0], np.float32(1.0))
