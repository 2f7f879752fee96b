"""Shading of surfaces by virtual lights, points or spheres, with visibility rays."""

from __future__ import annotations

from typing import Any

from lobewise.render.bridge import dr, mi, repeat
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import split_scattering
from lobewise.render.tracing.points import Points
from lobewise.render.tracing.rays import draw_point
from lobewise.render.virtual_lights.light_paths import LightSet, Visibility, evaluate_towards

_MIN_DISTANCE = 1e-6
"""Smallest distance to a light, over the largest coordinate plus 1. It avoids a division by 0."""


class Lighting:
    """Shading by a set of lights.

    Nearer than ``shortest``, in scene units, lights do not get brighter. ``radius`` is the radius of spherical lights,
    in scene units; 0 makes point lights.
    """

    def __init__(
        self, scene: Any, materials: dict[int, Material], lights: LightSet, *, shortest: float, radius: float
    ) -> None:
        self._materials = materials
        self._lights = lights
        self._visibility = Visibility(scene, materials)
        self._number = dr.opaque(mi.UInt32, lights.number)
        self._has_spheres = radius > 0.0
        self._radius = dr.opaque(mi.Float, radius)
        self.bound = dr.opaque(mi.Float, 1.0 / max(shortest, 1e-12) ** 2)
        """Largest geometry term, per unit of area."""

    @property
    def state(self) -> Any:
        """Arrays that shading reads beside the scene (a PyTree)."""
        return self._lights.arrays, self._number, self._radius, self.bound

    def gather(
        self, si: Any, bsdf: Any, run: Any, runs: Any, most_depth: Any, rng: Any, active: Any
    ) -> tuple[Any, Any]:
        """Return diffuse and specular radiance towards ``si.wi`` from one of ``runs`` equal runs, times ``runs``.

        Lights deeper than ``most_depth`` do not count. Only spheres draw from ``rng``.
        """
        first = self._trace_first(run, runs)
        end = dr.select(active, self._trace_first(run + 1, runs), first)

        # The loop over point lights needs no random numbers, so it does not carry the generator.
        shine = self._shine_sphere if self._has_spheres else self._shine_point

        def add(index: Any, diffuse: Any, specular: Any, *rng: Any) -> tuple[Any, ...]:
            more = shine(si, bsdf, index, most_depth, *rng)
            return diffuse + more[0], specular + more[1], *rng

        start = mi.Color3f(0), mi.Color3f(0), *([rng] if self._has_spheres else [])
        diffuse, specular, *advanced = repeat(add, first, end, *start, label="lights")
        for used in advanced:
            rng.state, rng.inc = used.state, used.inc
        scale = mi.Float(runs)
        return diffuse * scale, specular * scale

    def count_worth(self, points: Points, run: Any, runs: Any) -> Any:
        """Return the effective number of lights in a run at points, ``(sum L)^2 / sum L^2`` of the arriving light."""
        si = points.si
        first = self._trace_first(run, runs)
        end = dr.select(points.active, self._trace_first(run + 1, runs), first)

        def add(index: Any, total: Any, squares: Any) -> tuple[Any, ...]:
            light = self._fetch(index)
            towards, inverse = self._aim(si, light)
            value = light.flux * self._emit(light, towards, index < end)
            value = mi.luminance(value * dr.minimum(dr.abs(dr.dot(light.si.n, towards)) * inverse, self.bound))
            value *= dr.select(dr.dot(si.n, towards) * dr.dot(si.n, si.to_world(si.wi)) > 0, 1.0, 0.0)
            value *= mi.luminance(self._see(si, light, value > 0))
            return total + value, squares + dr.square(value)

        total, squares = repeat(add, first, end, mi.Float(0), mi.Float(0), label="worth")
        return dr.select(squares > 0, dr.square(total) / squares, 0.0)

    def _trace_first(self, run: Any, runs: Any) -> Any:
        return mi.UInt32(mi.UInt64(run) * mi.UInt64(self._number) // mi.UInt64(runs))

    def _fetch(self, index: Any) -> LightSet:
        return LightSet(*(dr.gather(type(array), array, index) for array in self._lights.arrays))

    def _aim(self, si: Any, light: LightSet) -> tuple[Any, Any]:
        """Return the direction to a light (unit vector in world space) and the inverse square of its distance."""
        away = light.si.p - si.p
        inverse = dr.rcp(dr.maximum(dr.squared_norm(away), dr.square(_MIN_DISTANCE * dr.max(dr.abs(si.p) + 1.0))))
        return away * dr.sqrt(inverse), inverse

    def _emit(self, light: LightSet, towards: Any, active: Any) -> Any:
        """Return the radiance of a light against the direction ``towards``, per flux and area."""
        outgoing = light.si.to_local(-towards)
        return evaluate_towards(light.si, light.bsdf, light.incoming, outgoing, active) * dr.rcp(light.cosine)

    def _shine_point(self, si: Any, bsdf: Any, index: Any, most_depth: Any) -> tuple[Any, Any]:
        light = self._fetch(index)
        towards, inverse = self._aim(si, light)
        wo = si.to_local(towards)
        near = light.depth <= most_depth
        value, share = split_scattering(self._materials, bsdf, si, wo, near)
        emitted = light.flux * self._emit(light, towards, near)
        facing = dr.abs(dr.dot(light.si.n, towards)) * inverse
        geometry = dr.abs(wo.z) * facing
        bounded = dr.minimum(1.0, self.bound / geometry)
        value *= emitted * (facing * dr.select(geometry > 0, bounded, 0.0))
        value = dr.select(near & dr.isfinite(dr.max(value)), value, 0.0)
        value *= self._see(si, light, dr.max(value) > 0)
        return value * share, value * (1.0 - share)

    def _shine_sphere(self, si: Any, bsdf: Any, index: Any, most_depth: Any, rng: Any) -> tuple[Any, Any]:
        """Sample the cone that the sphere fills, and the receiver's BSDF, combined by the balance heuristic.

        Departs from Hasan et al. 2009: no direction is sampled from the light's BSDF.
        """
        light = self._fetch(index)
        towards, inverse = self._aim(si, light)
        near = light.depth <= most_depth
        # A point inside the sphere sees it in all directions.
        sine2 = dr.square(self._radius) * inverse
        inside = sine2 >= 1.0
        # This form of 1 - cos has no cancellation.
        height = dr.select(inside, 2.0, sine2 / (1.0 + dr.safe_sqrt(1.0 - sine2)))
        cone_pdf = dr.rcp(dr.two_pi * height)
        down = height * rng.next_float32()
        out = dr.safe_sqrt(down * (2.0 - down))
        sine, cosine = dr.sincos(dr.two_pi * rng.next_float32())
        drawn = mi.Frame3f(towards).to_world(mi.Vector3f(out * cosine, out * sine, 1.0 - down))
        choice, point = rng.next_float32(), draw_point(rng)
        wo = si.to_local(drawn)
        _, pdf, chosen, _ = bsdf.eval_pdf_sample(mi.BSDFContext(), si, wo, choice, point, near)
        is_smooth = ~mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
        scattered = si.to_world(chosen.wo)
        hits = 0.5 * dr.squared_norm(scattered - towards) <= height
        reaches = near & is_smooth & hits & (chosen.pdf > 0)

        diffuse, specular = mi.Color3f(0), mi.Color3f(0)
        for direction, local, density, active in (
            (drawn, wo, cone_pdf + pdf, near),
            (scattered, mi.Vector3f(chosen.wo), cone_pdf + chosen.pdf, reaches),
        ):
            value, share = split_scattering(self._materials, bsdf, si, local, active)
            facing = dr.abs(dr.dot(light.si.n, direction))
            value = dr.select(active, value * self._emit(light, direction, active) * (facing / density), 0.0)
            value = dr.select(dr.isfinite(dr.max(value)), value, 0.0)
            diffuse += value * share
            specular += value * (1.0 - share)
        strength = light.flux * dr.rcp(dr.pi * dr.square(self._radius))
        strength *= self._see(si, light, dr.max(diffuse + specular) > 0)
        return diffuse * strength, specular * strength

    def _see(self, si: Any, light: LightSet, active: Any) -> Any:
        """Return the visibility of a light (Color3f)."""
        return self._visibility.see(si, light.si.p, active)
