"""What the features of a covariance across an axis share: their arrays, and the invariants of a pair."""

from __future__ import annotations

from dataclasses import dataclass

from lobewise.features.lobe import LobeFeature
from lobewise.frame import FloatArray
from lobewise.lobes.hits import HitField


@dataclass(frozen=True, eq=False, repr=False)
class CovarianceFeature(LobeFeature):
    """What the features of a covariance across an axis share: their arrays, and two invariants of a pair.

    Turned by a quarter about its axis, the covariance S is ``R = tr(S) P - S``, P the projection across the axis. The
    determinant of ``A_i + A_j``, A the inverse of S in its plane, over ``det A_i det A_j`` is exactly
    ``Q = d^T (R_i + R_j) d``, ``d = z_j - z_i``, because neither matrix has anything along its own axis; the second
    invariant over the same is ``P = det_i + det_j + t_i t_j - R_i:R_j``, t the traces. Their quotient is, to first
    order in itself, the smallest eigenvalue of ``A_i + A_j``, and exactly ``d^T (S_i + S_j)^-1 d`` in a plane. No
    frame, no inverse.
    """

    harmless = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0)
    axis: FloatArray
    covariance: FloatArray
    determinant: FloatArray
    beta: float
    hits: HitField | None = None
