"""Indirect light at surfaces from point lights or spheres, and beyond mirrors.

Source: Keller 1997, "Instant Radiosity"; interleaved sampling by Keller and Heidrich 2001; bounded geometry terms by
Kollig and Keller 2006, "Illumination in the Presence of Weak Singularities".
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from lobewise.render.bridge import dr, follow, mi, starts_as
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import split_scattering
from lobewise.render.tracing.light_sampling import scatter
from lobewise.render.tracing.points import Points
from lobewise.render.tracing.rays import draw_point, make_rng
from lobewise.render.virtual_lights.shading import Lighting
from lobewise.render.virtual_lights.walks import Walk, Walker, choose_place

LIGHTS_PER_SAMPLE = 32
"""Lights per sample of a pixel."""


@dataclass
class _Walk(Walk):
    """State of the loop, which follows rays of compensation as well."""

    share: Any = starts_as("Color3f")
    last_cosine: Any = starts_as("Float", 1)


class PointWalk(Walker):
    """The light of runs of point lights or spheres at pixels, and of what mirrors and smooth glass show.

    ``numbers`` holds the ``number`` of lights, too. With ``compensates``, rays of the points' own BSDF add the light
    that the clamp removes.
    """

    _lighting: Lighting

    def __init__(
        self,
        scene: Any,
        materials: dict[int, Material],
        lighting: Lighting,
        numbers: Mapping[str, Any],
        *,
        compensates: bool,
    ) -> None:
        super().__init__(scene, materials, lighting, numbers, mi.BSDFFlags.Delta)
        self._compensates = compensates
        self._follows |= compensates

    def take(self, points: Points, index: Any, end: Any, seed: Any, all_lights: bool) -> tuple[Any, Any, Any, Any]:
        """Return sample number ``index`` of ``end``; see `lobewise.render.tracing.points.average_samples`."""
        runs = self._count_runs(mi.UInt32(1), all_lights)
        stride = dr.maximum(runs // end, 1)
        first_run = choose_place(points.pixel, self._numbers["width"], runs, seed)
        rng = make_rng(points.pixel, index, seed)
        walk = self._walk(points, rng, (first_run + index * stride) % runs, runs)
        return walk.diffuse, walk.specular, walk.hit_count, walk.hit_inverse

    def count_worth(self, points: Points, samples: Any, all_lights: bool) -> Any:
        """Return the effective number of lights that each pixel sees."""
        runs = self._count_runs(samples, all_lights)
        run = choose_place(points.pixel, self._numbers["width"], runs, mi.UInt32(0))
        return self._lighting.count_worth(points, run, runs)

    def _count_runs(self, samples: Any, all_lights: bool) -> Any:
        lights_per_run = samples * LIGHTS_PER_SAMPLE
        runs = dr.maximum((self._numbers["number"] + lights_per_run - 1) // lights_per_run, 1)
        return mi.UInt32(1) if all_lights else runs

    def _walk(self, points: Points, rng: Any, run: Any, runs: Any) -> _Walk:
        """Return the light of one run of lights, in the sums of the last state."""
        walk = _Walk(points.active, mi.Ray3f(points.ray), rng)
        max_depth = self._numbers["max_depth"]
        if self._follows:
            walk = follow(walk, lambda walk: self._visit(walk, points, run, runs, max_depth), "mirrors")
        else:
            walk.diffuse, walk.specular = self._lighting.gather(
                points.si, points.bsdf, run, runs, max_depth - 2, rng, points.active
            )
        return walk

    def _visit(self, walk: _Walk, points: Points, run: Any, runs: Any, max_depth: Any) -> None:
        """Add the light at the next surface of a walk, and sample the next direction."""
        scene = self._scene
        si, emitted = walk.meet(scene, points)
        self._add(walk, walk.bounces >= 2, emitted, mi.Color3f(0))

        # Keep the part of the throughput that the clamp of virtual lights removes.
        geometry = walk.last_cosine * dr.abs(dr.dot(si.n, walk.ray.d)) / dr.square(si.t)
        beyond = 1.0 - dr.minimum(self._lighting.bound / geometry, 1.0)
        part_beyond_clamp = dr.select(walk.last.is_delta, 1.0, beyond if self._compensates else 0.0)
        walk.throughput *= dr.select(walk.start, 1.0, part_beyond_clamp)
        walk.active = si.is_valid() & (walk.depth + 2 <= max_depth) & (dr.max(walk.throughput) > 0)
        bsdf = si.bsdf()

        # Add virtual lights.
        other = dr.minimum(mi.UInt32(walk.rng.next_float32() * mi.Float(runs)), runs - 1)
        most = dr.select(walk.depth + 2 <= max_depth, max_depth - 2 - walk.depth, 0)
        lit = walk.active & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        diffuse, specular = self._lighting.gather(
            si, bsdf, dr.select(walk.start, run, other), runs, most, walk.rng, lit
        )
        self._add(walk, lit, diffuse + specular, dr.select(walk.bounces == 0, diffuse, 0.0))

        # Sample direct light, which counts as indirect after the first scattering, and the next direction.
        numbers = draw_point(walk.rng), walk.rng.next_float32(), draw_point(walk.rng)
        scattering = scatter(scene, si, bsdf, walk.active, lit=lit & (walk.bounces >= 1), numbers=numbers)
        self._add(walk, scattering.lit, scattering.value * scattering.radiance * scattering.weight, mi.Color3f(0))

        is_delta = scattering.is_delta
        first = (walk.bounces == 0) & ~scattering.is_null
        if self._compensates:
            going = walk.active & first & ~is_delta
            _, share = split_scattering(self._materials, bsdf, si, scattering.chosen.wo, going)
            walk.share = dr.select(first, dr.select(is_delta, 0.0, share), walk.share)
        # Rays of smooth lobes go on only to compensate the clamp and, after the first scattering, to hit emitters.
        walk.active &= (dr.max(scattering.factor) > 0) & (is_delta | ~first | mi.Bool(self._compensates))
        walk.go_on(scattering)
        walk.last_cosine = dr.abs(scattering.chosen.wo.z)

    def _add(self, walk: _Walk, active: Any, value: Any, diffuse: Any) -> None:
        """Add ``value``, whose diffuse part is ``diffuse`` before the first scattering, and the walk's share after."""
        value = dr.select(active, value, 0.0)
        before = walk.bounces == 0
        diffuse = dr.select(before, dr.select(active, diffuse, 0.0), value * walk.share)
        walk.diffuse += walk.throughput * diffuse
        walk.specular += walk.throughput * (value - diffuse)
