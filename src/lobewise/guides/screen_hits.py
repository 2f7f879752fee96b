"""Hit distances of reflections, found on the screen for frames that do not bring them.

A ray is followed from every pixel along the mirror direction. Where it goes behind a surface that the camera sees, that
surface is what the pixel reflects. Source: McGuire and Mara 2014, "Efficient GPU Screen-Space Ray Tracing", describe
the idea; here steps grow with the distance, because only the place of the virtual image is needed.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, is_finite
from lobewise.guides.places import project_step
from lobewise.guides.surfaces import is_surface_depth
from lobewise.lobes.directions import reflect
from lobewise.lobes.vectors import dot
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

STEPS = 96
"""Steps of a ray."""
STEPS_PER_CALL = 8
"""Steps that one kernel makes: more take long to compile."""
FIRST_STEP = 2.0
"""Length of the first step, pixel footprints."""
FARTHEST = 60.0
"""Length of a ray, distances of its surface from the camera."""
MAX_BEHIND = 2.0
"""Steps by which a point may lie behind the surface that the ray is said to hit. Farther behind, the ray passes."""
MIN_RISE = 0.02
"""Smallest cosine between a ray and the normal: flatter rays run along their own surface."""
MIN_OPENING = 2.0
"""Curvature times distance from the camera above which a mirror images everything near its focus."""


def estimate_screen_hits(
    camera: Camera, position: FloatArray, depth: FloatArray, normal: FloatArray, curvature: FloatArray
) -> FloatArray:
    """Return the distance to what each pixel reflects, (height, width), world units.

    Parameters
    ----------
    camera : Camera
    position, normal : array, shape (height, width, 3)
        Surface points and shading normals.
    depth : array, shape (height, width)
        Distances along the rays; 0 or not finite where there is no surface.
    curvature : array, shape (height, width)
        Of `lobewise.guides.places.estimate_curvature`.

    Returns
    -------
    array, shape (height, width)
        0 where unknown: the ray leaves the picture or passes behind something. inf where it is unknown and the mirror
        is so convex that the virtual image lies at its focus, however far the reflected surface is.
    """
    size = int(depth.shape[0]), int(depth.shape[1])
    pixel_angle = camera.get_pixel_angle(size[0])
    numbers: dict[str, Any] = {"eye": camera.position, "angle": pixel_angle, **camera.get_projection_numbers(size)}
    numbers = {name: np.asarray(value, np.float32) for name, value in numbers.items()}
    images = {"position": position, "depth": depth, "normal": normal}
    rays, state = engine.pixels(_define_rays, images, numbers)
    growth = math.exp(math.log(FARTHEST / (FIRST_STEP * pixel_angle)) / STEPS)
    for _ in range(STEPS // STEPS_PER_CALL):
        images = {"position": position, "depth": depth, "rays": rays, "state": state}
        (state,) = engine.pixels(_define_steps, images, {**numbers, "growth": np.float32(growth)})
    (hits,) = engine.pixels(_define_hits, {"depth": depth, "state": state, "curvature": curvature}, {})
    return np.asarray(hits)


def _define_rays(grid: Grid) -> list[Vector]:
    """Return mirror directions, and the state of the rays: the hit or 0, the last gap, and the length so far.

    The length of a ray that goes no further is negative.
    """
    view = [p - eye for p, eye in zip(grid.read("position"), grid.get("eye"), strict=True)]
    inverse = hl.f32(-1.0) / hl.sqrt(dot(view, view))
    view = [component * inverse for component in view]
    normal = grid.read("normal")
    ray = reflect(normal, view, dot(view, normal))
    depth = grid.read_one("depth")
    usable = is_surface_depth(depth) & is_finite(sum(ray[1:], ray[0])) & (dot(ray, normal) > hl.f32(MIN_RISE))
    start = depth * hl.f32(FIRST_STEP) * grid.get("angle")[0]
    zero = hl.f32(0.0)
    return [
        [hl.select(usable, component, zero) for component in ray],
        [zero, hl.f32(-1.0), hl.select(usable, start, hl.f32(-1.0))],
    ]


def _define_steps(grid: Grid) -> list[Vector]:
    state: Vector = grid.read("state")
    for _ in range(STEPS_PER_CALL):
        state = grid.share(_advance(grid, state))
    return [state]


def _advance(grid: Grid, state: Vector) -> list[hl.Expr]:
    """Return the state of a ray after one more step."""
    hit, gap, length = state
    zero, one = hl.f32(0.0), hl.f32(1.0)
    ahead = length * grid.get("growth")[0]
    step = ahead - length
    point = [p + ahead * r for p, r in zip(grid.read("position"), grid.read("rays"), strict=True)]
    away = [p - eye for p, eye in zip(point, grid.get("eye"), strict=True)]
    place, ahead_of_eye = project_step(grid, away)
    spots = [hl.floor(value + hl.f32(0.5)) for value in place]
    inside = [(spot >= zero) & (spot < hl.f32(extent)) for spot, extent in zip(spots, grid.size, strict=True)]
    seen = ahead_of_eye & inside[0] & inside[1]
    # A place outside the image, or NaN, must not become an index.
    indices = [hl.i32(hl.select(seen, spot, zero)) for spot in spots]
    (depth,) = grid.read(
        "depth", *(hl.clamp(spot, 0, extent - 1) for spot, extent in zip(indices, grid.size, strict=True))
    )
    # Nothing lies in front of the background.
    behind = hl.select(is_surface_depth(depth), hl.sqrt(dot(away, away)) - depth, hl.f32(-1e30))
    runs = length > zero
    hits = runs & seen & (behind > zero) & (behind < hl.f32(MAX_BEHIND) * step)
    before = hl.select(gap > hl.f32(-1e29), hl.min(gap, zero), -step)
    share = hl.clamp(-before / hl.max(behind - before, hl.f32(1e-12)), zero, one)
    stops = hits | ~seen
    return [
        hl.select(hits, length + share * step, hit),
        hl.select(seen, behind, hl.f32(-1.0)),
        hl.select(runs & ~stops, ahead, hl.f32(-1.0)),
    ]


def _define_hits(grid: Grid) -> list[Vector]:
    hit, _, _ = grid.read("state")
    depth = grid.read_one("depth")
    focused = is_surface_depth(depth) & (grid.read_one("curvature") * depth > hl.f32(MIN_OPENING))
    return [[hl.select(hit > hl.f32(0.0), hit, focused, hl.f32(np.inf), hl.f32(0.0))]]
