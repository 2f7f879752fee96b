"""How much of the noisy image a filtered one takes back: where the samples themselves say that the filter is wrong.

The squared difference of a filtered pixel and a noisy one is, in the mean, the squared error of the first plus the
variance of the second. Its excess over that variance, averaged over a neighbourhood, is the error of the filter. With
halves of the samples the excess is ``(F - A) (F - B)``, a product of independent errors: fireflies, which one half has,
make it vary and have no mean of their own. Noise of renders is heavy-tailed, so the mean excess counts only by how far
it exceeds its own standard error, which is estimated from the same products. As samples grow, that margin and the
variance vanish, and what is returned tends to the noisy image wherever the filter blurs.

Source: the unbiased product of halves is that of cross-validation between half buffers (Rousselle, Knaus and Zwicker
2012; Bitterli et al. 2016); the best share of two estimates is the inverse-variance weight. The lower bound by the
standard error is our own.
"""

from __future__ import annotations

import halide as hl
import numpy as np

from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector, run_pointwise
from lobewise.filters.noise.pooling import REACH as POOLING_REACH
from lobewise.filters.noise.pooling import (
    add_channels,
    average_light,
    blur_image,
    count_weights,
    estimate_noise,
    gather_noise,
)
from lobewise.frame import FloatArray

STANDARD_ERRORS = 2.2
"""By so many the mean excess is lowered before it counts; chosen among 1.7, 2.2 and 3 (docs/quality.md)."""
LEVELS = 4
"""Neighbourhoods, each a blur of the one before with taps twice as far apart: 1, 2.2, 4.6 and 9.2 pixels wide (standard
deviations)."""
FIRST_LEVEL = 1
"""The narrowest neighbourhood that is believed: fewer than 60 products say little of their own spread."""
REACH: int = POOLING_REACH + 2 * (2**LEVELS - 1)
"""Pixels to each side that tell on a pixel's share."""
_SMALLEST = 1e-30


def find_noisy_share(
    filtered: FloatArray,
    noisy: FloatArray,
    *,
    halves: tuple[FloatArray, FloatArray] | None = None,
    variance: FloatArray | None = None,
    floor: float,
    shared: bool = False,
    by_darker: bool = False,
    concentration: float = 1.0,
) -> FloatArray:
    """Return the share of the noisy image with which a mixture of both has the least error, as far as that is certain.

    Parameters
    ----------
    filtered : array, shape (height, width, 3)
        Radiance, finite, >= 0.
    noisy : array, shape (height, width, 3)
        What it was filtered from. Pixels that are NaN, infinite or negative are bad: they take no part.
    halves : two arrays, shape (height, width, 3), optional
        Means of one half of the samples each, whose mean is ``noisy``.
    variance : array, shape (height, width, 3), optional
        Of ``noisy``; looked at without halves. The noise is what it says, and no less than the residual of the
        difference: variances that renderers write are of samples or of means, and blind to what few samples hit.
    floor : float
        Added to the squared local luminance, which differences are relative to, > 0.
    shared : bool
        Whether neighbouring pixels share their noise.
    by_darker : bool
        Whether that luminance is the smaller of the filtered and the noisy image's: what a filter made too bright does
        not make its own error small. Else it is the filtered one's, which has less noise.
    concentration : float
        How many times the mean error of a neighbourhood a pixel may have, >= 1, by how its squared difference compares
        with that of the neighbourhood. Filters that guides tell err along edges; with 1 the error is spread evenly.

    Returns
    -------
    array, shape (height, width)
        In [0, 1); 0 where nothing is certain, and at bad pixels.

    Raises
    ------
    InputError
        If the images differ in size.
    """
    told, factor = gather_noise(halves, variance, shared=shared)
    images = {"filtered": filtered, "noisy": noisy, **told}
    (sums,) = run_pointwise(_define_excess, images, {"floor": np.float32(min(max(floor, 1e-24), 1e30))}, by_darker)
    levels = []
    for number in range(LEVELS):
        sums = blur_image(sums, 2**number)
        levels.append(sums)
    wide = np.ascontiguousarray(levels[-1][..., 1])
    share = np.zeros(wide.shape, np.float32)
    for number in range(FIRST_LEVEL, LEVELS):
        held = {"sums": levels[number], "near": levels[0], "wide": wide, "share": share}
        error = STANDARD_ERRORS**2 * factor / count_weights(number)
        numbers = {"error": np.float32(error), "most": np.float32(concentration)}
        (share,) = run_pointwise(_define_share, held, numbers)
    (share,) = run_pointwise(_define_kept, {"share": share, "noisy": noisy}, {})
    return np.asarray(share)


def _define_excess(grid: Grid, by_darker: bool) -> list[Vector]:
    """Define excess, its square, and variance; each a sum of the channels, over the local luminance squared."""
    luminance = average_light(grid, "filtered")
    if by_darker:
        luminance = hl.min(luminance, average_light(grid, "noisy"))
    filtered, noisy = grid.read("filtered"), grid.read("noisy")
    squares, known = estimate_noise(grid, "filtered")
    good = is_good(noisy) & is_good(filtered) & known
    difference = add_channels([(p - q) * (p - q) for p, q in zip(noisy, filtered, strict=True)])
    unit = hl.f32(1.0) / (luminance * luminance + grid.get("floor")[0])
    excess, square = (difference - add_channels(squares)) * unit, add_channels(squares) * unit
    # Larger numbers would overflow when they are squared; they are fireflies, and certain of nothing.
    excess = hl.clamp(excess, hl.f32(-1e12), hl.f32(1e12))
    square = hl.min(square, hl.f32(1e12))
    return [[hl.select(good, value, hl.f32(0.0)) for value in (excess, excess * excess, square)]]


def _define_share(grid: Grid) -> list[Vector]:
    """Define the larger of the share so far and of this neighbourhood's: certain error over that and the variance."""
    excess, square, variance = grid.read("sums")
    excess_near, _, variance_near = grid.read("near")
    # Where no firefly fell by chance, all samples are a little too dark, and nothing near tells how much they vary.
    square = hl.max(square, grid.read_one("wide"))
    certain = hl.max(excess - hl.sqrt(grid.get("error")[0] * square), hl.f32(0.0))
    # Excess and variance add up to the squared difference.
    apart = (excess_near + variance_near) / hl.max(excess + variance, hl.f32(_SMALLEST))
    certain = certain * hl.clamp(apart, hl.f32(1.0), grid.get("most")[0])
    noise = hl.max(variance, variance_near)
    return [[hl.max(grid.read_one("share"), certain / hl.max(certain + noise, hl.f32(_SMALLEST)))]]


def _define_kept(grid: Grid) -> list[Vector]:
    """Define the share where the noisy image is good."""
    return [[hl.select(is_good(grid.read("noisy")), grid.read_one("share"), hl.f32(0.0))]]
