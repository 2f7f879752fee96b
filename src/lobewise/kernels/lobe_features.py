"""The features that compare reflection lobes: diffuse, single spherical Gaussian, GGX covariance."""

from __future__ import annotations

import math
from collections.abc import Sequence

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.kernels import expressions
from lobewise.kernels.features import LOG2_E, Feature, Pixel, Pixels, Stage, dot, require_positive, subtract
from lobewise.lobes import sg, tangent

# Least-maximum fit, with x = |n_i - n_j| / sqrt(2), of the Lambert similarity ((pi - d) cos d + sin d) / pi:
# 1 - x^2 + x^3 (c0 + c1 x + c2 x^2 + c3 x^3), error 1.3e-3 for every angle d.
LAMBERT_COEFFICIENTS = (0.18075601, 0.40004349, -0.41958626, 0.15761182)

# (1 + q/4)^-2.4 stands for the planar autocorrelation of a GGX lobe: the slope at q = 0, 0.6, is exact, and 2.4 is
# eight times the exponent of `pre`, so that both need one logarithm together. It is within 3.7e-3 of the exact
# autocorrelation (tests/kernels/test_lobe_features.py).
CONCENTRIC_EXPONENT = 0.3
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
    neutral = (0.0, 0.0, 0.0)

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
        x2 = hl.f32(0.5) * dot(d, d)
        x = hl.sqrt(x2)
        cubic = hl.f32(LAMBERT_COEFFICIENTS[3])
        for coefficient in LAMBERT_COEFFICIENTS[2::-1]:
            cubic = cubic * x + hl.f32(coefficient)
        return parameters[0] * _log2_positive(hl.f32(1.0) + x2 * (x * cubic - hl.f32(1.0)))

    def get_similarity(self, i: Pixels, j: Pixels) -> NDArray[np.float64]:
        cosine = np.sum(self.normal[i].astype(np.float64) * self.normal[j].astype(np.float64), axis=-1)
        angle = np.arccos(np.clip(cosine, -1.0, 1.0))
        overlap = ((math.pi - angle) * np.cos(angle) + np.sin(angle)) / math.pi
        similarity: NDArray[np.float64] = np.maximum(overlap, 0.0) ** self.beta
        return similarity


class SgFeature(Feature):
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

    def __init__(self, axis: FloatArray, sharpness: FloatArray, beta: float) -> None:
        self.axis = axis
        self.sharpness = sharpness
        self.beta = require_positive("beta", beta)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.axis, self.sharpness

    def get_parameters(self) -> tuple[float, ...]:
        return (self.beta,)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        # With u = 2/(beta log2(e) lambda) the exponent is -|axis_i - axis_j|^2/(u_i + u_j) and the sharpness ratio
        # 2 sqrt(u_i u_j)/(u_i + u_j); the numerator of the latter is split into one plane per pixel.
        width = hl.f32(2.0 / LOG2_E) / (parameters[0] * inputs[3])
        return [*inputs[:3], width, hl.f32(0.5) * parameters[0] * (hl.f32(1.0) + expressions.log2(width))]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        d = subtract(j[:3], i[:3])
        width = i[3] + j[3]
        return i[4] + j[4] - parameters[0] * expressions.log2(width) - dot(d, d) * (hl.f32(1.0) / width)

    def get_similarity(self, i: Pixels, j: Pixels) -> NDArray[np.float64]:
        return np.asarray(
            sg.sg_slide_similarity(
                self.axis[i].astype(np.float64),
                self.sharpness[i].astype(np.float64),
                self.axis[j].astype(np.float64),
                self.sharpness[j].astype(np.float64),
                beta=self.beta,
            ),
            dtype=np.float64,
        )


class GgxFeature(Feature):
    """Overlap of two GGX reflection lobes, isotropic or anisotropic, as covariances in the tangent plane.

    ``pre^(0.6 beta) (1 + q/4)^(-2.4 beta)`` with ``pre = 2 (det_i det_j)^(1/4)/sqrt(det M)`` and q the Mahalanobis
    distance of the axes under ``M = S_i + S_j`` in the plane across ``m = z_i + z_j``.

    The plane is never built. With ``d = z_j - z_i``, which is perpendicular to m, ``D = d^T M d`` and the trace t and
    the sum C of the principal minors of the 3x3 matrix M: ``m^T M m = D`` because S_i z_i = S_j z_j = 0, so the trace
    in the plane is ``t - mu`` with ``mu = D/|m|^2``, ``det = C - mu (t - mu)`` and ``q = (|d|^2 (t - mu) - D)/det``.
    Dropped is the square of M's coupling between m and the plane, which vanishes for equal lobes; the determinant is
    bounded below by ``4 sqrt(det_i det_j)``, which keeps ``pre <= 1``.

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
    """

    name = "ggx"
    neutral = (0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 1.0, 1.0)

    def __init__(self, axis: FloatArray, covariance: FloatArray, determinant: FloatArray, beta: float) -> None:
        self.axis = axis
        self.covariance = covariance
        self.determinant = determinant
        self.beta = require_positive("beta", beta)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.axis, self.covariance, self.determinant

    def get_parameters(self) -> tuple[float, ...]:
        return (CONCENTRIC_EXPONENT * self.beta,)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        xx, xy, xz, yy, yz, zz = inputs[3:9]
        two = hl.f32(2.0)
        # The numerator of pre^0.6 is split into one logarithm per pixel; the last plane bounds the determinant.
        numerator = parameters[0] * (hl.f32(1.0) + hl.f32(0.5) * _log2_positive(inputs[9]))
        return [*inputs[:3], xx, yy, zz, two * xy, two * xz, two * yz, numerator, two * hl.sqrt(inputs[9])]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        dx, dy, dz = subtract(j[:3], i[:3])
        xx, yy, zz, xy2, xz2, yz2 = (i[k] + j[k] for k in range(3, 9))
        distance_squared = dx * dx + dy * dy + dz * dz
        quadratic = dx * (xx * dx + xy2 * dy + xz2 * dz) + (dy * (yy * dy + yz2 * dz) + zz * dz * dz)
        yy_zz = yy + zz
        minors = xx * yy_zz + yy * zz - hl.f32(0.25) * (xy2 * xy2 + xz2 * xz2 + yz2 * yz2)
        # 1/|m|^2 = 1/(4 - |d|^2) to third order in |d|^2/4: the lobes of a tap that counts are near.
        one, quarter = hl.f32(1.0), hl.f32(0.25) * distance_squared
        mu = hl.f32(0.25) * quadratic * (one + quarter * (one + quarter * (one + quarter)))
        trace = xx + yy_zz - mu
        # M's true determinant is at least 4 sqrt(det_i det_j); rounding and the dropped coupling may hide that.
        determinant = hl.max(minors - mu * trace, i[10] * j[10])
        distance = (distance_squared * trace - quadratic) / determinant
        # Beyond the bound the similarity is below 1e-9; without it the tail would overflow.
        tail = hl.f32(1.0) + hl.f32(0.25) * hl.min(distance, hl.f32(4e4))
        for _ in range(TAIL_SQUARINGS):
            tail = tail * tail
        return i[9] + j[9] - parameters[0] * expressions.log2(stage(tail * determinant))

    def get_similarity(self, i: Pixels, j: Pixels) -> NDArray[np.float64]:
        lobe_i, lobe_j = (
            tangent.TangentLobe(
                self.axis[k].astype(np.float64),
                self.covariance[k].astype(np.float64),
                self.determinant[k].astype(np.float64),
            )
            for k in (i, j)
        )
        return np.asarray(tangent.tangent_approx_similarity(lobe_i, lobe_j, self.beta), dtype=np.float64)
