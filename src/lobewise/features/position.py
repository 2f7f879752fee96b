"""The features that compare surface points: by their distance, and by their distance from each other's plane."""

from __future__ import annotations

import math
from collections.abc import Hashable
from dataclasses import dataclass
from typing import NamedTuple

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E
from lobewise.features.base import DeclaredFeature, Offset, Stage, Vector
from lobewise.lobes.vectors import dot, subtract
from lobewise.records.frame import FloatArray


class PointPlanes(NamedTuple):
    """The planes of a point."""

    place: Vector
    inverse: hl.Expr
    """Scale over the footprint."""


@dataclass(frozen=True, eq=False, repr=False)
class PositionFeature(DeclaredFeature):
    """Gaussian of the distance of two surface points, in units of the footprint of a pixel.

    ``exp(-|p_i - p_j|^2 / (2 sigma^2 f_i f_j))`` with world positions p, or with depths if there are no positions. f is
    the footprint ``depth * pixel_angle``. The geometric mean of both footprints keeps the weight symmetric.

    Parameters
    ----------
    place : array, shape (height, width, 3) or (height, width)
        World position, or depth.
    depth : array, shape (height, width)
        Distance to the camera, world units; pixels with depth <= 0 have no surface.
    pixel_angle : float
        Angle of one pixel, radians, > 0.
    sigma : float
        Standard deviation in pixel footprints, > 0.
    """

    name = "position"
    place: FloatArray
    depth: FloatArray
    pixel_angle: float
    sigma: float

    @property
    def structure(self) -> Hashable:
        return self.place.ndim

    @property
    def neutral(self) -> tuple[float, ...]:
        return (0.0, 0.0, 0.0, 1.0) if self.place.ndim == 3 else (0.0, 1.0)

    def get_parameters(self) -> tuple[float, ...]:
        return (math.sqrt(0.5 * LOG2_E) / (self.sigma * self.pixel_angle),)

    def prepare(self, inputs: Vector, parameters: Vector) -> PointPlanes:
        *place, depth = inputs
        return PointPlanes(place, parameters[0] / hl.max(depth, hl.f32(1e-20)))

    def log2_similarity(
        self, i: PointPlanes, j: PointPlanes, parameters: Vector, offset: Offset, stage: Stage
    ) -> hl.Expr:
        d = subtract(j.place, i.place)
        return -dot(d, d) * (i.inverse * j.inverse)


class TangentPlane(NamedTuple):
    """The planes of a point and of its tangent plane."""

    position: Vector
    normal: Vector
    inverse: hl.Expr
    """Scale over the footprint."""


@dataclass(frozen=True, eq=False, repr=False)
class PlaneFeature(DeclaredFeature):
    """Gaussian of the distances of two surface points from each other's tangent planes, in units of the footprint.

    ``exp(-((n_i . d)^2 + (n_j . d)^2) / (4 sigma^2 f_i f_j))``, d the step between the points and f the footprint
    ``depth * pixel_angle``. Unlike the distance of the points it does not depend on how slanted a surface is seen, so
    it recognises the surface a frame later.

    Parameters
    ----------
    position, normal : array, shape (height, width, 3)
        World positions and unit normals; 0 both where there is no surface.
    footprint : array, shape (height, width)
        Footprint of a pixel, world units, > 0; larger where more distance is allowed, for moving objects.
    sigma : float
        Standard deviation in footprints, > 0.
    """

    name = "plane"
    neutral = (0.0,) * 6 + (1.0,)
    position: FloatArray
    normal: FloatArray
    footprint: FloatArray
    sigma: float

    def get_parameters(self) -> tuple[float, ...]:
        return (math.sqrt(0.25 * LOG2_E) / self.sigma,)

    def prepare(self, inputs: Vector, parameters: Vector) -> TangentPlane:
        position, normal, footprint = self.split(inputs)
        return TangentPlane(position, normal, parameters[0] / hl.max(footprint, hl.f32(1e-20)))

    def log2_similarity(
        self, i: TangentPlane, j: TangentPlane, parameters: Vector, offset: Offset, stage: Stage
    ) -> hl.Expr:
        d = subtract(j.position, i.position)
        above, below = dot(i.normal, d), dot(j.normal, d)
        return -(above * above + below * below) * (i.inverse * j.inverse)
