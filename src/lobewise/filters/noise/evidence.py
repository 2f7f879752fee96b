"""Compute how much of the noisy image a filtered image takes back: as much as the samples prove the filter wrong.

The mean squared difference of a filtered pixel F and a noisy pixel is the squared error of the filtered pixel plus the
variance of the noisy one. Its excess over the variance, averaged over a neighbourhood, estimates the squared error of
the filter. With halves A and B of the samples the excess is ``(F - A) (F - B)``, a product with independent noise:
a firefly, which one half has, makes the excess vary but does not change its mean. Noise of renders is heavy-tailed, so
only the part of the mean excess above `MARGIN_STANDARD_ERRORS` of its standard errors counts; the standard error is
estimated from the same products. With more samples the margin and the variance vanish, and the result tends to the
noisy image wherever the filter blurs.

Source: the unbiased product of halves is that of cross-validation between half buffers (Rousselle, Knaus and Zwicker
2012; Bitterli et al. 2016); the best share of two estimates is the inverse-variance weight. The margin of standard
errors is our own.
"""

from __future__ import annotations

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector
from lobewise.engine.numbers import choose_larger, choose_smaller, make_single
from lobewise.filters.noise.pooling import (
    POOLING_REACH,
    add_channels,
    average_light,
    blur_image,
    count_weights,
    estimate_noise,
    gather_noise,
)
from lobewise.records.frame import FloatArray

MARGIN_STANDARD_ERRORS = 2.2
"""Standard errors subtracted from the mean excess; chosen among 1.7, 2.2 and 3
(docs/developers/research/quality_trials.md)."""
BLUR_COUNT = 4
"""Number of blurs. Each blurs the result of the one before with taps twice as far apart. Their standard deviations are
1, 2.2, 4.6 and 9.2 pixels."""
FIRST_BLUR = 1
"""First blur that counts: fewer than 60 products do not estimate their own spread well."""
EVIDENCE_REACH: int = POOLING_REACH + 2 * (2**BLUR_COUNT - 1)
"""Distance of the farthest pixel that affects a pixel's share, rows or columns."""
MAX_CONCENTRATION = 4.0
"""Largest error of a pixel over the mean error of its neighbourhood; the pixel's squared difference decides. Filters
steered by guides err along edges and textures (docs/developers/research/quality_trials.md)."""
_MIN_SQUARE = 1e-30


def estimate_noisy_share(
    filtered: FloatArray,
    noisy: FloatArray,
    *,
    halves: tuple[FloatArray, FloatArray],
    floor: float,
    shared: bool = False,
) -> FloatArray:
    """Return the share of the noisy image that minimises the error of a mixture of both, as far as it is certain.

    Parameters
    ----------
    filtered : array, shape (height, width, 3)
        Radiance, finite, >= 0.
    noisy : array, shape (height, width, 3)
        The image that was filtered. NaN, infinite and negative pixels do not count.
    halves : two arrays, shape (height, width, 3)
        Means of one half of the samples each; their mean is ``noisy``.
    floor : float
        Added to the squared local luminance that squared differences are divided by, > 0.
    shared : bool
        Whether neighbouring pixels share their noise.

    Returns
    -------
    array, shape (height, width)
        In [0, 1); 0 where the excess is below its margin, and at bad pixels.

    Raises
    ------
    InputError
        If the images differ in size.
    """
    least = make_single(choose_smaller(choose_larger(floor, 1e-24), 1e30))
    noise_images, factor = gather_noise(halves, shared=shared)
    images = {"filtered": filtered, "noisy": noisy, **noise_images}
    (sums,) = engine.pixels(define_excess, images, {"floor": least}, names=["excess"])
    levels = {}
    for number in range(BLUR_COUNT):
        levels[f"sums{number}"] = sums = blur_image(sums, 2**number)
    counts = [count_weights(number) for number in range(FIRST_BLUR, BLUR_COUNT)]
    margins = np.array([MARGIN_STANDARD_ERRORS**2 * factor / count for count in counts], np.float32)
    images = {"noisy": noisy, **levels}
    (share,) = engine.pixels(define_share, images, {"error": margins}, MAX_CONCENTRATION, names=["certain"])
    return share


def define_excess(grid: Grid) -> list[Vector]:
    """Define excess, squared excess and variance, each summed over channels and over the squared local luminance."""
    luminance = average_light(grid, "filtered")
    filtered, noisy = grid.read("filtered"), grid.read("noisy")
    squares, known = estimate_noise(grid, "filtered")
    good = is_good(noisy) & is_good(filtered) & known
    difference = add_channels([(p - q) * (p - q) for p, q in zip(noisy, filtered, strict=True)])
    unit = hl.f32(1.0) / (luminance * luminance + grid.get("floor")[0])
    excess, square = (difference - add_channels(squares)) * unit, add_channels(squares) * unit
    # The squares of larger numbers would overflow. They are fireflies, which prove nothing.
    excess = hl.clamp(excess, hl.f32(-1e12), hl.f32(1e12))
    square = hl.min(square, hl.f32(1e12))
    return [[hl.select(good, value, hl.f32(0.0)) for value in (excess, excess * excess, square)]]


def define_share(grid: Grid, most: float) -> list[Vector]:
    """Define the largest share of any blur: certain error over certain error plus variance; 0 at bad pixels."""
    share: hl.Expr = hl.f32(0.0)
    excess_near, _, variance_near = grid.read("sums0")
    wide = grid.read(f"sums{BLUR_COUNT - 1}")[1]
    for number, error in zip(range(FIRST_BLUR, BLUR_COUNT), grid.get("error"), strict=True):
        excess, square, variance = grid.read(f"sums{number}")
        # Where fireflies are missing by chance, samples are a little too dark and vary too little: use a wide average.
        certain = hl.max(excess - hl.sqrt(error * hl.max(square, wide)), hl.f32(0.0))
        # Excess and variance add up to the squared difference.
        apart = (excess_near + variance_near) / hl.max(excess + variance, hl.f32(_MIN_SQUARE))
        certain = certain * hl.clamp(apart, hl.f32(1.0), hl.f32(most))
        noise = hl.max(variance, variance_near)
        share = hl.max(share, certain / hl.max(certain + noise, hl.f32(_MIN_SQUARE)))
    return [[hl.select(is_good(grid.read("noisy")), share, hl.f32(0.0))]]
