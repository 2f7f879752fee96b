"""The similarities of covariance lobes (`lobewise.lobes.covariance`), in arrays of vectors."""

from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from lobewise.lobes.covariance import compute_round_covariance, make_covariance_lobe
from lobewise.lobes.numbers import NUMPY, NUMPY_SINGLE

from .vectors import Array, as_reals, contract, dot

GGX_WIDTH_POWER = 0.6
GGX_SHAPE_POWER = 0.9


class TangentLobe(NamedTuple):
    """A reflection lobe as a covariance in the plane across its axis."""

    axis: Array
    """Unit vector, shape (..., 3)."""
    covariance: Array
    """Shape (..., 6): xx, xy, xz, yy, yz, zz; square radians; ``covariance @ axis = 0``."""
    determinant: Array
    """Product of the two principal variances, shape (...)."""


def _split(vector: Array) -> tuple[Array, Array, Array]:
    return vector[..., 0], vector[..., 1], vector[..., 2]


def make_tangent_lobe(
    view: ArrayLike,
    normal: ArrayLike,
    alpha_u: ArrayLike,
    alpha_v: ArrayLike | None = None,
    tangent: ArrayLike | None = None,
    *,
    tau: float = 0.0,
    beckmann: bool = False,
    gaussian: bool = False,
) -> TangentLobe:
    """Return `lobewise.lobes.covariance.make_covariance_lobe` of arrays of vectors.

    Parameters
    ----------
    view, normal : array_like, shape (..., 3)
        Unit vectors away from the surface, ``normal.view > 0``.
    alpha_u, alpha_v : array_like
        Roughness along and across ``tangent``, in [0, 1]; ``alpha_v`` defaults to ``alpha_u``.
    tangent : array_like, shape (..., 3), optional
        Unit vector perpendicular to ``normal``; without it the lobe is isotropic with roughness ``alpha_u``.
    tau : float
        Radians; ``tau^2`` is added to both variances (band-limit).
    beckmann, gaussian : bool
        Beckmann normals instead of GGX; the covariance of the L2-best Gaussian.

    Returns
    -------
    TangentLobe
    """
    view, normal, alpha_u, alpha_v, tangent_ = as_reals(
        view, normal, alpha_u, alpha_u if alpha_v is None else alpha_v, normal if tangent is None else tangent
    )
    tangents = None if tangent is None else (_split(tangent_), _split(np.cross(normal, tangent_)))
    lobe = make_covariance_lobe(
        NUMPY_SINGLE if normal.dtype == np.float32 else NUMPY,
        _split(normal),
        _split(view),
        dot(normal, view),
        [alpha_u, alpha_v],
        tangents,
        tau * tau,
        beckmann=beckmann,
        gaussian=gaussian,
    )
    axis, covariance = (np.stack(np.broadcast_arrays(*parts), axis=-1) for parts in lobe[:2])
    return TangentLobe(axis, covariance, np.asarray(lobe.determinant))


def _quadratic(m: Array, a: Array) -> Array:
    """Return ``a^T M a`` of six components."""
    x, y, z = _split(a)
    return np.asarray(
        m[..., 0] * x * x
        + m[..., 3] * y * y
        + m[..., 5] * z * z
        + 2.0 * (m[..., 1] * x * y + m[..., 2] * x * z + m[..., 4] * y * z)
    )


def _log_areas(pre: Array, lobe_i: TangentLobe, lobe_j: TangentLobe) -> Array:
    """Return the logarithm of ``pre^0.9 (2 sqrt(s_i s_j) / (s_i + s_j))^-0.3``, ``s = sqrt(det)``."""
    scale_i, scale_j = np.sqrt(lobe_i.determinant), np.sqrt(lobe_j.determinant)
    scale = 2.0 * np.sqrt(scale_i) * np.sqrt(scale_j) / (scale_i + scale_j)
    sizes = (GGX_WIDTH_POWER - GGX_SHAPE_POWER) * np.log(np.minimum(scale, 1.0))
    return np.asarray(GGX_SHAPE_POWER * np.log(np.minimum(pre, scale)) + sizes)


def _split_eigenvalues(lobe: TangentLobe) -> tuple[Array, Array, Array]:
    """Return the eigenvalues a >= b of the covariance, and ``S - b P``, whose rank is 1."""
    trace = lobe.covariance[..., 0] + lobe.covariance[..., 3] + lobe.covariance[..., 5]
    mean = np.stack(compute_round_covariance(0.5 * trace, _split(lobe.axis)), axis=-1)
    # from the deviation from the mean: free of cancellation between lobes that are nearly round
    gap = np.sqrt(2.0 * contract(lobe.covariance - mean, lobe.covariance - mean))
    large = 0.5 * (trace + gap)
    small = lobe.determinant / large
    return large, small, lobe.covariance - np.stack(compute_round_covariance(small, _split(lobe.axis)), axis=-1)


def tangent_approx_similarity(lobe_i: TangentLobe, lobe_j: TangentLobe, beta: ArrayLike = 1.0) -> Array:
    """Return the similarity of two GGX lobes, in [0, 1], to the power ``beta``, as the image kernels do. Approximate.

    ``pre^0.9 (2 sqrt(s_i s_j) / (s_i + s_j))^-0.3 (1 + q / 4)^-2.4`` with ``s = sqrt(det)``,
    ``pre = 2 (det_i det_j)^(1/4) / sqrt(det M)``, ``q = d^T M^-1 d`` and M the sum of both covariances. The exponent is
    0.6 for unequal sizes, which is right for concentric lobes of one shape, and 0.9 for unequal shapes, which tells
    lobes of unlike anisotropy apart as they are in truth.

    With ``d = z_j - z_i`` and ``R = tr(S) P - S``, the covariances turned by a quarter about their axes,
    ``Q = d^T (R_i + R_j) d`` is the determinant of ``A_i + A_j``, ``A = S^-1`` in its plane, over ``det A_i det A_j``,
    exactly (neither matrix has anything along its own axis), and ``P = det_i + det_j + T_i T_j - R_i:R_j``, T the
    traces, is their second invariant over the same; ``q = Q / P`` and ``det M = P``, exact in a plane and off by second
    order in the angle of the axes. With the eigenvalues ``a >= b`` of S and ``L = S - b P``, which has rank 1, R is
    ``a P - L``. So that lobes which face away from each other are unlike, R gets a along its axis as well, which makes
    Q for round lobes the squared chord, and P is taken in a plane:
    ``Q = (a_i + a_j) |d|^2 - d^T (L_i + L_j) d``, ``P = (a_i + b_j) (a_j + b_i) - L_i:L_j``. P is bounded below by
    ``(sqrt(det_i) + sqrt(det_j))^2``, which it never is below but for rounding. The kernel is ``(1 + q / 4)^-2.4``,
    whose exponent is eight times 0.3: the planar L2 autocorrelation of the GGX shape within 3.7e-3.

    Validity: docs/developers/theory.md has bounds of the RMSE of S against quadrature, which the tests hold.
    """
    (beta,) = as_reals(beta)
    difference = lobe_j.axis - lobe_i.axis
    (large_i, small_i, rest_i), (large_j, small_j, rest_j) = (_split_eigenvalues(lobe) for lobe in (lobe_i, lobe_j))
    quadratic = (large_i + large_j) * dot(difference, difference)
    quadratic = np.maximum(quadratic - _quadratic(rest_i + rest_j, difference), 0.0)
    root_i, root_j = np.sqrt(lobe_i.determinant), np.sqrt(lobe_j.determinant)
    invariant = (large_i + small_j) * (large_j + small_i) - contract(rest_i, rest_j)
    invariant = np.maximum(invariant, (root_i + root_j) ** 2)
    pre = 2.0 * np.sqrt(root_i) * np.sqrt(root_j) / np.sqrt(invariant)
    exponent = _log_areas(pre, lobe_i, lobe_j) - 2.4 * np.log1p(0.25 * quadratic / invariant)
    return np.asarray(np.exp(beta.astype(exponent.dtype) * exponent))
