"""Where a pixel looks for its history in the previous frame: at its surface point, and at its virtual image.

A reflection does not stay on the surface when the camera moves. It moves like the virtual image of the reflected
object, which lies as far behind a flat mirror as the object lies in front of it, and nearer behind a convex mirror.

Cameras project in float64: a pixel whose surface stands still must find itself to a small fraction of a pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, is_finite, select_or_nan
from lobewise.guides.surfaces import is_surface_depth, make_ray
from lobewise.lobes.vectors import dot, subtract
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

MISS_DISTANCE = 1e6
"""Distance from the surface to the virtual image if the lobe hits nothing, over the distance from the camera."""
MIN_EDGE_RATIO = 4.0
"""Ratio of the squared steps to the two neighbours of a pixel. Above it the longer step crosses an object's edge."""


def make_grid(size: tuple[int, int]) -> FloatArray:
    """Return column and row of every pixel, pixel centres at whole numbers, (height, width, 2)."""
    rows, columns = np.indices(size, dtype=np.float32)
    return np.stack([columns, rows], axis=-1)


def add_grid(motion: FloatArray) -> FloatArray:
    """Return column and row where each pixel was, pixel centres at whole numbers, (height, width, 2)."""
    height, width = motion.shape[:2]
    return motion + make_grid((height, width))


def project_step(grid: Grid, step: Vector) -> tuple[list[hl.Expr], hl.Expr]:
    """Return column and row, pixel centres at whole numbers, of a step from the camera, and whether it is in front.

    The numbers are computed in the precision of the step, which is that of the grid's numbers.
    """
    one, half = (hl.cast(step[0].type(), value) for value in (hl.f64(1.0), hl.f64(0.5)))
    width, height = (hl.cast(step[0].type(), extent) for extent in grid.size)
    ahead = dot(step, grid.get("before_forward"))
    inverse = one / ahead
    column = (dot(step, grid.get("before_right")) * inverse + one) * half * width - half
    row = (one - dot(step, grid.get("before_up")) * inverse) * half * height - half
    place = [hl.f32(column), hl.f32(row)]
    return place, (ahead > one - one) & is_finite(place[0]) & is_finite(place[1])


def compute_surface_places(
    camera: Camera, previous: Camera, places: tuple[FloatArray, FloatArray], motion: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """Return where surfaces were in the previous frame, and by how many pixels objects moved by themselves.

    `lobewise.records.camera.compute_motion` computes the same places, up to rounding, for code without Halide.

    Parameters
    ----------
    camera, previous : Camera
        Cameras of this frame and of the previous one.
    places : pair of arrays, shape (height, width, 3) and (height, width)
        Surface points and depths; the background (depth 0, or not finite) is infinitely far.
    motion : array, shape (height, width, 2), optional
        Motion that came with the frame, pixels. Without it only the camera moves.

    Returns
    -------
    array, shape (height, width, 2)
        Column and row, pixel centres at whole numbers; outside the image if the point lay behind the camera.
    array, shape (height, width), or None
        Distance in pixels between ``motion`` and the motion of the camera, 0 if unknown; None without ``motion``.
    """
    position, depth = places
    size = depth.shape[0], depth.shape[1]
    numbers: dict[str, Any] = {**previous.get_projection_numbers(size), **camera.get_ray_numbers(size)}
    images = {"depth": depth, "position": position, "motion": motion}
    names, text = ["places", "allowance"], "places of surfaces a frame ago"
    where, *allowance = engine.pixels(define_surface_places, images, numbers, names=names, text=text)
    return where, allowance[0] if allowance else None


def define_surface_places(grid: Grid) -> list[Vector]:
    there = is_surface_depth(grid.read_one("depth"))
    step, ray = subtract([hl.f64(p) for p in grid.read("position")], grid.get("before")), make_ray(grid, hl.Float(64))
    place, known = project_step(grid, [hl.select(there, *pair) for pair in zip(step, ray, strict=True)])
    own = [hl.f32(grid.x), hl.f32(grid.y)]
    # A point that lay behind the camera moves by twice the size of the image.
    outside = [start + hl.f32(2 * extent) for start, extent in zip(own, grid.size, strict=True)]
    place = [hl.select(known, value, beyond) for value, beyond in zip(place, outside, strict=True)]
    if not grid.has("motion"):
        return [place]
    moved = [start + step for start, step in zip(own, grid.read("motion"), strict=True)]
    besides = subtract(moved, place)
    distance = hl.sqrt(besides[0] * besides[0] + besides[1] * besides[1])
    return [moved, [hl.select(is_finite(distance), distance, hl.f32(0.0))]]


def estimate_curvature(position: FloatArray, normal: FloatArray) -> FloatArray:
    """Return the mean curvature of the surface at each pixel, 1/world unit, > 0 for convex, shape (height, width).

    It is the mean over row and column of ``(dn . dx) / |dx|^2``, with the differences of normal and position to a
    neighbour. Of the two neighbours the much nearer one counts, or else the one with the flatter slope, so that neither
    edges of objects nor creases count. An image of a single row or column is flat in the other direction.
    """
    images = {"position": position, "normal": normal}
    numbers = {"edge": np.float32(MIN_EDGE_RATIO)}
    (curvature,) = engine.pixels(define_curvature, images, numbers, names=["curvature"], text="curvature of surfaces")
    return curvature


def define_curvature(grid: Grid) -> list[Vector]:
    x, y = grid.x, grid.y
    last_x, last_y = (hl.max(extent - 2, 0) for extent in grid.size)
    # From a pixel to its right neighbour; the last column has none.
    right = grid.keep(_open(grid, y, (hl.min(x + 1, grid.size[0] - 1) if grid.narrow else x + 1, y)))
    rows = [right(hl.clamp(column, 0, last_x), y) for column in (x - 1, x)]
    down = [hl.clamp(row, 0, last_y) for row in (y - 1, y)]
    columns = [_open(grid, row, (x, hl.min(row + 1, grid.size[1] - 1))) for row in down]
    curvature = hl.f32(0.5) * (_choose_side(grid, columns) + _choose_side(grid, rows))
    return [[hl.select(is_finite(curvature), curvature, hl.f32(0.0))]]


def _open(grid: Grid, row: hl.Expr, neighbour: tuple[hl.Expr, hl.Expr]) -> list[hl.Expr]:
    """Return the slope ``(dn . dx) / |dx|^2`` from (x, row) to its neighbour, and ``|dx|^2``; inf for no neighbour."""
    dx, dn = (subtract(grid.read(name, *neighbour), grid.read(name, y=row)) for name in ("position", "normal"))
    square = dot(dx, dx)
    slope = dot(dn, dx) / hl.select(square > hl.f32(1e-20), square, hl.f32(1e-20))
    # A neighbour with NaN counts as none.
    return [slope, hl.select(is_finite(slope), square, hl.f32(np.inf))]


def _choose_side(grid: Grid, sides: Any) -> hl.Expr:
    """Return the slope on the much nearer side, or else the flatter one of the two."""
    (first, near), (second, far) = ((side[0], side[1]) for side in sides)
    (edge,) = grid.get("edge")
    flatter = hl.select(hl.abs(first) < hl.abs(second), first, second)
    return hl.select(near > edge * far, second, far > edge * near, first, flatter)


def compute_virtual_places(
    position: FloatArray,
    curvature: FloatArray,
    hit_distance: FloatArray,
    camera: Camera,
    previous: Camera,
) -> FloatArray:
    """Return column and row where each pixel's reflection was in the previous frame, shape (height, width, 2).

    The virtual image of a hit at distance t lies ``t / (1 + 2 c t)`` behind the surface along the view ray, with the
    curvature c (thin mirror equation, paraxial). The previous camera projects this point. Motion of the reflected
    object is ignored; the comparison of lobes rejects a history that does not fit. NaN if the hit is unknown (0).

    Source: the mirror equation of optics. Zimmer et al. 2015, "Path-space motion estimation and decomposition for
    robust animation filtering", track the motion of reflections.
    """
    size = curvature.shape[0], curvature.shape[1]
    images = {"distance": hit_distance, "curvature": curvature, "position": position}
    numbers = {"eye": camera.position, "far": MISS_DISTANCE, **previous.get_projection_numbers(size)}
    names, text = ["virtual_places"], "places of reflections a frame ago"
    (places,) = engine.pixels(define_image_places, images, numbers, names=names, text=text)
    return places


def define_image_places(grid: Grid) -> list[Vector]:
    one = hl.f64(1.0)
    (far,) = grid.get("far")
    position = [hl.f64(component) for component in grid.read("position")]
    view = subtract(position, grid.get("eye"))
    distance = hl.sqrt(dot(view, view))
    raw = grid.read_one("distance")
    t = hl.select(is_finite(raw), hl.f64(raw), far * distance)
    opening = one + hl.f64(2.0) * hl.f64(grid.read_one("curvature")) * t
    # The image of a concave mirror turns over at the focus; reflections beyond it are not tracked.
    known = (raw > hl.f32(0.0)) & (opening > hl.f64(0.0))
    behind = t / hl.max(opening, hl.f64(1e-6)) / distance
    image = [place + component * behind for place, component in zip(position, view, strict=True)]
    places, seen = project_step(grid, subtract(image, grid.get("before")))
    return [[select_or_nan(known & seen, place) for place in places]]
