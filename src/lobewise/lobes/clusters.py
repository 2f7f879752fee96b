"""Light from a cluster of virtual lights, whose places and directions are Gaussians, on surfaces in closed form.

Source: Tokuyoshi 2015, "Virtual Spherical Gaussian Lights for Real-Time Glossy Indirect Illumination": the places of
the lights are a Gaussian of variance ``sigma^2``, so that a surface at the distance r sees a spherical Gaussian of
sharpness ``r^2 / sigma^2``; the radiant intensity of all lights is one spherical Gaussian for the diffuse and one for
the glossy part. Departs: the places have a covariance, because clusters are flat, and the lobe that receives is a sum
of planar Gaussians, `lobewise.lobes.gaussian`, about the axis of `lobewise.lobes.covariance`.
"""

from __future__ import annotations

import math
from typing import Any

from lobewise.lobes.gaussian import GGX_MIXTURES, compute_share_on_sphere, integrate_gaussian
from lobewise.lobes.numbers import Namespace
from lobewise.lobes.vectors import Vector, combine, dot

MAX_SHARPNESS = 1e6
"""Largest sharpness of a distribution of directions, inverse square radians: a milliradian."""
MIN_EXACT_SHARPNESS = 0.1
"""Sharpness below which the mean direction has a length of a third of the sharpness, to 1e-4."""
MIN_HALF_COSINE_SQUARE = 1e-4
"""Smallest squared cosine of half the angle between two directions whose offset in a plane is found."""
MIN_VARIANCE = 1e-6
"""Smallest principal variance of a lobe that receives light, square radians."""
TINY = 1e-30
"""Addend of a divisor that may be 0."""
GGX_SHARES = 3
"""Number of Gaussians that a GGX lobe is a sum of."""


def convolve_sharpness(first: Any, second: Any) -> Any:
    """Return the sharpness ``a b / (a + b)`` of two spherical Gaussians convolved; the sum must be above 0.

    Approximate: variances add up, which holds for narrow lobes. At sharpness 2 it is 10 % too high.
    """
    return first * second / (first + second)


def compute_mean_length(xp: Namespace, sharpness: Any) -> Any:
    """Return ``coth l - 1 / l``: the length, 0 to 1, of the mean of directions spread as a spherical Gaussian.

    Exact (Mardia and Jupp 2000, "Directional Statistics", section 9.3) above `MIN_EXACT_SHARPNESS`, and below to 1e-4.
    """
    safe = xp.maximum(sharpness, xp.number(MIN_EXACT_SHARPNESS))
    share = compute_share_on_sphere(xp, safe)
    return xp.where(sharpness < xp.number(MIN_EXACT_SHARPNESS), sharpness / 3.0, (2.0 - share) / share - 1.0 / safe)


def compute_sharpness_of_mean(xp: Namespace, length: Any) -> Any:
    """Return the sharpness whose mean direction has a length in [0, 1], at most `MAX_SHARPNESS`.

    Source: Banerjee et al. 2005, "Clustering on the Unit Hypersphere using von Mises-Fisher Distributions":
    ``(3 r - r^3) / (1 - r^2)``. Approximate: within 5 % of the inverse of `compute_mean_length`.
    """
    square = length * length
    return length * (3.0 - square) / xp.maximum(1.0 - square, xp.number(2.0 / MAX_SHARPNESS))


def compute_positive_mean(xp: Namespace, mean: Any, variance: Any) -> Any:
    """Return the mean of ``max(x, 0)`` of a number x with a mean and a variance. Approximate.

    ``(m + sqrt(m^2 + 2 s^2 / pi)) / 2``: exact for a Gaussian of mean 0, and far from 0. For a cosine whose direction
    is spread as a spherical Gaussian of any sharpness it is within 0.02.
    """
    return 0.5 * (mean + xp.sqrt(mean * mean + (2.0 / math.pi) * xp.maximum(variance, 0.0)))


def compute_positive_share(mean: Any, positive_mean: Any) -> Any:
    """Return the probability that a number is above 0, by its mean and the `compute_positive_mean` of it. Approximate.

    It is the derivative of the positive mean by the mean: 1/2 at mean 0.
    """
    return positive_mean / (2.0 * positive_mean - mean + TINY)


def compute_cosine_variance(cosine: Any, length: Any, across: Any, part: Any) -> Any:
    """Return the variance of n.w over directions w spread about an axis.

    Exact for a spherical Gaussian with the shares below (Mardia and Jupp 2000, section 9.3).

    Parameters
    ----------
    cosine : number
        Cosine between n and the axis.
    length : number
        `compute_mean_length` of the sharpness of w.
    across : number
        Variance of w along one direction across the axis: ``length / sharpness``.
    part : number
        Variance along the part of n that is across the axis, over ``across``: ``1 - cosine^2`` if w is spread evenly.
    """
    return part * across + cosine * cosine * (1.0 - 2.0 * across - length * length)


def evaluate_gaussian(xp: Namespace, cosine: Any, sharpness: Any) -> Any:
    """Return a spherical Gaussian of integral 1 in a direction at ``cosine`` to its axis, 1/sr. Exact."""
    return _exp(xp, sharpness * (cosine - 1.0)) / integrate_gaussian(xp, sharpness)


def project_direction(
    xp: Namespace, axis: Vector, basis: tuple[Vector, Vector], direction: Vector
) -> tuple[Any, Any, Any]:
    """Return the two coordinates of a direction in the plane across an axis, and ``1 + axis.direction``.

    The distance from 0 is the chord between direction and axis. ``basis`` holds two unit vectors across the axis.
    """
    twice = xp.maximum(1.0 + dot(axis, direction), xp.number(2.0 * MIN_HALF_COSINE_SQUARE))
    longer = xp.sqrt(2.0 / twice)
    return dot(basis[0], direction) * longer, dot(basis[1], direction) * longer, twice


def project_covariance(
    axis: Vector, basis: tuple[Vector, Vector], direction: Vector, twice: Any, covariance: Vector
) -> list[Any]:
    """Return xx, xy and yy of a covariance (six numbers) seen along a direction, in the turned basis of an axis.

    The basis is turned with the axis to the direction on the shortest way. ``twice`` is that of `project_direction`.
    """
    between = combine((1.0, axis), (1.0, direction))
    first, second = (combine((1.0, side), (-dot(side, direction) / twice, between)) for side in basis)
    images = [multiply_covariance(covariance, side) for side in (first, second)]
    return [dot(first, images[0]), dot(first, images[1]), dot(second, images[1])]


def multiply_covariance(covariance: Vector, vector: Vector) -> list[Any]:
    """Return the symmetric matrix xx, xy, xz, yy, yz, zz times a vector."""
    xx, xy, xz, yy, yz, zz = covariance
    return [dot((xx, xy, xz), vector), dot((xy, yy, yz), vector), dot((xz, yz, zz), vector)]


def evaluate_lobe(xp: Namespace, offset: tuple[Any, Any], lobe: Vector, light: Vector, beckmann: Any) -> Any:
    """Return a reflection lobe of integral 1, convolved with a planar Gaussian, at an offset from its axis, 1/sr.

    Exact in the plane but for the mixture of `GGX_SHARES` Gaussians that stands for GGX.

    Parameters
    ----------
    xp : Namespace
    offset : two numbers
        See `project_direction`.
    lobe, light : three numbers
        ``xx``, ``xy``, ``yy`` of the covariances of the lobe (`lobewise.lobes.covariance`) and of the light, square
        radians. The sum must be regular.
    beckmann : truth
        Whether the lobe is one Gaussian instead of GGX.
    """
    exponents, weights = GGX_MIXTURES[GGX_SHARES]
    total = sum(weight / exponent for weight, exponent in zip(weights, exponents, strict=True))
    value: Any = 0.0
    for number, (exponent, weight) in enumerate(zip(exponents, weights, strict=True)):
        narrower = xp.where(beckmann, 1.0, xp.number(1.0 / exponent))
        share = xp.where(beckmann, 1.0 if number == 0 else 0.0, xp.number(weight / exponent / total))
        covariance = [narrower * part + more for part, more in zip(lobe, light, strict=True)]
        square, determinant = _measure_offset(xp, offset, covariance)
        value = value + share * _exp(xp, -0.5 * square) / (xp.number(2.0 * math.pi) * xp.sqrt(determinant))
    return value


def bound_lobe(xp: Namespace, offset: tuple[Any, Any], lobe: Vector, variance: Any) -> Any:
    """Return a lobe of integral 1 with the tails of GGX about an axis, widened by a variance, 1/sr.

    It estimates `evaluate_lobe` for clusters of any shape of this variance, and never vanishes.
    """
    square, determinant = _measure_offset(xp, offset, (lobe[0] + variance, lobe[1], lobe[2] + variance))
    tail = 1.0 + 0.5 * square
    return 1.0 / (xp.number(2.0 * math.pi) * xp.sqrt(determinant) * (tail * tail))


def _measure_offset(xp: Namespace, offset: tuple[Any, Any], covariance: Vector) -> tuple[Any, Any]:
    """Return the squared length of an offset in standard deviations, and the determinant of the covariance.

    Rounding leaves the determinant above 0 if both principal variances are at least `MIN_VARIANCE`.
    """
    x, y = offset
    xx, xy, yy = covariance
    determinant = xp.maximum(xx * yy - xy * xy, xp.number(0.5 * MIN_VARIANCE) * (xx + yy))
    return (x * x * yy - 2.0 * (x * y) * xy + y * y * xx) / determinant, determinant


def _exp(xp: Namespace, value: Any) -> Any:
    return xp.expm1(value) + 1.0
