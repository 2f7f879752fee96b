"""Checks of two renders that shall show one frame: whether they show the same surfaces, and how much noise each has."""

from __future__ import annotations

from functools import reduce

import numpy as np

from lobewise.guides.squares import average_square, compute_square_maximum
from lobewise.records.frame import FloatArray, Frame, GBuffer
from lobewise.work.chunks import Chunk, run_chunks

SURFACES = {"normal": "normals", "diffuse_albedo": "albedos", "specular_albedo": "albedos", "position": "positions"}
"""Guides that tell surfaces apart, and the words for them. Another seed samples them elsewhere in the pixel."""
MAX_STEP = 0.2
"""Largest difference of normals and albedos between renders of one surface, beside what neighbours differ by."""
MAX_SHARE_MOVED, MIN_MOVED = 0.005, 8
"""Share of the pixels, and their number, up to which two renders show the same surfaces. Measured
(docs/developers/checks.md): other seeds and other sample counts up to 0.0017, a pan by three pixels 0.03 to 0.2."""
MAX_DOUBT = 0.15
"""Noise of a mean over 7x7 pixels, relative to it, up to which it is compared with that of another render."""
MANY_DEVIATIONS, MIN_CONTRAST = 5.0, 0.04
"""Least difference of two such means that no noise explains: in standard deviations of independent pixels, which a wide
pixel filter makes too small, and as a share of their sum."""
MAX_SHARE_RELIT, MIN_RELIT = 0.01, 32
"""Share and number of the compared pixels up to which the light of two renders is the same."""
MEAN_REACH = 2
"""Pixels around a pixel in which the other render may have the mean light of its surroundings."""
REACH = 1
"""Pixels around a pixel in which the other render may have its surface."""
NOISE_REACH = 3
"""Pixels around a pixel over which noise is measured."""
MIN_MEASURED = 256
"""Pixels below which an image is too small to compare its noise with that of another."""
LEAST_NOISE = 1e-3
"""Noise of a place, over the mean of the image, below which it is not told from none."""


def measure_moved(one: GBuffer, other: GBuffer) -> tuple[float, str]:
    """Return the share of the pixels where two renders show different surfaces, and the guides that tell.

    A pixel counts where neither render has the other's value, nor one between the values, among its neighbours. So
    neither edges count, nor guides that are noise themselves, as those of hair and of blurred surfaces. The share is 0
    where it is as small as between two seeds, and for frames without guides in common.
    """
    moved: dict[str, int] = {}
    for name, words in SURFACES.items():
        first, second = getattr(one, name), getattr(other, name)
        if first is not None and second is not None:
            step = 0.0 if name == "position" else MAX_STEP
            moved[words] = max(_count_apart(first, second, step), moved.get(words, 0))
    if not moved:
        return 0.0, ""
    words = max(moved, key=lambda name: moved[name])
    assert one.shape is not None
    share = moved[words] / (one.shape[0] * one.shape[1])
    return (share, words) if share > MAX_SHARE_MOVED and moved[words] >= MIN_MOVED else (0.0, words)


def _count_apart(one: FloatArray, other: FloatArray, step: float) -> int:
    """Return the number of pixels where each of two guides, (height, width, 3), lies outside of the other's range.

    The range is that of the pixel and its neighbours, widened by as much as they differ, and by ``step``.
    """
    height, width = one.shape[:2]
    apart = np.zeros((height, width), np.bool_)

    def compare(chunk: Chunk) -> None:
        around = [slice(max(part.start - REACH, 0), part.stop + REACH) for part in chunk]
        seen = [np.nan_to_num(each[tuple(around)], posinf=0.0, neginf=0.0) for each in (one, other)]
        high = [compute_square_maximum(each, REACH) for each in seen]
        low = [-compute_square_maximum(-each, REACH) for each in seen]
        spread = [(top - bottom).max(axis=-1, keepdims=True) for top, bottom in zip(high, low, strict=True)]
        margin = np.float32(step) + np.minimum(*spread)
        outside = [
            ((seen[1 - mine] < low[mine] - margin) | (seen[1 - mine] > high[mine] + margin)).any(axis=-1)
            for mine in range(2)
        ]
        inner = [slice(part.start - cut.start, part.stop - cut.start) for part, cut in zip(chunk, around, strict=True)]
        apart[chunk] = (outside[0] & outside[1])[tuple(inner)]

    run_chunks(compare, height, width)
    return int(np.count_nonzero(apart))


def measure_relit(one: FloatArray, other: FloatArray) -> float:
    """Return the share of the pixels whose light differs by more than noise between two renders, (height, width, 3).

    Means over 7x7 pixels are compared where their noise leaves no doubt. A mean counts that lies outside of what those
    around it are in the other render, for both. The share is of the pixels compared, and 0 where it is as small as
    between two seeds.
    """
    grays = [_take_gray(color) for color in (one, other)]
    means = [average_square(gray, NOISE_REACH) for gray in grays]
    known, deviations = np.ones(grays[0].shape, np.bool_), []
    for gray, mean in zip(grays, means, strict=True):
        # The largest variance nearby: where rare bright samples were missed there is none.
        variance = average_square(np.square(gray - mean), NOISE_REACH)
        noise = np.sqrt(compute_square_maximum(variance, NOISE_REACH)) / np.float32(2 * NOISE_REACH + 1)
        known &= (mean > 0.0) & (noise < MAX_DOUBT * mean)
        deviations.append(noise)
    doubt = np.float32(MANY_DEVIATIONS) * np.hypot(*deviations) + np.float32(MIN_CONTRAST) * (means[0] + means[1])
    apart = known
    for mean, its in (means, means[::-1]):
        high, low = compute_square_maximum(its, MEAN_REACH), -compute_square_maximum(-its, MEAN_REACH)
        apart = apart & ((mean > high + doubt) | (mean < low - doubt))
    count, compared = int(np.count_nonzero(apart)), int(np.count_nonzero(known))
    return count / compared if count > MAX_SHARE_RELIT * compared and count >= MIN_RELIT else 0.0


def compare_noise(one: Frame, other: Frame) -> float:
    """Return the variance of the noise of one render over that of another, which is the ratio of their samples.

    The renders show the same light with independent noise: what the deviations from the neighbours have in common is
    texture, and the rest is noise. Places count alike, as a few bright samples hold most of the noise of an image. The
    ratio is 1 where there is too little to measure.
    """
    images = [_take_gray(frame.radiance.color) for frame in (one, other)]
    if images[0].size < MIN_MEASURED:
        return 1.0
    deviations = [image - average_square(image, 1) for image in images]
    squares = [average_square(first * second, NOISE_REACH) for first, second in _pair(deviations)]
    noises = [squares[0] - squares[1], squares[2] - squares[1]]
    means = [float(np.mean(noise, dtype=np.float64)) for noise in noises]
    if not all(mean > 0.0 for mean in means):
        return 1.0
    logs = [
        np.log(np.maximum(noise, LEAST_NOISE * mean), dtype=np.float64)
        for noise, mean in zip(noises, means, strict=True)
    ]
    return float(np.exp(np.mean(logs[0] - logs[1])))


def _pair(deviations: list[FloatArray]) -> list[tuple[FloatArray, FloatArray]]:
    one, other = deviations
    return [(one, one), (one, other), (other, other)]


def _take_gray(color: FloatArray) -> FloatArray:
    """Return the brightness of an image, 0 in bad pixels, (height, width)."""
    with np.errstate(all="ignore"):
        gray: FloatArray = reduce(np.add, (color[..., k] for k in range(3)))
    return np.where(np.isfinite(gray), gray, np.float32(0.0))
