"""What the features of one lobe per pixel share: an axis, and what the lobe hits."""

from __future__ import annotations

from collections.abc import Hashable, Sequence
from typing import ClassVar, NamedTuple, Protocol

import halide as hl

from lobewise.backend.expressions import dot, subtract
from lobewise.features.base import DeclaredFeature, Vector
from lobewise.lobes.hits import HitField


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
    d = [p + q for p, q in zip(d, _find_shift(i.axis, j.axis, i.hit, j.hit, square), strict=True)]
    return LobeStep(d, dot(d, d), square)


def _find_shift(
    axis_i: Vector, axis_j: Vector, hit_i: HitPlanes, hit_j: HitPlanes, square: hl.Expr
) -> Sequence[hl.Expr]:
    """Return `lobewise.lobes.hits.find_hit_shift`; ``square`` is ``|axis_i - axis_j|^2``."""
    # The step between two surface points over their mean hit distance.
    inverse = hl.f32(0.5) * (hit_i.inverse_distance + hit_j.inverse_distance)
    step = [inverse * component for component in subtract(hit_j.position, hit_i.position)]
    middle = [p + q for p, q in zip(axis_i, axis_j, strict=True)]
    # 1 / |zi + zj|^2 = 1 / (4 - |d|^2), to first order in |d|^2 / 4: the lobes of a tap that counts are near.
    along = hl.f32(0.25) * dot(middle, step) * (hl.f32(1.0) + hl.f32(0.25) * square)
    return [p - along * q for p, q in zip(step, middle, strict=True)]
