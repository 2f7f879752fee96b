"""What is known of a frame's noise: how much there is, and two images in which it is independent."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray, Frame, Radiance
from lobewise.guides.halves import mark_bad, split_checkerboard
from lobewise.sparse_frame import AnyFrame

PARTS = ("color", "diffuse", "specular")
"""Radiance that is filtered, in total and by part."""
NOISE, FALL = 0.0825, 0.56
"""Of `expect_noise`: what it is at 4 samples, and with which power of their count it falls."""


@dataclass(frozen=True)
class Halves:
    """Two images of a frame whose noise is independent.

    Parameters
    ----------
    a, b : Radiance
        The parts of `PARTS` that the frame has. NaN where a half has no sample: a filter gives it weight 0.
    origin : {"file", "neighbours"}
        Whether every pixel has a half of its samples in each, or each has every other pixel.
    """

    a: Radiance
    b: Radiance
    origin: str


def find_halves(frame: Frame) -> Halves:
    """Return two independent images of a frame: the halves of its samples, or else the colours of a checkerboard.

    The halves of the samples serve only where they tell apart whatever the frame does, so that all parts of a half
    come from the same samples. Without them a pixel is in the half of its colour and NaN in the other. A pixel that is
    NaN, infinite or negative in a half becomes NaN there, and stays what it is in the other.
    """
    names = [name for name in PARTS if getattr(frame.radiance, name) is not None]
    a, b = frame.half_a, frame.half_b
    if a is not None and b is not None and all(getattr(half, name) is not None for half in (a, b) for name in names):
        return Halves(_map_parts(names, mark_bad, a), _map_parts(names, mark_bad, b), "file")
    boards = {name: split_checkerboard(getattr(frame.radiance, name)) for name in names}
    even, odd = (Radiance(**{name: both[k] for name, both in boards.items()}) for k in range(2))
    return Halves(even, odd, "neighbours")


def _map_parts(names: list[str], change: Callable[[FloatArray], FloatArray], radiance: Radiance) -> Radiance:
    """Return the named parts of a radiance, changed."""
    return Radiance(**{name: change(getattr(radiance, name)) for name in names})


def estimate_spp(frame: AnyFrame) -> float:
    """Return how many samples per pixel of a well-lit scene the noise is worth, > 0; see `judge_noise`."""
    return judge_noise(list_relative_variances(frame), frame.spp)


def list_relative_variances(frame: AnyFrame) -> NDArray[np.float64]:
    """Return the variance of the mean over its square at every lit pixel, (count,); none without variance."""
    if frame.variance is None:
        return np.empty(0)
    # The square of a very dim mean underflows in float32.
    mean, variance = (
        (image[..., 0].astype(np.float64) + image[..., 1] + image[..., 2]) / 3.0
        for image in (frame.radiance.color, frame.variance.color)
    )
    lit = np.isfinite(mean) & np.isfinite(variance) & (mean > 0.0) & (variance >= 0.0)
    return np.asarray(variance[lit] / mean[lit] ** 2)


def judge_noise(variances: NDArray[np.float64], spp: int | None) -> float:
    """Return how many samples per pixel of a well-lit scene the noise is worth, > 0.

    Where the frame has its variance, the median relative variance of the mean is compared with what a well-lit scene
    has at the same sample count, `expect_noise`. A dim, indirectly lit room is then worth fewer samples than it took.
    Without variance it is the sample count itself, and without that 4.

    Parameters
    ----------
    variances : (count,)
        What `list_relative_variances` gives.
    spp : int or None
        Samples that the frame took.
    """
    if not variances.size:
        return float(spp or 4.0)
    noise = max(float(np.median(variances)), 1e-9)
    if spp is None:
        return float(np.clip(expect_spp(noise), 0.25, 4096.0))
    return spp / float(np.clip(noise / expect_noise(spp), 0.25, 16.0))


def expect_noise(spp: float) -> float:
    """Return the relative variance that the built-in ``showroom`` has at a sample count, its median over the pixels.

    It falls more slowly than 1/spp because few samples hide the tail.
    """
    return NOISE * math.pow(4.0 / spp, FALL)


def expect_spp(noise: float) -> float:
    """Return at how many samples a pixel `expect_noise` is ``noise``."""
    return 4.0 * math.pow(NOISE / noise, 1.0 / FALL)
