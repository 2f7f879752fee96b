"""The feature that compares GGX lobes by their covariances, with the tail of GGX."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import HALIDE, log2
from lobewise.features.base import Offset, Stage, Vector
from lobewise.features.lobe import CovarianceFeature, HitPlanes, LobeFeature, compute_step
from lobewise.lobes.covariance import split_covariance
from lobewise.lobes.hits import HitField
from lobewise.lobes.vectors import dot
from lobewise.records.frame import FloatArray

# (1 + q/4)^-2.4 approximates the planar autocorrelation of a GGX lobe within 3.7e-3 (tests/features/test_constants.py).
# Its slope at q = 0, 0.6, is exact. All exponents of the similarity are whole or half multiples of GGX_UNIT, so powers
# become squarings and square roots, and one logarithm serves all: 2.4 is the unit after three squarings.
GGX_UNIT = 0.3
TAIL_SQUARINGS = 3


class GgxPlanes(NamedTuple):
    """The planes of a GGX lobe."""

    axis: Vector
    large: hl.Expr
    small: hl.Expr
    """The eigenvalues a and b of the covariance are ``large`` and ``small``."""
    t: Vector
    """Vector along the eigenvector of a, ``|t|^2 = a - b``."""
    root: hl.Expr
    """Square root of the determinant, half of s."""
    numerator: hl.Expr
    """Logarithm of the pixel's factor in the numerator."""
    hit: HitPlanes | None


class _GgxSimilarity(LobeFeature):
    """The comparison of two GGX lobes, which `GgxFeature` documents."""

    name = "ggx"

    def get_parameters(self) -> tuple[float, ...]:
        return (GGX_UNIT * self.beta,)

    def log2_similarity(self, i: GgxPlanes, j: GgxPlanes, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        d, square, _ = compute_step(i, j)
        on_i, on_j, both = dot(d, i.t), dot(d, j.t), dot(i.t, j.t)
        quadratic = (i.large + j.large) * square - (on_i * on_i + on_j * on_j)
        invariant = (i.large + j.small) * (j.large + i.small) - both * both
        # sqrt(P) is at least the mean of both s (Minkowski's inequality), but rounding may take it lower.
        mean = i.root + j.root
        invariant = hl.max(invariant, mean * mean)
        # At the bound the similarity is below 1e-9; larger quotients would make the tail overflow.
        tail = hl.f32(1.0) + hl.f32(0.25) * hl.min(quadratic / invariant, hl.f32(4e4))
        for _ in range(TAIL_SQUARINGS):
            tail = tail * tail
        areas = invariant * hl.sqrt(invariant) / mean
        return i.numerator + j.numerator - parameters[0] * log2(stage(tail * areas))


class GgxFeature(_GgxSimilarity, CovarianceFeature):
    """Overlap of two GGX lobes by their covariances across the lobe axis.

    With ``s = 2 sqrt(det)`` and ``q = Q / P``, the invariants of `CovarianceFeature`, the similarity is
    ``(s_i s_j / P)^0.45 (2 sqrt(s_i s_j) / (s_i + s_j))^-0.3 (1 + q / 4)^-2.4``, to the power beta; see
    `tests/lobes/oracles/tangent.py`, `tangent_approx_similarity`.

    With the eigenvalues ``a >= b`` of S, R is ``a`` times the projection across the axis minus ``t t^T``, where t lies
    along the eigenvector of a and ``|t|^2 = a - b``; its sign does not matter. P is evaluated as in a plane,
    ``(a_i + b_j) (a_j + b_i) - (t_i . t_j)^2``. In Q the matrix R also gets a along its axis, so that lobes that face
    away from each other are not similar: ``Q = (a_i + a_j) |d|^2 - (t_i . d)^2 - (t_j . d)^2``.

    Parameters
    ----------
    axis : array, shape (height, width, 3)
        Unit lobe axes z.
    covariance : array, shape (height, width, 6)
        Symmetric 3x3 covariance S with S z = 0: xx, xy, xz, yy, yz, zz.
    determinant : array, shape (height, width)
        Determinant of S in the plane across z, > 0.
    beta : float
        Exponent, > 0.
    hits : HitField, optional
        Compare footprints on what the lobes hit instead of directions; see `lobewise.lobes.hits`.
    """

    def prepare(self, inputs: Vector, parameters: Vector) -> GgxPlanes:
        axis, covariance, determinant, *hit = self.split(inputs)
        large, t = split_covariance(HALIDE, axis, covariance)
        small = determinant / hl.max(large, hl.f32(1e-30))
        return _make_planes((axis, large, small, t), hl.sqrt(determinant), parameters, hit)


class SplitLobe(NamedTuple):
    """The covariance lobes of an image, split into what `GgxFeature` compares; arrays of shape (height, width)."""

    axis_x: FloatArray
    axis_y: FloatArray
    axis_z: FloatArray
    t_x: FloatArray
    """The vector t of `lobewise.lobes.covariance.split_covariance`."""
    t_y: FloatArray
    t_z: FloatArray
    large: FloatArray
    """The larger eigenvalue of the covariance, > 0."""
    small: FloatArray
    """The smaller eigenvalue, > 0."""


@dataclass(frozen=True, eq=False, repr=False)
class SplitGgxFeature(_GgxSimilarity):
    """The similarity of `GgxFeature`, from covariances that were split beforehand: kernels need not split them again.

    Parameters
    ----------
    lobe : SplitLobe
    beta : float
        Exponent, > 0.
    hits : HitField, optional
        As for `GgxFeature`.
    """

    harmless = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    lobe: SplitLobe
    beta: float
    hits: HitField | None = None

    def prepare(self, inputs: Vector, parameters: Vector) -> GgxPlanes:
        parts = self.split(inputs)
        lobe, hit = SplitLobe(*parts[: len(SplitLobe._fields)]), parts[len(SplitLobe._fields) :]
        axis, t = [lobe.axis_x, lobe.axis_y, lobe.axis_z], [lobe.t_x, lobe.t_y, lobe.t_z]
        root = hl.sqrt(lobe.large * lobe.small)
        return _make_planes((axis, lobe.large, lobe.small, t), root, parameters, hit)


def _make_planes(lobe: tuple[Vector, Any, Any, Vector], root: hl.Expr, parameters: Vector, hit: Vector) -> GgxPlanes:
    # The logarithm of s_i s_j is a sum: compute its terms once per pixel.
    numerator = parameters[0] * log2(root + root)
    return GgxPlanes(*lobe, root, numerator, HitPlanes(*hit) if hit else None)
