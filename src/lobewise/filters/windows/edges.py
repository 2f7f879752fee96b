"""Edges of surfaces on the screen, and the surface that is in front at each of them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.compiler import hl
from lobewise.backend.pointwise import Grid, Vector, is_finite
from lobewise.guides.surfaces import is_surface_depth
from lobewise.lobes.vectors import dot, subtract
from lobewise.records.frame import FloatArray

MAX_OFFSET_FOOTPRINTS = 4.0
"""Distance from a pixel's tangent plane, pixel footprints, above which a neighbour belongs to another surface."""
MIN_EDGE_COSINE = 0.8
"""Cosine between the normals of neighbours below which there is a crease between them."""
MIN_OBJECT_SHARE = 0.95
"""Share of a pixel's area, below which several objects share the pixel."""
MIN_NEARER = 0.01
"""Part of the depth by which a neighbour must be nearer to be in front."""


def mark_edges(
    position: FloatArray, depth: FloatArray, normal: FloatArray, object_share: FloatArray | None, pixel_angle: float
) -> tuple[NDArray[np.bool_], FloatArray]:
    """Return the pixels at edges of surfaces, and the way to the neighbour that is in front.

    A pixel at an edge shows two surfaces. How much of each moves with the surface in front.

    Parameters
    ----------
    position, normal : array, shape (height, width, 3)
        Surface points and normals.
    depth : array, shape (height, width)
        Distances along the rays; 0 or not finite for the background.
    object_share : array, shape (height, width), optional
        See `lobewise.GBuffer`.
    pixel_angle : float
        Angle of a pixel, radians.

    Returns
    -------
    bool array, shape (height, width)
        True where one of the 3x3 pixels shows another surface, or where several objects share the pixel.
    array, shape (height, width, 2)
        Columns and rows, -1 to 1 each, to the nearest surface of the 3x3 pixels.
    """
    images = {"position": position, "depth": depth, "normal": normal, "share": object_share}
    edge, way = engine.pixels(_define_edges, images, {"angle": np.float32(pixel_angle)})
    return edge, way


def _define_edges(grid: Grid) -> list[Vector]:
    far, zero = hl.f32(1e30), hl.f32(0.0)

    def compute_depth(raw: hl.Expr) -> hl.Expr:
        return hl.select(is_surface_depth(raw), raw, far)

    own, normal = grid.read("position"), grid.read("normal")
    depth = compute_depth(grid.read_one("depth"))
    edge = hl.Expr(False)
    if grid.has("share"):
        edge = edge | (grid.read_one("share") < hl.f32(MIN_OBJECT_SHARE))
    best, way = depth, [zero, zero]
    at = grid.inside
    read = grid.keep(
        [compute_depth(grid.read("depth", *at)[0]), *grid.read("normal", *at), *grid.read("position", *at)]
    )
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if dx == dy == 0:
                continue
            there, *vectors = read(grid.x + dx, grid.y + dy)
            other, place = vectors[:3], vectors[3:]
            step = subtract(place, own)
            offset = hl.min(hl.abs(dot(step, normal)), hl.abs(dot(step, other)))
            least = hl.min(depth, there)
            is_apart = is_finite(offset) & (offset > hl.f32(MAX_OFFSET_FOOTPRINTS) * grid.get("angle")[0] * least)
            is_creased = dot(normal, other) < hl.f32(MIN_EDGE_COSINE)
            both = (depth < far) & (there < far)
            edge = edge | (both & (is_apart | is_creased)) | ((depth < far) != (there < far))
            nearer = there < hl.f32(1.0 - MIN_NEARER) * best
            best = hl.select(nearer, there, best)
            way = [hl.select(nearer, hl.f32(float(value)), old) for value, old in zip((dx, dy), way, strict=True)]
    return [[hl.u8(edge)], way]
