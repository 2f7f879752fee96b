"""MERL BRDFs: isotropic materials tabulated over half and difference angles (Matusik et al. 2003).

A table has three axes:
- theta_h, the angle of the half vector from the normal: 90 bins with centres ``pi/2 ((i + 1/2) / 90)^2``, which are
  dense where highlights are;
- theta_d, the angle between the light and the half vector: 90 bins;
- phi_d, the azimuth of the light about the half vector: 180 bins in [0, pi). By reciprocity phi_d + pi is phi_d.

The file holds these counts as three int32, then the red, green and blue planes as little-endian float64. A value times
the scale of its colour is 1/sr. A negative value marks a sample that could not be measured.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import FileError
from lobewise.fitting.arrays import Array, dot

THETA_H, THETA_D, PHI_D = 90, 90, 180
BINS = (THETA_H, THETA_D, PHI_D)
HEADER_BYTES = 12
FILE_BYTES = HEADER_BYTES + 3 * THETA_H * THETA_D * PHI_D * 8
"""Size of every MERL file: 34,992,012 bytes."""
SCALES = (1.0 / 1500.0, 1.15 / 1500.0, 1.66 / 1500.0)
"""1/sr per stored unit of red, green and blue."""

# Directions interpolated at a time: the values gathered for them fit into the cache of a core.
_DIRECTIONS_PER_CHUNK = 8192


@dataclass(frozen=True, eq=False)
class MerlBrdf:
    """A tabulated isotropic BRDF, called as ``brdf(view, light)``.

    Parameters
    ----------
    name : str
        Name of the material.
    samples : (90, 90, 180, 4), float32
        Red, green and blue in 1/sr, then 1. All four are 0 for a sample that was not measured.
    """

    name: str
    samples: NDArray[np.float32]

    @property
    def valid(self) -> NDArray[np.bool_]:
        """Which samples were measured, shape (90, 90, 180)."""
        return np.asarray(self.samples[..., 3] > 0.0)

    def __call__(self, view: ArrayLike, light: ArrayLike) -> Array:
        """Return the BRDF, interpolated trilinearly between the centres of the bins.

        Parameters
        ----------
        view, light : array_like, shape (..., 3)
            Local unit vectors that point away from the surface; z is the normal.

        Returns
        -------
        ndarray, shape (..., 3), float32
            1/sr. Samples that were not measured are left out, and the weights of the others are rescaled. NaN if all
            eight samples are missing; 0 if a direction is below the horizon.
        """
        view, light = np.broadcast_arrays(np.asarray(view, dtype=np.float64), np.asarray(light, dtype=np.float64))
        shape = view.shape
        views, lights = view.reshape(-1, 3), light.reshape(-1, 3)
        out = np.empty((views.shape[0], 3), dtype=np.float32)
        for first in range(0, out.shape[0], _DIRECTIONS_PER_CHUNK):
            part = slice(first, first + _DIRECTIONS_PER_CHUNK)
            out[part] = self._interpolate(*to_half_difference(views[part], lights[part]))
        out[(views[:, 2] <= 0.0) | (lights[:, 2] <= 0.0)] = 0.0
        return out.reshape(shape)

    def _interpolate(self, theta_h: Array, theta_d: Array, phi_d: Array) -> Array:
        position_h = np.clip(THETA_H * np.sqrt(theta_h * (2.0 / math.pi)) - 0.5, 0.0, THETA_H - 1.0)
        position_d = np.clip(THETA_D * (2.0 / math.pi) * theta_d - 0.5, 0.0, THETA_D - 1.0)
        position_p = PHI_D / math.pi * phi_d - 0.5
        low_h = np.minimum(position_h.astype(np.intp), THETA_H - 2)
        low_d = np.minimum(position_d.astype(np.intp), THETA_D - 2)
        floor_p = np.floor(position_p)
        share_h = (position_h - low_h).astype(np.float32)
        share_d = (position_d - low_d).astype(np.float32)
        share_p = (position_p - floor_p).astype(np.float32)
        low_p = floor_p.astype(np.intp) % PHI_D
        high_p = (low_p + 1) % PHI_D
        table = self.samples.reshape(-1, 4)
        total = np.zeros((theta_h.size, 4), dtype=np.float32)
        for step_h, weight_h in ((0, 1.0 - share_h), (1, share_h)):
            for step_d, weight_d in ((0, 1.0 - share_d), (1, share_d)):
                row = ((low_h + step_h) * THETA_D + low_d + step_d) * PHI_D
                weight = weight_h * weight_d
                total += table[row + low_p] * (weight * (1.0 - share_p))[:, None]
                total += table[row + high_p] * (weight * share_p)[:, None]
        known = total[:, 3:]
        return np.asarray(np.where(known > 0.0, total[:, :3] / np.where(known > 0.0, known, 1.0), np.nan))


def to_half_difference(view: ArrayLike, light: ArrayLike) -> tuple[Array, Array, Array]:
    """Return (theta_h, theta_d, phi_d) of a pair of unit vectors (..., 3): thetas in [0, pi / 2], phi_d in [0, pi).

    The angles do not change when the two directions are swapped or turned together about the normal.
    Source: Rusinkiewicz 1998.
    """
    view, light = np.asarray(view, dtype=np.float64), np.asarray(light, dtype=np.float64)
    total, difference = view + light, light - view
    across = np.hypot(total[..., 0], total[..., 1])
    theta_h = np.arctan2(across, total[..., 2])
    # tan(theta_d) is |l - v| / |l + v|. This form has no cancellation at small angles.
    theta_d = np.arctan2(np.sqrt(dot(difference, difference)), np.sqrt(dot(total, total)))
    turned = across > 0.0
    cosine = np.where(turned, total[..., 0], 1.0) / np.where(turned, across, 1.0)
    sine = np.where(turned, total[..., 1], 0.0) / np.where(turned, across, 1.0)
    along = cosine * difference[..., 0] + sine * difference[..., 1]
    x = np.cos(theta_h) * along - np.sin(theta_h) * difference[..., 2]
    y = cosine * difference[..., 1] - sine * difference[..., 0]
    phi_d = np.arctan2(y, x)
    phi_d = np.where(phi_d < 0.0, phi_d + math.pi, phi_d)
    return theta_h, theta_d, np.where(phi_d >= math.pi, 0.0, phi_d)


def parse_merl(data: bytes | bytearray | memoryview, name: str = "") -> MerlBrdf:
    """Return the BRDF that a MERL file holds.

    Parameters
    ----------
    data : bytes-like
        The whole file, 34,992,012 bytes.
    name : str
        Name of the material, for error messages.

    Raises
    ------
    FileError
        If the header is not that of a MERL file, bytes are missing or left over, a value is not finite, or no sample
        was measured.
    """
    what, size = f"MERL file {name!r}", len(memoryview(data).cast("B"))
    counts = tuple(np.frombuffer(data, "<i4", 3).tolist()) if size >= HEADER_BYTES else None
    if counts != BINS:
        raise FileError(
            what,
            expected=f"a MERL header of {THETA_H}, {THETA_D}, {PHI_D} bins",
            got=f"{size} bytes" if counts is None else ", ".join(map(str, counts)),
            action="pass a .binary file in the layout of the MERL database",
        )
    if size != FILE_BYTES:
        got = f"{size}, so {'the end is missing' if size < FILE_BYTES else 'something follows the table'}"
        raise FileError(what, expected=f"{FILE_BYTES} bytes", got=got, action="copy or download it again")
    planes = np.frombuffer(data, "<f8", offset=HEADER_BYTES).reshape(3, *BINS)
    samples = np.empty((*BINS, 4), dtype=np.float32)
    samples[..., 3] = 1.0
    with np.errstate(over="ignore", invalid="ignore"):
        for channel, scale in enumerate(SCALES):
            np.multiply(planes[channel], scale, out=samples[..., channel], casting="unsafe")
    bad = int(np.count_nonzero(~np.isfinite(samples[..., :3])))
    if bad:
        raise FileError(
            what, expected="finite values", got=f"{bad} values that are not", action="copy or download it again"
        )
    return MerlBrdf(name, _drop_unmeasured(samples, what))


def _drop_unmeasured(samples: NDArray[np.float32], what: str) -> NDArray[np.float32]:
    """Set all four numbers of the samples without a measurement to 0, and return the array read-only."""
    with np.errstate(invalid="ignore"):
        good = (samples >= 0.0).all(axis=-1) & np.isfinite(samples).all(axis=-1) & (samples[..., 3] > 0.0)
    samples[~good] = 0.0
    if not samples[..., :3].any():
        got = "a table that is black" if good.any() else "none: all are marked as not measured"
        raise FileError(what, expected="samples above 0", got=got, action="use another material")
    samples.flags.writeable = False
    return samples
