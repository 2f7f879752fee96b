"""Covariance lobes: a reflection lobe as an axis and a 2x2 covariance in the plane across the axis.

The covariance is stored as a symmetric 3x3 matrix of rank 2 in world space, six numbers ``xx, xy, xz, yy, yz, zz``,
and the determinant of its 2x2 part. No tangent frame is stored, so neighbouring pixels need no common frame.

The shape of the reflected lobe follows from the distribution of microfacet normals in the plane across the dominant
visible normal m: moving a normal by d in this plane turns the reflection by ``2 (v.d) m + 2 (v.m) d`` (the Jacobian).

Source: dominant visible normal and projected roughness ``alpha^2 / (1 - alpha^2)`` as in Tokuyoshi's public shaders
(Tokuyoshi and Kaplanyan 2021); the covariance, the limits of rough lobes and the scale of the dominant normal are this
library's, fitted to quadrature. `weights.shader` in exporting/ has the same formulas for shaders; a test compares them.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from lobewise.lobes.gaussian import GGX_MIXTURES
from lobewise.lobes.numbers import Namespace
from lobewise.lobes.vectors import Vector, combine, cross, dot, scale

GGX_LIMIT = 0.35
"""Inverse variance added to rough GGX lobes, so that none is wider than the hemisphere (fitted to quadrature)."""
BECKMANN_LIMIT = 0.5
"""Inverse variance added to rough Beckmann lobes."""
AXIS_TURN, AXIS_TURN_PER_ALPHA = 0.7, 0.6
"""The dominant normal turns from n to v by a share of what the public shaders say: the first number for a mirror, and
the second more per alpha, up to 1 (the axis of the L2-best lobe, fitted to quadrature)."""
MIN_VIEW_COSINE = 0.03
"""Smallest v.m in the Jacobian; at 0 the lobe would have no width across the plane of incidence."""
GGX_SHARPNESS = GGX_MIXTURES[1][0][0]
"""Sharpness of the L2-best Gaussian of ``(1 + q)^-2``, over that of the Gaussian with the same curvature at 0."""


class CovarianceLobe(NamedTuple):
    """A reflection lobe as a covariance in the plane across its axis."""

    axis: Vector
    """Unit vector, three components."""
    covariance: Vector
    """xx, xy, xz, yy, yz, zz; square radians; ``covariance @ axis = 0``."""
    determinant: Any
    """Product of the two principal variances."""


def compute_round_covariance(variance: Any, axis: Vector) -> list[Any]:
    """Return the six components of ``variance (I - axis axis^T)``."""
    x, y, z = axis
    vx, vy, vz = scale(axis, variance)
    return [variance - vx * x, -vx * y, -vx * z, variance - vy * y, -vy * z, variance - vz * z]


def _add_outer(covariance: Vector, weight: Any, a: Vector) -> list[Any]:
    """Return six components plus ``weight a a^T``."""
    x, y, z = scale(a, weight)
    outer = [x * a[0], x * a[1], x * a[2], y * a[1], y * a[2], z * a[2]]
    return [value + more for value, more in zip(covariance, outer, strict=True)]


def compute_dominant_normal(xp: Namespace, view: Vector, alphas: Vector) -> list[Any]:
    """Return the dominant visible normal of GGX, about which the lobe is reflected. Approximate.

    Source: Tokuyoshi's public shaders: ``m = normalize(au^2 vx, av^2 vy, sqrt(au^2 vx^2 + av^2 vy^2 + vz^2) + vz)``.
    Departs: both squares are scaled by ``min(1, 0.7 + 0.6 sqrt(au av))`` (`AXIS_TURN`), because the plain form turns
    the axis of narrow lobes too far.

    Parameters
    ----------
    xp : Namespace
    view : three numbers
        Local direction to the viewer: along the tangent, the bitangent and the normal, the last >= 0.
    alphas : two numbers
        Roughness along tangent and bitangent, in [0, 1].

    Returns
    -------
    list of three numbers
        Local unit vector. The mirror direction about it is within 4 degrees of the axis of the L2-best SG for n.v from
        0.2 up.
    """
    u, v, n = view
    part = xp.minimum(xp.number(AXIS_TURN) + xp.number(AXIS_TURN_PER_ALPHA) * xp.sqrt(alphas[0] * alphas[1]), 1.0)
    mu, mv = part * (alphas[0] * alphas[0]) * u, part * (alphas[1] * alphas[1]) * v
    mn = xp.sqrt(mu * u + mv * v + n * n) + n
    return scale([mu, mv, mn], 1.0 / xp.sqrt(mu * mu + mv * mv + mn * mn))


def make_covariance_lobe(
    xp: Namespace,
    normal: Vector,
    view: Vector,
    cosine: Any,
    alphas: Vector,
    tangents: tuple[Vector, Vector] | None,
    noise: Any,
    *,
    beckmann: Any,
    gaussian: bool = False,
) -> CovarianceLobe:
    """Return the covariance lobe of a GGX or Beckmann reflection. Approximate: see the theory page.

    Parameters
    ----------
    xp : Namespace
    normal, view : Vector
        Unit vectors away from the surface.
    cosine : number
        ``normal.view``, above 0.
    alphas : two numbers
        Roughness along and across the tangent, in [0, 1].
    tangents : pair of Vector, optional
        Unit tangent and bitangent; without them the lobe is isotropic, of the first roughness.
    noise : number
        Variance added to both principal ones, square radians (band-limit).
    beckmann : truth
        Whether normals follow Beckmann instead of GGX.
    gaussian : bool
        Return the covariance of the L2-best Gaussian of the lobe; for GGX it is narrower by `GGX_SHARPNESS`.
    """
    limit = xp.where(beckmann, BECKMANN_LIMIT, xp.number(GGX_LIMIT))
    deficits = [xp.where(beckmann, 1.0, 1.0 - alpha * alpha) for alpha in alphas]
    sharper = xp.where(beckmann, 1.0, xp.number(GGX_SHARPNESS)) if gaussian else 1.0
    # The lobe is scaled by 1 / sharper below, but its band-limit must not be: scale the band-limit up beforehand.
    noise = sharper * noise
    if tangents is None:
        lobe = _make_isotropic_lobe(xp, normal, view, cosine, alphas[0], deficits[0], limit, noise)
    else:
        lobe = _make_anisotropic_lobe(xp, tangents, (normal, view, cosine), alphas, deficits, limit, noise)
    if not gaussian:
        return lobe
    return CovarianceLobe(lobe.axis, scale(lobe.covariance, 1.0 / sharper), lobe.determinant / (sharper * sharper))


def _make_isotropic_lobe(
    xp: Namespace, normal: Vector, view: Vector, cosine: Any, alpha: Any, deficit: Any, limit: Any, noise: Any
) -> CovarianceLobe:
    """Return the lobe of one roughness.

    ``deficit`` is ``1 - alpha^2`` for GGX and 1 for Beckmann, ``limit`` the inverse variance added to rough lobes,
    ``noise`` the variance added to both axes.

    The dominant normal lies in the plane of n and v, so the principal axes are known: with
    ``A_x = 4 (v.m)^2 a^2 / (m.n)`` across and ``A_y = 4 (m.n) a^2`` along the plane of incidence, each over
    ``deficit``, the variances are ``A / (1 + limit A) / 2``. Common denominators avoid divisions by 0 for alpha from 0
    to 1.
    """
    square = alpha * alpha
    # m = normalize(a v + b n)
    a = xp.minimum(xp.number(AXIS_TURN) + xp.number(AXIS_TURN_PER_ALPHA) * alpha, 1.0) * square
    rest = 1.0 - a
    b = xp.sqrt(a + rest * cosine * cosine) + rest * cosine
    inverse_square = 1.0 / (a * a + b * b + 2.0 * a * b * cosine)
    inverse = xp.sqrt(inverse_square)
    view_cosine, normal_cosine = (a + b * cosine) * inverse, (a * cosine + b) * inverse
    twice = 2.0 * view_cosine * inverse
    axis = combine((twice * a - 1.0, view), (twice * b, normal))

    floored = xp.maximum(view_cosine, xp.number(MIN_VIEW_COSINE))
    floored_square = floored * floored
    across_part, along_part = 4.0 * square * floored_square, 4.0 * square * normal_cosine
    # Neither scale is 0: where alpha, and so the limit's term, is 0, the deficit is 1.
    across_scale = normal_cosine * deficit + limit * across_part
    along_scale = deficit + limit * along_part
    across = 0.5 * across_part / across_scale + noise
    along = 0.5 * along_part / along_scale + noise
    # ``excess`` is across - along over |v x n|^2, the weight of the outer product of v x n. This form has no
    # cancellation, and no 0/0 at n = v.
    lifted = (floored_square - view_cosine * view_cosine) / xp.maximum(1.0 - cosine * cosine, 0.5)
    excess = 2.0 * square * deficit * ((a * a - b * b) * inverse_square + lifted) / (across_scale * along_scale)
    covariance = _add_outer(compute_round_covariance(along, axis), excess, cross(view, normal))
    return CovarianceLobe(axis, covariance, across * along)


def _make_anisotropic_lobe(
    xp: Namespace,
    tangents: tuple[Vector, Vector],
    facing: tuple[Vector, Vector, Any],
    alphas: Vector,
    deficits: Vector,
    limit: Any,
    noise: Any,
) -> CovarianceLobe:
    """Return the lobe of two roughnesses; ``facing`` are normal, view and their cosine. See `_make_isotropic_lobe`.

    With ``g = deficit_u deficit_v`` and ``D = det(A) g = 16 (v.m)^2 au^2 av^2``, ``(A^-1 + c I)^-1`` is
    ``(A g + c D I) / (g + c tr(A g) + c^2 D)`` and its determinant ``D`` over the same denominator: sums of positive
    terms.
    """
    tangent, bitangent = tangents
    normal, view, cosine = facing
    squares = [alpha * alpha for alpha in alphas]
    cosine_u, cosine_v = dot(tangent, view), dot(bitangent, view)
    mu, mv, mn = compute_dominant_normal(xp, (cosine_u, cosine_v, cosine), alphas)
    m = combine((mu, tangent), (mv, bitangent), (mn, normal))
    view_cosine = mu * cosine_u + mv * cosine_v + mn * cosine
    axis = combine((2.0 * view_cosine, m), (-1.0, view))

    floored = xp.maximum(view_cosine, xp.number(MIN_VIEW_COSINE))
    lift = floored - view_cosine
    product = 16.0 * floored * floored * squares[0] * squares[1]
    covariance = compute_round_covariance(limit * product, axis)
    trace: Any = 0.0
    for vector, component, along, weight in (
        (tangent, mu, cosine_u, squares[0] * deficits[1]),
        (bitangent, mv, cosine_v, squares[1] * deficits[0]),
    ):
        # Compute the image of the tangent under the Jacobian: how a step along it turns the reflection.
        on_m = 2.0 * (along - 2.0 * component * view_cosine)
        # The floor of v.m must widen only the part across the plane of incidence.
        on_view = (along - component * view_cosine) / xp.maximum(1.0 - view_cosine * view_cosine, 0.5)
        on_m = on_m - 2.0 * lift * (component - on_view * view_cosine)
        image = combine((on_m, m), (2.0 * floored, vector), (-2.0 * lift * on_view, view))
        share = weight / mn
        trace = trace + share * dot(image, image)
        covariance = _add_outer(covariance, share, image)
    inverse = 1.0 / (deficits[0] * deficits[1] + limit * trace + limit * limit * product)
    blur = compute_round_covariance(noise, axis)
    covariance = [0.5 * inverse * value + more for value, more in zip(covariance, blur, strict=True)]
    # Compute determinant and trace of the 2x2 part before the band-limit is added.
    plain = 0.25 * product * inverse
    spread = 0.5 * inverse * (trace + 2.0 * limit * product)
    return CovarianceLobe(axis, covariance, plain + noise * (spread + noise))


def split_covariance(xp: Namespace, axis: Vector, covariance: Vector) -> tuple[Any, list[Any]]:
    """Return the larger eigenvalue a of a covariance, and a vector t along its eigenvector.

    With the smaller eigenvalue b, ``|t|^2 = a - b`` and ``S = b (I - axis axis^T) + t t^T``; the sign of t has no
    meaning. Both come from the covariance minus its mean across the axis: the norm of this deviation gives ``a - b``
    without cancellation.

    Parameters
    ----------
    xp : Namespace
    axis : Vector
        Unit vector.
    covariance : six numbers
        xx, xy, xz, yy, yz, zz; ``covariance @ axis = 0``.
    """
    x, y, z = axis
    xx, xy, xz, yy, yz, zz = covariance
    half = xp.number(0.5)
    trace = xx + yy + zz
    mean = half * trace
    xx, yy, zz = (value + mean * (p * p - xp.number(1.0)) for value, p in ((xx, x), (yy, y), (zz, z)))
    xy, xz, yz = xy + mean * x * y, xz + mean * x * z, yz + mean * y * z
    beside = xy * xy + xz * xz + yz * yz
    gap = xp.sqrt(xp.number(2.0) * (xx * xx + yy * yy + zz * zz + beside + beside))
    # t t^T is the deviation plus half the gap across the axis. t is its longest column over the root of its diagonal.
    spread = half * gap
    xx, yy, zz = (value + spread * (xp.number(1.0) - p * p) for value, p in ((xx, x), (yy, y), (zz, z)))
    xy, xz, yz = xy - spread * x * y, xz - spread * x * z, yz - spread * y * z
    first, second = (xx >= yy) & (xx >= zz), yy >= zz
    columns = ((xx, xy, xz), (xy, yy, yz), (xz, yz, zz))
    column = [xp.where(first, a, xp.where(second, b, c)) for a, b, c in columns]
    # The longest column's diagonal is at least a third of the gap: bound the divisor so that rounding is not magnified.
    longest = xp.maximum(xp.maximum(xp.maximum(xx, yy), zz), xp.number(0.3) * gap)
    inverse = xp.number(1.0) / xp.sqrt(xp.maximum(longest, xp.number(1e-30)))
    return mean + spread, scale(column, inverse)
