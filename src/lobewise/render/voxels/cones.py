"""Indirect light by voxel cone tracing: smooth and fast, with the resolution of the voxels.

Source: Crassin et al. 2011, "Interactive Indirect Illumination Using Voxel Cone Tracing".
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

from lobewise.errors import InputError, name_value, require_integer
from lobewise.records.frame import LobeKind
from lobewise.render.bridge import dr, mi, repeat
from lobewise.render.materials.bsdfs import Material
from lobewise.render.moving.shapes import Box
from lobewise.render.tracing.points import Indirect, Points
from lobewise.render.tracing.rays import make_opaque, make_rng
from lobewise.render.voxels.axis_hits import Caster, cast_hits, contains, measure_bounds, recast_hits
from lobewise.render.voxels.grid import Grid
from lobewise.render.voxels.lighting import SideLights, Surfaces, VoxelLight, make_surfaces
from lobewise.render.voxels.march import (
    MIN_TAN,
    compute_reflection,
    draw_jitter,
    gather_diffuse,
    trace_cone,
)
from lobewise.render.voxels.refraction import can_refract, cross_glass

RESOLUTIONS = (16, 32, 64, 128, 256)
"""Numbers of voxels along an edge of the grid that users can choose."""

Progress = Callable[[int, int], None]


class VoxelCones:
    """Cones through voxels that store the direct light reflected by their surfaces, and some bounces of it.

    Shapes of any kind are voxelised, with any BSDF. Light sources occlude, but voxels do not store their emission, only
    the light that falls on other surfaces.

    Departs from Crassin 2011: surfaces in voxels reflect like diffuse ones, with the sum of their albedos. Rays find
    the surfaces, not a rasteriser. Optical depths are summed, not opacities (`lobewise.render.voxels.march`).

    Parameters
    ----------
    scene : mitsuba.Scene
    materials : dict
        Materials of the scene; see `lobewise.render.materials.bsdfs.read_scene_materials`.
    resolution : int
        Voxels along the longest side of the scene: 16, 32, 64, 128 or 256.
    bounces : int
        Number of bounces between surfaces after the first scattering, 0 to 16.
    light_samples : int
        Samples of the light sources for each hit of a ray with a surface, 1 to 1024.
    progress : callable, optional
        Called with the number of finished steps and of all steps.

    Raises
    ------
    InputError
        If a number is out of range, or the scene has no surface of finite size.
    """

    name = "voxel_cones"
    worth = 8.0

    def __init__(
        self,
        scene: Any,
        materials: dict[int, Material],
        *,
        resolution: int = 128,
        bounces: int = 3,
        light_samples: int = 4,
        progress: Progress | None = None,
    ) -> None:
        if resolution not in RESOLUTIONS:
            expected = "one of " + ", ".join(map(str, RESOLUTIONS))
            raise InputError("resolution", expected=expected, got=name_value(resolution), action="pass resolution=128")
        require_integer("bounces", bounces, 0, 16)
        require_integer("light_samples", light_samples, 1, 1024)
        self._scene = scene
        self._caster = Caster(scene, materials)
        self._resolution = resolution
        self._bounces = bounces
        self._lights = SideLights(scene, light_samples)
        self._is_clear = can_refract(scene)
        self._light = self._build(progress)

    @property
    def state(self) -> Grid:
        """The grid, which `shade` reads beside the points; see `lobewise.render.tracing.points.IndirectMethod`."""
        return self.grid

    @property
    def grid(self) -> Grid:
        """The voxels."""
        grid = self._light.grid
        assert grid is not None
        return grid

    def update(self, progress: Progress | None = None) -> None:
        """Fill the voxels again after any change of the scene."""
        self._light = self._build(progress)

    def update_lights(self) -> None:
        """Light the voxels again after lights changed; `refine` completes it."""
        with dr.suspend_grad():
            self._light.follow()

    def update_shapes(self, boxes: Sequence[Box]) -> None:
        """Fill the voxels again where shapes moved, and light all voxels again; `refine` completes it.

        ``boxes`` are those of the moved shapes, before and after. A shape that leaves the grid makes it anew.
        """
        surfaces = self._light.surfaces
        if not all(contains(surfaces.bounds, box) for box in boxes):
            self.update()
            return
        with dr.suspend_grad():
            hits = recast_hits(self._caster, surfaces.bounds, surfaces.hits, boxes)
            former, self._light = self._light, self._make_light(make_surfaces(surfaces.bounds, hits))
            self._light.take_over(former)

    def refine(self) -> None:
        """Compute some more bounces of a change of the light; see `VoxelLight.refine`."""
        with dr.suspend_grad():
            self._light.refine()

    @property
    def is_settled(self) -> bool:
        """Whether all bounces are those of the scene as it is, so that `refine` has nothing left to do."""
        return self._light.is_settled

    def _make_light(self, surfaces: Surfaces) -> VoxelLight:
        return VoxelLight(self._lights, surfaces, self._bounces)

    def _build(self, progress: Progress | None) -> VoxelLight:
        total, done = 4 + self._bounces, 0

        def report() -> None:
            nonlocal done
            done += 1
            if progress is not None:
                progress(done, total)

        with dr.suspend_grad():
            bounds = measure_bounds(self._scene, self._resolution)
            hits = cast_hits(self._caster, bounds, report)
            light = self._make_light(make_surfaces(bounds, hits))
            light.solve(report)
        return light

    def get_band_limit(self, points: Points, samples: int) -> float:
        """Return 0, because directions are sampled by the lobes; see `IndirectMethod`."""
        return 0.0

    def shade(self, points: Points, *, samples: Any, seed: Any) -> Indirect:
        """Return the mean of ``samples`` sets of jittered cones; see `IndirectMethod`."""
        grid, surface = self.grid, points.surface
        seed_value, end = make_opaque(seed), make_opaque(samples)
        origin, normal, shading = points.si.p, mi.Vector3f(points.si.n), surface.normal
        matte = points.active & (dr.max(surface.diffuse_albedo) > 0)
        shiny = points.active & (surface.lobe_kind != float(LobeKind.NONE))
        view = -points.ray.d
        mirror = surface.lobe_kind == float(LobeKind.DELTA)
        alphas = (dr.select(mirror, 0.0, alpha) for alpha in (surface.alpha_u, surface.alpha_v))
        axis, tangent = compute_reflection(view, shading, surface.tangent, *alphas)

        def take(index: Any, diffuse: Any, specular: Any, inverse: Any) -> tuple[Any, Any, Any]:
            rng = make_rng(points.pixel, index, seed_value)
            jitter = draw_jitter(rng)
            cone = trace_cone(grid, origin, normal, axis, tangent, jitter, shiny, smooth=True)
            if self._is_clear:
                reflected, through = self._look_through(points, rng, jitter)
                specular += cone.radiance * reflected + through
            else:
                specular += cone.radiance * surface.specular_albedo
            diffuse += gather_diffuse(grid, origin, normal, shading, rng, matte)
            return diffuse, specular, inverse + cone.inverse

        start = mi.Color3f(0), mi.Color3f(0), mi.Float(0)
        diffuse, specular, inverse = repeat(take, mi.UInt32(0), end, *start, label="cone sets")
        share = dr.rcp(mi.Float(end))
        met = dr.select(inverse > 0, dr.rcp(inverse * share), dr.inf)
        return Indirect(
            diffuse=diffuse * share * surface.diffuse_albedo,
            specular=dr.maximum(specular * share, 0.0),
            hit_distance=dr.select(shiny, met, 0.0),
        )

    def _look_through(self, points: Points, rng: Any, jitter: tuple[Any, Any]) -> tuple[Any, Any]:
        """Return the albedo of the reflection without refraction, and the radiance through clear surfaces."""
        crossing = cross_glass(self._scene, points.si, rng, points.active)
        ray = crossing.ray
        cone = trace_cone(self.grid, ray.o, ray.d, ray.d, mi.Float(MIN_TAN), jitter, crossing.active)
        through = crossing.weight * (cone.radiance + crossing.emitted)
        return points.surface.specular_albedo - crossing.first, dr.select(crossing.active, through, 0.0)
