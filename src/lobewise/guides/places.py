"""Where in the frame before a pixel looks for its history: at its surface point, and at its virtual image.

What a pixel reflects does not stay on the surface when the camera moves: it moves like the reflected thing's virtual
image, which lies behind a flat mirror as far as the thing lies before it, and nearer behind a convex one.

Cameras project in float64: a pixel whose surface stands still must find itself to a small part of a pixel.
"""

from __future__ import annotations

from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.pointwise import Grid, Vector, is_finite, run_pointwise, select_or_nan
from lobewise.camera import Camera
from lobewise.frame import FloatArray
from lobewise.guides.surfaces import get_ray_numbers, is_surface_depth, make_ray
from lobewise.lobes.vectors import dot, subtract

FAR = 1e6
"""Distance, in distances from the camera, at which what a lobe does not hit is taken to be."""
EDGE = 4.0
"""Ratio of the squared steps to the neighbours on both sides of a pixel from which the longer one leads elsewhere."""


def add_grid(motion: FloatArray) -> FloatArray:
    """Return column and row of where each pixel was, pixel centres at whole numbers, (height, width, 2)."""
    height, width = motion.shape[:2]
    places = motion.copy()
    places[..., 0] += np.arange(width, dtype=np.float32)
    places[..., 1] += np.arange(height, dtype=np.float32)[:, None]
    return places


def get_projection_numbers(camera: Camera, size: tuple[int, int]) -> dict[str, NDArray[np.float64]]:
    """Return what `_project` reads: the camera, its axes in units of the half image."""
    height, width = size
    half_width, half_height = camera.get_half_extent(width, height)
    return {
        "before": camera.position,
        "before_forward": camera.forward,
        # A step is divided by its depth: of a shifted image the centre is taken off before.
        "before_right": (camera.right - camera.shift[0] * camera.forward) / half_width,
        "before_up": (camera.up - camera.shift[1] * camera.forward) / half_height,
    }


def _project(grid: Grid, step: Vector) -> tuple[list[hl.Expr], hl.Expr]:
    """Return column and row, pixel centres at whole numbers, of a step away from the camera, and whether it has one."""
    one, half = hl.f64(1.0), hl.f64(0.5)
    width, height = (hl.f64(extent) for extent in grid.size)
    ahead = dot(step, grid.get("before_forward"))
    inverse = one / ahead
    column = (dot(step, grid.get("before_right")) * inverse + one) * half * width - half
    row = (one - dot(step, grid.get("before_up")) * inverse) * half * height - half
    place = [hl.f32(column), hl.f32(row)]
    return place, (ahead > hl.f64(0.0)) & is_finite(place[0]) & is_finite(place[1])


def find_surface_places(
    camera: Camera, previous: Camera, places: tuple[FloatArray, FloatArray], motion: FloatArray | None
) -> tuple[FloatArray, FloatArray | None]:
    """Return where surfaces were in the frame before, and by how many pixels they moved by themselves.

    Parameters
    ----------
    camera, previous : Camera
        Of this frame and of the one before.
    places : pair of arrays, shape (height, width, 3) and (height, width)
        Surface points and depths; the background (depth 0, or not finite) is infinitely far.
    motion : array, shape (height, width, 2), optional
        What the frame knows of it; without it nothing moves by itself.

    Returns
    -------
    array, shape (height, width, 2)
        Column and row, pixel centres at whole numbers; beyond the image where a point lay behind the camera.
    array, shape (height, width), or None
        Pixels, 0 where nobody knows; None without ``motion``.
    """
    position, depth = places
    size = int(depth.shape[0]), int(depth.shape[1])
    numbers: dict[str, Any] = {**get_projection_numbers(previous, size), **get_ray_numbers(camera, size)}
    images = {"depth": depth, "position": position, "motion": motion}
    where, *allowance = run_pointwise(_define_surface_places, images, numbers)
    return where, allowance[0] if allowance else None


def _define_surface_places(grid: Grid) -> list[Vector]:
    there = is_surface_depth(grid.read_one("depth"))
    steps = zip(subtract([hl.f64(p) for p in grid.read("position")], grid.get("before")), _ray(grid), strict=True)
    place, known = _project(grid, [hl.select(there, step, ray) for step, ray in steps])
    own = [hl.f32(grid.x), hl.f32(grid.y)]
    # A point that lay behind the camera moves by twice the image.
    outside = [start + hl.f32(2 * extent) for start, extent in zip(own, grid.size, strict=True)]
    place = [hl.select(known, value, beyond) for value, beyond in zip(place, outside, strict=True)]
    if not grid.has("motion"):
        return [place]
    moved = [start + step for start, step in zip(own, grid.read("motion"), strict=True)]
    besides = subtract(moved, place)
    distance = hl.sqrt(besides[0] * besides[0] + besides[1] * besides[1])
    return [moved, [hl.select(is_finite(distance), distance, hl.f32(0.0))]]


def _ray(grid: Grid) -> list[hl.Expr]:
    return make_ray(grid, hl.Float(64))


def estimate_curvature(position: FloatArray, normal: FloatArray) -> FloatArray:
    """Return the mean curvature of the surface at each pixel, 1/world unit, > 0 for convex, shape (height, width).

    From how the normals of the neighbours open, ``(dn . dx) / |dx|^2``, along rows and along columns, each time of the
    side that is much nearer or else of the one that is flatter, so that neither the edge of an object counts nor a
    crease. A single row or column counts as flat in the other direction.
    """
    images = {"position": position, "normal": normal}
    (curvature,) = run_pointwise(_define_curvature, images, {"edge": np.float32(EDGE)})
    return np.asarray(curvature)


def _define_curvature(grid: Grid) -> list[Vector]:
    x, y = grid.x, grid.y
    last_x, last_y = (hl.max(extent - 2, 0) for extent in grid.size)
    # From a pixel to its right neighbour, which the last column has none of.
    right = grid.keep(_open(grid, y, (hl.min(x + 1, grid.size[0] - 1) if grid.narrow else x + 1, y)))
    rows = [right(hl.clamp(column, 0, last_x), y) for column in (x - 1, x)]
    down = [hl.clamp(row, 0, last_y) for row in (y - 1, y)]
    columns = [_open(grid, row, (x, hl.min(row + 1, grid.size[1] - 1))) for row in down]
    curvature = hl.f32(0.5) * (_choose_side(grid, columns) + _choose_side(grid, rows))
    return [[hl.select(is_finite(curvature), curvature, hl.f32(0.0))]]


def _open(grid: Grid, row: hl.Expr, neighbour: tuple[hl.Expr, hl.Expr]) -> list[hl.Expr]:
    """Return how much normals open from (x, row) to its neighbour, and the squared step; inf for no neighbour."""
    dx, dn = (subtract(grid.read(name, *neighbour), grid.read(name, y=row)) for name in ("position", "normal"))
    square = dot(dx, dx)
    slope = dot(dn, dx) / hl.select(square > hl.f32(1e-20), square, hl.f32(1e-20))
    # What is no number is no neighbour.
    return [slope, hl.select(is_finite(slope), square, hl.f32(np.inf))]


def _choose_side(grid: Grid, sides: Any) -> hl.Expr:
    """Return the slope on the side that is much nearer, or else the flatter one."""
    (first, near), (second, far) = ((side[0], side[1]) for side in sides)
    (edge,) = grid.get("edge")
    flatter = hl.select(hl.abs(first) < hl.abs(second), first, second)
    return hl.select(near > edge * far, second, far > edge * near, first, flatter)


def find_virtual_places(
    position: FloatArray,
    curvature: FloatArray,
    hit_distance: FloatArray,
    camera: Camera,
    previous: Camera,
) -> FloatArray:
    """Return column and row where each pixel's reflection was in the frame before, shape (height, width, 2).

    The virtual image of what is seen at distance t lies ``t / (1 + 2 c t)`` behind the surface along the view ray, c
    the curvature (thin mirror equation, paraxial); that point is projected by the previous camera. A reflection that
    moved with its object keeps no place of its own: the lobes decide whether what is found fits. Where the hit is
    unknown (0) there is no place: NaN.

    Source: the mirror equation of optics; that reflections have a motion of their own, Zimmer et al. 2015, "Path-space
    motion estimation and decomposition for robust animation filtering".
    """
    size = int(curvature.shape[0]), int(curvature.shape[1])
    images = {"distance": hit_distance, "curvature": curvature, "position": position}
    numbers = {"eye": camera.position, "far": FAR, **get_projection_numbers(previous, size)}
    (places,) = run_pointwise(_define_image_places, images, numbers)
    return np.asarray(places)


def _define_image_places(grid: Grid) -> list[Vector]:
    one = hl.f64(1.0)
    (far,) = grid.get("far")
    position = [hl.f64(component) for component in grid.read("position")]
    view = subtract(position, grid.get("eye"))
    distance = hl.sqrt(dot(view, view))
    raw = grid.read_one("distance")
    t = hl.select(is_finite(raw), hl.f64(raw), far * distance)
    opening = one + hl.f64(2.0) * hl.f64(grid.read_one("curvature")) * t
    # A concave mirror's image turns over at the focus; beyond it nothing is tracked.
    known = (raw > hl.f32(0.0)) & (opening > hl.f64(0.0))
    behind = t / hl.max(opening, hl.f64(1e-6)) / distance
    image = [place + component * behind for place, component in zip(position, view, strict=True)]
    places, seen = _project(grid, subtract(image, grid.get("before")))
    return [[select_or_nan(known & seen, place) for place in places]]
