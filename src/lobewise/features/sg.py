"""The feature that compares spherical Gaussians, one per pixel: the paper's single lobe."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E, log2
from lobewise.features.base import Offset, Stage, Vector
from lobewise.features.lobe import HitPlanes, LobeFeature, compute_step
from lobewise.lobes.hits import HitField
from lobewise.records.frame import FloatArray


class SgPlanes(NamedTuple):
    """The planes of a spherical Gaussian."""

    axis: Vector
    width: hl.Expr
    """``u = 2 / (beta log2(e) lambda)``."""
    numerator: hl.Expr
    """Logarithm of the pixel's factor in the numerator."""
    hit: HitPlanes | None


@dataclass(frozen=True, eq=False, repr=False)
class SgFeature(LobeFeature):
    """Overlap of two spherical Gaussians: the paper's single lobe.

    ``(2 sqrt(li lj)/(li + lj))^beta exp(-beta li lj/(li + lj) (1 - axis_i . axis_j))``.
    Source: Tokuyoshi 2015, slide "Single Lobe Case".

    Parameters
    ----------
    axis : array, shape (height, width, 3)
        Unit lobe axes.
    sharpness : array, shape (height, width)
        Band-limited lobe sharpness, > 0.
    beta : float
        Exponent, > 0.
    hits : HitField, optional
        Compare footprints on what the lobes hit instead of directions; see `lobewise.lobes.hits`.
    """

    name = "sg"
    harmless = (0.0, 0.0, 0.0, 1.0)
    axis: FloatArray
    sharpness: FloatArray
    beta: float
    hits: HitField | None = None

    def prepare(self, inputs: Vector, parameters: Vector) -> SgPlanes:
        axis, sharpness, *hit = self.split(inputs)
        # The exponent is -|axis_i - axis_j|^2/(u_i + u_j), the sharpness ratio 2 sqrt(u_i u_j)/(u_i + u_j). The
        # logarithm of the ratio's numerator is a sum with one term per pixel.
        width = hl.f32(2.0 / LOG2_E) / (parameters[0] * sharpness)
        numerator = hl.f32(0.5) * parameters[0] * (hl.f32(1.0) + log2(width))
        return SgPlanes(axis, width, numerator, HitPlanes(*hit) if hit else None)

    def log2_similarity(self, i: SgPlanes, j: SgPlanes, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        square = compute_step(i, j).square
        width = i.width + j.width
        return i.numerator + j.numerator - parameters[0] * log2(width) - square * (hl.f32(1.0) / width)
