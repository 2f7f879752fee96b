"""Meshes for `kinds.py`: many boxes, tubes, blades and sheets in one, so that clutter costs one shape and one material.

A mesh is what `lobewise.render.loading.build_scene` takes; texture coordinates lie in [0, 1].
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from benchmarks.training.materials import Array
from lobewise.scenes.parts import Item, Vector


class Box(NamedTuple):
    """A box: middle, half sizes, turn about the vertical and tilt about its own x axis before, in degrees."""

    center: Vector
    half: Vector
    turn: float = 0.0
    tilt: float = 0.0


class Surface(NamedTuple):
    """Positions and normals of a grid of points, (rows, columns, 3), with texture coordinates, (rows, columns, 2)."""

    position: Array
    normal: Array
    uv: Array


_SIDES = np.array(
    # Normal, then the two axes of each side: their cross product is the normal.
    [
        [[1, 0, 0], [0, 0, -1], [0, 1, 0]],
        [[-1, 0, 0], [0, 0, 1], [0, 1, 0]],
        [[0, 1, 0], [1, 0, 0], [0, 0, -1]],
        [[0, -1, 0], [1, 0, 0], [0, 0, 1]],
        [[0, 0, 1], [1, 0, 0], [0, 1, 0]],
        [[0, 0, -1], [-1, 0, 0], [0, 1, 0]],
    ],
    dtype=np.float64,
)
_MARGIN = 0.02
"""Of a cell of the texture, at each of its sides: no neighbour's colour is interpolated in."""


def make_rotation(turn: float, tilt: float = 0.0) -> Array:
    """Return the matrix that tilts about x and then turns about y, degrees."""
    a, b = np.deg2rad([turn, tilt])
    about_y = np.array([[np.cos(a), 0.0, np.sin(a)], [0.0, 1.0, 0.0], [-np.sin(a), 0.0, np.cos(a)]])
    about_x = np.array([[1.0, 0.0, 0.0], [0.0, np.cos(b), -np.sin(b)], [0.0, np.sin(b), np.cos(b)]])
    return np.asarray(about_y @ about_x)


def make_mesh(surfaces: Sequence[Surface], bsdf: Item) -> Item:
    """Return grids of points as one mesh of triangles."""
    faces, first = [], 0
    for surface in surfaces:
        rows, columns = surface.position.shape[:2]
        corner = (first + np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).reshape(-1)
        right, above = corner + 1, corner + columns
        faces += [np.stack([corner, right, above], axis=-1), np.stack([right, above + 1, above], axis=-1)]
        first += rows * columns

    def join(name: str, size: int) -> Array:
        return np.concatenate([getattr(each, name).reshape(-1, size) for each in surfaces]).astype(np.float32)

    return {
        "type": "mesh",
        "vertices": join("position", 3),
        "normals": join("normal", 3),
        "uv": join("uv", 2),
        "faces": np.concatenate(faces).astype(np.uint32),
        "bsdf": bsdf,
    }


def make_boxes(boxes: Sequence[Box], cells: int = 1) -> list[Surface]:
    """Return the sides of boxes; box k shows strip k modulo ``cells`` of the texture on each of its sides."""
    corners = np.array([[[-1.0, -1.0], [1.0, -1.0]], [[-1.0, 1.0], [1.0, 1.0]]])
    surfaces = []
    for k, box in enumerate(boxes):
        rotation, half = make_rotation(box.turn, box.tilt), np.array(box.half)
        for normal, across, up in _SIDES:
            local = normal + corners[..., :1] * across + corners[..., 1:] * up
            position = (local * half) @ rotation.T + np.array(box.center)
            uv = np.clip(0.5 + 0.5 * corners, _MARGIN, 1.0 - _MARGIN)
            uv = np.stack([(k % cells + uv[..., 0]) / cells, uv[..., 1]], axis=-1)
            surfaces.append(Surface(position, np.broadcast_to(rotation @ normal, position.shape), uv))
    return surfaces


def move(surfaces: Sequence[Surface], at: Vector, turn: float = 0.0) -> list[Surface]:
    """Return surfaces turned about the vertical through the origin, degrees, and then moved."""
    rotation = make_rotation(turn)
    return [Surface(each.position @ rotation.T + np.array(at), each.normal @ rotation.T, each.uv) for each in surfaces]


def make_tube(points: Array, radius: float | Array, sides: int = 10) -> Surface:
    """Return a round tube along points, (count, 3), of one radius or one for each point; its ends are open."""
    points = np.asarray(points, dtype=np.float64)
    along = np.gradient(points, axis=0)
    along /= np.maximum(np.linalg.norm(along, axis=-1, keepdims=True), 1e-12)
    # Carry one direction across the curve from point to point, so that the tube is not twisted.
    across = np.empty_like(points)
    start = np.eye(3)[int(np.argmin(np.abs(along[0])))]
    for k, direction in enumerate(along):
        start = start - (start @ direction) * direction
        start = start / np.linalg.norm(start)
        across[k] = start
    other = np.cross(along, across)
    angle = np.linspace(0.0, 2.0 * np.pi, sides + 1)[None, :, None]
    normal = np.cos(angle) * across[:, None] + np.sin(angle) * other[:, None]
    wide = np.broadcast_to(np.asarray(radius, dtype=np.float64), len(points))[:, None, None]
    length = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=-1))])
    v = np.broadcast_to(length[:, None] / length[-1], (len(points), sides + 1))
    u = np.broadcast_to(angle[..., 0] / (2.0 * np.pi), v.shape)
    return Surface(points[:, None] + wide * normal, normal, np.stack([u, v], axis=-1))


def compute_normals(position: Array) -> Array:
    """Return the unit normals of a grid of points, (rows, columns, 3), by differences."""
    normal = np.cross(np.gradient(position, axis=1), np.gradient(position, axis=0))
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return np.asarray(np.where(length > 1e-12, normal / np.maximum(length, 1e-12), [0.0, 1.0, 0.0]))


def make_grid_surface(position: Array) -> Surface:
    """Return a grid of points, (rows, columns, 3), with normals by differences and the grid as texture coordinates."""
    rows, columns = position.shape[:2]
    u, v = np.meshgrid(np.linspace(0.0, 1.0, columns), np.linspace(0.0, 1.0, rows))
    return Surface(position, compute_normals(position), np.stack([u, v], axis=-1))


def make_blade(root: Vector, toward: Vector, bend: float, width: float, steps: int = 8) -> Surface:
    """Return a narrow pointed leaf from its root to about ``root + toward``, which droops by ``bend`` at its tip."""
    t = np.linspace(0.0, 1.0, steps)[:, None]
    axis = np.array(toward)
    middle = np.array(root) + t * axis - bend * t**2 * np.array([0.0, 1.0, 0.0])
    side = np.cross(axis, [0.0, 1.0, 0.0])
    side = side / np.linalg.norm(side) if np.linalg.norm(side) > 1e-6 else np.array([1.0, 0.0, 0.0])
    half = width * (np.sin(np.pi * (0.15 + 0.85 * t)) ** 0.7 + 0.02) * side
    return make_grid_surface(np.stack([middle - half, middle, middle + half], axis=1))


def make_blob(center: Vector, half: Vector, bumps: Array, roundness: float, steps: int = 40) -> Surface:
    """Return a closed smooth body: a superellipsoid with waves on it.

    ``bumps`` is (waves, 4): height relative to the size, waves around, waves from pole to pole, shift in radians.
    ``roundness`` is 1 for an ellipsoid, smaller for a rounded box, larger for a body with edges; 0.3 to 2.
    """
    around, up = np.meshgrid(np.linspace(0.0, 2.0 * np.pi, 2 * steps + 1), np.linspace(-0.5, 0.5, steps + 1) * np.pi)

    def bend(value: Array) -> Array:
        return np.sign(value) * np.abs(value) ** roundness

    size = np.ones_like(around)
    for height, number, level, shift in bumps:
        size += height * np.cos(np.round(number) * around + shift) * np.cos(level * up) * np.cos(up)
    shape = np.stack(
        [bend(np.cos(up)) * bend(np.cos(around)), bend(np.sin(up)), bend(np.cos(up)) * -bend(np.sin(around))]
    )
    position = np.moveaxis(size * shape, 0, -1) * np.array(half) + np.array(center)
    surface = make_grid_surface(position)
    # At the seam both columns have the mean of their normals; at the poles the body is level.
    normal = surface.normal
    normal[:, [0, -1]] = 0.5 * (normal[:, :1] + normal[:, -1:])
    normal[0], normal[-1] = [0.0, -1.0, 0.0], [0.0, 1.0, 0.0]
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return surface._replace(normal=normal / np.maximum(length, 1e-12))


def hang_line(first: Vector, last: Vector, sag: float, steps: int = 24) -> Array:
    """Return the points of a line that hangs by ``sag`` between two points."""
    t = np.linspace(0.0, 1.0, steps)[:, None]
    down = np.array([0.0, 4.0 * sag, 0.0])
    return np.asarray(np.array(first) + t * np.subtract(last, first) - t * (1.0 - t) * down)
