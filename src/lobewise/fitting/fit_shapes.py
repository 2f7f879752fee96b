"""Fitted lobes as rows of numbers that a search may change freely."""

from __future__ import annotations

import math

import numpy as np

from lobewise.fitting.arrays import Array
from lobewise.lobes.gaussian import GGX_MIXTURES

# Range of the logarithm of sharpness. Flatter lobes all look alike, and closed forms for their products fail.
_LOG_SHARPNESS_RANGE = (math.log(0.5), math.log(1e7))


class LobeFamily:
    """The shapes that a lobe can take, as rows of numbers that the search changes freely.

    If ``flat``, axes stay in the plane of incidence and a row is (tilt, log sharpness...). Otherwise it is
    (tilt, side, [twist,] log sharpness...). The tilt is the angle of the axis from the normal, away from the viewer.
    The side is the angle of the axis from the plane of incidence. Angles are in radians.
    """

    def __init__(self, kind: str, *, flat: bool) -> None:
        self.kind = kind
        self.flat = flat
        angles = 1 if flat else 3 if kind == "asg" else 2
        self.first = angles
        self.size = angles + (2 if kind == "asg" else 1)
        self.low = np.full(self.size, -np.inf)
        self.high = np.full(self.size, np.inf)
        self.low[angles:], self.high[angles:] = _LOG_SHARPNESS_RANGE

    def make_start(self, cosine: float, alpha: Array, covariance: Array, lobes: int) -> Array:
        """Return start rows for a search: the Gaussians that approximate GGX best, reflected (Xu et al. 2013)."""
        mirror = math.atan2(math.sqrt(max(0.0, 1.0 - cosine * cosine)), cosine)
        precision = np.diag(np.maximum(1.0 / alpha**2 - 1.0, 0.02))
        if not self.flat:
            # Take the orientation of the ellipse of half vectors from the data, and its size from alpha.
            shape = np.linalg.inv(covariance)
            precision = shape * math.sqrt(np.linalg.det(precision) / np.linalg.det(shape))
        # A step of the half vector moves the light 2 times as far in the plane of incidence, 2 n.v times across it.
        warp = np.asarray([0.5, 0.5 / max(cosine, 0.1)])
        precision = precision * warp[:, None] * warp
        rows = np.zeros((lobes, self.size))
        rows[:, 0] = mirror
        scale = np.log(GGX_MIXTURES[lobes][0])
        values, vectors = np.linalg.eigh(precision)
        # A half vector that moves along y moves the light along the lobe's x; one along x, against the lobe's y.
        if self.kind == "sg":
            rows[:, -1] = scale + math.log(2.0) + 0.5 * math.log(np.linalg.det(precision))
            if not self.flat:
                # Spread the axes along the ellipse: one common axis is a stationary point of the search.
                spread = np.linspace(-0.5, 0.5, lobes) if lobes > 1 else np.zeros(1)
                rows[:, :2] += spread[:, None] * vectors[:, 0] * [-1.0, 1.0] / math.sqrt(values[0])
        elif self.flat:
            rows[:, 1:] = scale[:, None] + np.log([precision[1, 1], precision[0, 0]])
        else:
            rows[:, 2] = math.atan2(-vectors[0, 1], vectors[1, 1])
            rows[:, 3:] = scale[:, None] + np.log(values[::-1])
        return np.clip(rows, self.low, self.high)

    def to_frames(self, rows: Array) -> tuple[Array, Array, Array]:
        """Return (axis, sharpness, twist) of rows (..., size), as in a `LobeTable`."""
        tilt, none = rows[..., 0], np.zeros(rows.shape[:-1])
        side = none if self.flat else rows[..., 1]
        axis = np.stack([-np.sin(tilt) * np.cos(side), np.sin(side), np.cos(tilt) * np.cos(side)], axis=-1)
        if self.kind == "sg":
            return axis, np.repeat(0.5 * np.exp(rows[..., -1:]), 2, axis=-1), none
        twist = none if self.flat else np.arctan2(np.sin(rows[..., 2]), np.cos(rows[..., 2]))
        return axis, np.exp(rows[..., -2:]), twist

    def move(self, rows: Array, old: float, new: float) -> Array:
        """Return rows of the view at n.v = ``old`` moved to n.v = ``new``: mirrored, and warped as GGX is."""
        moved = rows.copy()
        moved[:, 0] += math.acos(new) - math.acos(old)
        ratio = math.log(max(old, 0.1) / max(new, 0.1))
        moved[:, self.first] += ratio if self.kind == "sg" else 2.0 * ratio
        return moved

    def turn(self, rows: Array, angle: float) -> Array:
        """Return rows of a view from straight above, as seen after its azimuth has grown by ``angle``."""
        x, y, z = np.moveaxis(self.to_frames(rows)[0], -1, 0)
        turned = rows.copy()
        ahead = math.cos(angle) * x + math.sin(angle) * y
        turned[:, 0] = np.arctan2(-ahead, z)
        if not self.flat:
            turned[:, 1] = np.arcsin(np.clip(math.cos(angle) * y - math.sin(angle) * x, -1.0, 1.0))
            turned[:, 2 : self.first] -= angle
        return turned

    def align(self, rows: Array, neighbour: Array) -> Array:
        """Return rows with x and y of each lobe named so that the twist is nearest to the neighbour's.

        A lobe does not change if it is twisted by a quarter turn and its two sharpnesses are swapped.
        """
        aligned = rows.copy()
        if self.flat or self.kind == "sg":
            return aligned
        quarters = np.round((neighbour[:, 2] - rows[:, 2]) / (0.5 * math.pi))
        aligned[:, 2] += 0.5 * math.pi * quarters
        swapped = np.asarray(quarters % 2.0 == 1.0)
        aligned[swapped, 3:] = aligned[swapped, :2:-1]
        return aligned

    def evaluate(self, row: Array, light: Array) -> Array:
        """Return the value of one row's lobe, of amplitude 1, in directions (n, 3)."""
        side = 0.0 if self.flat else row[1]
        sine, cosine = math.sin(row[0]), math.cos(row[0])
        in_plane = cosine * light[:, 2] - sine * light[:, 0]
        z = math.cos(side) * in_plane + math.sin(side) * light[:, 1]
        if self.kind == "sg":
            return np.asarray(np.exp(math.exp(row[-1]) * (z - 1.0)))
        x = math.cos(side) * light[:, 1] - math.sin(side) * in_plane
        y = -cosine * light[:, 0] - sine * light[:, 2]
        if not self.flat:
            turn = math.cos(row[2]), math.sin(row[2])
            x, y = turn[0] * x + turn[1] * y, turn[0] * y - turn[1] * x
        exponent = math.exp(row[-2]) * (x * x) + math.exp(row[-1]) * (y * y)
        return np.asarray(np.exp(-exponent) * np.maximum(z, 0.0))
