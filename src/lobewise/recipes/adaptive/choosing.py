"""Which pixels to shade again, and with how many samples."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.layers import compute_exact_light, mark_surface
from lobewise.errors import InputError
from lobewise.filters.noise.expected import expect_error
from lobewise.records.frame import Result
from lobewise.records.sparse_frame import AnyFrame

USUAL_SPP_OF_IMAGE = 3.2
"""Samples per pixel of the whole image that shading pixels again may cost: 64 for 5 % of the pixels."""
MIN_WEIGHT = 0.05
"""Weight sum below which a pixel is shaded again; a sample that matches fully has the weight 1."""
MIN_SHARE_OF_MEDIAN = 0.5
"""Share of the median weight sum below which a pixel is shaded again where no guides are known."""
MIN_SPP, MAX_SPP = 16, 256
"""Bounds of the samples of a pixel that is shaded again."""


def find_unsupported(
    result: Result,
    *,
    budget: float = 0.05,
    frame: AnyFrame | None = None,
) -> NDArray[np.bool_]:
    """Return which pixels to shade again, shape (height, width).

    With ``frame`` the pixels of weight below `MIN_WEIGHT` come first, then those whose expected error is largest: their
    noise times the contrast around them. The noise is the variance of the result over its squared light, or the
    inverse of the effective samples where the result tells no variance. Blurred edges and small highlights have
    contrast. Pixels without a surface are never taken.

    Parameters
    ----------
    result : Result
        A result of `lobewise.upsample`, `lobewise.denoise` or `lobewise.TemporalFilter.add`.
    budget : float
        Largest share of the pixels, 0 to 1.
    frame : Frame or SparseFrame, optional
        The frame of the result. Without it the pixels of lowest weight sum are taken, of those below `MIN_WEIGHT` or
        `MIN_SHARE_OF_MEDIAN`.

    Raises
    ------
    InputError
        If the budget is out of range.
    """
    if not 0.0 <= budget <= 1.0:
        raise InputError("budget", expected="a number from 0 to 1", got=str(budget), action="0.05 is usual")
    result = result.convert()
    weight = result.weight_sum
    count = int(budget * weight.size)
    if frame is not None:
        return _mark_uncertain(result, frame, count)
    median = float(np.median(weight))
    unsupported = (weight < MIN_WEIGHT) | (weight < MIN_SHARE_OF_MEDIAN * median)
    if np.count_nonzero(unsupported) > count:
        # Order pixels of equal weight by place, so that every machine chooses the same pixels.
        limit = np.partition(weight[unsupported], count)[count]
        less = unsupported & (weight < limit)
        equal = np.flatnonzero(unsupported & (weight == limit))
        unsupported = less
        unsupported.flat[equal[: count - np.count_nonzero(less)]] = True
    return np.asarray(unsupported)


def _mark_uncertain(result: Result, frame: AnyFrame, count: int) -> NDArray[np.bool_]:
    """Return the pixels of surfaces that have no support, then those of the largest expected error."""
    noise = {"variance": result.variance, "effective_samples": result.effective_samples}
    expected = expect_error(result.image, exact=compute_exact_light(frame), **noise)
    # Pixels without support come first, those of the lowest weight before others.
    surface = mark_surface(frame)
    order = np.where(surface, expected, np.float32(0.0)).ravel()
    lacking = np.flatnonzero((result.weight_sum < MIN_WEIGHT) & surface)
    order[lacking] = expected.max(initial=0.0) * (2.0 - result.weight_sum.ravel()[lacking] / MIN_WEIGHT) + 1.0
    if count < np.count_nonzero(order):
        limit = np.partition(order, order.size - count)[order.size - count] if count else np.inf
        # Pixels of equal rank are taken by place, so that every machine chooses the same pixels.
        equal = np.flatnonzero(order == limit)
        chosen = order > limit
        chosen[equal[: count - np.count_nonzero(chosen)]] = True
    else:
        chosen = order > 0.0
    return chosen.reshape(expected.shape)


def choose_spp(budget: float) -> int:
    """Return the samples of each pixel that is shaded again, a multiple of 16 from 16 to 256.

    Few pixels get many samples, and many pixels few: all of them cost as much as `USUAL_SPP_OF_IMAGE` samples per pixel
    of the whole image.

    Parameters
    ----------
    budget : float
        Share of the pixels that is shaded again, above 0, at most 1.

    Raises
    ------
    InputError
        If the budget is out of range.
    """
    if not 0.0 < budget <= 1.0:
        raise InputError("budget", expected="above 0, at most 1", got=str(budget), action="pass another")
    return int(np.clip(round(USUAL_SPP_OF_IMAGE / budget / MIN_SPP) * MIN_SPP, MIN_SPP, MAX_SPP))
