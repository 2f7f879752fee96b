"""Anisotropic spherical Gaussians ``G(w) = max(w.z, 0) exp(-l (w.x)^2 - m (w.y)^2)``.

The two sharpnesses and their axes x, y are kept as one symmetric 3x3 matrix of rank 2, ``A = l x x^T + m y y^T``, six
numbers ``xx, xy, xz, yy, yz, zz``, with ``l m`` beside it, so that no two pixels have to agree on a frame. Because
``A z = 0``, the exponent is also ``(w - z)^T A (w - z)``, which loses no digits where the lobe is sharp.

Equal sharpnesses ``s`` are the spherical Gaussian of sharpness ``2 s`` (Xu et al. 2013).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lobewise.lobes.covariance import MIN_VIEW_COSINE

from .brdf import ggx_dominant_visible_normal
from .roughness import GGX_SHARPNESS_SCALES, asg_sharpness_from_sg
from .vectors import Array, as_reals, contract, divide_or, dot, reflect

MIN_VARIANCE = 1e-9
"""Square radians; the least variance of a lobe made from a roughness, so that a mirror without band-limit is finite."""
GGX_LIMIT = 0.6
"""Sharpness added to GGX lobes, so that rough ones are no wider than the hemisphere (fitted to quadrature)."""
INTEGRAL_NODES = 24
"""Per quarter circle: 1e-11 for sharpnesses up to 1e6 in any ratio."""

FROM_SIX = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


class AsgLobe(NamedTuple):
    """An anisotropic spherical Gaussian of value 1 at its axis."""

    axis: Array
    """Unit vector, shape (..., 3)."""
    precision: Array
    """Shape (..., 6): xx, xy, xz, yy, yz, zz of A; inverse square radians; ``precision @ axis = 0``."""
    determinant: Array
    """Product of the two sharpnesses, shape (...)."""


class AsgProduct(NamedTuple):
    """The product of two anisotropic spherical Gaussians: ``amplitude * smooth`` times another one."""

    axis: Array
    """Unit vector, shape (..., 3)."""
    tangent_x: Array
    """Unit vector of the larger sharpness, shape (..., 3)."""
    tangent_y: Array
    """Unit vector of the smaller sharpness, shape (..., 3)."""
    sharpness_x: Array
    """Shape (...), >= ``sharpness_y``."""
    sharpness_y: Array
    """Shape (...), >= 0."""
    amplitude: Array
    """``exp(-c)``, shape (...); the exponent of the product is exact."""
    smooth: Array
    """``max(axis.z_i, 0) max(axis.z_j, 0)``, shape (...), which approximates the two cosines."""


def _outer(a: Array) -> Array:
    """Return the six components of ``a a^T``."""
    x, y, z = a[..., 0], a[..., 1], a[..., 2]
    return np.stack([x * x, x * y, x * z, y * y, y * z, z * z], axis=-1)


def _across(axis: Array) -> Array:
    """Return the six components of ``I - axis axis^T``."""
    return np.asarray([1.0, 0.0, 0.0, 1.0, 0.0, 1.0], dtype=axis.dtype) - _outer(axis)


def _trace(m: Array) -> Array:
    return np.asarray(m[..., 0] + m[..., 3] + m[..., 5])


def make_asg(axis: ArrayLike, tangent: ArrayLike, sharpness_x: ArrayLike, sharpness_y: ArrayLike) -> AsgLobe:
    """Return the lobe around ``axis`` with ``sharpness_x`` along ``tangent`` and ``sharpness_y`` along the third axis.

    ``axis`` and ``tangent`` are perpendicular unit vectors of shape (..., 3), the sharpnesses >= 0. Exact.
    """
    axis, tangent, sharpness_x, sharpness_y = as_reals(axis, tangent, sharpness_x, sharpness_y)
    bitangent = np.cross(axis, tangent)
    precision = sharpness_x[..., None] * _outer(tangent) + sharpness_y[..., None] * _outer(bitangent)
    determinant = np.broadcast_to(sharpness_x * sharpness_y, precision.shape[:-1])
    return AsgLobe(np.broadcast_to(axis, (*precision.shape[:-1], 3)), precision, determinant)


def asg_from_sg(axis: ArrayLike, sg_sharpness: ArrayLike) -> AsgLobe:
    """Return the anisotropic lobe that stands for a spherical Gaussian: half its sharpness in both directions.

    Source: Xu et al. 2013. Approximate: ``exp(-s (1 - u^2)) u`` against ``exp(2 s (u - 1))``, u the cosine.
    """
    axis, sharpness = as_reals(axis, sg_sharpness)
    sharpness = asg_sharpness_from_sg(sharpness)
    precision = sharpness[..., None] * _across(axis)
    shape = precision.shape[:-1]
    return AsgLobe(np.broadcast_to(axis, (*shape, 3)), precision, np.broadcast_to(sharpness * sharpness, shape))


def asg_from_covariance(axis: ArrayLike, covariance: ArrayLike, determinant: ArrayLike) -> AsgLobe:
    """Return the lobe with the shape of a planar Gaussian: ``A = Sigma^-1 / 2`` in the plane across ``axis``.

    Parameters
    ----------
    axis : array_like, shape (..., 3)
    covariance : array_like, shape (..., 6)
        As in `TangentLobe`: ``covariance @ axis = 0``, square radians.
    determinant : array_like
        Product of the two principal variances, > 0.
    """
    axis, covariance, determinant = as_reals(axis, covariance, determinant)
    # in two dimensions the inverse is (trace I - Sigma) / det
    scale = 0.5 / determinant
    precision = scale[..., None] * (_trace(covariance)[..., None] * _across(axis) - covariance)
    return AsgLobe(axis, precision, 0.5 * scale)


def asg_evaluate(direction: ArrayLike, lobe: AsgLobe) -> Array:
    """Return the value of a lobe in ``direction`` (unit vectors, shape (..., 3)). Exact."""
    direction, axis, precision = as_reals(direction, lobe.axis, lobe.precision)
    exponent = contract(precision, _outer(direction - axis))
    return np.asarray(np.maximum(dot(direction, axis), 0.0) * np.exp(-exponent))


def asg_integral(sharpness_x: ArrayLike, sharpness_y: ArrayLike) -> Array:
    """Return the integral over the sphere of a lobe with these sharpnesses (>= 0; pi where both are 0). Exact.

    With ``K = l cos^2 phi + m sin^2 phi`` it is the integral of ``(1 - exp(-K)) / (2 K)`` over the circle. The
    trapezoid rule does that to rounding in the angle psi with ``tan phi = g tan psi``,
    ``g = ((1 + l) / (1 + m))^(3/8)``, which spreads the narrow peak of unequal sharpnesses over the circle.
    """
    sharpness_x, sharpness_y = as_reals(sharpness_x, sharpness_y)
    large, small = np.maximum(sharpness_x, sharpness_y)[..., None], np.minimum(sharpness_x, sharpness_y)[..., None]
    stretch = ((1.0 + large) / (1.0 + small)) ** 0.375
    # midpoints of a quarter of the circle; the rest is the same by symmetry
    psi = (np.arange(INTEGRAL_NODES) + 0.5) * (0.5 * math.pi / INTEGRAL_NODES)
    cosine, sine = np.cos(psi).astype(large.dtype), np.sin(psi).astype(large.dtype) * stretch
    length = cosine * cosine + sine * sine
    k = (large * cosine * cosine + small * sine * sine) / length
    values = divide_or(-np.expm1(-k), k, 1.0) * stretch / length
    return np.asarray(math.pi * np.mean(values, axis=-1))


def _scaled_bessel(x: Array) -> Array:
    """Return ``exp(-x) I0(x)`` for x >= 0."""
    near = np.minimum(x, 20.0)
    far = 1.0 / np.maximum(x, 20.0)
    series = 1.0 + far * (1.0 / 8.0 + far * (9.0 / 128.0 + far * (225.0 / 3072.0)))
    tail = np.sqrt(far / (2.0 * math.pi)) * series
    return np.asarray(np.where(x < 20.0, np.exp(-near) * np.i0(near), tail), dtype=x.dtype)


def asg_approx_integral(sharpness_x: ArrayLike, sharpness_y: ArrayLike) -> Array:
    """Return the integral over the sphere in closed form: ``pi / sqrt(l m)`` less what lies beyond the equator.

    With ``l >= m``, ``n = l - m`` and ``F(a) = 2 pi exp(-a / 2) I0(a / 2)`` it is
    ``pi / sqrt(l m) - exp(-m) / (2 l) (F(n) + n / m F(n + n / m))``. Exact for equal sharpnesses.
    Validity: error at most 2.7 % at (2, 0.5), 0.2 % at (5, 1), 1.2 % at (100, 1); of no use for m below 0.3.
    """
    sharpness_x, sharpness_y = as_reals(sharpness_x, sharpness_y)
    large, small = np.maximum(sharpness_x, sharpness_y), np.minimum(sharpness_x, sharpness_y)
    excess = large - small
    ratio = excess / small
    cut = _scaled_bessel(0.5 * excess) + ratio * _scaled_bessel(0.5 * (excess + ratio))
    return np.asarray(math.pi * (1.0 / (np.sqrt(large) * np.sqrt(small)) - np.exp(-small) / large * cut))


def _exact_matrix(lobe: AsgLobe) -> tuple[Array, Array]:
    """Return (axis, A), (..., 3) and (..., 3, 3), in double precision, with ``A axis = 0`` to its last digits.

    Single precision leaves ``axis^T A axis`` at 1e-7 of the sharpness, which a sharp lobe's exponent would show.
    """
    axis = np.asarray(lobe.axis, dtype=np.float64)
    across = _across(axis)[..., FROM_SIX]
    return axis, across @ np.asarray(lobe.precision, dtype=np.float64)[..., FROM_SIX] @ across


def asg_product(lobe_i: AsgLobe, lobe_j: AsgLobe) -> AsgProduct:
    """Return the product of two lobes as one lobe with a factor.

    Source: Xu et al. 2013: with the eigenvalues ``a >= b >= c`` of ``A_i + A_j`` and their vectors ``e1, e2, e3`` the
    product is ``exp(-c)`` times the lobe of sharpness ``a - c`` along e1 and ``b - c`` along e2 around e3. That is
    exact but for the two cosines, for which ``(e3.z_i) (e3.z_j)`` times the lobe's own one stands.
    """
    dtype = np.result_type(lobe_i.precision, lobe_j.precision)
    axis_i, matrix_i = _exact_matrix(lobe_i)
    axis_j, matrix_j = _exact_matrix(lobe_j)
    values, vectors = np.linalg.eigh(matrix_i + matrix_j)
    axis = vectors[..., 0]
    axis = axis * np.where(dot(axis, axis_i + axis_j) < 0.0, -1.0, 1.0)[..., None]
    least = np.maximum(values[..., 0], 0.0)
    parts = (
        axis,
        vectors[..., 2],
        vectors[..., 1],
        np.maximum(values[..., 2] - least, 0.0),
        np.maximum(values[..., 1] - least, 0.0),
        np.exp(-least),
        np.maximum(dot(axis, axis_i), 0.0) * np.maximum(dot(axis, axis_j), 0.0),
    )
    return AsgProduct(*(np.asarray(part, dtype=dtype) for part in parts))


def _two_cosine_integral(sharpness_x: Array, sharpness_y: Array) -> Array:
    """Return `asg_integral` times the mean of a cosine: the integral of ``max(w.z, 0)^2 exp(-w^T A w)``."""
    product, total = sharpness_x * sharpness_y, sharpness_x + sharpness_y
    return asg_integral(sharpness_x, sharpness_y) * divide_or(product, product + 0.25 * total, 0.5)


def asg_product_integral(lobe_i: AsgLobe, lobe_j: AsgLobe) -> Array:
    """Return the integral over the sphere of the product of two lobes. Approximate.

    ``exp(-c) (e3.z_i) (e3.z_j) I(a - c, b - c)``, see `asg_product`; I is `asg_integral` with a second cosine.
    Source: Xu et al. 2013.
    Departs: the product has two cosines and one lobe has one. The mean of the second, ``1 / (1 + (1 / l + 1 / m) / 4)``
    for the sharpnesses l and m of the product, takes the relative error from 0.16, 0.022 and 0.0065 (RMS, smallest
    sharpness 1 to 2, 5 to 10 and 10 to 100) to 0.041, 0.0015 and 0.0002.
    """
    product = asg_product(lobe_i, lobe_j)
    integral = _two_cosine_integral(product.sharpness_x, product.sharpness_y)
    return np.asarray(product.amplitude * product.smooth * integral)


def asg_sg_product_integral(lobe: AsgLobe, sg_axis: ArrayLike, sg_sharpness: ArrayLike) -> Array:
    """Return the integral over the sphere of a lobe times a spherical Gaussian. Approximate.

    Source: Xu et al. 2013, the convolution operator: with ``n`` half the sharpness of the SG and p its axis,
    ``pi / sqrt((l + n) (m + n)) max(p.z, 0) exp(-l n / (l + n) (p.x)^2 - m n / (m + n) (p.y)^2)``.
    Departs: written with the trace t and the determinant D of A instead of its eigenvectors: ``(l + n) (m + n)`` is
    ``d = D + n t + n^2`` and the exponent ``n (n p^T A p + D (1 - (p.z)^2)) / d``.
    """
    axis, precision, determinant, sg_axis, sharpness = as_reals(
        lobe.axis, lobe.precision, lobe.determinant, sg_axis, sg_sharpness
    )
    half = asg_sharpness_from_sg(sharpness)
    total = determinant + half * (_trace(precision) + half)
    difference = sg_axis - axis
    square = dot(difference, difference)
    # 1 - (p.z)^2 without its cancellation
    sine_square = square * (1.0 - 0.25 * square)
    exponent = half * (half * contract(precision, _outer(difference)) + determinant * sine_square) / total
    return np.asarray(math.pi / np.sqrt(total) * np.maximum(dot(sg_axis, axis), 0.0) * np.exp(-exponent))


def asg_sharpness(lobe: AsgLobe) -> tuple[Array, Array]:
    """Return the two sharpnesses of a lobe, the larger one first."""
    precision, determinant = as_reals(lobe.precision, lobe.determinant)
    trace = _trace(precision)
    large = 0.5 * (trace + np.sqrt(np.maximum(trace * trace - 4.0 * determinant, 0.0)))
    return large, divide_or(determinant, large, 0.0)


def asg_similarity(lobe_i: AsgLobe, lobe_j: AsgLobe) -> Array:
    """Return the L2-normalised product integral of two lobes, in [0, 1]; 1 for equal lobes. Approximate.

    `asg_product_integral` over the norms by the same formula. Validity: RMSE of S against quadrature over random pairs
    (sharpness ratio in a lobe up to 4, between lobes up to 3, any twist, axes up to 1.3 widths apart) 0.012 for the
    smallest sharpness from 1 to 2, 0.0026 from 2 to 5, 0.0003 from 5 to 10.
    """
    norms = [_two_cosine_integral(2.0 * x, 2.0 * y) for x, y in (asg_sharpness(lobe_i), asg_sharpness(lobe_j))]
    value = asg_product_integral(lobe_i, lobe_j) / (np.sqrt(norms[0]) * np.sqrt(norms[1]))
    return np.asarray(np.clip(value, 0.0, 1.0))


def asg_approx_similarity(
    lobe_i: AsgLobe, lobe_j: AsgLobe, beta: ArrayLike = 1.0, *, shift: ArrayLike | None = None
) -> Array:
    """Return the similarity of two lobes without eigenvectors, in [0, 1], as the image kernels do. Approximate.

    Parameters
    ----------
    lobe_i, lobe_j : AsgLobe
        Lobes with positive determinants.
    beta : array_like
        Bandwidth exponent, > 0.
    shift : array_like, shape (..., 3), optional
        Added to the difference of the axes in c (`compute_hit_shift`).

    Notes
    -----
    With ``d = z_j - z_i``, ``g`` the root of the determinant, ``H = A / g`` the shape of the lobe,
    ``E = H_j - H_i``, ``N = (g_i + g_j)^2 + g_i g_j (E:E - (tr E)^2) / 2``,
    ``c = g_i g_j d^T (g_j H_i + g_i H_j) d / N``, ``s = tr(A_i + A_j) / N`` and, of each lobe, ``h = tr A / (8 g^2)``:
    ``S = 2 sqrt(g_i g_j / N) exp((h_i + h_j) / 2 - c - s (c - 1/2)^2 - |d|^2 / 4 (1 + |d|^2))``.

    Because both matrices have rank 2 and nothing along their own axis, the invariants of ``A_i + A_j`` are exactly
    ``c N`` (determinant), ``N`` (sum of the principal minors) and ``s N`` (trace), and none of them loses digits
    between similar lobes. ``c`` is the first step of Newton's method towards the smallest eigenvalue, the exponent of
    the product of the lobes; ``s c^2`` is what the second step adds, ``-s c`` turns N into the determinant across the
    product's axis, and ``s / 4`` is the second cosine of `asg_product_integral`, as ``h`` is in the norms. All are
    right to first order in s, which is of the order of 1 / sharpness. ``|d|^2 / 4`` stands for the other two cosines,
    and the term with it for the hemispheres, which part as the axes do: the exponent of an anisotropic lobe is the
    same for w and -w, so that without these lobes which face away from each other would be taken for similar.
    ``E:E >= (tr E)^2`` (Garding's inequality), and so it is held; the result is not taken above 1.

    Source: this library, from the product of Xu et al. 2013. Validity: RMSE of S against quadrature over random pairs
    as in `asg_similarity`: 0.008 for the smallest sharpness from 1 to 2, 0.0033 from 2 to 5, 0.0015 from 5 to 10,
    0.0006 from 10 to 100. In single precision within 1e-4 up to sharpness 1e6.
    """
    axis_i, precision_i, determinant_i, axis_j, precision_j, determinant_j, beta = as_reals(*lobe_i, *lobe_j, beta)
    difference = axis_j - axis_i
    square = dot(difference, difference)
    trace_i, trace_j = _trace(precision_i), _trace(precision_j)
    size_i, size_j = np.sqrt(determinant_i), np.sqrt(determinant_j)
    shape_i, shape_j = precision_i / size_i[..., None], precision_j / size_j[..., None]
    change = shape_j - shape_i
    unlike = np.maximum(contract(change, change) - _trace(change) ** 2, 0.0)
    product, total = size_i * size_j, size_i + size_j
    inverse = 1.0 / (total * total + 0.5 * product * unlike)
    if shift is not None:
        difference = difference + as_reals(shift)[0].astype(difference.dtype)
    spread = contract(size_j[..., None] * shape_i + size_i[..., None] * shape_j, _outer(difference))
    c = product * np.maximum(spread, 0.0) * inverse
    softness = (trace_i + trace_j) * inverse
    norms = (trace_i / determinant_i + trace_j / determinant_j) / 16.0
    exponent = c + softness * (c - 0.5) ** 2 + 0.25 * square * (1.0 + square)
    exponent = exponent - norms - 0.5 * np.log(4.0 * product * inverse)
    return np.asarray(np.exp(-beta * np.maximum(exponent, 0.0)))


def reflect_asg(view: ArrayLike, normal: ArrayLike, sharpness: ArrayLike) -> AsgLobe:
    """Return the reflected lobe of normals with one ASG sharpness around ``normal``.

    Source: Xu et al. 2013, the spherical warp: axis ``2 (n.v) n - v``, sharpness ``s / (4 (n.v)^2)`` across the plane
    of incidence and ``s / 4`` in it. Exact to first order.
    Departs: ``n.v`` is not taken below 0.03 (`MIN_VIEW_COSINE`). Written with ``v x n`` instead of
    its direction: nothing is 0/0 at n = v.
    """
    view, normal, sharpness = as_reals(view, normal, sharpness)
    cosine = dot(normal, view)
    axis, cross = reflect(view, normal), np.cross(view, normal)
    square = np.maximum(cosine, MIN_VIEW_COSINE) ** 2
    # (1 / square - 1) / |v x n|^2, which is 1 / square above the floor
    excess = (1.0 - (square - cosine * cosine) / np.maximum(1.0 - cosine * cosine, 0.5)) / square
    quarter = 0.25 * sharpness
    precision = quarter[..., None] * (_across(axis) + excess[..., None] * _outer(cross))
    return AsgLobe(axis, precision, quarter * quarter / square)


def _reflect_step(step: Array, view: Array, normal: Array) -> Array:
    """Return where a step of the normal takes the reflection: ``2 (v.d) m + 2 (v.m) d``, d the step across m."""
    cosine = dot(normal, view)[..., None]
    step = step - dot(step, normal)[..., None] * normal
    along = dot(step, view)[..., None]
    # the floor of v.m widens only the part across the plane of incidence
    lift = np.maximum(cosine, MIN_VIEW_COSINE) - cosine
    across = step - along / np.maximum(1.0 - cosine * cosine, 0.5) * (view - cosine * normal)
    return np.asarray(2.0 * along * normal + 2.0 * cosine * step + 2.0 * lift * across)


def reflect_anisotropic_asg(
    view: ArrayLike, normal: ArrayLike, tangent: ArrayLike, sharpness_u: ArrayLike, sharpness_v: ArrayLike
) -> AsgLobe:
    """Return the reflected lobe of normals with the ASG sharpness ``sharpness_u`` along ``tangent``, the other across.

    The precision of the normals L becomes ``J^-T L J^-1``, with the Jacobian ``J d = 2 (v.d) n + 2 (v.n) d``. Exact to
    first order; equal sharpnesses give `reflect_asg`. ``n.v`` is not taken below 0.03.
    """
    view, normal, tangent, sharpness_u, sharpness_v = as_reals(view, normal, tangent, sharpness_u, sharpness_v)
    step_u = _reflect_step(tangent, view, normal)
    step_v = _reflect_step(np.cross(normal, tangent), view, normal)
    axis = reflect(view, normal)
    # the covariance times lu lv, and its inverse in two dimensions: (trace I - C) / det, det J = 4 n.v
    shape = sharpness_v[..., None] * _outer(step_u) + sharpness_u[..., None] * _outer(step_v)
    jacobian = 16.0 * np.maximum(dot(normal, view), MIN_VIEW_COSINE) ** 2
    precision = (_trace(shape)[..., None] * _across(axis) - shape) / jacobian[..., None]
    return AsgLobe(axis, precision, sharpness_u * sharpness_v / jacobian)


def _dominant_normal(view: Array, normal: Array, tangent: Array, alpha_u: Array, alpha_v: Array) -> Array:
    bitangent = np.cross(normal, tangent)
    local = np.stack([dot(tangent, view), dot(bitangent, view), dot(normal, view)], axis=-1)
    m = ggx_dominant_visible_normal(local, alpha_u, alpha_v)
    return np.asarray(m[..., :1] * tangent + m[..., 1:2] * bitangent + m[..., 2:] * normal)


def _any_tangent(normal: Array) -> Array:
    """Return a unit vector across ``normal``, continuous but at one pole (Duff et al. 2017)."""
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    sign = np.where(z < 0.0, -1.0, 1.0).astype(normal.dtype)
    a = -1.0 / (sign + z)
    return np.stack([1.0 + sign * x * x * a, sign * x * y * a, -sign * x], axis=-1)


def make_ggx_asg(
    view: ArrayLike,
    normal: ArrayLike,
    alpha_u: ArrayLike,
    alpha_v: ArrayLike | None = None,
    tangent: ArrayLike | None = None,
    *,
    dominant: bool = True,
    tau: float = 0.0,
) -> AsgLobe:
    """Return the single anisotropic lobe for a GGX reflection.

    Parameters
    ----------
    view, normal : array_like, shape (..., 3)
        Unit vectors away from the surface, ``normal.view > 0``.
    alpha_u, alpha_v : array_like
        Roughness along and across ``tangent``, >= 0; ``alpha_v`` defaults to ``alpha_u``. Values above 1 count as 1.
    tangent : array_like, shape (..., 3), optional
        Unit vector perpendicular to ``normal``; not needed where the two roughnesses are equal.
    dominant : bool
        True: the lobe is reflected about the dominant visible normal m, its variances divided by m.n (see
        `ggx_dominant_visible_normal`). False: about the normal.
    tau : float
        Radians; ``tau^2`` is added to both variances (band-limit). Together they are at least 1e-9.

    Notes
    -----
    The normals have the sharpnesses ``1.131 (1 / alpha^2 - 1)`` (`asg_sharpness_from_ggx`),
    reflected as in `reflect_anisotropic_asg`; `GGX_LIMIT` is added to both. Written over common denominators nothing is
    divided by 0 from alpha 0 to 1. Validity: see the theory page.
    """
    view, normal, alpha_u, alpha_v, tangent_ = as_reals(
        view, normal, alpha_u, alpha_u if alpha_v is None else alpha_v, normal if tangent is None else tangent
    )
    if tangent is None:
        tangent_ = _any_tangent(normal)
    m = _dominant_normal(view, normal, tangent_, alpha_u, alpha_v) if dominant else normal
    slope = dot(m, normal)
    axis = reflect(view, m)
    square_u, square_v = alpha_u * alpha_u, alpha_v * alpha_v
    deficit_u, deficit_v = np.maximum(1.0 - square_u, 0.0), np.maximum(1.0 - square_v, 0.0)
    # U, the inverse of the reflected precision, and its determinant, both times g = deficit_u deficit_v
    scale = 1.0 / (0.5 * GGX_SHARPNESS_SCALES["l2"] * slope)
    step_u = _reflect_step(tangent_, view, m)
    step_v = _reflect_step(np.cross(normal, tangent_), view, m)
    weight_u, weight_v = scale * square_u * deficit_v, scale * square_v * deficit_u
    inverse = weight_u[..., None] * _outer(step_u) + weight_v[..., None] * _outer(step_v)
    # across m the two steps of the normal span m.n
    area = 16.0 * (np.maximum(dot(view, m), MIN_VIEW_COSINE) * slope * scale) ** 2 * square_u * square_v
    # (U^-1 + c I)^-1 = (U g + c det I) / (g + c tr + c^2 det), its determinant det over the same
    trace = _trace(inverse)
    half = 0.5 / (deficit_u * deficit_v + GGX_LIMIT * (trace + GGX_LIMIT * area))
    noise = max(tau * tau, MIN_VARIANCE)
    covariance = half[..., None] * inverse + (half * GGX_LIMIT * area + noise)[..., None] * _across(axis)
    spread = half * (trace + 2.0 * GGX_LIMIT * area)
    return asg_from_covariance(axis, covariance, 0.5 * half * area + noise * (spread + noise))
