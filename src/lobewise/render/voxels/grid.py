"""Sparse voxels with the radiance of a scene's surfaces for six directions, in levels of ever larger voxels.

For rays along each of the six axis directions a voxel stores an optical depth ``tau``, and ``tau`` times the radiance
against the ray. Both add up along a ray, so the result does not depend on the places of its steps.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.render.bridge import dr, mi, repeat, take_numbers, take_vectors
from lobewise.render.voxels.axis_hits import RAYS, Bounds, Hits

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
class Pairs:
    """The surfaces in a voxel seen along one axis, from both sides: all pairs of voxel and axis with hits.

    ``key`` is that of `Hits`, sorted. ``first`` is the number of the first hit, ``count`` the number of hits. Positions
    (n, 3), normals (n, 3), opacity (n,) and the two albedos (n, 3) are means over hits; normals are not of unit length.
    """

    key: NDArray[np.int64]
    first: NDArray[np.int64]
    count: NDArray[np.int64]
    position: Floats
    normal: Floats
    opacity: Floats
    albedos: tuple[Floats, Floats]


@dataclass(frozen=True)
class Faces:
    """The surfaces in a voxel seen along one direction: the first side of each of `Pairs`, then its second side.

    ``slot`` is the row times six plus the direction, ``number`` the number of the voxel times six plus the direction.
    ``position``, ``normal`` and ``albedo`` are means over hits.
    ``depth`` is the optical depth, ``planes`` that of `Grid`. ``first`` and ``end`` are the numbers of the first hit
    and of the one after the last, and ``side`` is 0 or 1.
    """

    slot: Any
    number: Any
    position: Any
    normal: Any
    albedo: Any
    depth: Any
    planes: Any
    first: Any
    end: Any
    side: Any

    def __len__(self) -> int:
        return int(dr.width(self.slot))


@dataclass(frozen=True)
class Level:
    """The voxels of one level that are not empty: their numbers in the level, and the row of the first one.

    ``number`` holds the numbers as a Dr.Jit array, and ``start`` is where the level begins in `Grid.row`.
    """

    cells: NDArray[np.int64]
    number: Any
    first_row: int
    start: int


@dataclass(frozen=True)
class Layout:
    """The voxels that are not empty, and the rows of pairs in level 0."""

    bounds: Bounds
    levels: tuple[Level, ...]
    row: Any
    starts: Any
    rows_of_pairs: NDArray[np.int64]
    rows: int


def gather_pairs(hits: Hits) -> Pairs:
    """Return the pairs of voxel and axis with hits, and the means over the hits of each."""
    first = np.flatnonzero(np.diff(hits.key, prepend=-1))
    count = np.diff(first, append=len(hits))

    def average(values: Any) -> Floats:
        sums = np.add.reduceat(values, first, axis=-1, dtype=np.float64) if len(first) else values.astype(np.float64)
        return np.asarray((sums / count).T)

    position, normal, opacity, *albedos = (
        average(values) for values in (hits.position, hits.normal, hits.opacity, hits.first, hits.second)
    )
    return Pairs(hits.key[first], first, count, position, normal, opacity, (albedos[0], albedos[1]))


def _number_parents(cells: NDArray[np.int64], resolution: int) -> NDArray[np.int64]:
    """Return the numbers of the voxels of the next level that contain the given voxels."""
    x, y, z = cells % resolution, cells // resolution % resolution, cells // resolution**2
    half = resolution // 2
    return x // 2 + half * (y // 2 + half * (z // 2))


def plan_layout(bounds: Bounds, pairs: Pairs) -> Layout:
    """Return the voxels with hits, level by level up to 2x2x2."""
    size = bounds.resolution
    own = pairs.key // 3
    cells = own[np.diff(own, prepend=-1) > 0]
    levels: list[Level] = []
    sizes = [size >> level for level in range(size.bit_length() - 1)]
    table = np.zeros(sum(side**3 for side in sizes), dtype=np.uint32)
    rows, start = 1, 0
    for side in sizes:
        table[start + cells] = np.arange(rows, rows + len(cells))
        levels.append(Level(cells, take_numbers(mi.UInt32, cells), rows, start))
        rows, start = rows + len(cells), start + side**3
        filled = np.zeros((side // 2) ** 3, np.bool_)
        filled[_number_parents(cells, side)] = True
        cells = np.flatnonzero(filled)
    return Layout(
        bounds=bounds,
        levels=tuple(levels),
        row=take_numbers(mi.UInt32, table),
        starts=take_numbers(mi.UInt32, np.array([level.start for level in levels])),
        rows_of_pairs=table[own].astype(np.int64),
        rows=rows,
    )


def compute_depth(pairs: Pairs) -> Floats:
    """Return the optical depth of every pair.

    If a share ``c`` of the rays through a voxel hits an opaque surface in it, the opacity is ``1 - (1 - c)^2``.

    Departs from Crassin 2011: the square keeps walls closed that pass through two voxels and cover each in part. Each
    axis has its own opacity.
    """
    covered = np.minimum(pairs.count / RAYS**2, 1.0)
    alpha = pairs.opacity * (1.0 - (1.0 - covered) ** 2)
    return np.asarray(-np.log(np.maximum(1.0 - alpha, np.exp(-MAX_OPTICAL_DEPTH))))


def make_faces(layout: Layout, pairs: Pairs) -> Faces:
    """Return the two faces of every pair."""
    lengths = np.linalg.norm(pairs.normal, axis=-1, keepdims=True)
    unit = pairs.normal / np.maximum(lengths, 1e-6)
    sides = np.tile(np.arange(2, dtype=np.uint32), len(pairs.key))
    slot = layout.rows_of_pairs * DIRECTIONS + 2 * (pairs.key % 3)
    return Faces(
        slot=take_numbers(mi.UInt32, slot.repeat(2) + sides),
        number=take_numbers(mi.UInt32, (2 * pairs.key).repeat(2) + sides),
        position=take_vectors(mi.Vector3f, pairs.position.repeat(2, axis=0).T),
        normal=take_vectors(mi.Vector3f, np.stack([unit, -unit], axis=1).reshape(-1, 3).T),
        albedo=take_vectors(mi.Color3f, np.stack(pairs.albedos, axis=1).reshape(-1, 3).T),
        depth=take_numbers(mi.Float, compute_depth(pairs).repeat(2)),
        planes=_compute_planes(layout, pairs),
        first=take_numbers(mi.UInt32, pairs.first.repeat(2)),
        end=take_numbers(mi.UInt32, (pairs.first + pairs.count).repeat(2)),
        side=take_numbers(mi.UInt32, sides),
    )


def _compute_planes(layout: Layout, pairs: Pairs) -> Any:
    """Return `Grid.planes` from the means of level 0."""
    values = np.concatenate([pairs.normal.T, pairs.position.T, np.ones((1, len(pairs.key)))]) * pairs.count
    axis = pairs.key % 3
    sums = np.zeros((3, 7, layout.rows))
    for k in range(3):
        sums[k][:, layout.rows_of_pairs[axis == k]] = values[:, axis == k]
    size = layout.bounds.resolution
    for below, above in zip(layout.levels, layout.levels[1:], strict=False):
        places = np.searchsorted(above.cells, _number_parents(below.cells, size))
        rows = slice(above.first_row, above.first_row + len(above.cells))
        for total in sums.reshape(21, -1):
            part = total[below.first_row : below.first_row + len(below.cells)]
            total[rows] = np.bincount(places, weights=part, minlength=len(above.cells))
        size //= 2
    normal, position = sums[:, :3], sums[:, 3:6] / np.maximum(sums[:, 6:], 1.0)
    length = np.sqrt((normal**2).sum(axis=1, keepdims=True))
    planar = length >= MIN_PLANAR_LENGTH * np.maximum(sums[:, 6:], 1.0)
    normal = np.where(planar, normal / np.maximum(length, 1e-6), 0.0)
    planes = np.concatenate([normal, (normal * position).sum(axis=1, keepdims=True)], axis=1)
    return take_numbers(mi.Float, planes.transpose(2, 0, 1).ravel())


def average_radiance(faces: Faces, radiance: tuple[Any, Any]) -> Any:
    """Return the mean radiance (Color3f) of every face, from the radiance of each side of the hits."""
    is_first = faces.side == 0

    def take(hit: Any, total: Any) -> tuple[Any]:
        first, second = (
            dr.gather(mi.Color3f, side, hit, mine) for side, mine in zip(radiance, (is_first, ~is_first), strict=True)
        )
        return (total + first + second,)

    (total,) = repeat(take, mi.UInt32(faces.first), faces.end, dr.zeros(mi.Color3f, len(faces)), label="hits of faces")
    return total / mi.Float(faces.end - faces.first)


def fill_grid(layout: Layout, faces: Faces, radiance: Any) -> Grid:
    """Return the grid, with all its levels, from the radiance (Color3f) of the faces."""
    bounds = layout.bounds
    values = dr.zeros(mi.Float, layout.rows * DIRECTIONS * 4)
    tau = faces.depth
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
    number = dr.gather(mi.UInt32, level.number, lane // DIRECTIONS)
    corner = mi.Vector3u(number % half, number // half % half, number // (half * half)) * 2
    axis, backwards = direction // 2, direction % 2
    strides = mi.Vector3u(1, size, size * size)
    along, across, aside = (_pick(strides, (axis + i) % 3) for i in range(3))
    first = dr.dot(corner, strides) + layout.levels[below].start

    total = mi.Vector4f(0)
    for column in range(4):
        base = first + across * (column % 2) + aside * (column // 2)
        near = _read(layout, values, base + along * backwards, direction)
        far = _read(layout, values, base + along * (1 - backwards), direction)
        total += near + far * (1.0 - near.w)
    total *= 0.25
    tau = -dr.log(dr.maximum(1.0 - total.w, float(np.exp(-MAX_OPTICAL_DEPTH))))
    scale = dr.select(total.w > 0, tau / total.w, 0.0)
    # Opaque, so that no kernel is compiled for every layout.
    slot = dr.opaque(mi.UInt32, level.first_row * DIRECTIONS) + lane
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
