"""What reflections see, compared: the albedo and the normal of what a lobe hits."""

from __future__ import annotations

from collections.abc import Sequence

import halide as hl

from lobewise.features.base import LOG2_E, Feature, Pixel, Stage, dot, require_positive, subtract
from lobewise.frame import FloatArray


class SeenFeature(Feature):
    """Gaussian of the differences of what two lobes see, ``exp(-a |d albedo|^2 - n |d normal|^2)``.

    Parameters
    ----------
    albedo, normal : array, shape (height, width, 3)
        Means of albedo, in [0, 1], and normal of what the lobes hit.
    albedo_sharpness, normal_sharpness : float
        a and n, > 0.
    """

    name = "seen"

    def __init__(
        self, albedo: FloatArray, normal: FloatArray, *, albedo_sharpness: float, normal_sharpness: float
    ) -> None:
        self.albedo = albedo
        self.normal = normal
        self.albedo_sharpness = require_positive("albedo sharpness", albedo_sharpness)
        self.normal_sharpness = require_positive("normal sharpness", normal_sharpness)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.albedo, self.normal

    def get_parameters(self) -> tuple[float, ...]:
        return self.albedo_sharpness * LOG2_E, self.normal_sharpness * LOG2_E

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        albedo, normal = subtract(i[:3], j[:3]), subtract(i[3:], j[3:])
        return -(dot(albedo, albedo) * parameters[0] + dot(normal, normal) * parameters[1])
