"""What the features of one lobe per pixel share: an axis, what the lobe hits, and for some a covariance."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import ClassVar, NamedTuple, Protocol

import halide as hl

from lobewise.features.base import DeclaredFeature, Vector
from lobewise.frame import FloatArray
from lobewise.lobes.hits import HitField, find_hit_shift
from lobewise.lobes.vectors import dot, subtract


class HitPlanes(NamedTuple):
    """What taps read of a surface point and of what its lobe hits."""

    position: Vector
    inverse_distance: hl.Expr


class LobePlanes(Protocol):
    """What taps read of any lobe."""

    @property
    def axis(self) -> Vector: ...

    @property
    def hit(self) -> HitPlanes | None: ...


class LobeStep(NamedTuple):
    """How far two lobes are apart."""

    d: Vector
    """Difference of the axes, and what the hits add to it."""
    square: hl.Expr
    """``|d|^2``."""
    axes_square: hl.Expr
    """The same without the hits."""


class LobeFeature(DeclaredFeature):
    """What the features of one lobe per pixel share: the exponent, and the optional hit-distance term."""

    harmless: ClassVar[tuple[float, ...]]
    """What is neutral of a lobe."""
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


def find_step(i: LobePlanes, j: LobePlanes) -> LobeStep:
    """Return the step from one lobe to another."""
    d = subtract(j.axis, i.axis)
    square = dot(d, d)
    if i.hit is None or j.hit is None:
        return LobeStep(d, square, square)
    d = [p + q for p, q in zip(d, find_hit_shift(i.axis, j.axis, i.hit, j.hit, square), strict=True)]
    return LobeStep(d, dot(d, d), square)
