"""The features of the distance on the screen: a Gaussian, a tent, and a Gaussian as wide as a lobe's blur."""

from __future__ import annotations

from dataclasses import dataclass

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E, log2
from lobewise.features.base import DeclaredFeature, Offset, Pixel, Stage, Vector
from lobewise.lobes.vectors import dot
from lobewise.records.frame import FloatArray


@dataclass(frozen=True, eq=False, repr=False)
class ScreenFeature(DeclaredFeature):
    """Gaussian of the distance on the screen.

    Parameters
    ----------
    sigma : float
        Standard deviation, pixels, > 0.
    """

    name = "screen"
    sigma: float

    def get_parameters(self) -> tuple[float, ...]:
        return (0.5 * LOG2_E / self.sigma**2,)

    def log2_similarity(self, i: Pixel, j: Pixel, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        return -dot(offset, offset) * parameters[0]


@dataclass(frozen=True, eq=False, repr=False)
class TentFeature(DeclaredFeature):
    """Tent over the distance on the screen, ``(1 - |x| / width) (1 - |y| / width)``: bilinear interpolation.

    Parameters
    ----------
    width : float
        Distance at which the tent is 0, the distance of samples, pixels, > 0.
    """

    name = "tent"
    width: float

    def get_parameters(self) -> tuple[float, ...]:
        return (1.0 / self.width,)

    def log2_similarity(self, i: Pixel, j: Pixel, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        sides = [hl.max(hl.f32(1.0) - hl.abs(step) * parameters[0], hl.f32(0.0)) for step in offset]
        return log2(hl.max(sides[0] * sides[1], hl.f32(1e-38)))


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
