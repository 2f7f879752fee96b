"""Hits of rays along the three axes with a scene's surfaces, from which voxels of shapes of every kind are made."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.render.bridge import Recorded, dr, give_vectors, mi, take_vectors
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_surface
from lobewise.render.moving.shapes import Box, measure_box
from lobewise.render.tracing.rays import make_rng
from lobewise.render.voxels.refraction import can_refract, refract

RAYS = 2
"""Rays through a voxel's face along each of its two edges."""

MAX_HITS = 64
"""Largest number of surfaces that one ray hits."""

MARGIN = 0.3
"""Voxels between the scene and the border of the grid. A fraction, so that walls of a box lie inside voxels."""

# The mean cosine of uniform light on a surface. The directional albedo at it approximates the hemispherical albedo.
_MEAN_COSINE = 2.0 / 3.0

Report = Callable[[], None]
Floats = NDArray[np.float32]


@dataclass(frozen=True)
class Bounds:
    """A cube of voxels: its lower corner, the edge of a voxel in world units, and the voxels along an edge."""

    lower: tuple[float, float, float]
    voxel: float
    resolution: int


@dataclass(frozen=True)
class Hits:
    """All hits of the rays, sorted by ``key``.

    Parameters
    ----------
    key : int array, shape (count,)
        Three times the number of the voxel, x fastest, plus the axis of the ray.
    position, normal : array, shape (3, count)
        World space; the unit normal of the first side.
    opacity : array, shape (count,)
        Share of the light along the ray that the surface does not transmit, 0 to 1.
    first, second : array, shape (3, count)
        Albedos of the two sides. The first side faces the ray's origin, so rays along ``+axis`` see it; rays along
        ``-axis`` see the second side.
    """

    key: NDArray[np.int64]
    position: Floats
    normal: Floats
    opacity: Floats
    first: Floats
    second: Floats

    def __len__(self) -> int:
        return len(self.key)

    @property
    def cell(self) -> NDArray[np.int64]:
        """Numbers of the voxels, x fastest."""
        return self.key // 3

    @property
    def axis(self) -> NDArray[np.int64]:
        """Axes of the rays, 0 to 2."""
        return self.key % 3


def _join_hits(parts: Sequence[Hits], chosen: NDArray[np.intp] | None = None) -> Hits:
    """Return the hits of some parts, sorted. Hits with equal keys keep their order.

    ``chosen`` are the numbers of hits, counted through all parts, that are wanted; by default all.
    """
    key = np.concatenate([part.key for part in parts])
    numbers = np.arange(len(key)) if chosen is None else chosen
    order = numbers[np.argsort(key[numbers], kind="stable")]
    joined = {item.name: np.concatenate([getattr(part, item.name) for part in parts], -1) for item in fields(Hits)}
    return Hits(**{name: np.take(values, order, axis=-1) for name, values in joined.items()})


def measure_bounds(scene: Any, resolution: int) -> Bounds:
    """Return the cube around a scene's surfaces, slightly enlarged; InputError if no surface has a finite size."""
    # The scene's own box includes point lights and cameras, which need no voxels, and an infinite sky.
    boxes = np.array([measure_box(shape) for shape in scene.shapes()]).reshape(-1, 2, 3)
    boxes = boxes[np.isfinite(boxes).all(axis=(1, 2))]
    extent = float((boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)).max()) if len(boxes) else 0.0
    if not extent > 0.0:
        got = f"{len(boxes)} of them, {extent:g} wide"
        raise InputError("scene", expected="surfaces of finite size", got=got, action="add a shape to the scene")
    voxel = extent / (resolution - 2.0 * MARGIN)
    corner = 0.5 * (boxes[:, 0].min(axis=0) + boxes[:, 1].max(axis=0)) - 0.5 * resolution * voxel
    return Bounds((float(corner[0]), float(corner[1]), float(corner[2])), voxel, resolution)


def contains(bounds: Bounds, box: Box) -> bool:
    """Return whether a box lies within the cube of voxels."""
    lower = np.array(bounds.lower)
    return bool((box[0] >= lower).all() and (box[1] <= lower + bounds.resolution * bounds.voxel).all())


def _list_rays(bounds: Bounds, axis: int, columns: NDArray[np.bool_] | None = None) -> NDArray[np.uint32]:
    """Return the numbers of the rays along an axis, `RAYS` squared of them through every column of voxels.

    ``columns`` (resolution, resolution) chooses columns, by their places along the next axis and the one after it.
    """
    if columns is None:
        return np.arange((bounds.resolution * RAYS) ** 2, dtype=np.uint32)
    return np.flatnonzero(columns.T.repeat(RAYS, 0).repeat(RAYS, 1)).astype(np.uint32)


def _make_rays(bounds: Bounds, numbers: Sequence[NDArray[np.uint32]]) -> Any:
    """Return rays along the three axes by their numbers."""
    across = bounds.resolution * RAYS
    step = bounds.voxel / RAYS
    origins, directions = [], []
    for axis, lane in enumerate(numbers):
        places = np.stack([np.zeros(len(lane)), (lane % across + 0.5) * step, (lane // across + 0.5) * step])
        origins.append(np.roll(places, axis, axis=0) + np.array(bounds.lower)[:, None])
        directions.append(np.tile(np.eye(3)[:, axis : axis + 1], len(lane)))
    origin, direction = (np.concatenate(parts, axis=1) for parts in (origins, directions))
    return mi.Ray3f(take_vectors(mi.Point3f, origin), take_vectors(mi.Vector3f, direction))


def _look_at_side(materials: dict[int, Material], si: Any, bsdf: Any, front: Any) -> Any:
    seen = mi.SurfaceInteraction3f(si)
    height = dr.select(front, _MEAN_COSINE, -_MEAN_COSINE)
    seen.wi = mi.Vector3f((1.0 - _MEAN_COSINE**2) ** 0.5, 0.0, height)
    return seen, dispatch_surface(materials, bsdf, seen, si.is_valid())


def _compute_transmittance(bsdf: Any, si: Any, lane: Any) -> Any:
    rng = make_rng(lane, mi.UInt32(0), mi.UInt32(0))
    chosen, weight = refract(bsdf, si, rng, si.is_valid())
    return dr.clip(weight * dr.square(chosen.eta), 0.0, 1.0)


class Caster:
    """Casts the rays along the axes of a scene, again and again."""

    def __init__(self, scene: Any, materials: dict[int, Material]) -> None:
        self._scene = scene
        self._materials = materials
        self._clear = can_refract(scene)
        self._look = Recorded(self._trace_layer, lambda: scene)

    def cast(self, ray: Any) -> Iterator[dict[str, Any]]:
        """Yield the first surfaces that rays hit, the second ones and so on, with ``axis``, that of the ray."""
        axis = dr.select(ray.d.x > 0.5, mi.UInt32(0), dr.select(ray.d.y > 0.5, mi.UInt32(1), mi.UInt32(2)))
        origin, direction = ray.o, ray.d
        # Recorded functions read meshes from their first addresses, which only stay the same on processors.
        look = self._look.run if dr.backend_v(axis) == dr.JitBackend.LLVM else self._trace_layer
        for _ in range(MAX_HITS):
            if not dr.width(origin):
                return
            dr.eval(origin, direction, axis)
            lane = dr.arange(mi.UInt32, dr.width(origin))
            surfaces, valid, onward = look(origin, direction, lane)
            dr.eval(surfaces, valid, onward)
            alive = dr.compress(valid)
            if not len(alive):
                return
            surfaces["axis"] = axis
            layer = {name: dr.gather(type(value), value, alive) for name, value in surfaces.items()}
            origin, direction = dr.gather(mi.Point3f, onward, alive), dr.gather(mi.Vector3f, direction, alive)
            axis = layer["axis"]
            dr.eval(layer)
            yield layer

    def _trace_layer(self, origin: Any, direction: Any, lane: Any) -> tuple[dict[str, Any], Any, Any]:
        """Return the surfaces that rays hit, where there are any, and the origins of the rays behind them."""
        si = self._scene.ray_intersect(mi.Ray3f(origin, direction))
        bsdf, valid = si.bsdf(), si.is_valid()
        front = dr.dot(si.n, direction) < 0
        seen, first = _look_at_side(self._materials, si, bsdf, front)
        _, second = _look_at_side(self._materials, si, bsdf, ~front)
        through = _compute_transmittance(bsdf, seen, lane) if self._clear else mi.Color3f(0)
        share = dr.maximum(1.0 - mi.luminance(through), 1e-3)
        surfaces = {
            "position": mi.Vector3f(si.p),
            "normal": mi.Vector3f(dr.select(front, si.sh_frame.n, -si.sh_frame.n)),
            "opacity": dr.clip(first.opacity * share, 0.0, 1.0),
        }
        for name, side in (("first", first), ("second", second)):
            # The albedo of the light that is not transmitted.
            total = side.diffuse_albedo + side.specular_albedo - through
            surfaces[name] = mi.Vector3f(dr.clip(total / share, 0.0, 1.0))
        return surfaces, valid, si.spawn_ray(direction).o


def _collect(bounds: Bounds, layers: Iterable[dict[str, Any]]) -> Hits:
    """Return the hits of some layers, sorted."""
    parts = []
    for layer in layers:
        arrays = {
            name: give_vectors(value) if dr.depth_v(value) > 1 else np.array(value) for name, value in layer.items()
        }
        place = (arrays["position"].astype(np.float64) - np.array(bounds.lower)[:, None]) / bounds.voxel
        x, y, z = np.clip(place.astype(np.int64), 0, bounds.resolution - 1)
        cell = x + bounds.resolution * (y + bounds.resolution * z)
        parts.append(Hits(key=3 * cell + arrays.pop("axis").astype(np.int64), **arrays))
    none, nowhere = np.zeros(0, np.float32), np.zeros((3, 0), np.float32)
    return _join_hits([Hits(np.zeros(0, np.int64), nowhere, nowhere, none, nowhere, nowhere), *parts])


def cast_hits(caster: Caster, bounds: Bounds, report: Report) -> Hits:
    """Return the hits of rays along the three axes, through every column of voxels.

    The number of rays that hit a flat wall is proportional to its projected area. So the share of a voxel's rays with
    hits is its coverage along the axis. ``report`` is called after each axis.
    """
    layers: list[dict[str, Any]] = []
    none = np.zeros(0, np.uint32)
    for axis in range(3):
        numbers = [_list_rays(bounds, axis) if axis == other else none for other in range(3)]
        layers.extend(caster.cast(_make_rays(bounds, numbers)))
        report()
    return _collect(bounds, layers)


def recast_hits(caster: Caster, bounds: Bounds, hits: Hits, boxes: Sequence[Box]) -> Hits:
    """Return the hits of a scene in which only the inside of some boxes changed, with ``hits`` before the change.

    Only the columns of voxels that cross a box are cast again.
    """
    if not boxes:
        return hits
    columns = [_mark_columns(bounds, axis, boxes) for axis in range(3)]
    size, axis = bounds.resolution, hits.axis
    place = np.stack([hits.cell % size, hits.cell // size % size, hits.cell // size**2])
    index = np.arange(len(hits))
    crossed = np.stack(columns)[axis, place[(axis + 1) % 3, index], place[(axis + 2) % 3, index]]
    ray = _make_rays(bounds, [_list_rays(bounds, axis, chosen) for axis, chosen in enumerate(columns)])
    new = _collect(bounds, caster.cast(ray))
    return _join_hits([hits, new], np.flatnonzero(np.append(~crossed, np.ones(len(new), np.bool_))))


def _mark_columns(bounds: Bounds, axis: int, boxes: Sequence[Box]) -> NDArray[np.bool_]:
    """Return which columns of voxels along an axis cross a box; see `_list_rays`."""
    size = bounds.resolution
    columns = np.zeros((size, size), np.bool_)
    for box in boxes:
        first, last = np.clip((box - np.array(bounds.lower)) / bounds.voxel, 0, size - 1).astype(np.int64)
        across, aside = ((axis + step) % 3 for step in (1, 2))
        columns[first[across] : last[across] + 1, first[aside] : last[aside] + 1] = True
    return columns
