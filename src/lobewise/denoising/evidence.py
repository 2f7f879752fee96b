"""What the samples say of a result: where the noisy image is better, and whether a result is worse than its input."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.layers import Layer
from lobewise.filters.noise.evidence import find_noisy_share
from lobewise.frame import FloatArray, Frame
from lobewise.metrics.images import EPSILON

MAX_CONCENTRATION = 4.0
"""Of the error of our own filters, which lies along edges and textures (docs/quality.md)."""
DARK_SHARE = 0.03
"""Errors are relative to local luminance, and to this share of the whole image's."""
MIN_SHARE_BLURRED = 0.01
"""Share of the pixels in which a result has clearly more error than its input, from which on one is told."""
Rows = NDArray[np.float64]


def take_back_noisy(
    frame: Frame,
    image: FloatArray,
    layers: Sequence[Layer],
    parts: Sequence[FloatArray],
    level: float,
    concentration: float = 1.0,
) -> list[FloatArray]:
    """Return the parts of a result mixed with the noisy ones, where the noisy image has less error for certain.

    Parameters
    ----------
    frame : Frame
        Noisy.
    image : array, shape (height, width, 3)
        The result: the parts and what is in none of them.
    layers : sequence of Layer
        Those of the frame.
    parts : sequence of arrays, shape (height, width, 3)
        What became of the layers. What is not finite stays.
    level : float
        About the mean luminance of the whole image.
    concentration : float
        As of `lobewise.filters.noise.evidence.find_noisy_share`.
    """
    floor = (DARK_SHARE * level) ** 2
    share = find_noisy_share(
        image,
        frame.radiance.color,
        **_list_noise(frame),
        floor=floor,
        shared=frame.noise_is_shared,
        concentration=concentration,
    )
    if not share.any():
        return list(parts)
    return [_mix(part, layer.radiance, share) for layer, part in zip(layers, parts, strict=True)]


def _mix(part: FloatArray, noisy: FloatArray, share: FloatArray) -> FloatArray:
    with np.errstate(invalid="ignore", over="ignore"):
        # As in the total, a negative part is no light.
        mixed = part + share[..., None] * (np.maximum(noisy, np.float32(0.0)) - part)
    return np.where(np.isfinite(mixed) & (share > 0.0)[..., None], mixed, part)


def _list_noise(frame: Frame) -> dict[str, Any]:
    """Return what a frame tells of its noise: halves of its samples, or a variance, or nothing."""
    a, b = frame.half_a, frame.half_b
    if a is not None and b is not None:
        return {"halves": (a.color, b.color)}
    return {} if frame.variance is None else {"variance": frame.variance.color}


def count_blurred(frame: Frame, image: FloatArray, rows: slice = slice(None)) -> Rows:
    """Return for some rows in how many pixels a result has clearly more error than its input, and how many they have.

    The halves of the samples are not looked at, which the quality "fast" does not read either.

    Parameters
    ----------
    frame : Frame
        Noisy; `lobewise.filters.noise.evidence.REACH` rows around those that are asked for tell on them.
    image : array, shape (height, width, 3)
        The result.
    rows : slice
        Which rows.

    Returns
    -------
    array, shape (rows, 2)
    """
    share = find_noisy_share(
        image,
        frame.radiance.color,
        variance=None if frame.variance is None else frame.variance.color,
        floor=EPSILON,
        shared=frame.noise_is_shared,
        by_darker=True,
    )[rows]
    # With equal errors the best mixture is half of each.
    blurred = np.count_nonzero(share > 0.5, axis=-1)
    return np.stack([blurred, np.full(len(blurred), share.shape[1])], axis=-1).astype(np.float64)


def describe_blurred(rows: Rows) -> tuple[str, ...]:
    """Return the sentence that a result has more error than its input in a part of the image, or none.

    Parameters
    ----------
    rows : array, shape (height, 2)
        What `count_blurred` gave.
    """
    blurred, count = rows.sum(axis=0) if len(rows) else (0.0, 0.0)
    if not blurred >= MIN_SHARE_BLURRED * max(count, 1.0):
        return ()
    return (
        f"In {100.0 * blurred / count:.0f} % of the image this filter blurs by more than the noise was, as the samples "
        "tell: there the noisy image is nearer to the truth. The qualities 'balanced' and 'high' keep what they blur; "
        "with 'fast' a smaller radius helps.",
    )
