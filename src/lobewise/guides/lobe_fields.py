"""The reflection lobe of every pixel of a frame, in one pass over its guides: the formulas of `lobewise.lobes`."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any, NoReturn, TypeVar

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.expressions import HALIDE
from lobewise.backend.pointwise import LARGEST_FLOAT, Grid, Vector, is_finite, run_pointwise
from lobewise.camera import Camera
from lobewise.errors import InputError, MissingChannelError
from lobewise.frame import FloatArray, GBuffer, LobeKind
from lobewise.guides.surfaces import get_ray_numbers, is_surface_depth, make_ray
from lobewise.lobes.covariance import find_round_covariance, make_covariance_lobe
from lobewise.lobes.directions import face_viewer, find_tangent, reflect
from lobewise.lobes.gaussian import LAMBERT_SIMILARITY_SHARPNESS, find_ggx_variance
from lobewise.lobes.vectors import cross, dot, scale


@dataclass(frozen=True)
class SgField:
    """The reflection lobes of an image as one spherical Gaussian for each pixel.

    Parameters
    ----------
    valid : (height, width), bool
        Whether the pixel has a lobe. Where not, the rest is finite and harmless: axis 0, sharpness 1.
    axis : (height, width, 3), float32
        Mirror direction about the shading normal, unit length.
    sharpness : (height, width), float32
        Band-limited, inverse square radians.
    """

    valid: NDArray[np.bool_]
    axis: FloatArray
    sharpness: FloatArray


@dataclass(frozen=True)
class CovarianceField:
    """The reflection lobes of an image as covariances across an axis; see `lobewise.lobes.covariance`.

    Parameters
    ----------
    valid : (height, width), bool
        Whether the pixel has a lobe. Where not, the rest is finite and harmless: axis and covariance 0, determinant 1.
    axis : (height, width, 3), float32
        Mirror direction about the dominant visible normal, unit length.
    covariance : (height, width, 6), float32
        Band-limited: xx, xy, xz, yy, yz, zz, square radians.
    determinant : (height, width), float32
        Product of the two principal variances.
    """

    valid: NDArray[np.bool_]
    axis: FloatArray
    covariance: FloatArray
    determinant: FloatArray


def make_sg_field(gbuffer: GBuffer, camera: Camera, *, tau: float, diffuse_fallback: bool) -> SgField:
    """Return the single spherical Gaussian of every pixel's specular reflection (Tokuyoshi 2015, Wang et al. 2009).

    Parameters
    ----------
    gbuffer : GBuffer
        Needs ``normal``, ``alpha_u`` and one of ``position`` and ``depth``. Without ``lobe_kind`` every surface has a
        GGX lobe. Normals need not have unit length; those that face away from the viewer are bent until they do not.
        Roughness is clamped to [0, 1].
    camera : Camera
        Where the view directions come from.
    tau : float
        Band-limit in radians, ``1e-5 <= tau <= 1``: ``tau^2`` is added to the variance of every lobe, so that a mirror
        is finite.
    diffuse_fallback : bool
        Give surfaces of kind NONE the Lambert lobe (axis = normal, sharpness 2, variance 1/2) instead of none.

    Returns
    -------
    SgField
        Finite everywhere. A pixel whose guides are not finite is invalid, and so is one without surface or lobe.

    Raises
    ------
    MissingChannelError
        If a channel is missing.
    InputError
        If ``tau`` is out of range.
    """
    return SgField(*_run(gbuffer, camera, tau, "sg", diffuse_fallback))


def make_covariance_field(
    gbuffer: GBuffer, camera: Camera, *, tau: float, gaussian: bool = False, diffuse_fallback: bool
) -> CovarianceField:
    """Return the covariance lobe of every pixel's specular reflection.

    Parameters
    ----------
    gbuffer : GBuffer
        As in `make_sg_field`; ``tangent`` where ``alpha_v`` differs from ``alpha_u``.
    camera, tau, diffuse_fallback
        As there.
    gaussian : bool
        The lobes that ``asg`` compares: the covariance of the Gaussian that is nearest in L2 to the lobe's shape, which
        for GGX is narrower.

    Returns
    -------
    CovarianceField
        As there.

    Raises
    ------
    MissingChannelError, InputError
        As there.
    """
    return CovarianceField(*_run(gbuffer, camera, tau, "asg" if gaussian else "ggx", diffuse_fallback))


SPREAD_TURNS = 2.0
"""Squared turns from a pixel to its neighbour by which the variance of its lobe grows."""
SPREAD_REACH = 1
"""Pixels to each side that tell on a lobe of `spread_lobes`."""
Field = TypeVar("Field", SgField, CovarianceField)


def spread_lobes(field: Field) -> Field:
    """Return lobes as wide as what the area of their pixel reflects.

    Lobes are those of pixel centres. From one pixel of a small or bumpy mirror to the next the axis turns by far more
    than a mirror's lobe is wide, so that no two lobes overlap and all noise stays. `SPREAD_TURNS` times the squared
    turn to that of the four neighbours whose axis is nearest is added to the variance of a lobe in every direction.

    Measured in docs/quality.md, "Mirrors": the larger of the turns along row and column blurs normal maps.

    Parameters
    ----------
    field : SgField or CovarianceField
        Lobes of an image.

    Returns
    -------
    SgField or CovarianceField
        With the same axes; where a pixel or all its neighbours have no lobe the same lobe.
    """
    shapes = {name: getattr(field, name) for name in SHAPES[type(field)]}
    images = {"valid": field.valid, "axis": field.axis, **shapes}
    found = run_pointwise(_define_spread, images, {})
    return replace(field, **dict(zip(shapes, found, strict=True)))


SHAPES: dict[type, tuple[str, ...]] = {SgField: ("sharpness",), CovarianceField: ("covariance", "determinant")}
"""What tells how wide the lobes of a field are."""


def _define_spread(grid: Grid) -> list[Vector]:
    width, height = grid.size
    axis, known = grid.read("axis"), grid.read_one("valid") != 0
    none = nearest = hl.f32(LARGEST_FLOAT)
    for step in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        x, y = grid.x + step[0], grid.y + step[1]
        inside = (x >= 0) & (width > x) & (y >= 0) & (height > y)
        at = hl.clamp(x, 0, width - 1), hl.clamp(y, 0, height - 1)
        other = [value - mine for value, mine in zip(grid.read("axis", *at), axis, strict=True)]
        there = inside & (grid.read("valid", *at)[0] != 0)
        nearest = hl.min(nearest, hl.select(there, dot(other, other), none))
    turned = hl.select(known & (nearest < none), hl.f32(SPREAD_TURNS) * nearest, hl.f32(0.0))
    (spread,) = grid.share([turned])
    if grid.has("sharpness"):
        return [[1.0 / (1.0 / grid.read_one("sharpness") + spread)]]
    covariance, determinant = grid.read("covariance"), grid.read_one("determinant")
    trace = covariance[0] + covariance[3] + covariance[5]
    # The axis of a pixel without a lobe is 0, and its spread.
    round_part = find_round_covariance(spread, axis)
    return [
        [value + more for value, more in zip(covariance, round_part, strict=True)],
        [determinant + spread * (trace + spread)],
    ]


def _run(
    gbuffer: GBuffer, camera: Camera, tau: float, similarity: str, diffuse_fallback: bool
) -> tuple[NDArray[Any], ...]:
    check_lobe_guides(gbuffer, similarity, tau)
    images, numbers = collect_guides(gbuffer, camera, tau, similarity)
    return run_pointwise(define_lobes, images, numbers, similarity, diffuse_fallback)


def check_lobe_guides(gbuffer: GBuffer, similarity: str, tau: float) -> None:
    """Raise what `make_covariance_field` raises if a channel that it needs is missing, or ``tau`` is out of range."""

    def complain(name: str, why: str, action: str) -> NoReturn:
        raise MissingChannelError(
            f"channel {name}", expected=f"it in the G-buffer ({why})", got="nothing", action=action
        )

    if gbuffer.normal is None:
        complain(
            "normal", "the lobe is a reflection about it", "render the shading normals, or choose no lobe similarity"
        )
    if gbuffer.alpha_u is None:
        complain("alpha_u", "the lobe's width", "render the roughness, or choose the similarity 'normal'")
    if gbuffer.position is None and gbuffer.depth is None:
        complain("position", "it or depth tells where a surface is", "render the position or the depth")
    if not 1e-5 <= tau <= 1.0:
        raise InputError("tau", expected="an angle from 1e-5 to 1 radian", got=str(tau), action="leave it out")
    if similarity == "sg" or gbuffer.tangent is not None or gbuffer.alpha_v is None:
        return
    if not np.array_equal(gbuffer.alpha_u, gbuffer.alpha_v, equal_nan=True):
        complain(
            "tangent",
            "alpha_v differs from alpha_u, so the lobe has a direction",
            "render the tangents, leave alpha_v out, or choose the similarity 'sg'",
        )


def collect_guides(
    gbuffer: GBuffer, camera: Camera, tau: float, similarity: str
) -> tuple[dict[str, NDArray[Any] | None], dict[str, Any]]:
    """Return the images and the numbers that `define_lobes` reads."""
    assert gbuffer.shape is not None
    directed = similarity != "sg" and gbuffer.tangent is not None
    images = {
        "normal": gbuffer.normal,
        "position": gbuffer.position,
        "depth": gbuffer.depth,
        "kind": gbuffer.lobe_kind,
        "alpha_u": gbuffer.alpha_u,
        "alpha_v": gbuffer.alpha_v if directed or similarity == "sg" else None,
        "tangent": gbuffer.tangent if directed and gbuffer.alpha_v is not None else None,
    }
    numbers = {
        "eye": camera.position.astype(np.float32),
        "noise": np.float32(tau) * np.float32(tau),
        **get_ray_numbers(camera, gbuffer.shape),
    }
    return images, numbers


def define_lobes(grid: Grid, similarity: str, diffuse_fallback: bool) -> list[Vector]:
    """Return validity; axis; and sharpness, or covariance and determinant."""
    normal, view, cosine, surface = _find_directions(grid)
    kind = grid.read_one("kind") if grid.has("kind") else None
    alphas, known = read_alphas(grid, kind)
    if similarity == "sg":
        (noise,) = grid.get("noise")
        variance = find_ggx_variance(HALIDE, cosine, alphas, noise)
        axis, shape = reflect(normal, view, cosine), [1.0 / variance]
        neutral = [1.0]
        finite = is_finite(axis[0] + axis[1] + axis[2] + variance)
    else:
        axis, shape = _make_covariance(grid, normal, view, cosine, alphas, kind, similarity == "asg")
        neutral = [0.0] * 6 + [1.0]
        finite = is_finite(axis[0] + axis[1] + axis[2] + shape[-1])
    specular = surface & known & finite
    lambert = hl.Expr(False)
    if kind is not None:
        specular = specular & (kind > hl.f32(0.5)) & (kind < hl.f32(3.5))
        lambert = surface & (kind == hl.f32(LobeKind.NONE)) if diffuse_fallback else lambert
    # What an output depends on hangs on every guide; without rows of their own each would compute it all.
    which = hl.select(specular, hl.u8(1), lambert, hl.u8(2), hl.u8(0))
    which, *kept = grid.share([which, *axis, *shape])
    axis, shape = kept[:3], kept[3:]
    grid.is_shared = True

    def choose(value: hl.Expr, diffuse: hl.Expr, harmless: float) -> hl.Expr:
        return hl.select(which == 1, value, which == 2, diffuse, hl.f32(harmless))

    flat: list[hl.Expr] = [hl.f32(LAMBERT_SIMILARITY_SHARPNESS)]
    if similarity != "sg":
        variance = hl.f32(1.0 / LAMBERT_SIMILARITY_SHARPNESS)
        flat = [*find_round_covariance(variance, normal), variance * variance]
    axis = [choose(value, diffuse, 0.0) for value, diffuse in zip(axis, normal, strict=True)]
    shape = [choose(*each) for each in zip(shape, flat, neutral, strict=True)]
    truth = [hl.u8(which != 0)]
    return [truth, axis, shape] if similarity == "sg" else [truth, axis, shape[:6], shape[6:]]


def _find_directions(grid: Grid) -> tuple[Vector, Vector, hl.Expr, hl.Expr]:
    """Return unit normal, unit view, their cosine, and whether there is a surface that can be seen."""
    raw = grid.read("normal")
    square = dot(raw, raw)
    # A normal averaged over an edge is short, but not a thousandth.
    surface = (square > hl.f32(1e-6)) & is_finite(square)
    if grid.has("depth"):
        surface = surface & is_surface_depth(grid.read_one("depth"))
    normal = scale(raw, 1.0 / hl.sqrt(square))
    if grid.has("position"):
        step = [eye - place for eye, place in zip(grid.get("eye"), grid.read("position"), strict=True)]
    else:
        step = [-component for component in make_ray(grid, hl.Float(32))]
    square = dot(step, step)
    view, seen = scale(step, 1.0 / hl.sqrt(square)), (square > hl.f32(0.0)) & is_finite(square)
    normal, cosine = face_viewer(HALIDE, normal, view)
    *facing, cosine = grid.share([*normal, *view, cosine])
    return facing[:3], facing[3:], cosine, surface & seen & is_finite(cosine)


def read_alphas(grid: Grid, kind: hl.Expr | None) -> tuple[list[hl.Expr], hl.Expr]:
    """Return both alphas, in [0, 1] and 0 for mirrors, and whether they are numbers."""
    alphas, known = [], hl.Expr(True)
    for name in ("alpha_u", "alpha_v") if grid.has("alpha_v") else ("alpha_u",):
        value = grid.read_one(name)
        if kind is not None:
            value = hl.select(kind == hl.f32(LobeKind.DELTA), hl.f32(0.0), value)
        known = known & is_finite(value)
        alphas.append(hl.max(hl.min(value, hl.f32(1.0)), hl.f32(0.0)))
    return [alphas[0], alphas[-1]], known


def _make_covariance(
    grid: Grid, normal: Vector, view: Vector, cosine: hl.Expr, alphas: Vector, kind: hl.Expr | None, gaussian: bool
) -> tuple[list[hl.Expr], list[hl.Expr]]:
    """Return the axis; and six covariances with the determinant."""
    (noise,) = grid.get("noise")
    beckmann = hl.Expr(False) if kind is None else kind == hl.f32(LobeKind.BECKMANN)
    tangents = None
    if grid.has("tangent"):
        tangent, directed = find_tangent(HALIDE, grid.read("tangent"), normal)
        tangent = grid.share(tangent)
        tangents = tangent, cross(normal, tangent)
        # Without a direction only the area of the lobe is known.
        mean = hl.sqrt(alphas[0] * alphas[1])
        alphas = [hl.select(directed, alpha, mean) for alpha in alphas]
    lobe = make_covariance_lobe(
        HALIDE, normal, view, cosine, alphas, tangents, noise, beckmann=beckmann, gaussian=gaussian
    )
    return list(lobe.axis), [*lobe.covariance, lobe.determinant]
