"""The reflection lobe of every pixel, computed from its guides by the formulas of `lobewise.lobes`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple, NoReturn

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import HALIDE
from lobewise.backend.pointwise import LARGEST_FLOAT, Grid, Vector, is_finite
from lobewise.engine.numbers import compute_hypotenuse, make_single, square_single
from lobewise.errors import InputError, MissingChannelError
from lobewise.guides.surfaces import is_surface, is_surface_depth, make_ray
from lobewise.lobes.covariance import compute_round_covariance, make_covariance_lobe, split_covariance
from lobewise.lobes.directions import compute_tangent, face_viewer, reflect
from lobewise.lobes.gaussian import LAMBERT_SIMILARITY_SHARPNESS, compute_ggx_variance
from lobewise.lobes.vectors import cross, dot, scale
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, GBuffer, LobeKind
from lobewise.settings.choices import get_similarity

NORMAL_ERROR = 1e-3
"""Standard deviation of the guides' normals, radians. An error e of the normal turns the reflection by 2 e."""


def default_tau(camera: Camera, height: int) -> float:
    """Return the band-limit, radians: the angle of a pixel and twice `NORMAL_ERROR`, added in square."""
    return compute_hypotenuse(camera.get_pixel_angle(height), 2.0 * NORMAL_ERROR)


@dataclass(frozen=True)
class SgField:
    """The reflection lobes of an image as one spherical Gaussian for each pixel.

    Parameters
    ----------
    valid : (height, width), bool
        Whether the pixel has a lobe. A pixel without a lobe has axis 0 and sharpness 1.
    axis : (height, width, 3), float32
        Mirror direction about the shading normal, unit length.
    sharpness : (height, width), float32
        Band-limited, inverse square radians.
    surface, mask : (height, width), bool
        Whether the pixel sees a surface (`lobewise.guides.surfaces.is_surface`), and one with a lobe.
    """

    valid: NDArray[np.bool_]
    axis: FloatArray
    sharpness: FloatArray
    surface: NDArray[np.bool_]
    mask: NDArray[np.bool_]


def make_sg_field(gbuffer: GBuffer, camera: Camera, *, tau: float, diffuse_fallback: bool) -> SgField:
    """Return the single spherical Gaussian of every pixel's specular reflection (Tokuyoshi 2015, Wang et al. 2009).

    Parameters
    ----------
    gbuffer : GBuffer
        Needs ``normal``, ``alpha_u`` and one of ``position`` and ``depth``. Without ``lobe_kind`` every surface has a
        GGX lobe. Normals may have any length. A normal that faces away from the viewer is bent until it faces the
        viewer. Roughness is clamped to [0, 1].
    camera : Camera
        Gives the view directions.
    tau : float
        Band-limit in radians, ``1e-5 <= tau <= 1``: ``tau^2`` is added to the variance of every lobe, so that the lobe
        of a mirror is finite.
    diffuse_fallback : bool
        Give surfaces of kind NONE the Lambert lobe (axis = normal, sharpness 2, variance 1/2). Otherwise they have no
        lobe.

    Returns
    -------
    SgField
        Finite everywhere. A pixel is invalid if a guide is not finite, or if it has no surface or no lobe.

    Raises
    ------
    MissingChannelError
        If a channel is missing.
    InputError
        If ``tau`` is out of range.
    """
    check_lobe_guides(gbuffer, "sg", tau)
    images, numbers = collect_guides(gbuffer, camera, tau, "sg")
    numbers["diffuse_fallback"] = np.float32(diffuse_fallback)
    names = ["has_lobe", "surface", "specular_mask", "axis", "sharpness"]
    valid, surface, mask, *lobe = engine.pixels(
        define_sg_lobes, images, numbers, names=names, text="lobes of the similarity sg"
    )
    return SgField(valid, lobe[0], lobe[1], surface, mask)


SPREAD_TURNS = 2.0
"""The variance that `spread_lobes` adds to a lobe, over the squared turn of the axis to the neighbouring pixel."""
SPREAD_REACH = 1
"""Distance in pixels from which `spread_lobes` reads neighbours."""


def spread_lobes(field: SgField) -> SgField:
    """Return lobes widened to cover what the whole area of their pixel reflects.

    The given lobes are evaluated at pixel centres. On a small or bumpy mirror the axis turns from one pixel to the next
    by far more than the width of the lobe. Then no two lobes overlap and all noise stays. So the variance of each lobe
    grows, in every direction, by `SPREAD_TURNS` times the squared turn of the axis to the neighbour (of four) with the
    nearest axis.

    Measured in docs/developers/research/quality_trials.md, "Mirrors": taking the larger of the turns along row and
    column blurs normal maps.

    Parameters
    ----------
    field : SgField
        Lobes of an image.

    Returns
    -------
    SgField
        The axes do not change. The lobe of a pixel whose neighbours have none does not change either.
    """
    images = {"valid": field.valid, "axis": field.axis, "sharpness": field.sharpness}
    names, text = ["wide_sharpness"], "lobes of pixel areas"
    (sharpness,) = engine.pixels(define_spread, images, {}, names=names, text=text)
    return replace(field, sharpness=sharpness)


def define_spread(grid: Grid) -> list[Vector]:
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
    return [[1.0 / (1.0 / grid.read_one("sharpness") + turned)]]


NO_LOBE, SPECULAR_LOBE, LAMBERT_LOBE = range(3)
"""Kinds of lobes that a pixel may have."""


class GgxField(NamedTuple):
    """The reflection lobes of an image as covariances across an axis, for several band-limits.

    See `lobewise.lobes.covariance`. The axis is the mirror direction about the dominant visible normal.

    Parameters
    ----------
    valid, surface, mask : (height, width), bool
        As in `SgField`.
    lobes : dict of float to tuple of array
        By the band-limit, radians: axis, vector t, larger and smaller eigenvalue; eight images (height, width). See
        `lobewise.features.ggx.GgxLobe`. A pixel without a lobe has axis 0, t 0 and eigenvalues 1.
    """

    valid: NDArray[np.bool_]
    surface: NDArray[np.bool_]
    mask: NDArray[np.bool_]
    lobes: dict[float, tuple[FloatArray, ...]]


def make_ggx_field(gbuffer: GBuffer, camera: Camera, taus: Sequence[float]) -> GgxField:
    """Return the covariance lobe of every pixel's specular reflection, for several band-limits.

    Surfaces of kind NONE have the Lambert lobe. A band-limit adds ``tau^2`` to both eigenvalues of the covariance.

    Parameters
    ----------
    gbuffer : GBuffer
        As in `make_sg_field`; ``tangent`` where ``alpha_v`` differs from ``alpha_u``.
    camera : Camera
    taus : sequence of float
        As ``tau`` in `make_sg_field`.

    Raises
    ------
    MissingChannelError, InputError
        As in `make_sg_field`.
    """
    for tau in taus:
        check_lobe_guides(gbuffer, "ggx", tau)
    images, numbers = collect_guides(gbuffer, camera, 0.0, "ggx")
    numbers["diffuse_fallback"] = np.float32(1.0)
    noises = {f"noise{k}": square_single(tau) for k, tau in enumerate(taus)}
    names = ["has_lobe", "surface", "specular_mask", *(f"{axis}_{each}" for axis in ("axis", "turn") for each in "xyz")]
    names += [f"{size}{k}" for k in range(len(taus)) for size in ("large", "small")]
    text = "lobes for each comparison"
    valid, surface, mask, *planes = engine.pixels(
        define_ggx_lobes, images, {**numbers, **noises}, len(taus), names=names, text=text
    )
    pairs = [planes[6 + 2 * k : 8 + 2 * k] for k in range(len(taus))]
    lobes = {tau: (*planes[:6], *pair) for tau, pair in zip(taus, pairs, strict=True)}
    return GgxField(valid, surface, mask, lobes)


def define_ggx_lobes(grid: Grid, count: int) -> list[Vector]:
    """Return validity, surface, mask, axis, t, and both eigenvalues for each of ``count`` band-limits."""
    which, axis, shape = compute_lobe(grid, "ggx")
    which, *lobe = grid.share([which, *axis, *shape])
    axis, covariance, determinant = lobe[:3], lobe[3:9], lobe[9]
    large, t = split_covariance(HALIDE, axis, covariance)
    large, small, *t = grid.share([large, determinant / hl.max(large, hl.f32(1e-30)), *t])
    outputs: list[Vector] = [*_compute_masks(grid, which), *([value] for value in (*axis, *t))]
    for k in range(count):
        # The Lambert lobe has no band-limit. A pixel without a lobe is harmless.
        noise = hl.select(which == SPECULAR_LOBE, grid.get(f"noise{k}")[0], hl.f32(0.0))
        outputs += [[hl.select(which == NO_LOBE, hl.f32(1.0), value + noise)] for value in (large, small)]
    return outputs


def check_lobe_guides(gbuffer: GBuffer, similarity: str, tau: float) -> None:
    """Raise an error if a channel that the lobes of ``similarity`` need is missing, or if ``tau`` is out of range."""

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
    if not get_similarity(similarity).has_covariance or gbuffer.tangent is not None or gbuffer.alpha_v is None:
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
    """Return the images and numbers that `compute_lobe` reads."""
    size = gbuffer.shape
    assert size is not None
    has_covariance = get_similarity(similarity).has_covariance
    directed = has_covariance and gbuffer.tangent is not None
    images = {
        "normal": gbuffer.normal,
        "position": gbuffer.position,
        "depth": gbuffer.depth,
        "kind": gbuffer.lobe_kind,
        "alpha_u": gbuffer.alpha_u,
        "alpha_v": gbuffer.alpha_v if directed or not has_covariance else None,
        "tangent": gbuffer.tangent if directed and gbuffer.alpha_v is not None else None,
    }
    numbers = {
        "eye": make_single(camera.position),
        "noise": square_single(tau),
        **camera.get_ray_numbers(size),
    }
    return images, numbers


def define_sg_lobes(grid: Grid) -> list[Vector]:
    """Return validity, surface, mask, axis and sharpness."""
    which, axis, sharpness = compute_lobe(grid, "sg")
    return [*_compute_masks(grid, which), axis, sharpness]


def _compute_masks(grid: Grid, which: hl.Expr) -> list[Vector]:
    """Return where there is a lobe, where a surface, and where both."""
    lobe, surface = which != NO_LOBE, is_surface(grid)
    return [[hl.u8(lobe)], [hl.u8(surface)], [hl.u8(surface & lobe)]]


def compute_lobe(grid: Grid, similarity: str) -> tuple[hl.Expr, list[hl.Expr], list[hl.Expr]]:
    """Return the kind of a pixel's lobe, its axis and its shape.

    The shape is the sharpness, or the covariance and its determinant. That of a GGX mixture is the variance without the
    band-limit, and the product of both alphas.
    """
    fallback = grid.get("diffuse_fallback")[0] != 0 if "diffuse_fallback" in grid.numbers else hl.Expr(False)
    normal, view, cosine, surface = _compute_directions(grid)
    kind = grid.read_one("kind") if grid.has("kind") else None
    alphas, known = read_alphas(grid, kind)
    record = get_similarity(similarity)
    if record.has_covariance:
        axis, shape = _make_covariance(grid, normal, view, cosine, alphas, kind)
        neutral = [0.0] * 6 + [1.0]
        finite = is_finite(axis[0] + axis[1] + axis[2] + shape[-1])
    else:
        noise = hl.f32(0.0) if record.is_mixture else grid.get("noise")[0]
        variance = compute_ggx_variance(HALIDE, cosine, alphas, noise)
        axis = reflect(normal, view, cosine)
        shape = [variance, alphas[0] * alphas[1]] if record.is_mixture else [1.0 / variance]
        neutral = [1.0] * len(shape)
        finite = is_finite(axis[0] + axis[1] + axis[2] + variance)
    specular = surface & known & finite
    lambert = hl.Expr(False)
    if kind is not None:
        specular = specular & (kind > hl.f32(0.5)) & (kind < hl.f32(3.5))
        lambert = surface & (kind == hl.f32(LobeKind.NONE)) & fallback
    # Store the choice and the lobe once per row: otherwise each output would compute them again from all guides.
    which = hl.select(specular, hl.u8(SPECULAR_LOBE), lambert, hl.u8(LAMBERT_LOBE), hl.u8(NO_LOBE))
    which, *shared = grid.share([which, *axis, *shape])
    axis, shape = shared[:3], shared[3:]
    grid.is_shared = True

    def choose(value: hl.Expr, diffuse: hl.Expr, harmless: float) -> hl.Expr:
        return hl.select(which == SPECULAR_LOBE, value, which == LAMBERT_LOBE, diffuse, hl.f32(harmless))

    flat = [hl.f32(LAMBERT_SIMILARITY_SHARPNESS)] * len(shape)
    if record.has_covariance:
        variance = hl.f32(1.0 / LAMBERT_SIMILARITY_SHARPNESS)
        flat = [*compute_round_covariance(variance, normal), variance * variance]
    axis = [choose(value, diffuse, 0.0) for value, diffuse in zip(axis, normal, strict=True)]
    return which, axis, [choose(*each) for each in zip(shape, flat, neutral, strict=True)]


def _compute_directions(grid: Grid) -> tuple[Vector, Vector, hl.Expr, hl.Expr]:
    """Return the unit normal, the unit view direction, their cosine, and whether the pixel sees a surface."""
    raw = grid.read("normal")
    square = dot(raw, raw)
    # A normal averaged over an edge is short, but longer than a thousandth.
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
    """Return both alphas, clamped to [0, 1] and 0 for mirrors, and whether they are finite."""
    alphas, known = [], hl.Expr(True)
    for name in ("alpha_u", "alpha_v") if grid.has("alpha_v") else ("alpha_u",):
        value = grid.read_one(name)
        if kind is not None:
            value = hl.select(kind == hl.f32(LobeKind.DELTA), hl.f32(0.0), value)
        known = known & is_finite(value)
        alphas.append(hl.max(hl.min(value, hl.f32(1.0)), hl.f32(0.0)))
    return [alphas[0], alphas[-1]], known


def _make_covariance(
    grid: Grid, normal: Vector, view: Vector, cosine: hl.Expr, alphas: Vector, kind: hl.Expr | None
) -> tuple[list[hl.Expr], list[hl.Expr]]:
    """Return the axis (3 values), and the covariance (6 values) followed by its determinant."""
    (noise,) = grid.get("noise")
    beckmann = hl.Expr(False) if kind is None else kind == hl.f32(LobeKind.BECKMANN)
    tangents = None
    if grid.has("tangent"):
        tangent, directed = compute_tangent(HALIDE, grid.read("tangent"), normal)
        tangent = grid.share(tangent)
        tangents = tangent, cross(normal, tangent)
        # Without a tangent only the area of the lobe is known: use an isotropic lobe of the same area.
        mean = hl.sqrt(alphas[0] * alphas[1])
        alphas = [hl.select(directed, alpha, mean) for alpha in alphas]
    lobe = make_covariance_lobe(HALIDE, normal, view, cosine, alphas, tangents, noise, beckmann=beckmann)
    return list(lobe.axis), [*lobe.covariance, lobe.determinant]
