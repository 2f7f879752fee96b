"""The feature that compares normals alone: the geometry-aware baseline."""

from __future__ import annotations

from dataclasses import dataclass

import halide as hl

from lobewise.backend.expressions import LOG2_E, dot
from lobewise.features.base import DeclaredFeature, Offset, Stage, Vector
from lobewise.frame import FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class NormalFeature(DeclaredFeature):
    """Geometry-aware baseline: ``exp(-exponent (1 - n_i . n_j))``, the usual cosine power for nearby normals.

    Parameters
    ----------
    normal : array, shape (height, width, 3)
        Unit shading normals.
    exponent : float
        Sharpness of the comparison, > 0; ``1/sqrt(exponent)`` is its standard deviation in radians.
    """

    name = "normal"
    normal: FloatArray
    exponent: float

    def get_parameters(self) -> tuple[float, ...]:
        return (self.exponent * LOG2_E,)

    def prepare(self, inputs: Vector, parameters: Vector) -> Vector:
        root = hl.sqrt(parameters[0])
        return [component * root for component in inputs]

    def log2_similarity(self, i: Vector, j: Vector, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        return dot(i, j) - parameters[0]
