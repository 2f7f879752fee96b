"""Sparse voxels with the radiance of a scene's surfaces for six directions, in levels of ever larger voxels.

For rays along each of the six axis directions a voxel stores an optical depth ``tau``, and ``tau`` times the radiance
against the ray. Both add up along a ray, so the result does not depend on the places of its steps.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.render.bridge import dr, mi
from lobewise.render.voxels.hits import RAYS, Bounds, Hits

DIRECTIONS = 6
"""Directions of rays, +x -x +y -y +z -z. A voxel stores a radiance for each."""

MAX_OPTICAL_DEPTH = 5.0
"""Optical depth of an opaque voxel. Light from behind it has a weight of 0.007."""

MIN_PLANAR_LENGTH = 0.9
"""Smallest length of the mean of a voxel's unit normals at which its surface counts as a plane."""

Floats = NDArray[np.float64]


@dataclass
class Grid:
    """All levels of the voxels (Dr.Jit arrays; a PyTree).

    ``row`` holds the row of every voxel of every level (level by level, x fastest), 0 for empty voxels. ``starts``
    holds where levels begin in ``row``. ``values`` holds four numbers (red, green, blue, tau) per row and direction.
    ``planes`` holds, per row and axis, the mean normal ``n`` of the surface and ``n.p``, or zeros if it is curved.
    """

    row: Any
    values: Any
    planes: Any
    starts: Any
    lower: Any
    voxel: Any
    resolution: Any
    levels: Any


@dataclass(frozen=True)
class Faces:
    """The surfaces in a voxel seen along one direction, for all pairs of voxel and direction with hits.

    ``slot`` is the row times six plus the direction. Positions, normals and albedos are means over hits. ``planes`` is
    that of `Grid`.
    """

    slot: Any
    position: Any
    normal: Any
    albedo: Any
    planes: Any


@dataclass(frozen=True)
class Level:
    """The voxels of one level that are not empty: their numbers in the level, and the row of the first one."""

    cells: NDArray[np.int64]
    first_row: int


@dataclass(frozen=True)
class Layout:
    """The voxels that are not empty, and the slots of the hits (for both sides) in level 0."""

    bounds: Bounds
    levels: tuple[Level, ...]
    row: Any
    starts: Any
    slots: tuple[NDArray[np.int64], NDArray[np.int64]]
    rows: int


def _find_parents(cells: NDArray[np.int64], resolution: int) -> NDArray[np.int64]:
    """Return the numbers of the voxels of the next level that contain the given voxels."""
    x, y, z = cells % resolution, cells // resolution % resolution, cells // resolution**2
    half = resolution // 2
    return x // 2 + half * (y // 2 + half * (z // 2))


def plan_layout(bounds: Bounds, hits: Hits) -> Layout:
    """Return the voxels with hits, level by level up to 2x2x2."""
    size = bounds.resolution
    cells = np.unique(hits.cell)
    levels: list[Level] = []
    starts: list[int] = []
    tables: list[NDArray[np.uint32]] = []
    rows = 1
    while size >= 2:
        table = np.zeros(size**3, dtype=np.uint32)
        table[cells] = np.arange(rows, rows + len(cells))
        levels.append(Level(cells, rows))
        starts.append(sum(len(other) for other in tables))
        tables.append(table)
        rows += len(cells)
        cells, size = np.unique(_find_parents(cells, size)), size // 2
    row_of_hit = tables[0][hits.cell].astype(np.int64)
    slots = tuple(row_of_hit * DIRECTIONS + side.direction for side in hits.sides)
    return Layout(
        bounds=bounds,
        levels=tuple(levels),
        row=mi.UInt32(np.concatenate(tables)),
        starts=mi.UInt32(np.array(starts, dtype=np.uint32)),
        slots=(slots[0], slots[1]),
        rows=rows,
    )


def _sum(layout: Layout, weights: Sequence[Any]) -> Floats:
    """Return the sums per slot of a weight of each side's hits, in a fixed order."""
    length = layout.rows * DIRECTIONS
    total = np.zeros(length)
    for slot, weight in zip(layout.slots, weights, strict=True):
        total += np.bincount(slot, weights=weight, minlength=length)
    return total


def _average(layout: Layout, values: Sequence[Any], count: Floats) -> Floats:
    """Return the means per slot, (slots, 3), of a vector of each side's hits."""
    parts = [np.array(value, dtype=np.float64) for value in values]
    sums = [_sum(layout, [part[i] for part in parts]) for i in range(3)]
    return np.stack(sums, axis=-1) / np.maximum(count, 1.0)[:, None]


def find_depth(layout: Layout, hits: Hits) -> tuple[Floats, Floats]:
    """Return the optical depth and the number of hits of every slot.

    If a share ``c`` of the rays through a voxel hits an opaque surface in it, the opacity is ``1 - (1 - c)^2``.

    Departs from Crassin 2011: the square keeps walls closed that pass through two voxels and cover each in part. Each
    axis has its own opacity.
    """
    ones = np.ones(len(hits))
    count = _sum(layout, (ones, ones))
    opacity = _sum(layout, (hits.opacity, hits.opacity)) / np.maximum(count, 1.0)
    covered = np.minimum(count / RAYS**2, 1.0)
    alpha = opacity * (1.0 - (1.0 - covered) ** 2)
    return -np.log(np.maximum(1.0 - alpha, np.exp(-MAX_OPTICAL_DEPTH))), count


def make_faces(layout: Layout, hits: Hits, count: Floats) -> Faces:
    """Return the faces of every slot that has hits."""
    (filled,) = np.nonzero(count)
    position = np.array(hits.position, dtype=np.float64)
    normal = np.array(hits.normal, dtype=np.float64)
    normals = _average(layout, (normal, -normal), count)
    positions = _average(layout, (position, position), count)
    lengths = np.linalg.norm(normals, axis=-1, keepdims=True)
    return Faces(
        slot=mi.UInt32(filled.astype(np.uint32)),
        position=_make(mi.Vector3f, positions[filled]),
        normal=_make(mi.Vector3f, (normals / np.maximum(lengths, 1e-6))[filled]),
        albedo=_make(mi.Color3f, _average(layout, [side.albedo for side in hits.sides], count)[filled]),
        planes=_find_planes(layout, normals[::2], positions[::2], count[::2]),
    )


def _find_planes(layout: Layout, normals: Floats, positions: Floats, count: Floats) -> Any:
    """Return `Grid.planes` from the means of level 0 per row and axis."""
    sums = np.concatenate([normals, positions, np.ones((len(count), 1))], axis=-1) * count[:, None]
    sums = sums.reshape(layout.rows, 3, 7)
    size = layout.bounds.resolution
    for below, above in zip(layout.levels, layout.levels[1:], strict=False):
        rows = above.first_row + np.searchsorted(above.cells, _find_parents(below.cells, size))
        np.add.at(sums, rows, sums[below.first_row : below.first_row + len(below.cells)])
        size //= 2
    mean = sums[..., :6] / np.maximum(sums[..., 6:], 1.0)
    length = np.linalg.norm(mean[..., :3], axis=-1, keepdims=True)
    normal = np.where(length >= MIN_PLANAR_LENGTH, mean[..., :3] / np.maximum(length, 1e-6), 0.0)
    planes = np.concatenate([normal, np.sum(normal * mean[..., 3:], axis=-1, keepdims=True)], axis=-1)
    return mi.Float(planes.astype(np.float32).ravel())


def _make(kind: Any, values: Floats) -> Any:
    return kind(np.ascontiguousarray(values.T, dtype=np.float32))


def average_radiance(layout: Layout, faces: Faces, radiance: Sequence[Any], count: Floats) -> Any:
    """Return the mean radiance (Color3f) of every face, from the radiance of each side of the hits."""
    return _make(mi.Color3f, _average(layout, radiance, count)[np.array(faces.slot)])


def fill_grid(layout: Layout, faces: Faces, depth: Floats, radiance: Any) -> Grid:
    """Return the grid, with all its levels, from the radiance (Color3f) of the faces."""
    bounds = layout.bounds
    values = dr.zeros(mi.Float, layout.rows * DIRECTIONS * 4)
    tau = dr.gather(mi.Float, mi.Float(depth.astype(np.float32)), faces.slot)
    dr.scatter(values, mi.Vector4f(radiance.x * tau, radiance.y * tau, radiance.z * tau, tau), faces.slot)
    for below, level in enumerate(layout.levels[1:]):
        _fill_level(layout, values, below, level)
    dr.eval(values)
    return Grid(
        row=layout.row,
        values=values,
        planes=faces.planes,
        starts=layout.starts,
        lower=mi.Point3f(*(dr.opaque(mi.Float, place) for place in bounds.lower)),
        voxel=dr.opaque(mi.Float, bounds.voxel),
        resolution=dr.opaque(mi.UInt32, bounds.resolution),
        levels=dr.opaque(mi.UInt32, len(layout.levels)),
    )


def _fill_level(layout: Layout, values: Any, below: int, level: Level) -> None:
    """Fill a level from the level below it: two voxels one behind the other, four such pairs side by side.

    Source: Crassin et al. 2011, "Interactive Indirect Illumination Using Voxel Cone Tracing", section 6 (anisotropic
    pre-integration): composite along the direction, average across it.
    """
    size = layout.bounds.resolution >> below
    half = size // 2
    lane = dr.arange(mi.UInt32, len(level.cells) * DIRECTIONS)
    direction = lane % DIRECTIONS
    number = dr.gather(mi.UInt32, mi.UInt32(level.cells.astype(np.uint32)), lane // DIRECTIONS)
    corner = mi.Vector3u(number % half, number // half % half, number // (half * half)) * 2
    axis, backwards = direction // 2, direction % 2
    strides = mi.Vector3u(1, size, size * size)
    along, across, aside = (_pick(strides, (axis + i) % 3) for i in range(3))
    first = dr.dot(corner, strides) + int(np.array(layout.starts)[below])

    total = mi.Vector4f(0)
    for column in range(4):
        base = first + across * (column % 2) + aside * (column // 2)
        near = _read(layout, values, base + along * backwards, direction)
        far = _read(layout, values, base + along * (1 - backwards), direction)
        total += near + far * (1.0 - near.w)
    total *= 0.25
    tau = -dr.log(dr.maximum(1.0 - total.w, float(np.exp(-MAX_OPTICAL_DEPTH))))
    scale = dr.select(total.w > 0, tau / total.w, 0.0)
    slot = level.first_row * DIRECTIONS + lane
    dr.scatter(values, mi.Vector4f(total.x * scale, total.y * scale, total.z * scale, tau), slot)
    dr.eval(values)


def _pick(vector: Any, index: Any) -> Any:
    return dr.select(index == 0, vector.x, dr.select(index == 1, vector.y, vector.z))


def _read(layout: Layout, values: Any, place: Any, direction: Any) -> Any:
    """Return radiance times alpha, and alpha, of voxels, given by indices into ``layout.row``."""
    row = dr.gather(mi.UInt32, layout.row, place)
    value = dr.gather(mi.Vector4f, values, row * DIRECTIONS + direction)
    alpha = 1.0 - dr.exp(-value.w)
    scale = dr.select(value.w > 0, alpha / value.w, 0.0)
    return mi.Vector4f(value.x * scale, value.y * scale, value.z * scale, alpha)
