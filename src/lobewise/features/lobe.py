"""What the features of one lobe per pixel share: an axis, and what the lobe hits."""

from __future__ import annotations

from collections.abc import Hashable
from typing import ClassVar, NamedTuple, Protocol

import halide as hl

from lobewise.backend.expressions import dot, subtract
from lobewise.features.base import DeclaredFeature, Vector
from lobewise.lobes.hits import HitField, find_hit_shift


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


def find_step(i: LobePlanes, j: LobePlanes) -> LobeStep:
    """Return the step from one lobe to another."""
    d = subtract(j.axis, i.axis)
    square = dot(d, d)
    if i.hit is None or j.hit is None:
        return LobeStep(d, square, square)
    d = [p + q for p, q in zip(d, find_hit_shift(i.axis, j.axis, i.hit, j.hit, square), strict=True)]
    return LobeStep(d, dot(d, d), square)
