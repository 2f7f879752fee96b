"""Light through glass by rays, up to the first surface that does not refract, where a cone takes over."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lobewise.render.bridge import dr, follow, mi, starts_as
from lobewise.render.materials.probe import make_context
from lobewise.render.tracing.rays import draw_point

MAX_BOUNDARIES = 4
"""Largest number of clear surfaces that a ray crosses."""


@dataclass
class Crossing:
    """A ray behind clear surfaces (Dr.Jit arrays; a PyTree).

    ``first`` is the transmittance of the first surface, in [0, 1] (Color3f). ``weight`` is the factor of radiance
    through all surfaces. ``emitted`` (Color3f) is the emission at the end of the ray, behind at least two surfaces:
    light through a single surface was scattered only once. ``active`` tells whether any light is transmitted.
    """

    ray: Any
    first: Any
    weight: Any
    emitted: Any
    active: Any


@dataclass
class _State:
    ray: Any
    weight: Any
    rng: Any
    active: Any
    si: Any = starts_as("SurfaceInteraction3f")
    count: Any = starts_as("UInt32", 1)


def _bends(flags: Any) -> Any:
    bent = mi.BSDFFlags.DiffuseTransmission, mi.BSDFFlags.GlossyTransmission, mi.BSDFFlags.DeltaTransmission
    return mi.has_flag(flags, bent[0]) | mi.has_flag(flags, bent[1]) | mi.has_flag(flags, bent[2])


def can_refract(scene: Any) -> bool:
    """Return whether any surface of a scene refracts or scatters transmitted light."""
    bsdfs = [shape.bsdf() for shape in scene.shapes()]
    return any(bsdf is not None and bool(_bends(bsdf.flags())) for bsdf in bsdfs)


def refract(bsdf: Any, si: Any, rng: Any, active: Any) -> tuple[Any, Any]:
    """Return one BSDF sample of refracted or scattered transmission, and its weight (Color3f), 0 if there is none.

    Null transmission, as through a mask, is not included; it is part of the surface's opacity.
    """
    point = draw_point(rng)
    chosen, weight = bsdf.sample(make_context(mi.BSDFFlags.Transmission), si, rng.next_float32(), point, active)
    return chosen, dr.select(_bends(chosen.sampled_type), weight, 0.0)


def cross_glass(scene: Any, si: Any, rng: Any, active: Any) -> Crossing:
    """Return the ray behind clear surfaces that enters at hits ``si``. Light that is reflected inside is lost."""
    chosen, first = refract(si.bsdf(), si, rng, active)
    going = active & (dr.max(first) > 0)

    def cross(state: _State) -> None:
        state.si = scene.ray_intersect(state.ray, state.active)
        bsdf = state.si.bsdf()
        clear = state.active & state.si.is_valid() & _bends(bsdf.flags()) & (state.count < MAX_BOUNDARIES)
        chosen, weight = refract(bsdf, state.si, state.rng, clear)
        state.ray = dr.select(clear, state.si.spawn_ray(state.si.to_world(chosen.wo)), state.ray)
        state.weight = dr.select(clear, state.weight * weight, state.weight)
        state.count += dr.select(clear, mi.UInt32(1), 0)
        state.active = clear & (dr.max(state.weight) > 0)

    ray = si.spawn_ray(si.to_world(chosen.wo))
    end = follow(_State(ray, mi.Color3f(first), rng, mi.Bool(going)), cross, "boundaries")
    shines = going & (end.count >= 2)
    return Crossing(
        ray=end.ray,
        first=dr.clip(first * dr.square(chosen.eta), 0.0, 1.0),
        weight=end.weight,
        emitted=dr.select(shines, end.si.emitter(scene).eval(end.si, shines), 0.0),
        active=going & (dr.max(end.weight) > 0),
    )
