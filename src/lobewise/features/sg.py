"""Features that compare spherical Gaussians: one per pixel, or sums of several, as in the paper."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass
from typing import NamedTuple

from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E, exp2, log2
from lobewise.errors import InputError
from lobewise.features.base import DeclaredFeature, Offset, Stage, Vector
from lobewise.lobes.vectors import dot, subtract
from lobewise.records.frame import FloatArray
from lobewise.settings import MAX_LOBES


class SgPlanes(NamedTuple):
    """The planes of a spherical Gaussian."""

    axis: Vector
    width: hl.Expr
    """``u = 2 / (beta log2(e) lambda)``."""
    numerator: hl.Expr
    """Logarithm of the pixel's factor in the numerator."""


@dataclass(frozen=True, eq=False, repr=False)
class SgFeature(DeclaredFeature):
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
    """

    name = "sg"
    neutral = (0.0, 0.0, 0.0, 1.0)
    axis: FloatArray
    sharpness: FloatArray
    beta: float

    def prepare(self, inputs: Vector, parameters: Vector) -> SgPlanes:
        axis, sharpness = self.split(inputs)
        # The exponent is -|axis_i - axis_j|^2/(u_i + u_j), the sharpness ratio 2 sqrt(u_i u_j)/(u_i + u_j). The
        # logarithm of the ratio's numerator is a sum with one term per pixel.
        width = hl.f32(2.0 / LOG2_E) / (parameters[0] * sharpness)
        numerator = hl.f32(0.5) * parameters[0] * (hl.f32(1.0) + log2(width))
        return SgPlanes(axis, width, numerator)

    def log2_similarity(self, i: SgPlanes, j: SgPlanes, parameters: Vector, offset: Offset, stage: Stage) -> hl.Expr:
        d = subtract(j.axis, i.axis)
        width = i.width + j.width
        return i.numerator + j.numerator - parameters[0] * log2(width) - dot(d, d) * (hl.f32(1.0) / width)


class MixturePlanes(NamedTuple):
    """The planes of a mixture: numbers per lobe, and an axis per lobe or one for all lobes."""

    axes: list[Vector]
    widths: Vector
    """``u = 2 / (log2(e) lambda)``."""
    scales: Vector
    """Amplitude times u, over the norm of the mixture."""


@dataclass(frozen=True, eq=False, repr=False)
class SgMixtureFeature(DeclaredFeature):
    """Overlap of two sums of spherical Gaussians, ``<f_i, f_j> / (|f_i| |f_j|)``, to the power beta.

    ``<f_i, f_j> = sum_a sum_b mu_a mu_b 2 pi / (la + lb) exp(-la lb / (la + lb) (1 - axis_a . axis_b))``; the norms are
    computed by the same formula once per pixel, so that a pixel's similarity to itself is exactly 1.
    Source: Tokuyoshi 2015, slide "Spherical Gaussian Approximation"; the product integral of Iwasaki et al. 2012.

    Parameters
    ----------
    axis : array, shape (height, width, 3) or (height, width, 3 N)
        Unit lobe axes, x, y, z of the first, then of the next; three channels where the N lobes of a pixel share one
        axis, which is cheaper.
    sharpness : array, shape (height, width, N)
        Band-limited sharpness, > 0; N from 1 to 4.
    amplitude : array, shape (height, width, N)
        Value at the axis, >= 0; 0 where a pixel has fewer lobes. A pixel without lobes has similarity 0 to all.
    beta : float
        Exponent, > 0.

    Raises
    ------
    InputError
        If the shapes do not fit each other, or there are more than four lobes.
    """

    name = "sg_mixture"
    axis: FloatArray
    sharpness: FloatArray
    amplitude: FloatArray
    beta: float

    def __post_init__(self) -> None:
        super().__post_init__()
        axis, sharpness, amplitude = self.get_arrays()
        lobes = sharpness.shape[2] if sharpness.ndim == 3 else 0
        fits = sharpness.shape == amplitude.shape and axis.ndim == 3 and axis.shape[2] in (3, 3 * lobes)
        if not fits or not 1 <= lobes <= MAX_LOBES:
            raise InputError(
                "lobes of a mixture",
                expected="sharpness and amplitude (height, width, 1 to 4) and an axis of 3 channels, or 3 a lobe",
                got=f"axis {axis.shape}, sharpness {sharpness.shape}, amplitude {amplitude.shape}",
                action="stack the lobes of a pixel along the last axis",
            )

    @property
    def structure(self) -> Hashable:
        return self.sharpness.shape[2], self.axis.shape[2]

    @property
    def neutral(self) -> tuple[float, ...]:
        return (*[0.0] * self.axis.shape[2], *[1.0] * (2 * self.sharpness.shape[2]))

    def prepare(self, inputs: Vector, parameters: Vector) -> MixturePlanes:
        # A term is a_i a_j / (u_i + u_j) 2^(-|d|^2 / (u_i + u_j)) with a = amplitude u. Dividing the amplitudes by the
        # norm makes the sum of all terms the similarity.
        axis, sharpness, amplitude = self.split(inputs)
        axes = [axis[k : k + 3] for k in range(0, len(axis), 3)]
        widths = [hl.f32(2.0 / LOG2_E) / value for value in sharpness]
        scales = [value * u for value, u in zip(amplitude, widths, strict=True)]
        own = MixturePlanes(axes, widths, scales)
        square = _sum_terms(own, own)
        inverse = hl.select(square > hl.f32(0.0), hl.f32(1.0) / hl.sqrt(hl.max(square, hl.f32(1e-37))), hl.f32(0.0))
        return MixturePlanes(axes, widths, [value * inverse for value in scales])

    def log2_similarity(
        self, i: MixturePlanes, j: MixturePlanes, parameters: Vector, offset: Offset, stage: Stage
    ) -> hl.Expr:
        return parameters[0] * log2(hl.max(stage(_sum_terms(i, j)), hl.f32(1e-30)))


def _sum_terms(i: MixturePlanes, j: MixturePlanes) -> hl.Expr:
    """Return the product integral, summed over all pairs of lobes of both pixels."""
    steps = [[subtract(q, p) for q in j.axes] for p in i.axes]
    squares = [[dot(d, d) for d in row] for row in steps]
    shared = len(i.axes) == 1
    rows: list[hl.Expr] = []
    for a, (width, scale) in enumerate(zip(i.widths, i.scales, strict=True)):
        terms: list[hl.Expr] = []
        for b, (other, amplitude) in enumerate(zip(j.widths, j.scales, strict=True)):
            inverse = hl.f32(1.0) / (width + other)
            square = squares[0][0] if shared else squares[a][b]
            terms.append(amplitude * inverse * exp2(-square * inverse))
        rows.append(scale * sum(terms[1:], terms[0]))
    return sum(rows[1:], rows[0])
