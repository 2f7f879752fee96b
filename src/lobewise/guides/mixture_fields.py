"""The reflection lobes of every pixel of a frame as a sum of spherical Gaussians."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from itertools import zip_longest
from operator import or_
from typing import NoReturn

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import HALIDE
from lobewise.backend.pointwise import Grid, Vector, give_channels, is_finite
from lobewise.errors import InputError
from lobewise.fitting.arrays import normalize
from lobewise.fitting.table import evaluate_table
from lobewise.guides.lobe_fields import LAMBERT_LOBE, NO_LOBE, check_lobe_guides, collect_guides, compute_lobe
from lobewise.guides.surfaces import mark_surface_pixels
from lobewise.lobes.gaussian import (
    LAMBERT_AMPLITUDE,
    LAMBERT_SHARPNESS,
    LAMBERT_SIMILARITY_SHARPNESS,
    integrate_gaussian,
    spread_ggx_mixture,
)
from lobewise.lobes.vectors import compute_luminance, dot, scale
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, GBuffer, LobeKind
from lobewise.records.lobe_table import LobeTable
from lobewise.settings import MAX_LOBES
from lobewise.work.chunks import Chunk, run_chunks


@dataclass(frozen=True)
class MixtureField:
    """The reflection lobes of an image, N lobes for every pixel.

    Parameters
    ----------
    valid : (height, width), bool
        Whether the pixel has a lobe. A pixel without one has axes 0, sharpnesses 1 and amplitudes 0.
    axis : (height, width, 3) or (height, width, 3 N), float32
        Unit axes: one per lobe, or a single one if all lobes of each pixel have the same axis.
    sharpness : (height, width, N), float32
        Band-limited, inverse square radians.
    amplitude : (height, width, N), float32
        Value along the axis, 1/sr; 0 for an absent lobe.
    """

    valid: NDArray[np.bool_]
    axis: FloatArray
    sharpness: FloatArray
    amplitude: FloatArray


def make_mixture_field(
    gbuffer: GBuffer,
    camera: Camera,
    *,
    tau: float,
    lobes: int = 3,
    lobe_tables: Sequence[LobeTable] = (),
    diffuse: bool = False,
) -> MixtureField:
    """Return the lobes of every pixel.

    A GGX surface has ``lobes`` lobes about its mirror direction (`lobewise.lobes.gaussian.GGX_MIXTURES`). A Beckmann
    surface and a mirror have one lobe. A material with a lobe table has the lobes of the table. The lobes integrate to
    the specular albedo if the G-buffer has it, and otherwise to 1.

    Parameters
    ----------
    gbuffer, camera
        See `lobewise.guides.lobe_fields.make_sg_field`.
    tau : float
        Band-limit, radians: ``tau^2`` is added to the variance of every lobe; its integral does not change.
    lobes : {1, 2, 3, 4}
        Number of lobes of a GGX surface; at most 3 with ``diffuse``.
    lobe_tables : sequence of LobeTable
        ``gbuffer.material`` holds indices into this sequence, counted from 1.
    diffuse : bool
        Add the diffuse lobe, with the integral ``gbuffer.diffuse_albedo``. It is needed if the radiance holds both
        diffuse and specular light. If False, only surfaces without a specular lobe get the diffuse lobe.

    Returns
    -------
    MixtureField

    Raises
    ------
    MissingChannelError
        If a channel is missing.
    InputError
        If ``tau`` or ``lobes`` is out of range.
    """
    tables = tuple(lobe_tables) if gbuffer.material is not None else ()
    albedo = gbuffer.diffuse_albedo if diffuse else None
    _check_count(lobes, tables, diffuse, int(albedo is not None))
    check_lobe_guides(gbuffer, "sg_mixture", tau)
    images, numbers = collect_guides(gbuffer, camera, tau, "sg_mixture")
    images |= {"specular_albedo": gbuffer.specular_albedo, "diffuse_albedo": albedo}
    if tables:
        images |= give_channels("table", _read_tables(gbuffer, camera, tables))
    numbers["diffuse_fallback"] = np.float32(not diffuse)
    names, text = ["has_lobe", "axis", "sharpness", "amplitude"], "lobes of the similarity sg_mixture"
    valid, axis, *shapes = engine.pixels(define_mixture, images, numbers, lobes, names=names, text=text)
    return MixtureField(valid, axis, *(image if image.ndim == 3 else image[..., None] for image in shapes))


def _check_count(lobes: int, tables: Sequence[LobeTable], diffuse: bool, diffuse_lobes: int) -> None:
    """Raise an error if a pixel can have too many lobes."""

    def complain(expected: str, got: str, action: str) -> NoReturn:
        raise InputError("lobes of a mixture", expected=expected, got=got, action=action)

    most = MAX_LOBES - diffuse
    if isinstance(lobes, bool) or lobes not in range(1, most + 1):
        complain(
            f"an integer from 1 to {most}",
            repr(lobes),
            "use 3, which approximate GGX within 1 %; a fourth one may be diffuse, where light is not split",
        )
    count = max([lobes, *(table.lobe_count for table in tables)]) + diffuse_lobes
    if count > MAX_LOBES:
        complain(
            f"at most {MAX_LOBES} for a pixel, the diffuse one included",
            str(count),
            "fit the materials with fewer lobes, or render diffuse and specular radiance apart",
        )


def _read_tables(gbuffer: GBuffer, camera: Camera, tables: Sequence[LobeTable]) -> list[FloatArray]:
    """Return planes, five for each lobe of a table: the axis, the sharpness without band-limit, and the amplitude.

    All five are 0 where a pixel has fewer lobes, or shows no material with a table.
    """
    material, normal, position = gbuffer.material, gbuffer.normal, gbuffer.position
    assert material is not None and normal is not None
    height, width = material.shape
    planes = np.zeros((max(table.lobe_count for table in tables), 5, height, width), np.float32)
    surface, eye = mark_surface_pixels(gbuffer, (height, width)), camera.position.astype(np.float32)
    rays = camera.make_ray_directions(width, height)

    def fill(chunk: Chunk) -> None:
        for number, table in enumerate(tables, 1):
            here = surface[chunk] & (material[chunk] == number)
            if not here.any():
                continue
            view = -rays[chunk][here] if position is None else normalize(eye - position[chunk][here])
            tangent = None if gbuffer.tangent is None or table.is_isotropic else gbuffer.tangent[chunk][here]
            mixture = evaluate_table(table, normalize(normal[chunk][here]), view, tangent)
            # The isotropic Gaussian with the area of the anisotropic one has twice the mean sharpness (geometric).
            sharpness = 2.0 * np.sqrt(mixture.sharpness[..., 0] * mixture.sharpness[..., 1])
            for k in range(table.lobe_count):
                values = *np.moveaxis(mixture.axis[:, k], -1, 0), sharpness[:, k], mixture.amplitude[:, k]
                for plane, value in zip(planes[k], values, strict=True):
                    plane[chunk][here] = value

    run_chunks(fill, height, width)
    return list(planes.reshape(-1, height, width))


ABSENT = (0.0, 0.0, 0.0, 1.0, 0.0)
"""A lobe that a pixel does not have: axis, sharpness and amplitude."""


def define_mixture(grid: Grid, lobes: int) -> list[Vector]:
    """Return validity, axes, sharpnesses and amplitudes; a GGX surface has ``lobes`` lobes.

    All lobes of a pixel have one axis, unless there are tables or diffuse lobes. Without an image the albedo is 1.
    """
    which, mixture = _compute_specular(grid, lobes)
    there = [which != NO_LOBE] * len(mixture)
    if grid.has("diffuse_albedo"):
        diffuse, is_lit = _compute_diffuse(grid)
        mixture, there = [*mixture, diffuse], [*there, is_lit]
    zero = hl.f32(0.0)
    sums = [hl.select(has, x + y + z + value, zero) for has, (x, y, z, _, value) in zip(there, mixture, strict=True)]
    finite = is_finite(sum(sums[1:], sums[0]))
    values = [
        hl.select(has & finite, value, hl.f32(absent))
        for has, lobe in zip(there, mixture, strict=True)
        for value, absent in zip(lobe, ABSENT, strict=True)
    ]
    valid, *values = grid.share([hl.u8(finite & reduce(or_, there)), *values])
    lobe_values = [values[k : k + 5] for k in range(0, len(values), 5)]
    own_axes = lobe_values if grid.has("diffuse_albedo") or grid.has("table_channel0") else lobe_values[:1]
    axes = [value for lobe in own_axes for value in lobe[:3]]
    return [[valid], axes, [lobe[3] for lobe in lobe_values], [lobe[4] for lobe in lobe_values]]


def _compute_specular(grid: Grid, lobes: int) -> tuple[hl.Expr, list[Vector]]:
    """Return the kind of a pixel's lobe (see `compute_lobe`) and its lobes: axis, sharpness and amplitude."""
    which, axis, (area, alpha_square) = compute_lobe(grid, "sg_mixture")
    (noise,) = grid.get("noise")
    albedo = compute_luminance(HALIDE, grid.read("specular_albedo")) if grid.has("specular_albedo") else hl.f32(1.0)
    sharpness, amplitude = spread_ggx_mixture(HALIDE, area, alpha_square, albedo, lobes=lobes, noise=noise)
    if grid.has("kind"):
        # The lobes of Beckmann surfaces and mirrors, and the diffuse lobe, are a single Gaussian already.
        alone, is_lambert = grid.read_one("kind") != hl.f32(LobeKind.GGX), which == LAMBERT_LOBE
        single = hl.select(is_lambert, hl.f32(LAMBERT_SIMILARITY_SHARPNESS), 1.0 / (area + noise))
        peak = hl.select(is_lambert, hl.f32(1.0), albedo) / integrate_gaussian(HALIDE, single)
        sharpness[0] = hl.select(alone, single, sharpness[0])
        amplitude = [hl.select(alone, hl.f32(0.0) if k else peak, amplitude[k]) for k in range(lobes)]
    mixture: list[Vector] = [[*axis, *shape] for shape in zip(sharpness, amplitude, strict=True)]
    if not grid.has("table_channel0"):
        return which, mixture
    planes = grid.read_channels("table")
    is_measured, absent = planes[3] > hl.f32(0.0), [hl.f32(value) for value in ABSENT]
    measured = [_limit_band(planes[k : k + 5], noise) for k in range(0, len(planes), 5)]
    pairs = zip_longest(measured, mixture, fillvalue=absent)
    return which, [[hl.select(is_measured, a, b) for a, b in zip(*pair, strict=True)] for pair in pairs]


def _limit_band(lobe: Vector, noise: hl.Expr) -> Vector:
    """Return a lobe of a table with the variance ``noise`` more; its integral does not change."""
    *axis, sharpness, amplitude = lobe
    factor = 1.0 / (1.0 + noise * sharpness)
    return [*axis, hl.select(sharpness > hl.f32(0.0), sharpness * factor, hl.f32(1.0)), amplitude * factor]


def _compute_diffuse(grid: Grid) -> tuple[Vector, hl.Expr]:
    """Return the diffuse lobe of a pixel, and whether the surface reflects diffuse light."""
    normal, tint = grid.read("normal"), compute_luminance(HALIDE, grid.read("diffuse_albedo"))
    square = dot(normal, normal)
    is_lit = (tint > hl.f32(0.0)) & is_finite(tint) & (square > hl.f32(1e-6)) & is_finite(square)
    axis = scale(normal, 1.0 / hl.sqrt(square))
    return [*axis, hl.f32(LAMBERT_SHARPNESS), tint * hl.f32(LAMBERT_AMPLITUDE / math.pi)], is_lit
