"""The feature that compares sums of spherical Gaussians: the paper's several lobes per pixel."""

from __future__ import annotations

from collections.abc import Hashable, Sequence

import halide as hl

from lobewise.backend import expressions
from lobewise.errors import InputError, describe_problem
from lobewise.features.base import LOG2_E, Feature, Pixel, Stage, dot, require_positive, subtract
from lobewise.frame import FloatArray
from lobewise.settings import MAX_LOBES


class SgMixtureFeature(Feature):
    """Overlap of two sums of spherical Gaussians, ``<f_i, f_j> / (|f_i| |f_j|)``, to the power beta.

    ``<f_i, f_j> = sum_a sum_b mu_a mu_b 2 pi / (la + lb) exp(-la lb / (la + lb) (1 - axis_a . axis_b))``; the norms are
    taken by the same formula once per pixel, so that a pixel is like itself exactly.
    Source: Tokuyoshi 2015, slide "Spherical Gaussian Approximation"; the product integral of Iwasaki et al. 2012.

    Parameters
    ----------
    axis : array, shape (height, width, 3) or (height, width, 3 N)
        Unit lobe axes, x, y, z of the first, then of the next; three channels where the N lobes of a pixel share one
        axis, which is cheaper.
    sharpness : array, shape (height, width, N)
        Band-limited sharpness, > 0; N from 1 to 4.
    amplitude : array, shape (height, width, N)
        Value at the axis, >= 0; 0 where a pixel has fewer lobes. A pixel without any is like none.
    beta : float
        Exponent, > 0.

    Raises
    ------
    InputError
        If the arrays do not belong together, or there are more than four lobes.
    """

    name = "sg_mixture"

    def __init__(self, axis: FloatArray, sharpness: FloatArray, amplitude: FloatArray, beta: float) -> None:
        lobes = sharpness.shape[2] if sharpness.ndim == 3 else 0
        fits = sharpness.shape == amplitude.shape and axis.ndim == 3 and axis.shape[2] in (3, 3 * lobes)
        if not fits or not 1 <= lobes <= MAX_LOBES:
            raise InputError(
                describe_problem(
                    "lobes of a mixture",
                    expected="sharpness and amplitude (height, width, 1 to 4) and an axis of 3 channels, or 3 a lobe",
                    got=f"axis {axis.shape}, sharpness {sharpness.shape}, amplitude {amplitude.shape}",
                    action="stack the lobes of a pixel along the last axis",
                )
            )
        self.axis = axis
        self.sharpness = sharpness
        self.amplitude = amplitude
        self.beta = require_positive("beta", beta)
        self.lobes = int(lobes)
        self.coaxial = axis.shape[2] == 3

    @property
    def structure(self) -> Hashable:
        return self.lobes, self.coaxial

    @property
    def neutral(self) -> tuple[float, ...]:
        return (*[0.0] * self.axis.shape[2], *[1.0] * (2 * self.lobes))

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.axis, self.sharpness, self.amplitude

    def get_parameters(self) -> tuple[float, ...]:
        return (self.beta,)

    def _split(self, channels: Pixel) -> tuple[list[Pixel], Pixel, Pixel]:
        """Return the axes, and both numbers of every lobe."""
        first, n = self.axis.shape[2], self.lobes
        axes = [channels[k : k + 3] for k in range(0, first, 3)]
        return axes, channels[first : first + n], channels[first + n :]

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        # With u = 2/(log2(e) lambda) a term is a_i a_j / (u_i + u_j) 2^(-|d|^2 / (u_i + u_j)), a = amplitude u; the
        # amplitudes are divided by the norm, so that the sum over all terms is the similarity.
        axes, sharpness, amplitude = self._split(inputs)
        width = [hl.f32(2.0 / LOG2_E) / value for value in sharpness]
        scale = [value * u for value, u in zip(amplitude, width, strict=True)]
        square = self._sum_terms(axes, width, scale, axes, width, scale)
        inverse = hl.select(square > hl.f32(0.0), hl.f32(1.0) / hl.sqrt(hl.max(square, hl.f32(1e-37))), hl.f32(0.0))
        return [*inputs[: self.axis.shape[2]], *width, *[value * inverse for value in scale]]

    def _sum_terms(
        self,
        axes_i: list[Pixel],
        width_i: Pixel,
        scale_i: Pixel,
        axes_j: list[Pixel],
        width_j: Pixel,
        scale_j: Pixel,
    ) -> hl.Expr:
        """Return the product integral: every lobe of one pixel with every lobe of the other."""
        squares: dict[tuple[int, int], hl.Expr] = {}
        total: hl.Expr | None = None
        for a in range(self.lobes):
            row: hl.Expr | None = None
            for b in range(self.lobes):
                pair = (0, 0) if self.coaxial else (a, b)
                if pair not in squares:
                    d = subtract(axes_j[pair[1]], axes_i[pair[0]])
                    squares[pair] = dot(d, d)
                inverse = hl.f32(1.0) / (width_i[a] + width_j[b])
                term = scale_j[b] * inverse * expressions.exp2(-squares[pair] * inverse)
                row = term if row is None else row + term
            assert row is not None
            total = scale_i[a] * row if total is None else total + scale_i[a] * row
        assert total is not None
        return total

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        total = stage(self._sum_terms(*self._split(i), *self._split(j)))
        return parameters[0] * expressions.log2(hl.max(total, hl.f32(1e-30)))
