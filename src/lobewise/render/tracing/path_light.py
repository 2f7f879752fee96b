"""Indirect light by path tracing: noisy, right in expectation, and what the other methods are held against."""

from __future__ import annotations

from typing import Any

from lobewise.render.bridge import dr, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.tracing.paths import PathSettings, make_sample, trace_path
from lobewise.render.tracing.points import Indirect, Points
from lobewise.render.tracing.rays import make_opaque, make_rng


class PathLight:
    """Paths from the pixel's centre: BSDF importance sampling, next-event estimation, Russian roulette.

    Parameters
    ----------
    scene : mitsuba.Scene
        What lights the points.
    materials : dict
        Of the scene; see `lobewise.render.materials.bsdfs.read_scene_materials`.
    max_depth : int
        Longest path, in vertices after the camera, >= 3.
    """

    name = "paths"
    worth = 1.0
    can_replay = True
    state = None

    def __init__(self, scene: Any, materials: dict[int, Material], *, max_depth: int = 8) -> None:
        self._scene = scene
        self._materials = materials
        self._max_depth = max_depth

    def find_band_limit(self, points: Points, samples: int) -> float:
        """Return 0: directions follow the lobes; see `lobewise.render.tracing.points.IndirectMethod`."""
        return 0.0

    def shade(self, points: Points, *, samples: Any, seed: Any) -> Indirect:
        """Return the mean of ``samples`` paths; see `lobewise.render.tracing.points.IndirectMethod`."""
        settings = PathSettings(max_depth=self._max_depth, fewest_bounces=2, surfaces=False)
        max_depth = dr.opaque(mi.UInt32, self._max_depth)
        seed_value = make_opaque(seed)
        end = make_opaque(samples)

        def go_on(index: Any, total: Any) -> Any:
            return index < end

        def take(index: Any, total: Any) -> tuple[Any, Any]:
            rng = make_rng(points.pixel, index, seed_value)
            sample = trace_path(self._scene, self._materials, points.ray, rng, settings, max_depth)
            total.diffuse += sample.diffuse
            total.specular += sample.specular
            total.hit_count += sample.hit_count
            total.hit_inverse += sample.hit_inverse
            return index + 1, total

        _, total = dr.while_loop((mi.UInt32(0), make_sample()), go_on, take, label="samples")
        share = dr.rcp(mi.Float(end))
        distance = dr.select(total.hit_inverse > 0, total.hit_count / total.hit_inverse, dr.inf)
        return Indirect(
            diffuse=total.diffuse * share,
            specular=total.specular * share,
            hit_distance=dr.select(total.hit_count > 0, distance, 0.0),
        )
