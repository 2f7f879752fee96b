"""The feature that compares anisotropic spherical Gaussians."""

from __future__ import annotations

from typing import NamedTuple

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E, log2
from lobewise.features.base import Offset, Stage, Vector
from lobewise.features.lobe import CovarianceFeature, HitPlanes, compute_step
from lobewise.lobes.vectors import dot


class AsgPlanes(NamedTuple):
    """The planes of an anisotropic spherical Gaussian."""

    axis: Vector
    diagonal: Vector
    """Diagonal of R: xx, yy, zz."""
    beside: Vector
    """Twice the other components of R: xy, xz, yz."""
    s: hl.Expr
    """``2 sqrt(det)``."""
    hit: HitPlanes | None


class AsgFeature(CovarianceFeature):
    """Overlap of two anisotropic spherical Gaussians (Xu et al. 2013), to the power beta.

    Near its axis the lobe ``exp(-w^T A w)`` is a planar Gaussian of covariance ``S = A^-1 / 2``, which describes it.
    docs/developers/theory.md derives the evaluation without eigenvectors.

    Parameters
    ----------
    axis, covariance, determinant, beta, hits
        See `GgxFeature`.
    """

    name = "asg"

    def prepare(self, inputs: Vector, parameters: Vector) -> AsgPlanes:
        axis, (xx, xy, xz, yy, yz, zz), determinant, *hit = self.split(inputs)
        x, y, z = axis
        trace = xx + yy + zz
        two = hl.f32(2.0)
        diagonal = [trace - trace * p * p - value for p, value in ((x, xx), (y, yy), (z, zz))]
        beside = [two * (-trace * p * q - value) for p, q, value in ((x, y, xy), (x, z, xz), (y, z, yz))]
        return AsgPlanes(axis, diagonal, beside, two * hl.sqrt(determinant), HitPlanes(*hit) if hit else None)

    def log2_similarity(self, i: AsgPlanes, j: AsgPlanes, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        d, _, square = compute_step(i, j)
        quadratic, invariant = _compare(i, j, d)
        least = i.s * j.s
        inverse = hl.f32(1.0) / hl.max(invariant, least)
        # R holds variances here, but half inverse sharpnesses in docs/developers/theory.md: c is half of Q / P, and T /
        # P doubles.
        half, quarter, one = hl.f32(0.5), hl.f32(0.25), hl.f32(1.0)
        c = half * quadratic * inverse
        trace_i, trace_j = _sum(i.diagonal), _sum(j.diagonal)
        mixed = quarter * (trace_i * j.s * j.s + trace_j * i.s * i.s)
        softness = hl.f32(2.0) * mixed * inverse
        away = c - half
        exponent = c + softness * away * away + quarter * square * (one + square)
        exponent = exponent - hl.f32(0.125) * (trace_i + trace_j)
        areas = half * log2(stage(least * inverse))
        return parameters[0] * (areas - hl.f32(LOG2_E) * exponent)


def _sum(values: Vector) -> hl.Expr:
    return values[0] + values[1] + values[2]


def _compare(i: AsgPlanes, j: AsgPlanes, d: Vector) -> tuple[hl.Expr, hl.Expr]:
    """Return the invariants Q and P of `CovarianceFeature`."""
    dx, dy, dz = d
    xx, yy, zz = (p + q for p, q in zip(i.diagonal, j.diagonal, strict=True))
    xy2, xz2, yz2 = (p + q for p, q in zip(i.beside, j.beside, strict=True))
    quadratic = dx * (xx * dx + xy2 * dy + xz2 * dz) + (dy * (yy * dy + yz2 * dz) + zz * dz * dz)
    inner = dot(i.diagonal, j.diagonal) + hl.f32(0.5) * dot(i.beside, j.beside)
    traces = _sum(i.diagonal) * _sum(j.diagonal)
    determinants = hl.f32(0.25) * (i.s * i.s + j.s * j.s)
    return quadratic, traces - inner + determinants
