"""Rays through pixels, and random numbers of pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lobewise.render.bridge import dr, follow, mi, starts_as
from lobewise.render.camera import get_sensor


@dataclass
class _Skip:
    """State of the walk through hidden lamps."""

    ray: Any
    active: Any = starts_as("Bool", True)


def hides_emitters(scene: Any) -> bool:
    """Return whether the scene's integrator hides lamps and background from rays that nothing has scattered yet."""
    return bool(getattr(scene.integrator(), "hide_emitters", False))


def make_ray(
    scene: Any, pixel: Any, size: tuple[Any, Any], place: Any, aperture: Any = None, *, hides: bool = True
) -> Any:
    """Return rays through pixels. ``place`` in [0, 1) counts right and down from a pixel's corner.

    ``aperture`` (Point2f in the unit square) chooses points of a lens. Without it rays pass through its middle, which
    is the only point of a pinhole. With ``hides`` the rays begin behind lamps that the scene's integrator hides.
    """
    width, height = size
    x = (mi.Float(pixel % width) + place.x) / mi.Float(width)
    y = (mi.Float(pixel // width) + place.y) / mi.Float(height)
    ray, _ = get_sensor(scene).sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5) if aperture is None else aperture)
    return _skip_lamps(scene, ray) if hides and hides_emitters(scene) else ray


def _skip_lamps(scene: Any, ray: Any) -> Any:
    if not any(shape.is_emitter() for shape in scene.shapes()):
        return ray

    def skip(state: _Skip) -> None:
        si = scene.ray_intersect(state.ray, state.active)
        state.active &= si.is_valid() & si.shape.is_emitter()
        state.ray = dr.select(state.active, si.spawn_ray(state.ray.d), state.ray)

    return follow(_Skip(ray), skip, "lamps").ray


def make_rng(pixel: Any, index: Any, seed: Any) -> Any:
    """Return a generator of random numbers that depend only on pixel, sample index and seed, not on the lane."""
    state, sequence = mi.sample_tea_32(pixel, index)
    state, sequence = mi.sample_tea_32(state, sequence ^ seed)
    rng = mi.PCG32()
    rng.seed(initstate=state, initseq=sequence)  # the constructor would mix in the lane, which depends on the tile
    return rng


def invert_distance(si: Any, seen: Any) -> Any:
    """Return one over the distance of hits, 0 where not ``seen``."""
    return dr.select(seen, dr.rcp(dr.maximum(si.t, 1e-12)), 0.0)


def draw_point(rng: Any) -> Any:
    """Return a random point of the unit square."""
    return mi.Point2f(rng.next_float32(), rng.next_float32())


def make_opaque(number: Any) -> Any:
    """Return a whole number as a UInt32 that is not compiled into kernels; a Dr.Jit number is returned unchanged."""
    return number if isinstance(number, mi.UInt32) else dr.opaque(mi.UInt32, int(number) & 0xFFFFFFFF)
