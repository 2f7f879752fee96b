"""The features that compare normals: the cosine lobe of diffuse reflection, and the geometry-aware baseline."""

from __future__ import annotations

from dataclasses import dataclass

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E
from lobewise.features.base import DeclaredFeature, Offset, Stage, Vector
from lobewise.lobes.vectors import dot, subtract
from lobewise.records.frame import FloatArray

# With x = 1 - cos d, 2^-(x (c0 + c1 x + ...)) approximates the Lambert similarity ((pi - d) cos d + sin d) / pi within
# 3.8e-3 for every angle d. It is monotonic and needs neither logarithm nor root.
LAMBERT_COEFFICIENTS = (1.53062855, -1.35309751, 3.48856559, -2.92217656, 0.91606498)


@dataclass(frozen=True, eq=False, repr=False)
class DiffuseFeature(DeclaredFeature):
    """Overlap of two Lambert lobes, ``((pi - d) cos d + sin d) / pi`` at the normal angle d, to the power beta.

    Parameters
    ----------
    normal : array, shape (height, width, 3)
        Unit shading normals.
    beta : float
        Exponent, > 0.
    """

    name = "diffuse"
    normal: FloatArray
    beta: float

    def log2_similarity(self, i: Vector, j: Vector, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        d = subtract(j, i)
        x = hl.f32(0.5) * dot(d, d)
        quotient = hl.f32(LAMBERT_COEFFICIENTS[-1])
        for coefficient in LAMBERT_COEFFICIENTS[-2::-1]:
            quotient = quotient * x + hl.f32(coefficient)
        return -parameters[0] * (x * quotient)


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
