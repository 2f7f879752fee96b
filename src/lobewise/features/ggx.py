"""The feature that compares GGX lobes by their covariances, with the tail of GGX."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import log2
from lobewise.features.base import DeclaredFeature, Offset, Stage, Vector
from lobewise.lobes.vectors import dot, subtract
from lobewise.records.frame import FloatArray

# (1 + q/4)^-2.4 approximates the planar autocorrelation of a GGX lobe within 3.7e-3 (tests/features/test_constants.py).
# Its slope at q = 0, 0.6, is exact. All exponents of the similarity are whole or half multiples of GGX_UNIT, so powers
# become squarings and square roots, and one logarithm serves all: 2.4 is the unit after three squarings.
GGX_UNIT = 0.3
TAIL_SQUARINGS = 3


class GgxLobe(NamedTuple):
    """The covariance lobes of an image as their principal variances; arrays of shape (height, width)."""

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


@dataclass(frozen=True, eq=False, repr=False)
class GgxFeature(DeclaredFeature):
    """Overlap of two GGX lobes by their covariances across the lobe axis.

    Let S be the covariance across the axis z, ``S z = 0``, with the eigenvalues ``a >= b``, and let
    ``R = tr(S) (I - z z^T) - S``, which is S turned by a quarter about z. Over ``det_i det_j`` the 3x3 determinant of
    the sum of both inverses is exactly ``Q = d^T (R_i + R_j) d`` with ``d = z_j - z_i``. The second invariant over the
    same product is ``P = det_i + det_j + tr_i tr_j - R_i:R_j``. To first order ``Q / P`` is the smallest eigenvalue of
    this sum; in a plane it is exactly ``d^T (S_i + S_j)^-1 d``. Neither needs a frame or an inverse.

    With ``s = 2 sqrt(det)`` and ``q = Q / P`` the similarity is
    ``(s_i s_j / P)^0.45 (2 sqrt(s_i s_j) / (s_i + s_j))^-0.3 (1 + q / 4)^-2.4``, to the power beta; see
    `tests/lobes/oracles/tangent.py`, `tangent_approx_similarity`.

    R is ``a`` times the projection across the axis minus ``t t^T``, where t lies along the eigenvector of a and
    ``|t|^2 = a - b``; its sign does not matter. P is evaluated as in a plane,
    ``(a_i + b_j) (a_j + b_i) - (t_i . t_j)^2``. In Q the matrix R also gets a along its axis, so that lobes that face
    away from each other are not similar: ``Q = (a_i + a_j) |d|^2 - (t_i . d)^2 - (t_j . d)^2``.

    Parameters
    ----------
    lobe : GgxLobe
        The lobes; see `lobewise.guides.lobe_fields.make_ggx_field`.
    beta : float
        Exponent, > 0.
    """

    name = "ggx"
    neutral = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    lobe: GgxLobe
    beta: float

    def get_parameters(self) -> tuple[float, ...]:
        return (GGX_UNIT * self.beta,)

    def prepare(self, inputs: Vector, parameters: Vector) -> GgxPlanes:
        lobe = GgxLobe(*self.split(inputs))
        root = hl.sqrt(lobe.large * lobe.small)
        # The logarithm of s_i s_j is a sum: compute its terms once per pixel.
        numerator = parameters[0] * log2(root + root)
        axis, t = [lobe.axis_x, lobe.axis_y, lobe.axis_z], [lobe.t_x, lobe.t_y, lobe.t_z]
        return GgxPlanes(axis, lobe.large, lobe.small, t, root, numerator)

    def log2_similarity(self, i: GgxPlanes, j: GgxPlanes, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        d = subtract(j.axis, i.axis)
        on_i, on_j, both = dot(d, i.t), dot(d, j.t), dot(i.t, j.t)
        quadratic = (i.large + j.large) * dot(d, d) - (on_i * on_i + on_j * on_j)
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
