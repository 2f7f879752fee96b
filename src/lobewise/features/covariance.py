"""The features that compare lobes by covariances across their axes: GGX, anisotropic spherical Gaussian."""

from __future__ import annotations

from collections.abc import Sequence

import halide as hl

from lobewise.backend import expressions
from lobewise.features.base import LOG2_E, Pixel, Stage, dot, require_positive, subtract
from lobewise.features.lobe import LobeFeature, find_shift
from lobewise.frame import FloatArray
from lobewise.lobes.hits import HitField

# (1 + q/4)^-2.4 stands for the planar autocorrelation of a GGX lobe: the slope at q = 0, 0.6, is exact, and 2.4 is
# eight times 0.3, the unit in which every exponent of the similarity is whole or half, so that one logarithm serves
# all. It is within 3.7e-3 of the exact autocorrelation (tests/kernels/test_lobe_features.py).
GGX_UNIT = 0.3
TAIL_SQUARINGS = 3


def _split_covariance(axis: Pixel, covariance: Pixel) -> tuple[hl.Expr, list[hl.Expr]]:
    """Return the larger eigenvalue a, and t along its direction with ``|t|^2`` what it exceeds the other by.

    From the deviation of the covariance from its mean, whose length is their difference: free of cancellation.
    """
    x, y, z = axis
    xx, xy, xz, yy, yz, zz = covariance
    half = hl.f32(0.5)
    trace = xx + yy + zz
    mean = half * trace
    xx, yy, zz = (value + mean * (p * p - hl.f32(1.0)) for value, p in ((xx, x), (yy, y), (zz, z)))
    xy, xz, yz = xy + mean * x * y, xz + mean * x * z, yz + mean * y * z
    beside = xy * xy + xz * xz + yz * yz
    gap = hl.sqrt(hl.f32(2.0) * (xx * xx + yy * yy + zz * zz + beside + beside))
    # t t^T is the deviation and half the gap across the axis; t is its longest column over the root of its diagonal.
    spread = half * gap
    xx, yy, zz = (value + spread * (hl.f32(1.0) - p * p) for value, p in ((xx, x), (yy, y), (zz, z)))
    xy, xz, yz = xy - spread * x * y, xz - spread * x * z, yz - spread * y * z
    first, second = (xx >= yy) & (xx >= zz), yy >= zz
    column = [hl.select(first, a, second, b, c) for a, b, c in ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))]
    # The longest holds a third of the gap; where there is none, rounding must not be divided by less.
    scale = hl.f32(1.0) / hl.sqrt(hl.max(xx, yy, zz, hl.f32(0.3) * gap, hl.f32(1e-30)))
    return mean + spread, [component * scale for component in column]


class _CovarianceFeature(LobeFeature):
    """What the features of a covariance across an axis share: their arrays, and two invariants of a pair.

    Turned by a quarter about its axis, the covariance S is ``R = tr(S) P - S``, P the projection across the axis. The
    determinant of ``A_i + A_j``, A the inverse of S in its plane, over ``det A_i det A_j`` is exactly
    ``Q = d^T (R_i + R_j) d``, ``d = z_j - z_i``, because neither matrix has anything along its own axis; the second
    invariant over the same is ``P = det_i + det_j + t_i t_j - R_i:R_j``, t the traces. Their quotient is, to first
    order in itself, the smallest eigenvalue of ``A_i + A_j``, and exactly ``d^T (S_i + S_j)^-1 d`` in a plane. No
    frame, no inverse.
    """

    def __init__(
        self,
        axis: FloatArray,
        covariance: FloatArray,
        determinant: FloatArray,
        beta: float,
        hits: HitField | None = None,
    ) -> None:
        self.axis = axis
        self.covariance = covariance
        self.determinant = determinant
        self.beta = require_positive("beta", beta)
        self.hits = hits

    @property
    def neutral(self) -> tuple[float, ...]:
        return (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0, *self._get_hit_neutral())

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.axis, self.covariance, self.determinant, *self._get_hit_arrays()

    def _step(self, i: Pixel, j: Pixel, hit_i: Pixel, hit_j: Pixel) -> tuple[list[hl.Expr], hl.Expr, hl.Expr]:
        """Return d, ``|d|^2``, and the square of the difference of the axes, which d is without hits."""
        d = subtract(j[:3], i[:3])
        square = dot(d, d)
        if self.hits is None:
            return d, square, square
        d = [p + q for p, q in zip(d, find_shift(i[:3], j[:3], hit_i, hit_j, square), strict=True)]
        return d, dot(d, d), square


class GgxFeature(_CovarianceFeature):
    """Overlap of two GGX lobes by their covariances across the lobe axis.

    With the eigenvalues ``a >= b`` of S, R is ``a P - t t^T``: t along the long direction, ``|t|^2 = a - b``. In a
    plane P is ``(a_i + b_j) (a_j + b_i) - (t_i . t_j)^2``, and so it is taken; R gets a along its axis as well, so that
    lobes which face away from each other are unlike: ``Q = (a_i + a_j) |d|^2 - (t_i . d)^2 - (t_j . d)^2``. Which of
    its two signs t has does not matter.

    With ``s = 2 sqrt(det)`` and ``q = Q / P``
    ``(s_i s_j / P)^0.45 (2 sqrt(s_i s_j) / (s_i + s_j))^-0.3 (1 + q / 4)^-2.4``, to the power beta; see
    `lobewise.lobes.tangent.tangent_approx_similarity`.

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

    name = "ggx"

    def get_parameters(self) -> tuple[float, ...]:
        return (GGX_UNIT * self.beta,)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        large, t = _split_covariance(inputs[:3], inputs[3:9])
        small = inputs[9] / hl.max(large, hl.f32(1e-30))
        root = hl.sqrt(inputs[9])
        # s_i s_j is split into one logarithm per pixel.
        numerator = parameters[0] * expressions.log2(root + root)
        return [*inputs[:3], large, small, *t, root, numerator, *inputs[10:]]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        (i, hit_i), (j, hit_j) = self._split_hits(i), self._split_hits(j)
        d, length, _ = self._step(i, j, hit_i, hit_j)
        on_i, on_j, both = dot(d, i[5:8]), dot(d, j[5:8]), dot(i[5:8], j[5:8])
        quadratic = (i[3] + j[3]) * length - (on_i * on_i + on_j * on_j)
        invariant = (i[3] + j[4]) * (j[3] + i[4]) - both * both
        # sqrt(P) is at least the mean of both s (Minkowski's inequality); rounding may hide that.
        mean = i[8] + j[8]
        invariant = hl.max(invariant, mean * mean)
        # Beyond the bound the similarity is below 1e-9; without it the tail would overflow.
        tail = hl.f32(1.0) + hl.f32(0.25) * hl.min(quadratic / invariant, hl.f32(4e4))
        for _ in range(TAIL_SQUARINGS):
            tail = tail * tail
        areas = invariant * hl.sqrt(invariant) / mean
        return i[9] + j[9] - parameters[0] * expressions.log2(stage(tail * areas))


class AsgFeature(_CovarianceFeature):
    """Overlap of two anisotropic spherical Gaussians (Xu et al. 2013), to the power beta.

    The lobe ``exp(-w^T A w)`` is given by the covariance of the planar Gaussian that it is near its axis,
    ``S = A^-1 / 2``. See `lobewise.lobes.asg.asg_approx_similarity` for the evaluation without eigenvectors.

    Parameters
    ----------
    axis, covariance, determinant, beta, hits
        See `GgxFeature`.
    """

    name = "asg"

    def get_parameters(self) -> tuple[float, ...]:
        return (self.beta,)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        x, y, z = inputs[:3]
        xx, xy, xz, yy, yz, zz = inputs[3:9]
        trace = xx + yy + zz
        two = hl.f32(2.0)
        return [
            x,
            y,
            z,
            trace - trace * x * x - xx,
            trace - trace * y * y - yy,
            trace - trace * z * z - zz,
            two * (-trace * x * y - xy),
            two * (-trace * x * z - xz),
            two * (-trace * y * z - yz),
            two * hl.sqrt(inputs[9]),
            *inputs[10:],
        ]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        (i, hit_i), (j, hit_j) = self._split_hits(i), self._split_hits(j)
        d, _, square = self._step(i, j, hit_i, hit_j)
        quadratic, invariant = self._compare(i, j, d)
        least = i[9] * j[9]
        inverse = hl.f32(1.0) / hl.max(invariant, least)
        # R holds variances here, and half inverse sharpnesses there: c is half of Q / P, and T / P twice as large.
        half, quarter, one = hl.f32(0.5), hl.f32(0.25), hl.f32(1.0)
        c = half * quadratic * inverse
        trace_i, trace_j = i[3] + i[4] + i[5], j[3] + j[4] + j[5]
        mixed = quarter * (trace_i * j[9] * j[9] + trace_j * i[9] * i[9])
        softness = hl.f32(2.0) * mixed * inverse
        away = c - half
        exponent = c + softness * away * away + quarter * square * (one + square)
        exponent = exponent - hl.f32(0.125) * (trace_i + trace_j)
        areas = half * expressions.log2(stage(least * inverse))
        return parameters[0] * (areas - hl.f32(LOG2_E) * exponent)

    def _compare(self, i: Pixel, j: Pixel, d: Sequence[hl.Expr]) -> tuple[hl.Expr, hl.Expr]:
        """Return Q and P."""
        dx, dy, dz = d
        xx, yy, zz, xy2, xz2, yz2 = (i[k] + j[k] for k in range(3, 9))
        quadratic = dx * (xx * dx + xy2 * dy + xz2 * dz) + (dy * (yy * dy + yz2 * dz) + zz * dz * dz)
        inner = dot(i[3:6], j[3:6]) + hl.f32(0.5) * dot(i[6:9], j[6:9])
        traces = (i[3] + i[4] + i[5]) * (j[3] + j[4] + j[5])
        determinants = hl.f32(0.25) * (i[9] * i[9] + j[9] * j[9])
        return quadratic, traces - inner + determinants
