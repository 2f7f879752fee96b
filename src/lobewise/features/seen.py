"""The feature that compares how far what reflections see is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E
from lobewise.features.base import DeclaredFeature, Offset, Stage, Vector
from lobewise.records.frame import FloatArray


class Distance(NamedTuple):
    """The planes of a hit distance."""

    inverse_distance: hl.Expr
    precision: hl.Expr


@dataclass(frozen=True, eq=False, repr=False)
class HitDistanceFeature(DeclaredFeature):
    """Gaussian of the difference of two inverse hit distances, relative to the larger one.

    ``exp(-(x_i - x_j)^2 / (2 max(x_i, x_j)^2 s_i s_j))`` with x = 1/t: 1 for equal distances, also
    infinite ones. A change of the distance shows that a mirror sees another surface.

    Parameters
    ----------
    inverse_distance : array, shape (height, width)
        1/t, >= 0; 0 where the lobe hits nothing.
    tolerance : array, shape (height, width)
        Standard deviation s of the relative difference, > 0.
    """

    name = "hit_distance"
    neutral = (0.0, 1.0)
    inverse_distance: FloatArray
    tolerance: FloatArray

    def prepare(self, inputs: Vector, parameters: Vector) -> Distance:
        inverse, tolerance = inputs
        return Distance(inverse, hl.f32(math.sqrt(0.5 * LOG2_E)) / hl.max(tolerance, hl.f32(1e-6)))

    def log2_similarity(self, i: Distance, j: Distance, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        largest = hl.max(i.inverse_distance, j.inverse_distance, hl.f32(1e-12))
        step = (i.inverse_distance - j.inverse_distance) / largest
        return -step * step * (i.precision * j.precision)
