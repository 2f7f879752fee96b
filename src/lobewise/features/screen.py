"""The features of the distance on the screen: a Gaussian, and a tent."""

from __future__ import annotations

from dataclasses import dataclass

import halide as hl

from lobewise.backend.expressions import LOG2_E, dot, log2
from lobewise.features.base import DeclaredFeature, Offset, Pixel, Stage, Vector


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
        Pixels from sample to sample, > 0; the tent is 0 from there on.
    """

    name = "tent"
    width: float

    def get_parameters(self) -> tuple[float, ...]:
        return (1.0 / self.width,)

    def log2_similarity(self, i: Pixel, j: Pixel, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        sides = [hl.max(hl.f32(1.0) - hl.abs(step) * parameters[0], hl.f32(0.0)) for step in offset]
        return log2(hl.max(sides[0] * sides[1], hl.f32(1e-38)))
