"""Indirect light by voxel cone tracing: smooth and fast, with the resolution of the voxels.

Source: Crassin et al. 2011, "Interactive Indirect Illumination Using Voxel Cone Tracing".
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from lobewise.errors import InputError, name_value, require_integer
from lobewise.frame import LobeKind
from lobewise.render.bridge import dr, mi, repeat
from lobewise.render.materials.bsdfs import Material
from lobewise.render.tracing.points import Indirect, Points
from lobewise.render.tracing.rays import draw_point, make_opaque, make_rng
from lobewise.render.voxels.grid import (
    Faces,
    Floats,
    Grid,
    average_radiance,
    fill_grid,
    find_depth,
    make_faces,
    plan_layout,
)
from lobewise.render.voxels.hits import Hits, cast_hits, find_bounds
from lobewise.render.voxels.march import (
    MIN_TAN,
    draw_jitter,
    find_reflection,
    gather_diffuse,
    trace_cone,
)
from lobewise.render.voxels.refraction import can_refract, cross_glass

RESOLUTIONS = (16, 32, 64, 128, 256)
"""Numbers of voxels along an edge of the grid that users can choose."""

MAX_GAIN = 0.9
"""Largest ratio of successive bounces in the extrapolation to infinitely many bounces."""

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
        self._materials = materials
        self._resolution = resolution
        self._bounces = bounces
        self._light_samples = light_samples
        self._is_clear = can_refract(scene)
        self._grid = self._build(progress)

    @property
    def state(self) -> Grid:
        """The grid, which `shade` reads beside the points; see `lobewise.render.tracing.points.IndirectMethod`."""
        return self._grid

    @property
    def grid(self) -> Grid:
        """The voxels."""
        return self._grid

    def update(self, progress: Progress | None = None) -> None:
        """Fill the voxels again after a change of the scene."""
        self._grid = self._build(progress)

    def _build(self, progress: Progress | None) -> Grid:
        total, done = 4 + self._bounces, 0

        def report() -> None:
            nonlocal done
            done += 1
            if progress is not None:
                progress(done, total)

        with dr.suspend_grad():
            bounds = find_bounds(self._scene, self._resolution)
            hits = cast_hits(self._scene, self._materials, bounds, report)
            layout = plan_layout(bounds, hits)
            depth, count = find_depth(layout, hits)
            faces = make_faces(layout, hits, count)
            direct = average_radiance(layout, faces, _light_sides(self._scene, hits, self._light_samples), count)
            grid = fill_grid(layout, faces, depth, direct)
            report()
            series = [direct]
            for bounce in range(self._bounces):
                series.append(_bounce(faces, direct, grid, bounce))
                grid = fill_grid(layout, faces, depth, series[-1])
                report()
            if len(series) > 2:
                grid = fill_grid(layout, faces, depth, _extend(series[-3:], count[np.array(faces.slot)]))
        return grid

    def find_band_limit(self, points: Points, samples: int) -> float:
        """Return 0, because directions are sampled by the lobes; see `IndirectMethod`."""
        return 0.0

    def shade(self, points: Points, *, samples: Any, seed: Any) -> Indirect:
        """Return the mean of ``samples`` sets of jittered cones; see `IndirectMethod`."""
        grid, surface = self._grid, points.surface
        seed_value, end = make_opaque(seed), make_opaque(samples)
        origin, normal, shading = points.si.p, mi.Vector3f(points.si.n), surface.normal
        matte = points.active & (dr.max(surface.diffuse_albedo) > 0)
        shiny = points.active & (surface.lobe_kind != float(LobeKind.NONE))
        view = -points.ray.d
        mirror = surface.lobe_kind == float(LobeKind.DELTA)
        alphas = (dr.select(mirror, 0.0, alpha) for alpha in (surface.alpha_u, surface.alpha_v))
        axis, tangent = find_reflection(view, shading, surface.tangent, *alphas)

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
        cone = trace_cone(self._grid, ray.o, ray.d, ray.d, mi.Float(MIN_TAN), jitter, crossing.active)
        through = crossing.weight * (cone.radiance + crossing.emitted)
        return points.surface.specular_albedo - crossing.first, dr.select(crossing.active, through, 0.0)


def _light_sides(scene: Any, hits: Hits, samples: int) -> tuple[Any, Any]:
    """Return the direct light that each side of the hits reflects, like a diffuse surface (Color3f)."""
    si = dr.zeros(mi.SurfaceInteraction3f, len(hits))
    si.p, si.n = mi.Point3f(hits.position), mi.Normal3f(hits.normal)
    lane = dr.arange(mi.UInt32, len(hits))
    end = dr.opaque(mi.UInt32, samples)

    def take(index: Any, first: Any, second: Any) -> tuple[Any, Any]:
        point = draw_point(make_rng(lane, index, mi.UInt32(0)))
        light, radiance = scene.sample_emitter_direction(si, point, True, mi.Bool(True))
        # A hit inside a light source gets NaN or infinity from it.
        arriving = mi.Color3f(radiance) * dr.dot(light.d, hits.normal)
        arriving = dr.select((light.pdf > 0) & dr.isfinite(dr.sum(arriving)), arriving, 0.0)
        return first + dr.maximum(arriving, 0.0), second + dr.maximum(-arriving, 0.0)

    dark = (dr.zeros(mi.Color3f, len(hits)) for _ in hits.sides)
    first, second = repeat(take, mi.UInt32(0), end, *dark, label="light samples")
    scale = dr.inv_pi / mi.Float(end)
    reflected = first * hits.sides[0].albedo * scale, second * hits.sides[1].albedo * scale
    dr.eval(reflected)
    return reflected


def _bounce(faces: Faces, direct: Any, grid: Grid, bounce: int) -> Any:
    """Return the radiance of faces: the direct light plus the light that they reflect from the grid (Color3f)."""
    rng = make_rng(faces.slot, dr.opaque(mi.UInt32, bounce), mi.UInt32(0))
    position, reflects = mi.Point3f(faces.position), dr.max(faces.albedo) > 0
    radiance = direct + faces.albedo * gather_diffuse(grid, position, faces.normal, faces.normal, rng, reflects)
    dr.eval(radiance)
    return radiance


def _extend(series: list[Any], area: Floats) -> Any:
    """Return the limit of a series from its last three members, as if it continued as a geometric series.

    The ratio is that of the total light of all faces, for each colour.
    """
    before, last, end = (np.array(member, dtype=np.float64) for member in series)
    gains = (last - before) @ area, (end - last) @ area
    ratio = np.clip(np.divide(gains[1], gains[0], out=np.zeros(3), where=gains[0] > 0), 0.0, MAX_GAIN)
    limit = end + np.maximum(end - last, 0.0) * (ratio / (1.0 - ratio))[:, None]
    return mi.Color3f(limit.astype(np.float32))
