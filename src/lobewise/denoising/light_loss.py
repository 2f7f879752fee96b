"""The light of an image before and after: what its filter lost is shared out, and where that is much it is told.

A filter that knows noise loses light: fireflies are bounded, and what is brighter than its neighbours counts less. So
the sum of a layer's light falls, by a quarter in rooms that the sun lights through small windows. What a layer lost is
shared out over its pixels, in proportion to their light but no more than to `MAX_TAKER` of the layer's mean, so that
shadows stay dark and spots that are still too bright take no more than others. Most of it was lost where no pixel
tells; so it goes everywhere, too thin to be seen.

Whether a filter clearly took light away is told by the change of its mean against the noise of that mean. Fireflies are
light that the scene has, found by few samples: a mean without them is too dark, one with them is noisy. Which it is,
their share alone does not tell: one of them may hold 4 % of an image whose mean is right by chance. So the change of
the mean is compared with its standard error, from the squared residuals of all pixels; what k equal fireflies add to a
mean is sqrt(k) of its errors. Source of the residual: `lobewise.filters.noise.residuals`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.bad_pixels import find_good
from lobewise.denoising.layers import Layer
from lobewise.filters.noise.residuals import DIFFERENCES, SHARED_NOISE_VARIANCE, SHARED_STEP
from lobewise.frame import FloatArray, Frame

MIN_SHARE_BOUNDED = 1e-3
"""Share of the light that was taken from fireflies, below which they are not the cause of a change."""
MIN_SHARE_LOST = 0.01
"""Share of the mean below which nobody misses it: a seventieth of a stop."""
MIN_STANDARD_ERRORS = 2.5
"""Of the noisy image's mean: below, its noise may be the change. Measured on 87 frames of Blender, LuxCore and Mitsuba
with references (benchmarks/foreign): the 12 that are told lack 5 to 25 % of their reference's light (LuxCore's
``sparks``), no other lacks more than 3 %; at 2 one more would be told, which lacks 1.9 %."""
MAX_TAKER = 0.5
"""Times the layer's mean light, over albedo, above which a pixel takes no more of what is shared out."""
MAX_SHARED_AS_NOISE = 0.01
"""Share of a layer's filtered light that is shared out even if it is no more than the noise of the layer's mean."""
MAX_GAIN_PER_FIREFLY = 0.02
"""Share of their light by which pixels grow at most, for each of the equal fireflies that would lose as much, once by
what takes part and once by all. A few pixels may hold more light than all others: they tell nothing of the mean, and
would make the image several times as bright."""
MAX_TAKERS_GAIN, MAX_GAIN = 1.0, 4.0
"""By how much the light that takes part in sharing grows at most; what is left goes to all light in proportion, which
grows by no more than the second."""
MAX_FALL = 0.5
"""Share of its light that a layer loses at most, where its filter added some."""
ROWS_AT_ONCE = 128

Rows = NDArray[np.float64]


def find_takers(layer: Layer, part: FloatArray, level: float) -> FloatArray:
    """Return by which share of its light a pixel takes part in what is shared out, (height, width), in [0, 1].

    What is no part of the layer passes as it is, and takes nothing.

    Parameters
    ----------
    layer : Layer
        Whose light it is.
    part : array, shape (height, width, 3)
        The layer, filtered; what is not finite or negative takes nothing.
    level : float
        Mean light of the layer's samples, over albedo.
    """
    light = _add_channels(np.where(find_good(part)[..., None], part, np.float32(0.0)))
    bound = np.full_like(light, 3.0)
    if layer.albedo is not None:
        bound = _add_channels(np.where(find_good(layer.albedo)[..., None], layer.albedo, np.float32(0.0)))
    bound *= MAX_TAKER * level
    share = np.divide(bound, light, out=np.zeros_like(light), where=layer.mask & (light > 0.0))
    return np.minimum(share, 1.0).astype(np.float32)


def sum_missing(layer: Layer, part: FloatArray, taker: FloatArray, rows: slice = slice(None)) -> Rows:
    """Return for some rows of a layer, over good pixels, what `find_gain` asks for, (rows, 5).

    They are the sums of its noisy light, of what the filtered ``part`` lacks of it, of the square of that, of the light
    that takes part in sharing, and of all light of the pixels that take part. Light is the sum of the three channels.
    """
    found = []
    for noisy, done, share in zip(layer.radiance[rows], part[rows], taker[rows], strict=True):
        good = find_good(noisy) & find_good(done)
        before, after = (np.where(good, _add_channels(image), 0.0) for image in (noisy, done))
        missing = before - after
        sums = before, missing, missing * missing, after * share, np.where(share > 0.0, after, 0.0)
        # Row by row, so that rows add up to the same bits however an image was cut into bands of them.
        found.append([one.sum() for one in sums])
    return np.array(found, np.float64).reshape(-1, 5)


class Gain(NamedTuple):
    """What the light of a layer gains, as shares of it: what takes part in sharing, and all of the same pixels."""

    takers: float = 0.0
    all: float = 0.0

    def sum_light(self, rows: Rows) -> float:
        """Return the light that is shared out, the sum of all pixels and channels, from what `sum_missing` gave."""
        taking, whole = rows[:, 3:].sum(axis=0)
        return float(self.takers * taking + self.all * whole)


def find_gain(rows: Rows) -> Gain:
    """Return what the light of a layer gains.

    Of k equal fireflies, and nothing else, the share ``1 - 1/k^2`` is shared out: the error of what is missing is the
    root of the sum of its squares. Pixels grow by no more than `MAX_GAIN_PER_FIREFLY` for each of them, whatever these
    hold.
    """
    _, missing, squared, taking, whole = (float(each) for each in rows.sum(axis=0))
    if not (taking > 0.0 and squared > 0.0 and math.isfinite(squared)) or missing == 0.0:
        return Gain()
    fireflies = max(missing * missing / squared, 1.0)
    known = (1.0 - fireflies**-2.0) * abs(missing)
    shared = max(known, min(abs(missing), MAX_SHARED_AS_NOISE * whole))
    most = MAX_GAIN_PER_FIREFLY * fireflies
    if missing < 0.0:
        return Gain(all=-min(shared / whole, most, MAX_FALL))
    takers = min(shared / taking, most, MAX_TAKERS_GAIN)
    return Gain(takers, min((shared - takers * taking) / whole, most, MAX_GAIN))


def brighten(image: FloatArray, part: FloatArray, taker: FloatArray, gain: Gain) -> FloatArray:
    """Return an image, (height, width, 3), with the light that a layer's ``part`` gains."""
    if not any(gain):
        return image
    factor = np.where(taker > 0.0, np.float32(gain.takers) * taker + np.float32(gain.all), np.float32(0.0))
    return np.asarray(image + part * factor[..., None], np.float32)


def find_share_missing(rows: Sequence[Rows], gains: Sequence[Gain]) -> float:
    """Return which share of the light of all layers is missing after sharing, in [0, 1]."""
    noisy = missing = 0.0
    for each, gain in zip(rows, gains, strict=True):
        sums = each.sum(axis=0)
        noisy, missing = noisy + float(sums[0]), missing + float(sums[1]) - gain.sum_light(each)
    # Rounding leaves a little behind.
    return min(missing / noisy, 1.0) if missing > 1e-6 * noisy else 0.0


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
        sums = (noisy[core], _add_channels(image[top:end]), squared if step == 1 else SHARED_NOISE_VARIANCE * squared)
        lit = [np.where(good[core], one, 0.0) for one in sums]
        # Row by row, so that rows add up to the same bits however an image was cut into bands of them.
        found += [[one[row].sum(dtype=np.float64) for one in lit] for row in range(end - top)]
    return np.array(found, np.float64).reshape(-1, 3)


def describe_loss(rows: Rows, share_bounded: float) -> tuple[str, ...]:
    """Return the sentence that light was moved, or none where the noise explains the change.

    Parameters
    ----------
    rows : array, shape (height, 3)
        What `sum_light` gave, of the image before its light is shared out.
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
        f"{100.0 * lost:.2g} % of the light was shared out over the image, more than its noise explains "
        f"({100.0 * error:.2g} %): very bright pixels that few samples hit (fireflies, as of caustics and small lamps) "
        "were bounded; the image stays as bright, but where this light falls is not known; to see it, render more "
        "samples, or use larger lamps or an integrator that finds them.",
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
