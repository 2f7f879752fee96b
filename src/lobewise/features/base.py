"""What makes two pixels similar.

A feature is a distribution per pixel; two pixels are as similar as the L2-normalised product integral of their
distributions, to the power beta (Tokuyoshi 2015). The filter multiplies the similarities of its features by adding
their base-2 logarithms, so that a tap costs one exponential however many features there are.

To write one, derive from `Feature`: hand over the per-pixel arrays and give the log-similarity of two pixels as an
expression. It then runs in every form and on every device. docs/features.md shows how, `examples/` two of them.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Sequence
from typing import ClassVar

import halide as hl

from lobewise.backend import expressions
from lobewise.errors import InputError, describe_problem
from lobewise.frame import FloatArray

LOG2_E = math.log2(math.e)

Pixel = Sequence[hl.Expr]
"""The planes of one pixel, in the order in which `Feature.prepare` returned them."""
Stage = Callable[[hl.Expr], hl.Expr]
"""Keeps an intermediate value of a whole row of taps in cache; splits a long log-similarity into shorter loops."""


class Feature(ABC):
    """A distribution per pixel.

    A feature holds the arrays of one frame. Kernels are compiled once per *structure* (class and `structure`) and
    run on any arrays of any size.
    """

    name: ClassVar[str] = "own"

    @property
    def neutral(self) -> tuple[float, ...]:
        """One value per input channel that is put in place of a pixel without meaning, so that no tap sees NaN."""
        return (0.0,) * sum(1 if array.ndim == 2 else array.shape[2] for array in self.get_arrays())

    @property
    def structure(self) -> Hashable:
        """What, besides the class, changes the expressions."""
        return ()

    @abstractmethod
    def get_arrays(self) -> tuple[FloatArray, ...]:
        """Return the per-pixel inputs, each float32 of shape (height, width) or (height, width, channels)."""

    def get_parameters(self) -> tuple[float, ...]:
        """Return the scalars of this feature; they may change without compiling again."""
        return ()

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        """Return the planes that taps read, from the input channels of one pixel in the order of the arrays.

        Done once per pixel: whatever does not need both pixels belongs here.
        """
        return list(inputs)

    @abstractmethod
    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        """Return the base-2 logarithm of the similarity, in (-inf, 0], to the power beta.

        Symmetric in i and j, with the offset negated: rows of taps ask once for both.

        Parameters
        ----------
        i, j : sequence of halide.Expr
            Planes of the centre pixel and of the tap.
        parameters : sequence of halide.Expr
            The scalars of `get_parameters`.
        offset : pair of halide.Expr
            Tap minus centre in pixels, x right and y down, float32.
        stage : callable
            Wrap a long intermediate in ``stage(...)`` to compute it in a loop of its own (fewer registers).
        """


def require_positive(name: str, value: float) -> float:
    """Return ``value``; raise InputError unless it is finite and above 0."""
    if not (value > 0.0 and math.isfinite(value)):
        raise InputError(describe_problem(name, expected="a finite number above 0", got=str(value), action="raise it"))
    return float(value)


def dot(a: Sequence[hl.Expr], b: Sequence[hl.Expr]) -> hl.Expr:
    """Return the scalar product of two 3-vectors."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def subtract(a: Sequence[hl.Expr], b: Sequence[hl.Expr]) -> list[hl.Expr]:
    """Return a - b, component by component."""
    return [p - q for p, q in zip(a, b, strict=True)]


class ScreenFeature(Feature):
    """Gaussian of the distance on the screen.

    Parameters
    ----------
    sigma : float
        Standard deviation, pixels, > 0.
    """

    name = "screen"

    def __init__(self, sigma: float) -> None:
        self.sigma = require_positive("screen sigma", sigma)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return ()

    def get_parameters(self) -> tuple[float, ...]:
        return (0.5 * LOG2_E / self.sigma**2,)

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        return -(offset[0] * offset[0] + offset[1] * offset[1]) * parameters[0]


class TentFeature(Feature):
    """Tent over the distance on the screen, ``(1 - |x| / width) (1 - |y| / width)``: bilinear interpolation.

    Parameters
    ----------
    width : float
        Pixels from sample to sample, > 0; the tent is 0 from there on.
    """

    name = "tent"

    def __init__(self, width: float) -> None:
        self.width = require_positive("tent width", width)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return ()

    def get_parameters(self) -> tuple[float, ...]:
        return (1.0 / self.width,)

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        sides = [hl.max(hl.f32(1.0) - hl.abs(step) * parameters[0], hl.f32(0.0)) for step in offset]
        return expressions.log2(hl.max(sides[0] * sides[1], hl.f32(1e-38)))


class PositionFeature(Feature):
    """Gaussian of the distance in the scene, in units of what a pixel covers there.

    With world positions ``|p_i - p_j|^2 / (2 sigma^2 f_i f_j)``; with depth alone the same of ``depth_i - depth_j``;
    f is the footprint ``depth * pixel_angle``. The geometric mean of both footprints keeps the weight symmetric.

    Parameters
    ----------
    place : array, shape (height, width, 3) or (height, width)
        World position, or depth.
    depth : array, shape (height, width)
        Distance to the camera, world units; pixels with depth <= 0 have no surface.
    pixel_angle : float
        Angle of one pixel, radians, > 0.
    sigma : float
        Standard deviation in pixel footprints, > 0.
    """

    name = "position"

    def __init__(self, place: FloatArray, depth: FloatArray, *, pixel_angle: float, sigma: float) -> None:
        self.place = place
        self.depth = depth
        self.pixel_angle = require_positive("pixel angle", pixel_angle)
        self.sigma = require_positive("position sigma", sigma)

    @property
    def structure(self) -> Hashable:
        return self.place.ndim

    @property
    def neutral(self) -> tuple[float, ...]:
        return (0.0, 0.0, 0.0, 1.0) if self.place.ndim == 3 else (0.0, 1.0)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.place, self.depth

    def get_parameters(self) -> tuple[float, ...]:
        return (math.sqrt(0.5 * LOG2_E) / (self.sigma * self.pixel_angle),)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        return [*inputs[:-1], parameters[0] / hl.max(inputs[-1], hl.f32(1e-20))]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        d = subtract(j[:-1], i[:-1])
        distance_squared = dot(d, d) if len(d) == 3 else d[0] * d[0]
        return -distance_squared * (i[-1] * j[-1])


class PlaneFeature(Feature):
    """Gaussian of how far two surface points lie off each other's tangent plane, in units of what a pixel covers.

    ``exp(-((n_i . d)^2 + (n_j . d)^2) / (4 sigma^2 f_i f_j))``, d the step between the points and f the footprint
    ``depth * pixel_angle``. Unlike the distance itself it does not mind how slanted a surface is seen: what tells the
    same surface a frame later from another one.

    Parameters
    ----------
    position, normal : array, shape (height, width, 3)
        World positions and unit normals; 0 both where there is no surface.
    footprint : array, shape (height, width)
        What a pixel covers, times what is allowed for (a moving object), world units, > 0.
    sigma : float
        Standard deviation in footprints, > 0.
    """

    name = "plane"

    def __init__(self, position: FloatArray, normal: FloatArray, footprint: FloatArray, sigma: float) -> None:
        self.position = position
        self.normal = normal
        self.footprint = footprint
        self.sigma = require_positive("plane sigma", sigma)

    @property
    def neutral(self) -> tuple[float, ...]:
        return (0.0,) * 6 + (1.0,)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return self.position, self.normal, self.footprint

    def get_parameters(self) -> tuple[float, ...]:
        return (math.sqrt(0.25 * LOG2_E) / self.sigma,)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        return [*inputs[:6], parameters[0] / hl.max(inputs[6], hl.f32(1e-20))]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        d = subtract(j[:3], i[:3])
        above, below = dot(i[3:6], d), dot(j[3:6], d)
        return -(above * above + below * below) * (i[6] * j[6])


class NormalFeature(Feature):
    """Geometry-aware baseline: ``exp(-exponent (1 - n_i . n_j))``, the usual cosine power for nearby normals.

    Parameters
    ----------
    normal : array, shape (height, width, 3)
        Unit shading normals.
    exponent : float
        Sharpness of the comparison, > 0; ``1/sqrt(exponent)`` is its standard deviation in radians.
    """

    name = "normal"

    def __init__(self, normal: FloatArray, exponent: float) -> None:
        self.normal = normal
        self.exponent = require_positive("normal exponent", exponent)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return (self.normal,)

    def get_parameters(self) -> tuple[float, ...]:
        return (self.exponent * LOG2_E,)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        root = hl.sqrt(parameters[0])
        return [component * root for component in inputs]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        return dot(i, j) - parameters[0]


class BandLimitFeature(Feature):
    """Screen-space Gaussian whose width follows each pixel's reflection lobe.

    Source: the paper's second comparison ("normal-aware filtering with screen-space bandlimit according to the BRDF
    parameter"); a lobe of sharpness lambda that sees something far away blurs it over
    ``scale / (sqrt(lambda) pixel_angle)`` pixels. Departs: two pixels use the mean of their precisions, which keeps
    the weight symmetric.

    Parameters
    ----------
    sharpness : array, shape (height, width)
        Sharpness of the pixel's lobe, > 0.
    pixel_angle : float
        Angle of one pixel, radians, > 0.
    scale : float
        The constant in front, of order 1, > 0.
    largest_sigma : float
        Upper bound of the standard deviation, pixels, > 0.
    """

    name = "band_limit"
    neutral = (1.0,)

    def __init__(self, sharpness: FloatArray, *, pixel_angle: float, scale: float, largest_sigma: float) -> None:
        self.sharpness = sharpness
        self.pixel_angle = require_positive("pixel angle", pixel_angle)
        self.scale = require_positive("band-limit scale", scale)
        self.largest_sigma = require_positive("largest sigma", largest_sigma)

    def get_arrays(self) -> tuple[FloatArray, ...]:
        return (self.sharpness,)

    def get_parameters(self) -> tuple[float, ...]:
        return (self.pixel_angle**2 / self.scale**2, 1.0 / self.largest_sigma**2)

    def prepare(self, inputs: Pixel, parameters: Sequence[hl.Expr]) -> list[hl.Expr]:
        precision = hl.max(inputs[0] * parameters[0], parameters[1])
        return [precision * hl.f32(0.25 * LOG2_E)]

    def log2_similarity(
        self, i: Pixel, j: Pixel, parameters: Sequence[hl.Expr], offset: tuple[hl.Expr, hl.Expr], stage: Stage
    ) -> hl.Expr:
        return -(offset[0] * offset[0] + offset[1] * offset[1]) * (i[0] + j[0])
