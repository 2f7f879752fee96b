"""Where a reflection was in the previous frame if the reflected object has moved, or the mirror.

The virtual image of a point H lies behind the mirror, on the line from the mirror's point P to the image of H in the
tangent plane. Its distance from P is ``t / (1 + 2 c t)`` with ``t = |H - P|`` and the curvature c (thin mirror
equation, paraxial). To first order it does not depend on which point P of the mirror near the line of sight is chosen.
So the image in the previous frame is found from a point and a normal of the mirror in the previous frame, and from the
previous place of H.

Source: the mirror equation of optics; Zeng et al. 2021, "Temporally Reliable Motion Vectors for Real-time Ray Tracing"
(the previous place of the hit is mirrored). Departs: mirrors may be curved.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, is_finite, select_or_nan
from lobewise.guides.places import MISS_DISTANCE, project_step
from lobewise.lobes.vectors import dot, subtract
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

MIN_MIRROR_MOTION = 0.004
"""Motion of a surface besides that of the camera, pixels, above which the mirror's previous plane is looked up.

Rounding moves surfaces that stand still by less.
"""
MOTION_REACH = 8
"""Pixels to each side, above and below whose motion counts as well. Near the axis of a mirror that turns, the mirror
itself hardly moves, and the reflection moves as far as elsewhere."""
MIN_NORMAL_COSINE = 0.5
"""Smallest cosine between a mirror's normals in two frames. Below it the two pixels show different surfaces."""


class Mirror(NamedTuple):
    """The surfaces of a frame as mirrors."""

    position: FloatArray
    """Surface points, world space, (height, width, 3)."""
    normal: FloatArray
    """Shading normals, (height, width, 3)."""


class MovedReflections(NamedTuple):
    """The reflections of a frame as the previous frame showed them."""

    places: FloatArray
    """Column and row, pixel centres at whole numbers, (height, width, 2); NaN where the hit is unknown."""
    hit_distance: FloatArray
    """Distance from the mirror to the previous place of the hit, (height, width), as in `GBuffer.hit_distance`."""
    axis: FloatArray
    """Direction from the mirror to the previous place of the hit, unit length, (height, width, 3)."""
    has_moved: NDArray[np.bool_]
    """Whether hit or mirror has moved, and the place lies in the image, (height, width)."""


def compute_moved_reflections(
    mirrors: tuple[Mirror, Mirror],
    curvature: FloatArray,
    hit_distance: FloatArray,
    reflected_motion: FloatArray,
    surface: tuple[FloatArray, FloatArray | None],
    cameras: tuple[Camera, Camera],
) -> MovedReflections:
    """Return where each pixel's reflection was in the previous frame, and the distance of its hit from the mirror then.

    Without any motion of objects these are the places of `lobewise.guides.places.compute_virtual_places`.

    Parameters
    ----------
    mirrors : pair of Mirror
        The surfaces of this frame and of the previous one.
    curvature : array, shape (height, width)
        From `lobewise.guides.places.estimate_curvature`.
    hit_distance : array, shape (height, width)
        Distances from the surfaces to their hits; 0 if unknown, inf for none.
    reflected_motion : array, shape (height, width, 3)
        Previous minus present position of the hits, world units; values that are not finite count as 0.
    surface : pair of arrays, shape (height, width, 2) and (height, width)
        Results of `lobewise.guides.places.compute_surface_places`: the previous places of the surface points, and their
        own motion in pixels, or None if no surface has moved by itself.
    cameras : pair of Camera
        The cameras of this frame and of the previous one.
    """
    (mirror, before), (camera, previous) = mirrors, cameras
    size = int(curvature.shape[0]), int(curvature.shape[1])
    images = {
        "distance": hit_distance,
        "curvature": curvature,
        "position": mirror.position,
        "normal": mirror.normal,
        "reflected": reflected_motion,
        "position_before": before.position,
        "normal_before": before.normal,
        "place": surface[0],
        "own": surface[1],
    }
    numbers: dict[str, Any] = {"eye": camera.position, "far": MISS_DISTANCE, **previous.get_projection_numbers(size)}
    limits = {"least_motion": np.float32(MIN_MIRROR_MOTION), "least_cosine": np.float32(MIN_NORMAL_COSINE)}
    return MovedReflections(*engine.pixels(_define_reflections, images, {**numbers, **limits}))


def _define_reflections(grid: Grid) -> list[Vector]:
    zero, one, two = hl.f64(0.0), hl.f64(1.0), hl.f64(2.0)
    (far,) = grid.get("far")
    position, normal = _read(grid, "position"), _read(grid, "normal")
    view = subtract(position, grid.get("eye"))
    depth = hl.sqrt(dot(view, view))
    raw = grid.read_one("distance")
    t = hl.select(is_finite(raw), hl.f64(raw), far * depth)
    step = grid.read("reflected")
    stands = ~is_finite(step[0] + step[1] + step[2])
    moved = [hl.select(stands, zero, hl.f64(component)) for component in step]

    # From the mirror's point to the previous place of the hit, mirrored: on a mirror that stood still.
    ray = [component / depth for component in view]
    flat = [t * along + across for along, across in zip(ray, _reflect(moved, normal), strict=True)]

    # The same from the mirror's previous point, on a mirror that has moved by itself.
    point, facing, has_moved = _read_mirror_before(grid, normal)
    out = _reflect(ray, normal)
    hit = [p + t * o + m for p, o, m in zip(position, out, moved, strict=True)]
    turned = _reflect(subtract(hit, point), facing)
    has_moved = has_moved & (dot(subtract(hit, point), facing) > zero)
    flat = [hl.select(has_moved, new, old) for new, old in zip(turned, flat, strict=True)]
    point = [hl.select(has_moved, new, old) for new, old in zip(point, position, strict=True)]
    facing = [hl.select(has_moved, new, old) for new, old in zip(facing, normal, strict=True)]

    length = hl.sqrt(dot(flat, flat))
    opening = one + two * hl.f64(grid.read_one("curvature")) * length
    # The image of a concave mirror turns over at the focus; reflections beyond it are not tracked.
    known = (raw > hl.f32(0.0)) & (opening > zero)
    shrink = one / hl.max(opening, hl.f64(1e-6))
    image = [p + shrink * f for p, f in zip(point, flat, strict=True)]
    from_eye = subtract(image, grid.get("before"))
    places, seen = project_step(grid, from_eye)

    # Find where the previous camera's ray to the image crosses the mirror's tangent plane.
    height, below = dot(subtract(grid.get("before"), point), facing), -shrink * dot(flat, facing)
    crosses = (height > zero) & (below > zero)
    share = height / hl.select(crosses, height + below, one)
    crossing = [eye + share * part for eye, part in zip(grid.get("before"), from_eye, strict=True)]
    offset = [p + f - c for p, f, c in zip(point, flat, crossing, strict=True)]
    offset = [hl.select(crosses, new, old) for new, old in zip(offset, flat, strict=True)]
    length = hl.sqrt(dot(offset, offset))
    reach, axis = hl.f32(length), _reflect([component / length for component in offset], facing)
    there = known & seen
    distance = hl.select(there & is_finite(raw), reach, raw)
    width, height = (hl.f32(extent) for extent in grid.size)
    half = hl.f32(0.5)
    column, row = places
    seen = there & (column > -half) & (row > -half) & (column < width - half) & (row < height - half)
    steps = hl.abs(moved[0]) + hl.abs(moved[1]) + hl.abs(moved[2])
    return [
        [select_or_nan(there, place) for place in places],
        [distance],
        [hl.f32(component) for component in axis],
        [hl.u8(seen & (has_moved | (steps > zero)))],
    ]


def _read(grid: Grid, name: str) -> list[hl.Expr]:
    return [hl.f64(component) for component in grid.read(name)]


def _reflect(vector: Vector, normal: Vector) -> list[hl.Expr]:
    """Return a vector mirrored in the plane across a normal of any length."""
    square = hl.max(dot(normal, normal), hl.f64(1e-12))
    scale = hl.f64(2.0) * dot(vector, normal) / square
    return [component - scale * across for component, across in zip(vector, normal, strict=True)]


def _read_mirror_before(grid: Grid, normal: Vector) -> tuple[list[hl.Expr], list[hl.Expr], hl.Expr]:
    """Return the point and the normal of the mirror in the previous frame, and whether it has moved and was seen."""
    if not grid.has("own"):
        return [hl.f64(0.0)] * 3, list(normal), hl.Expr(False)
    width, height = grid.size
    column, row = (hl.floor(place + hl.f32(0.5)) for place in grid.read("place"))
    inside = (column > hl.f32(-1.0)) & (row > hl.f32(-1.0)) & (column < hl.f32(width)) & (row < hl.f32(height))
    # A place outside the image, or NaN, must not become an index.
    x = hl.clamp(hl.i32(hl.select(inside, column, hl.f32(0.0))), 0, width - 1)
    y = hl.clamp(hl.i32(hl.select(inside, row, hl.f32(0.0))), 0, height - 1)
    point, facing = (
        [hl.f64(component) for component in grid.read(name, x, y)] for name in ("position_before", "normal_before")
    )
    least = hl.f64(grid.get("least_cosine")[0]) * hl.sqrt(dot(normal, normal) * dot(facing, facing))
    alike = inside & (_compute_largest_motion(grid) > grid.get("least_motion")[0]) & (dot(facing, normal) > least)
    return point, facing, alike


def _compute_largest_motion(grid: Grid) -> hl.Expr:
    """Return the largest own motion of the pixels in a cross around a pixel."""
    width, height = grid.size
    largest = grid.read_one("own")
    for step in (each for reach in range(1, MOTION_REACH + 1) for each in (-reach, reach)):
        (across,) = grid.read("own", hl.clamp(grid.x + step, 0, width - 1), grid.y)
        (along,) = grid.read("own", grid.x, hl.clamp(grid.y + step, 0, height - 1))
        largest = hl.max(largest, across, along)
    return largest
