"""The feature of the distance on the screen that knows how far a lobe blurs what it sees."""

from __future__ import annotations

from dataclasses import dataclass

import halide as hl

from lobewise.backend.expressions import LOG2_E, dot
from lobewise.features.base import DeclaredFeature, Offset, Stage, Vector
from lobewise.frame import FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class BandLimitFeature(DeclaredFeature):
    """Screen-space Gaussian whose width follows each pixel's reflection lobe.

    Source: the paper's second comparison ("normal-aware filtering with screen-space bandlimit according to the BRDF
    parameter"); a lobe of sharpness lambda that sees something far away blurs it over
    ``scale / (sqrt(lambda) pixel_angle)`` pixels. Departs: two pixels use the mean of their precisions, which keeps
    the weight symmetric.

    Parameters
    ----------
    sharpness : array, shape (height, width)
        Sharpness of the pixel's lobe, > 0.
    pixel_angle : float
        Angle of one pixel, radians, > 0.
    scale : float
        The constant in front, of order 1, > 0.
    largest_sigma : float
        Upper bound of the standard deviation, pixels, > 0.
    """

    name = "band_limit"
    neutral = (1.0,)
    sharpness: FloatArray
    pixel_angle: float
    scale: float
    largest_sigma: float

    def get_parameters(self) -> tuple[float, ...]:
        return (self.pixel_angle**2 / self.scale**2, 1.0 / self.largest_sigma**2)

    def prepare(self, inputs: Vector, parameters: Vector) -> hl.Expr:
        precision = hl.max(inputs[0] * parameters[0], parameters[1])
        return precision * hl.f32(0.25 * LOG2_E)

    def log2_similarity(self, i: hl.Expr, j: hl.Expr, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        return -dot(offset, offset) * (i + j)
