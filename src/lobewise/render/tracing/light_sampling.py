"""Direct light at the vertices of paths by multiple importance sampling: sampled lights, and emitters that paths hit.

Source: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", chapter 9 (multiple importance
sampling).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lobewise.render.bridge import dr, mi


@dataclass
class Vertex:
    """The last vertex of a path (Dr.Jit arrays; a PyTree): its place, and density and kind of the sampled direction."""

    place: Any
    pdf: Any
    is_delta: Any


def make_eye() -> Vertex:
    """Return the camera as the vertex before the first. Emitters seen from it cannot be sampled, so they weigh 1."""
    return Vertex(dr.zeros(mi.Interaction3f), mi.Float(1), mi.Bool(True))


@dataclass
class Scattering:
    """Scattering at a hit: a light sample, and a BSDF sample along which the path goes on.

    Light from the sampled light is ``value * radiance * weight`` where ``lit``: ``f cos`` towards ``to_light`` (local),
    radiance over density, and the weight of multiple importance sampling. ``lit`` is false where the light is hidden or
    the product is 0. ``chosen`` is the BSDF sample, and ``factor`` multiplies the path's throughput.
    """

    si: Any
    lit: Any
    to_light: Any
    value: Any
    radiance: Any
    weight: Any
    chosen: Any
    factor: Any

    @property
    def is_delta(self) -> Any:
        """Whether the BSDF sample comes from a delta lobe."""
        return mi.has_flag(self.chosen.sampled_type, mi.BSDFFlags.Delta)

    @property
    def is_null(self) -> Any:
        """Whether the path passes through the surface unchanged."""
        return mi.has_flag(self.chosen.sampled_type, mi.BSDFFlags.Null)

    @property
    def ray(self) -> Any:
        """The ray along which the path goes on."""
        return self.si.spawn_ray(self.si.to_world(self.chosen.wo))

    @property
    def vertex(self) -> Vertex:
        """This hit as the last vertex of the next one."""
        return Vertex(mi.Interaction3f(self.si), self.chosen.pdf, self.is_delta)


def weigh(pdf: Any, other: Any) -> Any:
    """Return the weight of the power heuristic (Veach 1997, section 9.2.4)."""
    weight = dr.square(pdf) / (dr.square(pdf) + dr.square(other))
    return dr.select(dr.isfinite(weight), weight, 0.0)


def meet_emitter(scene: Any, si: Any, last: Vertex, active: Any) -> tuple[Any, Any]:
    """Return the radiance of the emitter at a hit towards the last vertex, and its weight against light samples."""
    light = mi.DirectionSample3f(scene, si, last.place)
    light_pdf = scene.pdf_emitter_direction(last.place, light, active & ~last.is_delta)
    return light.emitter.eval(si, active), dr.select(last.is_delta, 1.0, weigh(last.pdf, light_pdf))


def scatter(
    scene: Any, si: Any, bsdf: Any, active: Any, *, lit: Any, numbers: tuple[Any, Any, Any], alone: Any = False
) -> Scattering:
    """Sample a light, where ``lit``, and the BSDF at hits. Where ``alone``, no BSDF sample competes with the light.

    ``numbers`` holds the random numbers of the light (Point2f, or None to sample no light), of the BSDF's lobe (Float)
    and of its direction (Point2f).
    """
    light_point, choice, point = numbers
    to_light, radiance, density, only = mi.Vector3f(0, 0, 1), mi.Color3f(0), mi.Float(0), mi.Bool(True)
    if light_point is not None:
        light, radiance = scene.sample_emitter_direction(si, light_point, False, lit)
        to_light, density, only = si.to_local(light.d), light.pdf, light.delta | alone
    value, pdf, chosen, factor = bsdf.eval_pdf_sample(mi.BSDFContext(), si, to_light, choice, point, active)
    if light_point is not None:
        # A light below the horizon, or of whose light the BSDF scatters none, needs no shadow ray.
        lit &= (light.pdf != 0) & dr.any(value * radiance != 0)
        lit &= ~scene.ray_test(si.spawn_ray_to(light.p), lit)
    weight = dr.select(only, 1.0, weigh(density, pdf))
    return Scattering(si, lit, to_light, value, radiance, weight, chosen, factor)
