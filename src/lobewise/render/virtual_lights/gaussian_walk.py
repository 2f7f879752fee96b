"""Indirect light at surfaces from clusters of virtual lights, and from what mirrors and very narrow lobes reflect."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lobewise.render.bridge import dr, follow, mi, starts_as
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_share, dispatch_surface
from lobewise.render.tracing.light_sampling import Scattering, scatter
from lobewise.render.tracing.points import Points
from lobewise.render.tracing.rays import draw_point, make_rng
from lobewise.render.virtual_lights.gaussian_lighting import GaussianLighting
from lobewise.render.virtual_lights.receivers import Receiver, lets_through, make_receiver, weigh_distance
from lobewise.render.virtual_lights.walks import Walk, Walker, choose_place

CLUSTERS_PER_SAMPLE = 4
"""Clusters per sample of a pixel."""
CLUSTERS_PER_RAY = 2
"""Clusters per surface that a ray from a lobe or mirror hits."""


@dataclass
class _Walk(Walk):
    """State of the loop, which follows narrow lobes as well.

    ``followed_share`` is the part of the last scattering by lobes that are followed, and ``mix`` the part by which a
    hit emitter counts. ``reach`` is that of the last lobe, infinite for mirrors, and ``travelled`` the way from it to
    the last surface that let the ray pass.
    """

    reach: Any = starts_as("Float", math.inf)
    followed_share: Any = starts_as("Color3f", 1)
    mix: Any = starts_as("Color3f", 1)
    travelled: Any = starts_as("Float")


class GaussianWalk(Walker):
    """The light of drawn clusters at pixels, and of what mirrors, smooth glass and very narrow lobes show."""

    _lighting: GaussianLighting

    def __init__(
        self, scene: Any, materials: dict[int, Material], lighting: GaussianLighting, numbers: Mapping[str, Any]
    ) -> None:
        super().__init__(scene, materials, lighting, numbers, mi.BSDFFlags.Delta, mi.BSDFFlags.Glossy)

    def take(self, points: Points, index: Any, end: Any, seed: Any, all_lights: bool) -> tuple[Any, Any, Any, Any]:
        """Return sample number ``index`` of ``end``; see `lobewise.render.tracing.points.average_samples`."""
        rng = make_rng(points.pixel, index, seed)
        steps = 1 << 24
        place = mi.Float(choose_place(points.pixel, self._numbers["width"], mi.UInt32(steps), seed)) * (1.0 / steps)
        # The clusters of all samples of a pixel are at equal distances.
        place = (mi.Float(index) + place) / mi.Float(end)
        walk = _Walk(mi.Bool(points.active), mi.Ray3f(points.ray), rng)
        if self._follows:
            walk = follow(walk, lambda walk: self._visit(walk, points, place, all_lights), "mirrors")
        else:
            at = make_receiver(points.si, points.surface, points.bsdf, self._lighting.width)
            walk.diffuse, walk.specular = self._gather(
                points.si, at, place, mi.UInt32(CLUSTERS_PER_SAMPLE), rng, points.active, all_lights
            )
        return walk.diffuse, walk.specular, walk.hit_count, walk.hit_inverse

    def _gather(
        self, si: Any, at: Receiver, place: Any, count: Any, rng: Any, active: Any, all_lights: bool
    ) -> tuple[Any, Any]:
        if all_lights:
            return self._lighting.gather_all(si, at, rng, active)
        return self._lighting.gather(si, at, place, count, rng, active)

    def _visit(self, walk: _Walk, points: Points, place: Any, all_lights: bool) -> None:
        """Add the light at the next surface of a walk, and sample the next direction."""
        scene, max_depth = self._scene, self._numbers["max_depth"]
        si, emitted = walk.meet(scene, points)
        self._add(walk, walk.bounces >= 2, emitted * walk.mix, mi.Color3f(0))

        later = ~walk.start
        walk.throughput *= walk.followed_share
        walk.active = si.is_valid() & (walk.depth + 2 <= max_depth) & (dr.max(walk.throughput) > 0)
        bsdf = si.bsdf()
        surface = dispatch_surface(self._materials, bsdf, si, walk.active & later)
        surface = dr.select(walk.start, points.surface, surface)
        at = make_receiver(si, surface, bsdf, self._lighting.width)
        # Clusters have shown the rest of what the surface sends to the last lobe.
        distance = walk.travelled + dr.select(later, si.t, 0.0)
        near = dr.select(lets_through(bsdf), 1.0, 1.0 - weigh_distance(distance, walk.reach))

        # Add virtual lights.
        lit = walk.active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        place = dr.select(walk.start, place, walk.rng.next_float32())
        count = dr.select(walk.start, mi.UInt32(CLUSTERS_PER_SAMPLE), CLUSTERS_PER_RAY)
        diffuse, specular = self._gather(si, at, place, count, walk.rng, lit, all_lights)
        self._add(walk, lit, near * (diffuse + specular), dr.select(walk.bounces == 0, diffuse, 0.0))

        # Sample direct light, which counts as indirect after the first scattering, and the next direction.
        numbers = draw_point(walk.rng), walk.rng.next_float32(), draw_point(walk.rng)
        scattering = scatter(scene, si, bsdf, walk.active, lit=lit & (walk.bounces >= 1), numbers=numbers)
        self._add(
            walk, scattering.lit, scattering.value * scattering.radiance * (scattering.weight * near), mi.Color3f(0)
        )
        self._go_on(walk, scattering, at, near)
        walk.travelled = dr.select(scattering.is_null, distance, 0.0)

    def _go_on(self, walk: _Walk, scattering: Scattering, at: Receiver, near: Any) -> None:
        """Continue along the sampled direction if the lobe is followed, or to hit an emitter.

        No cluster shows what mirrors reflect, so their rays count fully.
        """
        is_delta, is_null = scattering.is_delta, scattering.is_null
        share = dispatch_share(
            self._materials, scattering.si.bsdf(), scattering.si, scattering.chosen.wo, walk.active & ~is_delta
        )
        walk.followed_share = dr.select(is_delta, 1.0, dr.select(at.reach > 0, (1.0 - share) * near, 0.0))
        walk.mix = dr.select(is_null, walk.mix, dr.select(is_delta, 1.0, near))
        walk.reach = dr.select(is_null, walk.reach, dr.select(is_delta, dr.inf, at.reach))
        first = (walk.bounces == 0) & ~is_null
        walk.active &= (dr.max(scattering.factor) > 0) & ((dr.max(walk.followed_share) > 0) | ~first)
        walk.go_on(scattering)

    def _add(self, walk: _Walk, active: Any, value: Any, diffuse: Any) -> None:
        """Add ``value``, whose diffuse part at the first surface is ``diffuse``; rays follow specular light only."""
        value = walk.throughput * dr.select(active, value, 0.0)
        diffuse = walk.throughput * dr.select(active, diffuse, 0.0)
        walk.diffuse += diffuse
        walk.specular += value - diffuse
