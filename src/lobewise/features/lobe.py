"""The features that compare reflection lobes by an axis: diffuse, hit distance, single spherical Gaussian."""

from __future__ import annotations

import math
from collections.abc import Hashable, Sequence

import halide as hl

from lobewise.backend import expressions
from lobewise.features.base import LOG2_E, Feature, Pixel, Stage, dot, require_positive, subtract
from lobewise.frame import FloatArray
from lobewise.lobes.hits import HitField

# With x = 1 - cos d, 2^-(x (c0 + c1 x + ...)) is within 3.8e-3 of the Lambert similarity
# ((pi - d) cos d + sin d) / pi for every angle d, and falls throughout: no logarithm and no root.
LAMBERT_COEFFICIENTS = (1.53062855, -1.35309751, 3.48856559, -2.92217656, 0.91606498)


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


class LobeFeature(Feature):
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


def _scale_step(i: Pixel, j: Pixel) -> list[hl.Expr]:
    """Return the step between two surface points over their mean hit distance, from the planes of the hits."""
    inverse = hl.f32(0.5) * (i[3] + j[3])
    return [inverse * component for component in subtract(j[:3], i[:3])]


def find_shift(axis_i: Pixel, axis_j: Pixel, hit_i: Pixel, hit_j: Pixel, square: hl.Expr) -> list[hl.Expr]:
    """Return `lobewise.lobes.hits.find_hit_shift`; ``square`` is ``|axis_i - axis_j|^2``."""
    step = _scale_step(hit_i, hit_j)
    middle = [p + q for p, q in zip(axis_i, axis_j, strict=True)]
    # 1 / |zi + zj|^2 = 1 / (4 - |d|^2), to first order in |d|^2 / 4: the lobes of a tap that counts are near.
    along = hl.f32(0.25) * dot(middle, step) * (hl.f32(1.0) + hl.f32(0.25) * square)
    return [p - along * q for p, q in zip(step, middle, strict=True)]


class SgFeature(LobeFeature):
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
            d = [p + q for p, q in zip(d, find_shift(i[:3], j[:3], hit_i, hit_j, square), strict=True)]
            square = dot(d, d)
        width = i[3] + j[3]
        return i[4] + j[4] - parameters[0] * expressions.log2(width) - square * (hl.f32(1.0) / width)
