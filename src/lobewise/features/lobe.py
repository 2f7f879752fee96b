"""Common parts of features with one lobe per pixel: an axis, optional hit points, and for some a covariance."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

from lobewise.backend.compiler import hl
from lobewise.features.base import DeclaredFeature, Vector
from lobewise.lobes.hits import HitField, compute_hit_shift
from lobewise.lobes.vectors import dot, subtract
from lobewise.records.frame import FloatArray


class HitPlanes(NamedTuple):
    """The planes of a surface point and of the distance to what its lobe hits."""

    position: Vector
    inverse_distance: hl.Expr


class LobePlanes(Protocol):
    """The planes that all lobes have."""

    @property
    def axis(self) -> Vector: ...

    @property
    def hit(self) -> HitPlanes | None: ...


class LobeStep(NamedTuple):
    """The difference of two lobes."""

    d: Vector
    """Difference of the axes, plus the shift of the hits."""
    square: hl.Expr
    """``|d|^2``."""
    axes_square: hl.Expr
    """Squared difference of the axes alone."""


class LobeFeature(DeclaredFeature):
    """Base of features with one lobe per pixel: the exponent beta, and the optional hit-distance term."""

    harmless: ClassVar[tuple[float, ...]]
    """Neutral values of the lobe's input channels."""
    beta: float
    hits: HitField | None

    @property
    def structure(self) -> Hashable:
        return self.hits is not None

    @property
    def neutral(self) -> tuple[float, ...]:
        return self.harmless if self.hits is None else (*self.harmless, 0.0, 0.0, 0.0, 0.0)

    def get_parameters(self) -> tuple[float, ...]:
        return (self.beta,)


@dataclass(frozen=True, eq=False, repr=False)
class CovarianceFeature(LobeFeature):
    """Base of features with a covariance S across an axis z: the arrays, and two invariants Q and P of a pair.

    Let A be the inverse of S in its plane, and ``R = tr(S) (I - z z^T) - S``, which is S turned by a quarter about z.
    Over ``det A_i det A_j`` the 3x3 determinant of ``A_i + A_j`` is exactly ``Q = d^T (R_i + R_j) d`` with
    ``d = z_j - z_i``, because each A is 0 along its own axis. The second invariant over the same product is
    ``P = det_i + det_j + t_i t_j - R_i:R_j`` with the traces t. To first order ``Q / P`` is the smallest eigenvalue of
    ``A_i + A_j``; in a plane it is exactly ``d^T (S_i + S_j)^-1 d``. Neither needs a frame or an inverse.
    """

    harmless = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0)
    axis: FloatArray
    covariance: FloatArray
    determinant: FloatArray
    beta: float
    hits: HitField | None = None


def compute_step(i: LobePlanes, j: LobePlanes) -> LobeStep:
    """Return the difference of two lobes."""
    d = subtract(j.axis, i.axis)
    square = dot(d, d)
    if i.hit is None or j.hit is None:
        return LobeStep(d, square, square)
    d = [p + q for p, q in zip(d, compute_hit_shift(i.axis, j.axis, i.hit, j.hit, square), strict=True)]
    return LobeStep(d, dot(d, d), square)
