"""What a history is and how samples are added to it, written out in NumPy: the oracle of the kernels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.bad_pixels import mark_good
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.history.accumulation_pass import MIN_WEIGHT
from lobewise.filters.history.sums import HISTORY_CHANNELS
from lobewise.frame import FloatArray
from lobewise.lobes.vectors import LUMINANCE

WEIGHT, SQUARED_WEIGHT, MOMENT, FRAMES = 3, 4, 5, 6
"""Channels beside the weighted radiance over albedo, 0 to 2."""


@dataclass(frozen=True)
class Samples:
    """The samples of one layer at the pixels that were shaded.

    Parameters
    ----------
    where : pair of slice
        The shaded pixels, as an index into images of the full size.
    radiance : array, shape (rows, columns, 3)
        Their radiance over albedo; 0 where bad.
    good : bool array, shape (rows, columns)
        Which of them count.
    """

    where: tuple[slice, slice]
    radiance: FloatArray
    good: NDArray[np.bool_]

    @property
    def luminance(self) -> FloatArray:
        """Luminance of the radiance over albedo."""
        return compute_luminance(self.radiance)


def compute_luminance(image: FloatArray) -> FloatArray:
    """Return the luminance of an image of three channels or more, whose first three count."""
    return np.asarray(sum(np.float32(share) * image[..., k] for k, share in enumerate(LUMINANCE)), dtype=np.float32)


def gather_samples(
    radiance: FloatArray,
    albedo: FloatArray | None,
    mask: NDArray[np.bool_],
    where: tuple[slice, slice],
    floor: float = ALBEDO_FLOOR,
) -> Samples:
    """Return the samples of a layer but the bad ones.

    As in the filter, an albedo below ``floor`` tells nothing of the light. Without noise a lower one still does.
    """
    good = mark_good(radiance) & mask[where]
    if albedo is not None:
        tint = albedo[where]
        good &= mark_good(tint) & (np.maximum(np.maximum(tint[..., 0], tint[..., 1]), tint[..., 2]) > floor)
        with np.errstate(invalid="ignore", over="ignore"):
            radiance = np.asarray(radiance / np.maximum(tint, np.float32(floor)), dtype=np.float32)
    return Samples(where, np.where(good[..., None], radiance, np.float32(0.0)).astype(np.float32), good)


def make_sums(
    image: FloatArray,
    weight_sum: FloatArray,
    effective_samples: FloatArray,
    moment: FloatArray,
    factor: FloatArray,
    history: FloatArray | None = None,
) -> FloatArray:
    """Return what this frame's filter gathered as sums, every weight times ``factor``, and the history's with them.

    Parameters
    ----------
    image, weight_sum, effective_samples, moment
        See `lobewise.filters.cross_filter.FilterOutput`.
    factor : array, shape (height, width)
        What a weight of 1 counts.
    history : array, shape (height, width, 7), optional
        Sums that are added.

    Returns
    -------
    array, shape (height, width, 7)
    """
    height, width = weight_sum.shape
    sums = np.empty((height, width, HISTORY_CHANNELS), np.float32)
    weight = weight_sum * factor
    weight = np.where(weight > 0.0, np.maximum(weight, np.float32(MIN_WEIGHT)), np.float32(0.0))
    with np.errstate(over="ignore", invalid="ignore"):
        np.multiply(image, weight[..., None], out=sums[..., :3])
        np.multiply(moment, weight, out=sums[..., MOMENT])
        sums[..., WEIGHT] = weight
        sums[..., SQUARED_WEIGHT] = weight * weight / np.maximum(effective_samples, np.float32(1.0))
        sums[..., FRAMES] = weight > 0.0
        if history is not None:
            sums += history
    return sums


def add_own_samples(sums: FloatArray, samples: Samples, bonus: FloatArray, counted: FloatArray | float = 0.0) -> None:
    """Add to the sums of the shaded pixels their own sample.

    Parameters
    ----------
    sums : array, shape (height, width, 7)
        Changed in place.
    samples : Samples
        What to add; bad ones are left out.
    bonus : array, shape (height, width)
        Its weight.
    counted : array, shape (height, width), or float
        The weight that it has in the sums already, so that both together count as one sample.
    """
    before = np.broadcast_to(np.asarray(counted, dtype=np.float32), bonus.shape)[samples.where]
    more = np.where(samples.good, bonus[samples.where], np.float32(0.0))
    part = sums[samples.where]
    # A sum that overflows is dropped as history; see `lobewise.filters.history.sums`.
    with np.errstate(over="ignore"):
        part[..., :3] += more[..., None] * samples.radiance
        part[..., WEIGHT] += more
        part[..., SQUARED_WEIGHT] += more * (more + 2.0 * before)
        part[..., MOMENT] += more * samples.luminance**2


def fade(sums: FloatArray, share: float | FloatArray) -> FloatArray:
    """Return sums whose samples count ``share`` as much as before, a number or an image."""
    factor = np.asarray(share, dtype=np.float32)
    with np.errstate(invalid="ignore"):
        faded = sums * (factor[..., None] if factor.ndim else factor)
    faded[..., SQUARED_WEIGHT] *= factor
    return np.asarray(faded, dtype=np.float32)


def divide(sums: FloatArray) -> FloatArray:
    """Return the mean radiance over albedo, 0 where there is no weight, (height, width, 3)."""
    weight = sums[..., WEIGHT]
    some = np.where(weight > 0.0, weight, np.float32(np.inf))
    with np.errstate(invalid="ignore"):
        return np.asarray(sums[..., :3] / some[..., None], dtype=np.float32)


def compute_effective_samples(sums: FloatArray) -> FloatArray:
    """Return ``(sum w)^2 / sum w^2``, at least 1, and 0 where there is no weight."""
    weight, squares = sums[..., WEIGHT], sums[..., SQUARED_WEIGHT]
    # In two steps, because the square of a large weight overflows.
    count = weight / np.maximum(squares, np.float32(1e-30)) * weight
    # Between the pixels of a history the sums are interpolated one by one, which does not keep it at 1.
    return np.asarray(np.where(weight > 0.0, np.maximum(count, 1.0), 0.0), dtype=np.float32)


def compute_variance(sums: FloatArray) -> FloatArray:
    """Return the variance of the mean luminance over albedo: that of the samples, over how many they are worth."""
    weight = sums[..., WEIGHT]
    some = np.where(weight > 0.0, weight, np.float32(np.inf))
    with np.errstate(over="ignore", invalid="ignore"):
        spread = sums[..., MOMENT] / some - compute_luminance(divide(sums)) ** 2
    return np.asarray(np.maximum(spread, 0.0) / np.maximum(compute_effective_samples(sums), 1.0), dtype=np.float32)


def summarize(
    sums: FloatArray, unit: FloatArray, albedo: FloatArray | None = None
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """Return what sums tell of every pixel: radiance (height, width, 3), weight sum, effective samples, variance.

    Parameters
    ----------
    sums : array, shape (height, width, 7)
    unit : array, shape (height, width)
        What a weight of 1 counts in them.
    albedo : array, shape (height, width, 3), optional
        Multiplies the radiance, and its square the variance of the luminance.
    """
    image, variance = divide(sums), compute_variance(sums)
    if albedo is not None:
        tint = np.where(mark_good(albedo)[..., None], albedo, np.float32(0.0))
        image = image * tint
        variance = variance * compute_luminance(tint) ** 2
    return image, sums[..., WEIGHT] / unit, compute_effective_samples(sums), variance
