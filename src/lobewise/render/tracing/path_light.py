"""Indirect light by path tracing: noisy, right in expectation, and what the other methods are held against."""

from __future__ import annotations

from typing import Any

from lobewise.render.bridge import dr, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.tracing.paths import PathSettings, trace_path
from lobewise.render.tracing.points import Indirect, Points, average_samples
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

        def take(index: Any) -> tuple[Any, Any, Any, Any]:
            rng = make_rng(points.pixel, index, seed_value)
            found = trace_path(self._scene, self._materials, points.ray, rng, settings, max_depth)
            return found.lobes.diffuse, found.lobes.specular, found.totals.hit_count, found.totals.hit_inverse

        return average_samples(take, make_opaque(samples))
