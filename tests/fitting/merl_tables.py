"""BRDFs tabulated in MERL's layout: the inverse of reading a MERL file, for tests and benchmarks."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.fitting.merl import BINS, PHI_D, SCALES, THETA_D, THETA_H, MerlBrdf

Array = NDArray[Any]


def from_half_difference(theta_h: ArrayLike, theta_d: ArrayLike, phi_d: ArrayLike) -> tuple[Array, Array]:
    """Return (view, light), shape (..., 3), with these angles and the half vector in the plane y = 0, x >= 0."""
    theta_h, theta_d, phi_d = (np.asarray(angle, dtype=np.float64) for angle in (theta_h, theta_d, phi_d))
    theta_h, theta_d, phi_d = np.broadcast_arrays(theta_h, theta_d, phi_d)
    sine, cosine = np.sin(theta_h), np.cos(theta_h)
    x, y, z = np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)
    light = np.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=-1)
    view = np.stack([sine * z - cosine * x, -y, cosine * z + sine * x], axis=-1)
    return view, light


def get_bin_centres() -> tuple[Array, Array, Array]:
    """Return the angles (theta_h, theta_d, phi_d) at the centres of the bins: 90, 90 and 180 numbers."""
    theta_h = 0.5 * math.pi * ((np.arange(THETA_H) + 0.5) / THETA_H) ** 2
    theta_d = 0.5 * math.pi * (np.arange(THETA_D) + 0.5) / THETA_D
    return theta_h, theta_d, math.pi * (np.arange(PHI_D) + 0.5) / PHI_D


def make_merl(brdf: Callable[[Array, Array], Any], name: str = "") -> MerlBrdf:
    """Return an isotropic BRDF tabulated at the centres of the bins.

    ``brdf(view, light)`` takes unit vectors of shape (n, 3) and returns 1/sr, shape (n,) or (n, 3).
    """
    centres_h, centres_d, centres_p = get_bin_centres()
    samples = np.zeros((*BINS, 4), dtype=np.float32)
    for index, theta_h in enumerate(centres_h):
        view, light = from_half_difference(theta_h, centres_d[:, None], centres_p)
        above = (view[..., 2] > 0.0) & (light[..., 2] > 0.0)
        values = np.asarray(brdf(view[above], light[above]))
        samples[index, above, :3] = values if values.ndim == 2 else values[:, None]
        samples[index, above, 3] = 1.0
    samples.flags.writeable = False
    return MerlBrdf(name, samples)


def to_bytes(brdf: MerlBrdf) -> bytes:
    """Return the bytes of a MERL file. Samples that were not measured become -1."""
    planes = np.empty((3, *BINS), dtype="<f8")
    for channel, scale in enumerate(SCALES):
        np.divide(brdf.samples[..., channel], scale, out=planes[channel])
    planes[:, brdf.samples[..., 3] == 0.0] = -1.0
    return np.asarray(BINS, dtype="<i4").tobytes() + planes.tobytes()
