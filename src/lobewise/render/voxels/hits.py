"""Hits of rays along the three axes with a scene's surfaces, from which voxels of shapes of every kind are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.render.bridge import dr, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_surface
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


@dataclass(frozen=True)
class Bounds:
    """A cube of voxels: its lower corner, the edge of a voxel in world units, and the voxels along an edge."""

    lower: tuple[float, float, float]
    voxel: float
    resolution: int


@dataclass(frozen=True)
class Side:
    """One side of every hit surface: its albedo (Color3f), and the index of the ray direction that sees it."""

    albedo: Any
    direction: NDArray[np.int64]


@dataclass(frozen=True)
class Hits:
    """All hits of the rays, one per lane.

    ``position`` and ``normal`` (world space, unit, of the first side) are Dr.Jit arrays, and so are the albedos.
    ``cell`` is the number of the voxel, x fastest. ``opacity`` in [0, 1] is the share of light along the ray that the
    surface does not transmit. The first side faces the ray's origin, so rays along ``+axis`` see it; rays along
    ``-axis`` see the second side.
    """

    position: Any
    normal: Any
    cell: NDArray[np.int64]
    opacity: NDArray[np.float64]
    sides: tuple[Side, Side]

    def __len__(self) -> int:
        return len(self.cell)


def _find_box(shape: Any) -> NDArray[np.float64]:
    """Return the corners (2, 3) of a shape's box. Meshes that Mitsuba has merged have no valid box of their own."""
    if shape.is_mesh():
        vertices = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    box = shape.bbox()
    return np.stack([np.array(box.min, dtype=np.float64), np.array(box.max, dtype=np.float64)])


def find_bounds(scene: Any, resolution: int) -> Bounds:
    """Return the cube around a scene's surfaces, slightly enlarged; InputError if no surface has a finite size."""
    # The scene's own box includes point lights and cameras, which need no voxels, and an infinite sky.
    boxes = np.array([_find_box(shape) for shape in scene.shapes()]).reshape(-1, 2, 3)
    boxes = boxes[np.isfinite(boxes).all(axis=(1, 2))]
    extent = float((boxes[:, 1].max(axis=0) - boxes[:, 0].min(axis=0)).max()) if len(boxes) else 0.0
    if not extent > 0.0:
        got = f"{len(boxes)} of them, {extent:g} wide"
        raise InputError("scene", expected="surfaces of finite size", got=got, action="add a shape to the scene")
    voxel = extent / (resolution - 2.0 * MARGIN)
    corner = 0.5 * (boxes[:, 0].min(axis=0) + boxes[:, 1].max(axis=0)) - 0.5 * resolution * voxel
    return Bounds((float(corner[0]), float(corner[1]), float(corner[2])), voxel, resolution)


def _make_rays(bounds: Bounds, axis: int) -> Any:
    """Return the rays along one axis, `RAYS` squared of them through every column of voxels."""
    across = bounds.resolution * RAYS
    lane = dr.arange(mi.UInt32, across * across)
    step = bounds.voxel / RAYS
    places = [mi.Float(0), (mi.Float(lane % across) + 0.5) * step, (mi.Float(lane // across) + 0.5) * step]
    place = [places[(i - axis) % 3] + bounds.lower[i] for i in range(3)]
    direction = [1.0 if i == axis else 0.0 for i in range(3)]
    return mi.Ray3f(mi.Point3f(*place), mi.Vector3f(*direction))


def _look_at_side(materials: dict[int, Material], si: Any, bsdf: Any, front: Any) -> Any:
    seen = mi.SurfaceInteraction3f(si)
    height = dr.select(front, _MEAN_COSINE, -_MEAN_COSINE)
    seen.wi = mi.Vector3f((1.0 - _MEAN_COSINE**2) ** 0.5, 0.0, height)
    return seen, dispatch_surface(materials, bsdf, seen, si.is_valid())


def _find_transmittance(bsdf: Any, si: Any, lane: Any) -> Any:
    rng = make_rng(lane, mi.UInt32(0), mi.UInt32(0))
    chosen, weight = refract(bsdf, si, rng, si.is_valid())
    return dr.clip(weight * dr.square(chosen.eta), 0.0, 1.0)


def _cast(scene: Any, materials: dict[int, Material], bounds: Bounds, axis: int, clear: bool) -> list[dict[str, Any]]:
    ray = _make_rays(bounds, axis)
    layers: list[dict[str, Any]] = []
    while len(layers) < MAX_HITS and dr.width(ray):
        si = scene.ray_intersect(ray)
        bsdf, valid = si.bsdf(), si.is_valid()
        front = dr.dot(si.n, ray.d) < 0
        seen, first = _look_at_side(materials, si, bsdf, front)
        _, second = _look_at_side(materials, si, bsdf, ~front)
        through = _find_transmittance(bsdf, seen, dr.arange(mi.UInt32, dr.width(ray))) if clear else mi.Color3f(0)
        kept = dr.maximum(1.0 - mi.luminance(through), 1e-3)
        found = {
            "position": mi.Vector3f(si.p),
            "normal": mi.Vector3f(dr.select(front, si.sh_frame.n, -si.sh_frame.n)),
            "opacity": dr.clip(first.opacity * kept, 0.0, 1.0),
        }
        for name, side in (("first", first), ("second", second)):
            # The albedo of the light that is not transmitted.
            total = side.diffuse_albedo + side.specular_albedo - through
            found[name] = dr.clip(total / kept, 0.0, 1.0)
        onward = si.spawn_ray(ray.d)
        dr.eval(found, valid, onward)
        alive = dr.compress(valid)
        if not len(alive):
            break
        layers.append({name: dr.gather(type(value), value, alive) for name, value in found.items()})
        ray = dr.gather(mi.Ray3f, onward, alive)
        dr.eval(layers[-1], ray)
    return layers


def cast_hits(scene: Any, materials: dict[int, Material], bounds: Bounds, report: Report) -> Hits:
    """Return the hits of rays along the three axes, through every column of voxels.

    The number of rays that hit a flat wall is proportional to its projected area. So the share of a voxel's rays with
    hits is its coverage along the axis. ``report`` is called after each axis.
    """
    clear = can_refract(scene)
    names = ("position", "normal", "opacity", "first", "second")
    layers = [{name: np.zeros((0,) if name == "opacity" else (3, 0), dtype=np.float32) for name in names}]
    axes = [np.zeros(0, dtype=np.int64)]
    for axis in range(3):
        for layer in _cast(scene, materials, bounds, axis, clear):
            layers.append({name: np.array(layer[name], dtype=np.float32) for name in names})
            axes.append(np.full(layers[-1]["opacity"].shape, axis, dtype=np.int64))
        report()
    joined = {name: np.concatenate([layer[name] for layer in layers], axis=-1) for name in names}
    first, second = 2 * np.concatenate(axes), 2 * np.concatenate(axes) + 1
    place = (joined["position"].astype(np.float64) - np.array(bounds.lower)[:, None]) / bounds.voxel
    x, y, z = np.clip(place.astype(np.int64), 0, bounds.resolution - 1)
    return Hits(
        position=mi.Vector3f(joined["position"]),
        normal=mi.Vector3f(joined["normal"]),
        cell=x + bounds.resolution * (y + bounds.resolution * z),
        opacity=joined["opacity"].astype(np.float64),
        sides=(Side(mi.Color3f(joined["first"]), first), Side(mi.Color3f(joined["second"]), second)),
    )
