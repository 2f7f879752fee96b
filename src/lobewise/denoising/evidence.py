"""The evidence of the samples about a result: where it lost detail, and whether it is worse than its input."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.chunks import cut_rows
from lobewise.denoising.bad_pixels import blacken_bad, find_good
from lobewise.denoising.networks import load_networks
from lobewise.filters.mixing import Network
from lobewise.filters.noise.detail import find_detail
from lobewise.filters.noise.evidence import count_certain, find_noisy_share
from lobewise.filters.noise.pooling import DARK_SHARE
from lobewise.filters.noise.shares import find_shares
from lobewise.frame import FloatArray, Frame
from lobewise.metrics.images import EPSILON

MAX_CONCENTRATION = 4.0
"""Concentration that `find_noisy_share` expects of the error of our filters: this error lies along edges and textures
(docs/research/quality_trials.md)."""
MIN_SHARE_BLURRED = 0.01
"""Share of the pixels. The user is told if a result has clearly more error than its input in more of them."""
MAX_RADIANCE = 1e36
"""Radiance above which no share of a pixel is taken back, because sums of it overflow."""
Rows = NDArray[np.float64]
STRIP_ROWS = 32
"""Rows of a strip. What the user is told about blur is counted in strips, each an image of its own."""
MAX_STRIP_STEP = 4
"""Strips, of which one is counted in a high image. A quarter of the rows tells the share of the image."""
MIN_STRIPS = 4
"""Smallest number of strips that is counted, as far as the image has so many."""


def find_share_lost(
    frame: Frame, samples: FloatArray, image: FloatArray, level: float, *, refined: bool = False
) -> FloatArray:
    """Return the share of the noisy image to take back where the filter removed detail, (height, width), in [0, 1].

    Parameters
    ----------
    frame : Frame
        The noisy frame.
    samples : array, shape (height, width, 3)
        The noisy image; see `lobewise.filters.fireflies.cut_samples`.
    image : array, shape (height, width, 3)
        The filtered image: the sum of the layers and of the light that is in no layer.
    level : float
        Mean light of the samples of the whole image, radiance over albedo, > 0.
    refined : bool
        Whether the refining network made the image.
    """
    image, color, halves = blacken_bad(image), samples, find_image_halves(frame)
    shared = frame.noise_is_shared
    network = load_networks()["refined" if refined else "noisy"]
    share = find_share_taken_back(image, color, network, halves=halves, level=level, shared=shared)
    if halves is not None:
        share = np.maximum(share, find_share_proved(image, color, halves, level=level, shared=shared))
    # The parts are added later, and near the largest float their sum overflows.
    return np.where(np.max(color, axis=-1) < MAX_RADIANCE, share, np.float32(0.0))


def find_share_proved(
    image: FloatArray, samples: FloatArray, halves: tuple[FloatArray, FloatArray], *, level: float, shared: bool
) -> FloatArray:
    """Return the share of the noisy image that its halves prove to be missing, (height, width), in [0, 1).

    No network is asked, so that the share is right on textures unlike any of the training, too.

    Parameters
    ----------
    image, samples : (height, width, 3)
        The result so far, finite and >= 0, and the noisy image.
    halves : two arrays, (height, width, 3)
        Means of one half of the samples each.
    level : float
        About the mean luminance of the whole image, > 0.
    shared : bool
        Whether neighbouring pixels share their noise.
    """
    floor = (DARK_SHARE * level) ** 2
    return find_noisy_share(image, samples, halves=halves, floor=floor, shared=shared, concentration=MAX_CONCENTRATION)


def find_image_halves(frame: Frame) -> tuple[FloatArray, FloatArray] | None:
    """Return the images of both halves of the samples, None where the frame has no halves."""
    a, b = frame.half_a, frame.half_b
    return None if a is None or b is None else (a.color, b.color)


def find_share_taken_back(
    filtered: FloatArray,
    noisy: FloatArray,
    network: Network,
    *,
    halves: tuple[FloatArray, FloatArray] | None,
    level: float,
    shared: bool,
) -> FloatArray:
    """Return the share of the noisy image at which a network expects the least error of the mixture.

    The network was trained on random scenes, with and without guides and halves (``benchmarks/training/shares.py``).

    Parameters
    ----------
    filtered, noisy, halves, level, shared
        As in `lobewise.filters.noise.detail.find_detail`.
    network : Network
        Its two outputs are the shares of the noisy and of the filtered image.

    Returns
    -------
    array, shape (height, width)
        In [0, 1]; 0 at bad pixels.
    """
    share = np.empty(noisy.shape[:2], np.float32)
    for rows, seen in find_detail(filtered, noisy, halves=halves, level=level, shared=shared):
        share[rows] = find_shares(seen, network, 2)[..., 0]
    share[~find_good(noisy)] = 0.0
    return share


def mix_noisy(part: FloatArray, noisy: FloatArray, share: FloatArray) -> FloatArray:
    """Return a filtered part with a share, (height, width), of its samples; where these are not finite, the part."""
    mixed = np.empty_like(part)
    for chunk in cut_rows(*share.shape):  # a chunk stays in the core's cache
        here, before = mixed[chunk], part[chunk]
        # Shares of their own for every channel: NumPy is several times slower where it spreads them.
        shares = np.repeat(share[chunk], 3, axis=1).reshape(before.shape)
        with np.errstate(invalid="ignore", over="ignore"):
            # A negative part counts as no light, as in the total.
            np.subtract(np.maximum(noisy[chunk], np.float32(0.0)), before, out=here)
            here *= shares
            here += before
        np.copyto(here, before, where=~(np.isfinite(here) & (shares > 0.0)))
    return mixed


def count_blurred(
    frame: Frame, image: FloatArray, band: tuple[int, int] | None = None, top: int = 0, height: int | None = None
) -> Rows:
    """Return for each strip of an image the pixels with clearly more error than the input, and all of its pixels.

    The count does not read the halves of the samples, because the quality "fast" does not read them either. Low images
    are counted whole, and of high ones a strip of every `MAX_STRIP_STEP`.

    Parameters
    ----------
    frame : Frame
        The noisy frame, or some of its rows.
    image : array, shape (height, width, 3)
        The result, of the same rows.
    band : two int, optional
        Rows of the whole frame, first and end: the strips that begin there are counted. The ``frame`` goes on for
        `STRIP_ROWS` rows beyond, as far as the whole one does. By default all rows.
    top : int
        First row of ``frame`` in the whole frame.
    height : int, optional
        Rows of the whole frame; by default those of ``frame``.

    Returns
    -------
    array, shape (strips, 2)
    """
    height = frame.height if height is None else height
    first, end = band or (0, height)
    step = STRIP_ROWS * min(max(height // (STRIP_ROWS * MIN_STRIPS), 1), MAX_STRIP_STEP)
    variance = None if frame.variance is None else frame.variance.color
    counts = []
    for start in range(-(-first // step) * step, end, step):
        rows = slice(start - top, min(start + STRIP_ROWS, height) - top)
        blurred = count_certain(
            image[rows],
            frame.radiance.color[rows],
            variance=None if variance is None else variance[rows],
            floor=EPSILON,
            shared=frame.noise_is_shared,
        )
        counts.append((blurred, (rows.stop - rows.start) * frame.width))
    return np.array(counts, np.float64).reshape(-1, 2)


def describe_blurred(strips: Rows) -> tuple[str, ...]:
    """Return the sentence that a result has more error than its input in a part of the image, or none.

    Parameters
    ----------
    strips : array, shape (strips, 2)
        Result of `count_blurred`.
    """
    blurred, count = strips.sum(axis=0) if len(strips) else (0.0, 0.0)
    if not blurred >= MIN_SHARE_BLURRED * max(count, 1.0):
        return ()
    return (
        f"In {100.0 * blurred / count:.0f} % of the image this filter blurs by more than the noise was, as the samples "
        "tell: there the noisy image is nearer to the truth. The qualities 'balanced' and 'high' keep what they blur; "
        "with 'fast' a smaller radius helps.",
    )
