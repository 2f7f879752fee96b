"""Surfaces from a frame's guides: where a pixel sees one, its position and depth, and numbers that filters compare."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, is_finite
from lobewise.engine.numbers import make_single
from lobewise.lobes.vectors import dot
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, GBuffer

MIN_SQUARED_NORMAL = 0.01
"""Squared length of a normal. Below it the pixel sees no surface: every renderer writes 0 for the background."""


def is_surface_depth(depth: hl.Expr) -> hl.Expr:
    """Return whether a ray of this length hits a surface."""
    return (depth > hl.f32(0.0)) & is_finite(depth)


def make_ray(grid: Grid, kind: hl.Type) -> list[hl.Expr]:
    """Return the direction in which a pixel looks, of length 1 along the camera's axis."""
    x, y = hl.cast(hl.Float(64), grid.x), hl.cast(hl.Float(64), grid.y) + grid.get("first_row")[0]
    parts = zip(grid.get("first_ray"), grid.get("ray_right"), grid.get("ray_down"), strict=True)
    return [hl.cast(kind, first + x * right + y * down) for first, right, down in parts]


def mark_surface_pixels(gbuffer: GBuffer, size: tuple[int, int]) -> NDArray[np.bool_]:
    """Return which pixels of an image of ``size`` see a surface with finite guides."""
    images = {"depth": gbuffer.depth, "position": gbuffer.position, "normal": gbuffer.normal}
    if all(image is None for image in images.values()):
        return np.ones(size, dtype=bool)
    (surface,) = engine.pixels(define_surface, images, {}, names=["surface"], text="pixels with a surface")
    return surface


def define_surface(grid: Grid) -> list[Vector]:
    return [[hl.u8(is_surface(grid))]]


def is_surface(grid: Grid) -> hl.Expr:
    """Return whether a pixel sees a surface whose depth, position and normal are finite, as far as they are given."""
    surface = hl.Expr(True)
    if grid.has("depth"):
        surface = surface & is_surface_depth(grid.read_one("depth"))
    if grid.has("position"):
        x, y, z = grid.read("position")
        surface = surface & is_finite(x + y + z)
    if grid.has("normal"):
        normal = grid.read("normal")
        square = dot(normal, normal)
        surface = surface & (square > hl.f32(MIN_SQUARED_NORMAL)) & is_finite(square)
    return surface


def compute_points(gbuffer: GBuffer, camera: Camera) -> tuple[FloatArray, FloatArray]:
    """Return surface points (height, width, 3) and depths. The G-buffer has at least one; the other is computed."""
    position, depth = gbuffer.position, gbuffer.depth
    if position is None:
        assert depth is not None
        numbers: dict[str, Any] = {"eye": camera.position, **camera.get_ray_numbers(depth.shape)}
        (position,) = engine.pixels(
            define_positions, {"depth": depth}, numbers, names=["position"], text="positions from depths"
        )
    if depth is None:
        (depth,) = engine.pixels(_define_depths, {"position": position}, {"eye": camera.position})
    return position, depth


def define_positions(grid: Grid) -> list[Vector]:
    ray = make_ray(grid, hl.Float(64))
    along = hl.f64(grid.read_one("depth")) / hl.sqrt(dot(ray, ray))
    return [[hl.f32(eye + along * component) for eye, component in zip(grid.get("eye"), ray, strict=True)]]


def _define_depths(grid: Grid) -> list[Vector]:
    step = [hl.f64(place) - eye for place, eye in zip(grid.read("position"), grid.get("eye"), strict=True)]
    return [[hl.f32(hl.sqrt(dot(step, step)))]]


def compute_inverse_hits(distance: FloatArray) -> FloatArray:
    """Return 1/t of every hit distance t, (height, width); 0 if the ray missed or the distance is unknown."""
    images, names = {"distance": distance}, ["inverse_hit"]
    (inverse,) = engine.pixels(define_inverse_hits, images, {}, names=names, text="inverse hit distances")
    return inverse


def define_inverse_hits(grid: Grid) -> list[Vector]:
    distance = grid.read_one("distance")
    inverse = hl.f32(1.0) / distance
    return [[hl.select((distance > hl.f32(0.0)) & is_finite(inverse), inverse, hl.f32(0.0))]]


def compute_tolerances(alpha_u: FloatArray, alpha_v: FloatArray | None, least: float, slope: float) -> FloatArray:
    """Return ``least + slope * alpha`` with the larger alpha, (height, width). NaN counts as alpha 0."""
    images = {"alpha_u": alpha_u, "alpha_v": alpha_v}
    numbers = {"least": least, "slope": slope}
    (tolerance,) = engine.pixels(
        define_tolerances, images, numbers, names=["tolerance"], text="tolerances of hit distances"
    )
    return tolerance


def define_tolerances(grid: Grid) -> list[Vector]:
    alphas = [grid.read_one(name) for name in ("alpha_u", "alpha_v") if grid.has(name)]
    known = is_finite(sum(alphas[1:], alphas[0]))
    widest = hl.select(known, hl.max(*alphas, hl.f32(0.0)), hl.f32(0.0))
    return [[hl.f32(grid.get("least")[0]) + hl.f32(grid.get("slope")[0]) * widest]]


def compute_footprints(
    surface: NDArray[np.bool_],
    depth: FloatArray,
    pixel_angle: float,
    allowance: FloatArray | None,
    allowed: float,
    into: FloatArray | None = None,
) -> FloatArray:
    """Return the width of a pixel on its surface, world units, (height, width); 1 where there is no surface.

    With ``allowance`` the width grows by the factor ``1 + allowed * allowance``. ``into`` is memory for the result.
    """
    images = {"surface": surface, "depth": depth, "allowance": allowance}
    numbers = {"pixel_angle": make_single(pixel_angle), "allowed": make_single(allowed)}
    (footprint,) = engine.pixels(
        define_footprints, images, numbers, names=["footprint"], into=[into], text="widths of pixels on their surfaces"
    )
    return footprint


def define_footprints(grid: Grid) -> list[Vector]:
    (angle,), (allowed,) = grid.get("pixel_angle"), grid.get("allowed")
    footprint = grid.read_one("depth") * angle
    if grid.has("allowance"):
        footprint = footprint * (hl.f32(1.0) + grid.read_one("allowance") * allowed)
    return [[hl.select(grid.read_one("surface") != 0, footprint, hl.f32(1.0))]]


class Backdrop(NamedTuple):
    """Surfaces in front of a wall that is far away, each (height, width, 3)."""

    facing: FloatArray
    """Normals; on the wall they face the camera."""
    normal: FloatArray
    """Normals; on the wall they are 0, because it has no tangent plane."""
    position: FloatArray | None
    """Surface points; None if they were not given."""


def put_backdrop(
    surface: NDArray[np.bool_], normal: FloatArray, position: FloatArray | None, camera: Camera | None, far: float
) -> Backdrop:
    """Return the guides with a wall at the distance ``far`` in place of the background.

    Without a camera all pixels look along -z.
    """
    size = surface.shape[0], surface.shape[1]
    if camera is not None:
        rays = camera.get_ray_numbers(size)
    else:
        still = np.zeros(3)
        rays = {"first_ray": np.array([0.0, 0.0, -1.0]), "ray_right": still, "ray_down": still, "first_row": still[:1]}
    eye = np.zeros(3) if camera is None else camera.position
    images = {"surface": surface, "normal": normal, "position": position}
    numbers = {"eye": make_single(eye), "far": np.float32(far), **rays}
    facing, flat, *points = engine.pixels(
        define_backdrop,
        images,
        numbers,
        names=["facing", "flat_normal", "flat_position"],
        text="a wall far away in place of the background",
    )
    return Backdrop(facing, flat, points[0] if points else None)


def define_backdrop(grid: Grid) -> list[Vector]:
    there = grid.read_one("surface") != 0
    ray = make_ray(grid, hl.Float(32))
    inverse = hl.f32(1.0) / hl.sqrt(dot(ray, ray))
    ray = [component * inverse for component in ray]
    normal = grid.read("normal")
    outputs: list[Vector] = [
        [hl.select(there, n, -r) for n, r in zip(normal, ray, strict=True)],
        [hl.select(there, n, hl.f32(0.0)) for n in normal],
    ]
    if grid.has("position"):
        (far,) = grid.get("far")
        triples = zip(grid.read("position"), grid.get("eye"), ray, strict=True)
        outputs.append([hl.select(there, p, eye + far * r) for p, eye, r in triples])
    return outputs
