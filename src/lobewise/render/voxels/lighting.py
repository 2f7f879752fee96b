"""The light that the surfaces in voxels reflect: computed once, and again in small steps after a change.

The bounces of light are the fixed point of ``bounced = albedo * gather(direct + bounced)``. After a change the bounced
light of the moment before is a good start, and each step gathers for some of the faces only.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise.render.bridge import Recorded, dr, give_vectors, mi, repeat, take_numbers, take_vectors
from lobewise.render.tracing.rays import draw_point, make_rng
from lobewise.render.voxels.axis_hits import Bounds, Hits
from lobewise.render.voxels.grid import (
    Faces,
    Floats,
    Grid,
    Layout,
    Pairs,
    average_radiance,
    fill_grid,
    gather_pairs,
    make_faces,
    plan_layout,
)
from lobewise.render.voxels.march import gather_diffuse

MAX_GAIN = 0.9
"""Largest ratio of successive bounces in the extrapolation to infinitely many bounces."""

FACES_PER_STEP = 1 << 14
"""Faces for which one step gathers light."""

PASSES = 4
"""Times that steps gather for every face after a change."""

MAX_RATIO = 100.0
"""Largest factor by which light that bounced before a change is made brighter."""

MIN_BOUNCES_TO_EXTEND = 2
"""Bounces from which on the series of bounces is extended to its limit."""


@dataclass(frozen=True)
class Surfaces:
    """The surfaces in the voxels: hits of rays, their means in every voxel, and the order of the voxels."""

    hits: Hits
    pairs: Pairs
    layout: Layout
    faces: Faces

    @property
    def bounds(self) -> Bounds:
        """The cube of voxels."""
        return self.layout.bounds


def make_surfaces(bounds: Bounds, hits: Hits) -> Surfaces:
    """Return the surfaces of hits."""
    pairs = gather_pairs(hits)
    layout = plan_layout(bounds, pairs)
    return Surfaces(hits, pairs, layout, make_faces(layout, pairs))


class SideLights:
    """The direct light that falls on hits in a scene, computed again and again; ``samples`` of it at each hit."""

    def __init__(self, scene: Any, samples: int) -> None:
        self._scene = scene
        self._samples = samples
        self._recorded = Recorded(self._sample, lambda: scene)

    def find(self, hits: Hits) -> tuple[Any, Any]:
        """Return the direct light that each side of the hits reflects, like a diffuse surface (Color3f)."""
        # A hit has the same random numbers for as long as its voxel has the same hits.
        start = np.flatnonzero(np.diff(hits.key, prepend=-1))
        rank = np.arange(len(hits)) - start.repeat(np.diff(start, append=len(hits)))
        lane, seed = (take_numbers(mi.UInt32, numbers) for numbers in (hits.key, rank))
        position, normal = take_vectors(mi.Point3f, hits.position), take_vectors(mi.Vector3f, hits.normal)
        first, second = (take_vectors(mi.Color3f, albedo) for albedo in (hits.first, hits.second))
        end = dr.opaque(mi.UInt32, self._samples)
        # A new acceleration structure would need a new kernel. Recorded functions do not, but see `Caster`.
        sample = self._recorded.run if dr.backend_v(lane) == dr.JitBackend.LLVM else self._sample
        front, back = sample(position, normal, first, second, lane, seed, end)
        dr.eval(front, back)
        return front, back

    def _sample(self, position: Any, normal: Any, first: Any, second: Any, lane: Any, seed: Any, end: Any) -> Any:
        si = dr.zeros(mi.SurfaceInteraction3f)
        si.p, si.n = position, mi.Normal3f(normal)

        def take(index: Any, front: Any, back: Any) -> tuple[Any, Any]:
            point = draw_point(make_rng(lane, index, seed))
            light, radiance = self._scene.sample_emitter_direction(si, point, True, mi.Bool(True))
            # A hit inside a light source gets NaN or infinity from it.
            arriving = mi.Color3f(radiance) * dr.dot(light.d, normal)
            arriving = dr.select((light.pdf > 0) & dr.isfinite(dr.sum(arriving)), arriving, 0.0)
            return front + dr.maximum(arriving, 0.0), back + dr.maximum(-arriving, 0.0)

        dark = (mi.Color3f(0.0 * position.x) for _ in range(2))
        front, back = repeat(take, mi.UInt32(0), end, *dark, label="light samples")
        scale = dr.inv_pi / mi.Float(end)
        return front * first * scale, back * second * scale


class VoxelLight:
    """The light of surfaces in voxels.

    ``bounces`` is that of `lobewise.render.voxels.cones.VoxelCones`. The light is 0 until
    `solve` or `take_over` is called, and there is no ``grid``.
    """

    def __init__(self, lights: SideLights, surfaces: Surfaces, bounces: int) -> None:
        self._lights = lights
        self.surfaces = surfaces
        self._bounces = bounces
        self._area = surfaces.pairs.count.astype(np.float64).repeat(2)
        self._direct: Any = dr.zeros(mi.Color3f, len(surfaces.faces))
        self._bounced: Any = dr.zeros(mi.Color3f, len(surfaces.faces))
        self._total = np.zeros(3)
        """Sum of the direct light of all hits."""
        self._new = np.zeros(0, np.uint32)
        """Faces that have no light of an earlier moment."""
        self._parts = max(1, -(-len(surfaces.faces) // FACES_PER_STEP))
        self._turn = 0
        self._steps_left = 0
        self.grid: Grid | None = None

    def solve(self, report: Callable[[], None]) -> None:
        """Compute all light; ``report`` is called after the direct light and after every bounce."""
        self._direct = self._compute_direct()
        report()
        series, grid = [self._direct], fill_grid(self.surfaces.layout, self.surfaces.faces, self._direct)
        for _ in range(self._bounces):
            series.append(self._direct + self._gather(grid, dr.arange(mi.UInt32, len(self.surfaces.faces))))
            grid = fill_grid(self.surfaces.layout, self.surfaces.faces, series[-1])
            report()
        end = _extend(series[-3:], self._area) if self._bounces >= MIN_BOUNCES_TO_EXTEND else series[-1]
        self._bounced = end - self._direct
        self.grid = self._fill()

    def take_over(self, former: VoxelLight) -> None:
        """Take the light of an earlier moment for the faces that were there already, and follow the change."""
        old, new = former.surfaces.pairs.key, self.surfaces.pairs.key
        place = np.minimum(np.searchsorted(old, new), len(old) - 1)
        known = (old[place] == new).repeat(2)
        face = take_numbers(mi.UInt32, 2 * place.repeat(2) + np.tile((0, 1), len(new)))
        self._bounced = dr.gather(mi.Color3f, former._bounced, face, mi.Bool(known))
        dr.eval(self._bounced)
        self._total = former._total
        self._new = np.flatnonzero(~known).astype(np.uint32)
        self._turn = former._turn
        self.follow()

    def follow(self) -> None:
        """Compute the direct light again, and a part of the bounces; `refine` computes the rest.

        Until then the light that bounced before counts, times the ratio of all direct light now and before.
        """
        before = self._total
        self._direct = self._compute_direct()
        ratio = np.divide(self._total, before, out=np.ones(3), where=before > 0.0)
        # Opaque, so that no kernel is compiled for each ratio.
        self._bounced *= mi.Color3f(*(dr.opaque(mi.Float, float(part)) for part in np.minimum(ratio, MAX_RATIO)))
        self._steps_left = PASSES * self._parts if self._bounces else 0
        self.grid = self._fill()
        self.refine()

    def refine(self) -> None:
        """Compute some more of the bounces, until all are those of the scene as it is."""
        if not self._steps_left or self.grid is None:
            return
        source = self.grid
        if self._bounces == 1:
            source = fill_grid(self.surfaces.layout, self.surfaces.faces, self._direct)
        elif len(self._new):
            # New faces are near each other: what they gather twice holds the light that they send to each other.
            chosen = take_numbers(mi.UInt32, self._new)
            dr.scatter(self._bounced, self._gather(source, chosen), chosen)
            source = self._fill()
        turn = np.arange(self._turn % self._parts, len(self.surfaces.faces), self._parts, dtype=np.uint32)
        chosen = take_numbers(mi.UInt32, np.concatenate([self._new, turn]))
        if len(chosen):
            dr.scatter(self._bounced, self._gather(source, chosen), chosen)
        self._new = np.zeros(0, np.uint32)
        self._turn += 1
        self._steps_left -= 1
        self.grid = self._fill()

    @property
    def is_settled(self) -> bool:
        """Whether `refine` has nothing left to do."""
        return not self._steps_left

    def _fill(self) -> Grid:
        return fill_grid(self.surfaces.layout, self.surfaces.faces, self._direct + self._bounced)

    def _compute_direct(self) -> Any:
        if not len(self.surfaces.hits):
            return self._direct
        direct = average_radiance(self.surfaces.faces, self._lights.find(self.surfaces.hits))
        self._total = give_vectors(direct) @ self._area
        return direct

    def _gather(self, grid: Grid, chosen: Any) -> Any:
        """Return the light that some faces reflect from the grid (Color3f), through the same cones every time."""
        faces = self.surfaces.faces
        number, position, normal, albedo = (
            dr.gather(kind, values, chosen)
            for kind, values in (
                (mi.UInt32, faces.number),
                (mi.Point3f, mi.Point3f(faces.position)),
                (mi.Vector3f, faces.normal),
                (mi.Color3f, faces.albedo),
            )
        )
        rng = make_rng(number, mi.UInt32(0), mi.UInt32(0))
        light = albedo * gather_diffuse(grid, position, normal, normal, rng, dr.max(albedo) > 0)
        dr.eval(light)
        return light


def _extend(series: list[Any], area: Floats) -> Any:
    """Return the limit of a series from its last three members, as if it continued as a geometric series.

    The ratio is that of the total light of all faces, for each colour.
    """
    before, last, end = (give_vectors(member).astype(np.float64) for member in series)
    gains = (last - before) @ area, (end - last) @ area
    ratio = np.clip(np.divide(gains[1], gains[0], out=np.zeros(3), where=gains[0] > 0), 0.0, MAX_GAIN)
    limit = end + np.maximum(end - last, 0.0) * (ratio / (1.0 - ratio))[:, None]
    return take_vectors(mi.Color3f, limit)
