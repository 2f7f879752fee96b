"""The light that a filter loses: it is shared out over its layer, and the user is told where it is much.

A filter that is guided by the noise loses light: fireflies are bounded, and pixels brighter than their neighbours count
less. So the sum of a layer's light falls, by a quarter in rooms that the sun lights through small windows. The lost
light of a layer is shared out over its pixels, in proportion to their light. The samples do not tell where most of the
lost light belongs, so it goes everywhere, too thin to be seen.

The user is told of a loss if the mean changed by much more than its noise. Fireflies are light of the scene that few
samples found: a mean without them is too dark, and a mean with them is noisy. The share of the fireflies does not tell
these cases apart, because one firefly may hold 4 % of an image whose mean is right by chance. So the change of the mean
is compared with its standard error, from the squared residuals of all pixels: k equal fireflies change a mean by
sqrt(k) standard errors. Source of the residual: `lobewise.filters.noise.residuals`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.denoising.bad_pixels import mark_good
from lobewise.engine.numbers import make_single
from lobewise.filters.glue import define_brightened
from lobewise.filters.noise.residuals import SHARED_NOISE_VARIANCE, SHARED_STEP, compute_residual
from lobewise.lobes.numbers import NUMPY
from lobewise.records.frame import FloatArray, Frame

MIN_SHARE_BOUNDED = 1e-3
"""Share of the light that bounding took from fireflies. Below it, fireflies are not the cause of a change."""
MIN_SHARE_LOST = 0.01
"""Lost share of the mean below which the user is not told: a seventieth of a stop."""
MIN_STANDARD_ERRORS = 2.5
"""Standard errors of the noisy mean below which its noise explains a change. Measured on 87 frames of Blender, LuxCore
and Mitsuba with references (benchmarks/foreign): the user is told of 12 frames, which lack 5 to 25 % of the light of
their references (LuxCore's ``sparks``). No other frame lacks more than 3 %. With 2 standard errors the user would be
told of one more frame, which lacks 1.9 %."""
MAX_SHARED_AS_NOISE = 0.01
"""Share of a layer's filtered light that is shared out even where the noise of the layer's mean explains the loss."""
MAX_GAIN_PER_FIREFLY = 0.02
"""Largest gain of a layer, as a share of its light, for each of the equal fireflies that would explain the loss. A few
pixels may hold more light than all others: they tell nothing of the mean, and would make the image several times as
bright."""
MAX_GAIN = 4.0
"""Largest gain of a layer."""
MAX_FALL = 0.5
"""Largest share of its light that a layer loses where its filter added light."""
ROWS_AT_ONCE = 128
"""Rows whose sums are computed together."""
MISSING_PIXELS_AT_ONCE = 1 << 14
"""Pixels of the rows of a layer whose light is summed together, in 64 bits: few enough for a core's cache."""

RowSums = NDArray[np.float64]


def sum_missing(
    radiance: FloatArray,
    part: FloatArray,
    mask: NDArray[np.bool_],
    rows: slice = slice(None),
    *,
    uncounted: NDArray[np.bool_] | None = None,
) -> RowSums:
    """Return sums over the good pixels of each row, (rows, 5), from which `compute_gain` computes the gain of a layer.

    The images are the layer's noisy and filtered light, (height, width, 3), and its mask, (height, width). The sums
    are: the noisy light; the noisy minus the filtered light; the square of this difference; the filtered light inside
    the mask. The last number is the largest difference, and no sum. Light is the sum of the three channels. Pixels in
    ``uncounted``, (height, width), are left out.
    """
    first, stop, _ = rows.indices(len(part))
    row_sums, height = [np.zeros((0, 5))], max(MISSING_PIXELS_AT_ONCE // part.shape[1], 1)
    for top in range(first, stop, height):
        block = slice(top, min(top + height, stop))
        noisy, done = radiance[block], part[block]
        good = mark_good(noisy) & mark_good(done)
        if uncounted is not None:
            good &= ~uncounted[block]
        before, after = (np.where(good, _add_channels(image), 0.0) for image in (noisy, done))
        missing = before - after
        sums = before, missing, missing * missing, np.where(mask[block], after, 0.0)
        # Sum each row alone: bands of any height then give the same bits.
        row_sums.append(np.stack([*(one.sum(axis=1) for one in sums), missing.max(axis=1)], axis=1))
    return np.concatenate(row_sums)


def compute_gain(rows: RowSums) -> float:
    """Return the gain of a layer: the light that each pixel takes, as a share of its own.

    The standard error of the missing light is the root of the sum of its squares. Where k equal fireflies are all that
    is missing, the share ``1 - 1/k^2`` of it is shared out. Pixels grow by at most `MAX_GAIN_PER_FIREFLY` for each
    firefly, however much light the fireflies hold.
    """
    _, missing, squared, whole = (float(each) for each in rows[:, :4].sum(axis=0))
    # One firefly, which the next frame has not, must not change the light of the image.
    sure = abs(missing) if missing < 0.0 else max(missing - float(rows[:, 4].max(initial=0.0)), 0.0)
    if not (whole > 0.0 and squared > 0.0 and math.isfinite(squared)) or missing == 0.0:
        return 0.0
    fireflies = max(missing * missing / squared, 1.0)
    known = (1.0 - 1.0 / fireflies**2) * abs(missing)
    gain = max(known, min(sure, MAX_SHARED_AS_NOISE * whole)) / whole
    most = MAX_GAIN_PER_FIREFLY * fireflies
    return -min(gain, most, MAX_FALL) if missing < 0.0 else min(gain, most, MAX_GAIN)


class Loss(NamedTuple):
    """The light of a layer.

    Parameters
    ----------
    gain : float
        Its gain; see `compute_gain`.
    noisy, missing : float
        Sums over pixels and channels: the light of its samples, and what is missing of it with the gain.
    """

    gain: float
    noisy: float
    missing: float


def compute_loss(rows: RowSums) -> Loss:
    """Return the light of a layer; ``rows`` are the result of `sum_missing`."""
    gain, sums = compute_gain(rows), rows.sum(axis=0)
    return Loss(gain, float(sums[0]), float(sums[1] - gain * sums[3]))


def measure_gain(radiance: FloatArray, part: FloatArray, mask: NDArray[np.bool_]) -> Loss:
    """Return the gain of a layer, and the light that is missing with it."""
    return compute_loss(sum_missing(radiance, part, mask))


def measure_gain_outside(
    radiance: FloatArray, part: FloatArray, mask: NDArray[np.bool_], uncounted: NDArray[np.bool_]
) -> Loss:
    """Return the gain of a layer, and the light that is missing with it, from pixels outside of a mask."""
    return compute_loss(sum_missing(radiance, part, mask, uncounted=uncounted))


def brighten(
    image: FloatArray, part: FloatArray, mask: NDArray[np.bool_], gain: float, *, name: str = ""
) -> FloatArray:
    """Return an image, (height, width, 3), plus the gain of a layer's ``part``; ``name`` is its name in plans."""
    images, numbers = {"image": image, "part": part, "mask": mask}, {"gain": make_single(gain)}
    (bright,) = engine.pixels(define_brightened, images, numbers, names=[name], text="share light out")
    return bright


def share_light(
    image: FloatArray, parts: Sequence[FloatArray], masks: Sequence[NDArray[np.bool_]], gains: Sequence[float]
) -> tuple[FloatArray, list[FloatArray]]:
    """Return an image, (height, width, 3), and its parts, each with the gains of the layers."""
    bright = []
    for part, mask, gain in zip(parts, masks, gains, strict=True):
        image = brighten(image, part, mask, gain, name="total")
        bright.append(brighten(part, part, mask, gain, name="part"))
    return image, bright


def compute_share_missing(losses: Sequence[Loss]) -> float:
    """Return the share of the light of all layers that is missing after sharing, in [0, 1]."""
    noisy, missing = (sum(each) for each in ([loss.noisy for loss in losses], [loss.missing for loss in losses]))
    # Rounding leaves a little behind.
    return min(missing / noisy, 1.0) if missing > 1e-6 * noisy else 0.0


def sum_light(frame: Frame, image: FloatArray, bad: NDArray[np.bool_], rows: slice = slice(None)) -> RowSums:
    """Return sums over the good pixels of each row: noisy light, light of the result, squared residuals of the mean.

    Parameters
    ----------
    frame : Frame
        The noisy frame. Residuals also read the rows beside ``rows``.
    image : array, shape (height, width, 3)
        The result.
    bad : bool array, shape (height, width)
        Pixels that are NaN, infinite or negative.
    rows : slice
        Rows to sum.

    Returns
    -------
    array, shape (rows, 3)
        Light is the sum of the three channels. Where neighbours share their noise, the noise of the mean is larger, and
        the squared residuals are scaled accordingly.
    """
    first, stop, _ = rows.indices(frame.height)
    color, step = frame.radiance.color, SHARED_STEP if frame.noise_is_shared else 1
    row_sums: list[list[np.float64]] = []
    # Sum block by block: a whole image in 64 bits takes as much memory as its filter.
    for top in range(first, stop, ROWS_AT_ONCE):
        end = min(top + ROWS_AT_ONCE, stop)
        begin = max(top - step, 0)
        wide, core = slice(begin, min(end + step, frame.height)), slice(top - begin, end - begin)
        good = mark_good(color[wide]) & ~bad[wide]
        noisy = np.where(good, _add_channels(color[wide]), np.nan)
        squared = _compute_squared_residual(noisy, step)[core]
        sums = (noisy[core], _add_channels(image[top:end]), squared if step == 1 else SHARED_NOISE_VARIANCE * squared)
        lit = [np.where(good[core], one, 0.0) for one in sums]
        # Sum each row alone: bands of any height then give the same bits.
        row_sums += [[one[row].sum(dtype=np.float64) for one in lit] for row in range(end - top)]
    return np.array(row_sums, np.float64).reshape(-1, 3)


def describe_loss(rows: RowSums, share_bounded: float) -> tuple[str, ...]:
    """Return the sentence that tells the user of a loss, or nothing where the noise explains it.

    Parameters
    ----------
    rows : array, shape (height, 3)
        Result of `sum_light` for the image before its light is shared out.
    share_bounded : float
        Share of the light that bounding took from fireflies, in [0, 1].
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


def _compute_squared_residual(light: NDArray[np.float64], step: int) -> NDArray[np.float64]:
    """Return the squared residual of every pixel. A pixel replaces its neighbours that are bad (NaN) or outside."""
    height, width = light.shape
    around = np.pad(light, step, mode="edge")
    has_bad = bool(np.isnan(light).any())

    def take(dx: int, dy: int) -> list[NDArray[np.float64]]:
        there = around[step + dy : step + dy + height, step + dx : step + dx + width]
        return [np.where(np.isnan(there), light, there) if has_bad else there]

    (residual,) = compute_residual(NUMPY, take, step)
    return np.asarray(residual * residual)
