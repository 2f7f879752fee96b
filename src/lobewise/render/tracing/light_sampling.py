"""Direct light at the vertices of paths: lights are sampled, emitters met, and both weighed against each other.

Source: Veach 1997, "Robust Monte Carlo Methods for Light Transport Simulation", chapter 9 (multiple importance
sampling).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lobewise.render.bridge import dr, mi


@dataclass
class Vertex:
    """Where a path was scattered last (Dr.Jit arrays; a PyTree): place, and density and kind of the way it took."""

    place: Any
    pdf: Any
    is_delta: Any


def make_eye() -> Vertex:
    """Return the vertex before the first, from which emitters are met in no other way."""
    return Vertex(dr.zeros(mi.Interaction3f), mi.Float(1), mi.Bool(True))


@dataclass
class Scattering:
    """What happens at a hit: a light is sampled, and the BSDF chooses where the path goes on.

    What comes from the light is ``value * radiance * weight`` where ``lit``: ``f cos`` towards ``to_light`` (local),
    radiance over density, and the weight against meeting it by chance. ``chosen`` is the BSDF's sample, ``factor`` what
    it does to the path's throughput.
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
        """Whether the path goes on in the only direction that there was."""
        return mi.has_flag(self.chosen.sampled_type, mi.BSDFFlags.Delta)

    @property
    def is_null(self) -> Any:
        """Whether the path passes without noticing the surface."""
        return mi.has_flag(self.chosen.sampled_type, mi.BSDFFlags.Null)

    @property
    def ray(self) -> Any:
        """The way on."""
        return self.si.spawn_ray(self.si.to_world(self.chosen.wo))

    @property
    def vertex(self) -> Vertex:
        """What the next hit has to know."""
        return Vertex(mi.Interaction3f(self.si), self.chosen.pdf, self.is_delta)


def weigh(pdf: Any, other: Any) -> Any:
    """Return the power heuristic's weight (Veach 1997, section 9.2.4)."""
    weight = dr.square(pdf) / (dr.square(pdf) + dr.square(other))
    return dr.select(dr.isfinite(weight), weight, 0.0)


def meet_emitter(scene: Any, si: Any, last: Vertex, active: Any) -> tuple[Any, Any]:
    """Return what the emitter at a hit sends back to the vertex before, and its weight against sampling it."""
    light = mi.DirectionSample3f(scene, si, last.place)
    light_pdf = scene.pdf_emitter_direction(last.place, light, active & ~last.is_delta)
    return light.emitter.eval(si, active), dr.select(last.is_delta, 1.0, weigh(last.pdf, light_pdf))


def scatter(
    scene: Any, si: Any, bsdf: Any, active: Any, *, lit: Any, numbers: tuple[Any, Any, Any], alone: Any = False
) -> Scattering:
    """Sample a light, where it is ``lit``, and the BSDF at hits; ``alone`` is where lights are not met by chance.

    The random numbers are those of the light (Point2f, or None: no light is sampled), of the BSDF's lobe (Float) and of
    its direction (Point2f).
    """
    light_point, choice, point = numbers
    to_light, radiance, density, only = mi.Vector3f(0, 0, 1), mi.Color3f(0), mi.Float(0), mi.Bool(True)
    if light_point is not None:
        light, radiance = scene.sample_emitter_direction(si, light_point, True, lit)
        lit &= light.pdf != 0
        to_light, density, only = si.to_local(light.d), light.pdf, light.delta | alone
    value, pdf, chosen, factor = bsdf.eval_pdf_sample(mi.BSDFContext(), si, to_light, choice, point, active)
    weight = dr.select(only, 1.0, weigh(density, pdf))
    return Scattering(si, lit, to_light, value, radiance, weight, chosen, factor)
