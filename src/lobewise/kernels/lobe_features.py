"""The features that compare reflection lobes: diffuse, single spherical Gaussian, GGX covariance."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence
from typing import ClassVar

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.kernels import expressions
from lobewise.kernels.features import LOG2_E, Feature, Pixel, Pixels, Stage, dot, require_positive, subtract
from lobewise.lobes import asg, sg, tangent
from lobewise.lobes.hits import HitField, find_hit_shift

# With x = 1 - cos d, 2^-(x (c0 + c1 x + ...)) is within 3.8e-3 of the Lambert similarity
# ((pi - d) cos d + sin d) / pi for every angle d, and falls throughout: no logarithm and no root.
LAMBERT_COEFFICIENTS = (1.53062855, -1.35309751, 3.48856559, -2.92217656, 0.91606498)

# (1 + q/4)^-2.4 stands for the planar autocorrelation of a GGX lobe: the slope at q = 0, 0.6, is exact, and 2.4 is
# eight times 0.3, the unit in which every exponent of the similarity is whole or half, so that one logarithm serves
# all. It is within 3.7e-3 of the exact autocorrelation (tests/kernels/test_lobe_features.py).
GGX_UNIT = 0.3
TAIL_SQUARINGS = 3


def _log2_positive(x: hl.Expr) -> hl.Expr:
    """Return log2 of x, which rounding may have pushed to 0 or below."""
    return expressions.log2(hl.max(x, hl.f32(1e-30)))


class DiffuseFeature(Feature):
    """Overlap of two Lambert lobes, ``((pi - d) cos d + sin d) / pi`` at the normal angle d, to the power beta.

    Parameters
    ----------
    normal : array, shape (height, width, 3)
        Unit shading normals.
    beta : float
        Exponent, > 0.
    """

    name = "diffuse"

    def __init__(self, normal: FloatArray, beta: float) -> None:
        self.normal = normal
        self.beta = require_positive("beta", beta)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return (self.normal,)

    def get_parameters(self) -> tuple[float, ...]:
        return (self.beta,)

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        d = subtract(j, i)
        x = hl.f32(0.5) * dot(d, d)
        quotient = hl.f32(LAMBERT_COEFFICIENTS[-1])
        for coefficient in LAMBERT_COEFFICIENTS[-2::-1]:
            quotient = quotient * x + hl.f32(coefficient)
        return -parameters[0] * (x * quotient)

    def get_similarity(self, i: Pixels, j: Pixels) -> NDArray[np.float64]:
        cosine = np.sum(self.normal[i].astype(np.float64) * self.normal[j].astype(np.float64), axis=-1)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        overlap = ((math.pi - angle) * np.cos(angle) + np.sin(angle)) / math.pi
        similarity: NDArray[np.float64] = np.maximum(overlap, 0.0) ** self.beta
        return similarity


class HitDistanceFeature(Feature):
    """Gaussian of how much the inverse hit distances of two lobes differ, relative to the larger of them.

    ``exp(-(x_i - x_j)^2 / (2 max(x_i, x_j)^2 s_i s_j))`` with x = 1/t: 1 for equal distances, both infinite included.
    What a mirror sees has changed when something else is at another distance.

    Parameters
    ----------
    inverse_distance : array, shape (height, width)
        1/t, >= 0; 0 where nothing is seen.
    tolerance : array, shape (height, width)
        Relative standard deviation s that is no change, > 0.
    """

    name = "hit_distance"
    neutral = (0.0, 1.0)

    def __init__(self, inverse_distance: FloatArray, tolerance: FloatArray) -> None:
        self.inverse_distance = inverse_distance
        self.tolerance = tolerance

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.inverse_distance, self.tolerance

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        return [inputs[0], hl.f32(math.sqrt(0.5 * LOG2_E)) / hl.max(inputs[1], hl.f32(1e-6))]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        step = (i[0] - j[0]) / hl.max(i[0], j[0], hl.f32(1e-12))
        return -step * step * (i[1] * j[1])

    def get_similarity(self, i: Pixels, j: Pixels) -> NDArray[np.float64]:
        x_i, x_j = (self.inverse_distance[k].astype(np.float64) for k in (i, j))
        largest = np.maximum(np.maximum(x_i, x_j), 1e-12)
        tolerances = self.tolerance[i].astype(np.float64) * self.tolerance[j]
        return np.asarray(np.exp(-(((x_i - x_j) / largest) ** 2) / (2.0 * tolerances)))


class _LobeFeature(Feature):
    """What the features of one lobe per pixel share: the exponent, and the optional hit-distance term."""

    beta: float
    hits: HitField | None

    @property
    def structure(self) -> Hashable:
        return self.hits is not None

    def _get_hit_arrays(self) -> tuple[FloatArray, ...]:
        return () if self.hits is None else (self.hits.position, self.hits.inverse_distance)

    def _get_hit_neutral(self) -> tuple[float, ...]:
        return () if self.hits is None else (0.0, 0.0, 0.0, 0.0)

    def _split_hits(self, pixel: Pixel) -> tuple[Pixel, Pixel]:
        """Return the planes of the lobe and those of the hit, which are the last four."""
        return (pixel, ()) if self.hits is None else (pixel[:-4], pixel[-4:])

    def _get_shift(self, i: Pixels, j: Pixels, axis: FloatArray) -> NDArray[np.float64] | None:
        """Return what the hits add to the difference of the axes, float64; None without the term."""
        if self.hits is None:
            return None
        position, inverse = self.hits.position, self.hits.inverse_distance
        pairs = (a[k].astype(np.float64) for a in (axis, position, inverse) for k in (i, j))
        return np.asarray(find_hit_shift(*pairs), dtype=np.float64)


def _scale_step(i: Pixel, j: Pixel) -> list[hl.Expr]:
    """Return the step between two surface points over their mean hit distance, from the planes of the hits."""
    inverse = hl.f32(0.5) * (i[3] + j[3])
    return [inverse * component for component in subtract(j[:3], i[:3])]


def _find_shift(axis_i: Pixel, axis_j: Pixel, hit_i: Pixel, hit_j: Pixel, square: hl.Expr) -> list[hl.Expr]:
    """Return `lobewise.lobes.hits.find_hit_shift`; ``square`` is ``|axis_i - axis_j|^2``."""
    step = _scale_step(hit_i, hit_j)
    middle = [p + q for p, q in zip(axis_i, axis_j, strict=True)]
    # 1 / |zi + zj|^2 = 1 / (4 - |d|^2), to first order in |d|^2 / 4: the lobes of a tap that counts are near.
    along = hl.f32(0.25) * dot(middle, step) * (hl.f32(1.0) + hl.f32(0.25) * square)
    return [p - along * q for p, q in zip(step, middle, strict=True)]


class SgFeature(_LobeFeature):
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
    hits : HitField, optional
        Compare footprints on what the lobes hit instead of directions; see `lobewise.lobes.hits`.
    """

    name = "sg"

    def __init__(self, axis: FloatArray, sharpness: FloatArray, beta: float, hits: HitField | None = None) -> None:
        self.axis = axis
        self.sharpness = sharpness
        self.beta = require_positive("beta", beta)
        self.hits = hits

    @property
    def neutral(self) -> tuple[float, ...]:
        return (0.0, 0.0, 0.0, 1.0, *self._get_hit_neutral())

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.axis, self.sharpness, *self._get_hit_arrays()

    def get_parameters(self) -> tuple[float, ...]:
        return (self.beta,)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        # With u = 2/(beta log2(e) lambda) the exponent is -|axis_i - axis_j|^2/(u_i + u_j) and the sharpness ratio
        # 2 sqrt(u_i u_j)/(u_i + u_j); the numerator of the latter is split into one plane per pixel.
        width = hl.f32(2.0 / LOG2_E) / (parameters[0] * inputs[3])
        numerator = hl.f32(0.5) * parameters[0] * (hl.f32(1.0) + expressions.log2(width))
        return [*inputs[:3], width, numerator, *inputs[4:]]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        (i, hit_i), (j, hit_j) = self._split_hits(i), self._split_hits(j)
        d = subtract(j[:3], i[:3])
        square = dot(d, d)
        if self.hits is not None:
            d = [p + q for p, q in zip(d, _find_shift(i[:3], j[:3], hit_i, hit_j, square), strict=True)]
            square = dot(d, d)
        width = i[3] + j[3]
        return i[4] + j[4] - parameters[0] * expressions.log2(width) - square * (hl.f32(1.0) / width)

    def get_similarity(self, i: Pixels, j: Pixels) -> NDArray[np.float64]:
        return np.asarray(
            sg.sg_slide_similarity(
                self.axis[i].astype(np.float64),
                self.sharpness[i].astype(np.float64),
                self.axis[j].astype(np.float64),
                self.sharpness[j].astype(np.float64),
                beta=self.beta,
                shift=self._get_shift(i, j, self.axis),
            ),
            dtype=np.float64,
        )


class _CovarianceFeature(_LobeFeature):
    """What the features of a covariance across an axis share.

    With ``R = tr(S) P - S`` (the covariance S turned by a quarter about its axis, P the projection across it) the
    determinant of ``A_i + A_j``, A the inverse of S in its plane, over ``det A_i det A_j`` is exactly
    ``Q = d^T (R_i + R_j) d``, ``d = z_j - z_i``, because neither matrix has anything along its own axis; the second
    invariant is ``P = det_i + det_j + t_i t_j - R_i:R_j``, t the traces. Their quotient is, to first order in itself,
    the smallest eigenvalue of ``A_i + A_j``, and exactly ``d^T (S_i + S_j)^-1 d`` in a plane. No frame, no inverse.
    """

    along: ClassVar[float]
    """Which part of its trace R gets along its axis; P follows from it to second order."""

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

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        x, y, z = inputs[:3]
        xx, xy, xz, yy, yz, zz = inputs[3:9]
        trace = xx + yy + zz
        two = hl.f32(2.0)
        across = hl.f32(1.0 - self.along) * trace
        return [
            x,
            y,
            z,
            trace - across * x * x - xx,
            trace - across * y * y - yy,
            trace - across * z * z - zz,
            two * (-across * x * y - xy),
            two * (-across * x * z - xz),
            two * (-across * y * z - yz),
            two * hl.sqrt(inputs[9]),
            *self._prepare_more(two * hl.sqrt(inputs[9]), parameters),
            *inputs[10:],
        ]

    def _prepare_more(self, root: hl.Expr, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        """Return more planes from ``root``, twice the root of the determinant."""
        return []

    def _compare(self, i: Pixel, j: Pixel, hit_i: Pixel, hit_j: Pixel) -> tuple[hl.Expr, hl.Expr, hl.Expr]:
        """Return Q, P and ``|d|^2``."""
        d = subtract(j[:3], i[:3])
        square = dot(d, d)
        if self.hits is not None:
            d = [p + q for p, q in zip(d, _find_shift(i[:3], j[:3], hit_i, hit_j, square), strict=True)]
        dx, dy, dz = d
        xx, yy, zz, xy2, xz2, yz2 = (i[k] + j[k] for k in range(3, 9))
        quadratic = dx * (xx * dx + xy2 * dy + xz2 * dz) + (dy * (yy * dy + yz2 * dz) + zz * dz * dz)
        inner = dot(i[3:6], j[3:6]) + hl.f32(0.5) * dot(i[6:9], j[6:9])
        # The traces hold 1 + along of that across, and R_i:R_j along^2 of it more.
        share = hl.f32((1.0 + self.along**2) / (1.0 + self.along) ** 2)
        traces = share * (i[3] + i[4] + i[5]) * (j[3] + j[4] + j[5])
        determinants = hl.f32(0.25) * (i[9] * i[9] + j[9] * j[9])
        return quadratic, traces - inner + determinants, square

    def _get_lobes(self, i: Pixels, j: Pixels) -> tuple[tangent.TangentLobe, tangent.TangentLobe]:
        lobe_i, lobe_j = (
            tangent.TangentLobe(
                self.axis[k].astype(np.float64),
                self.covariance[k].astype(np.float64),
                self.determinant[k].astype(np.float64),
            )
            for k in (i, j)
        )
        return lobe_i, lobe_j


class GgxFeature(_CovarianceFeature):
    """Overlap of two GGX lobes by their covariances across the lobe axis.

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
    along = 0.5  # so that lobes which face away from each other are unlike

    def get_parameters(self) -> tuple[float, ...]:
        return (GGX_UNIT * self.beta,)

    def _prepare_more(self, root: hl.Expr, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        # s_i s_j is split into one logarithm per pixel.
        return [parameters[0] * expressions.log2(root)]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        (i, hit_i), (j, hit_j) = self._split_hits(i), self._split_hits(j)
        quadratic, invariant, _ = self._compare(i, j, hit_i, hit_j)
        # sqrt(P) is at least the mean of both s (Minkowski's inequality); rounding may hide that.
        mean = hl.f32(0.5) * (i[9] + j[9])
        invariant = hl.max(invariant, mean * mean)
        # Beyond the bound the similarity is below 1e-9; without it the tail would overflow.
        tail = hl.f32(1.0) + hl.f32(0.25) * hl.min(quadratic / invariant, hl.f32(4e4))
        for _ in range(TAIL_SQUARINGS):
            tail = tail * tail
        areas = invariant * hl.sqrt(invariant) / mean
        return i[10] + j[10] - parameters[0] * expressions.log2(stage(tail * areas))

    def get_similarity(self, i: Pixels, j: Pixels) -> NDArray[np.float64]:
        shift = self._get_shift(i, j, self.axis)
        return np.asarray(
            tangent.tangent_approx_similarity(*self._get_lobes(i, j), self.beta, shift=shift), dtype=np.float64
        )


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
    along = 0.0

    def get_parameters(self) -> tuple[float, ...]:
        return (self.beta,)

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        (i, hit_i), (j, hit_j) = self._split_hits(i), self._split_hits(j)
        quadratic, invariant, square = self._compare(i, j, hit_i, hit_j)
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

    def get_similarity(self, i: Pixels, j: Pixels) -> NDArray[np.float64]:
        lobe_i, lobe_j = (asg.asg_from_covariance(*lobe) for lobe in self._get_lobes(i, j))
        shift = self._get_shift(i, j, self.axis)
        return np.asarray(asg.asg_approx_similarity(lobe_i, lobe_j, self.beta, shift=shift), dtype=np.float64)
