"""Indirect light from virtual lights, also known as instant radiosity: the same few lights serve all pixels.

Source: Keller 1997, "Instant Radiosity"; interleaved sampling by Keller and Heidrich 2001; bounded geometry terms by
Kollig and Keller 2006, "Illumination in the Presence of Weak Singularities"; spheres in place of points by Hasan,
Krivanek, Walter and Bala 2009, "Virtual Spherical Lights for Many-Light Rendering of Glossy Scenes".
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lobewise.errors import InputError, name_value, require_integer
from lobewise.render.bridge import dr, follow, mi, starts_as
from lobewise.render.camera import get_image_size
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import split_scattering
from lobewise.render.tracing.light_sampling import Vertex, make_eye, meet_emitter, scatter
from lobewise.render.tracing.points import Indirect, Points, average_samples
from lobewise.render.tracing.rays import draw_point, invert_distance, make_opaque, make_rng
from lobewise.render.virtual_lights.light_paths import LightPaths, LightSet, find_sphere
from lobewise.render.virtual_lights.shading import Lighting

LIGHTS_PER_SAMPLE = 32
"""Lights per sample of a pixel."""

MAX_PATHS = 1 << 20
"""Largest number of light paths."""
MAX_DEPTH = 64
"""Longest path from the camera to the emitter, vertices after the camera."""

# Roberts 2018, "The unreasonable effectiveness of quasirandom sequences": 1/g, 1/g^2 of the plastic number and 1/g of
# the golden one, as parts of 2^32: products that wrap around are fractions.
_STEP_X, _STEP_Y, _STEP_FRAME = 3242174889, 2447445414, 2654435769


@dataclass
class _Walk:
    """State of the loop that follows mirrors, refractions and rays of compensation."""

    active: Any
    ray: Any
    rng: Any
    start: Any = starts_as("Bool", True)
    throughput: Any = starts_as("Color3f", 1)
    share: Any = starts_as("Color3f")
    depth: Any = starts_as("UInt32")
    bounces: Any = starts_as("UInt32")
    last: Vertex = field(default_factory=make_eye)
    last_cosine: Any = starts_as("Float", 1)
    diffuse: Any = starts_as("Color3f")
    specular: Any = starts_as("Color3f")
    looks: Any = starts_as("Bool")
    hit_count: Any = starts_as("Float")
    hit_inverse: Any = starts_as("Float")


class VirtualLights:
    """Lights at the hits of quasi-random light paths, which light the points through visibility rays.

    The radiance differs from that of paths in three ways. A light nearer than the clamp is darker, so corners are too
    dark, unless ``compensate`` adds the missing light by short rays. Light from an emitter by mirrors or smooth glass
    alone (a caustic seen directly) is missing, because no light can lie on a mirror. The error of a small number of
    lights is not noise but blotches, the same in all pixels, and spikes on glossy surfaces.

    Rays from smooth mirrors and glass are followed to the next other surface, which is also lit directly.

    Parameters
    ----------
    scene : mitsuba.Scene
    materials : dict
        Materials of the scene; see `lobewise.render.materials.bsdfs.read_scene_materials`.
    count : int
        Number of light paths, 1 to 2^20. Each leaves a light at every surface that it hits, except on mirrors.
    max_depth : int
        Longest path from the camera to the emitter, vertices after the camera, 3 to 64.
    clamp : float
        Distance from a light, over the diagonal of the scene's bounding box, 0 to 1. The geometry term is limited to
        its inverse square. With 0 there is no limit, and single lights dominate corners.
    compensate : bool
        Whether rays of the points' own BSDF add the clamped light: unbiased, with a little noise in corners. Has no
        effect on spheres, or without a clamp.
    radius : float
        Radius of spheres that replace the point lights, over the same diagonal, 0 to 1. With 0 lights are points.
        Spheres ignore ``clamp``.
    seed : int
        Seed of the light paths.

    Raises
    ------
    InputError
        If a number is out of range, or no emitter of the scene emits light.
    """

    name = "virtual_lights"
    # Variance of one path over that of one sample, median over pixels, in three built-in scenes: 1.7 to 39 for diffuse
    # light, 1.5 to 6 for specular light.
    worth = 4.0

    def __init__(
        self,
        scene: Any,
        materials: dict[int, Material],
        *,
        count: int = 1024,
        max_depth: int = 8,
        clamp: float = 0.05,
        compensate: bool = False,
        radius: float = 0.0,
        seed: int = 0,
    ) -> None:
        require_integer("count", count, 1, MAX_PATHS)
        require_integer("max_depth", max_depth, 3, MAX_DEPTH)
        require_integer("seed", seed, 0, (1 << 32) - 1)
        _require_part("clamp", clamp)
        _require_part("radius", radius)
        self._scene = scene
        self._materials = materials
        self._max_depth = max_depth
        self._clamp = clamp
        self._radius = radius
        self._compensates = compensate and clamp > 0.0 and radius == 0.0
        passes = mi.BSDFFlags.Null | mi.BSDFFlags.DeltaReflection | mi.BSDFFlags.DeltaTransmission
        self._follows = self._compensates or any(
            mi.has_flag(node.bsdf.flags(), passes) for material in materials.values() for node in material
        )
        self._paths = LightPaths(scene, count, max_depth - 2, seed)
        self.update()

    def update(self) -> None:
        """Trace the lights again after a change of the scene, without compiling again."""
        self._lights = self._paths.trace()
        _, half_diagonal = find_sphere(self._scene)
        self._lighting = Lighting(
            self._scene,
            self._materials,
            self._lights,
            shortest=2.0 * self._clamp * half_diagonal,
            radius=2.0 * self._radius * half_diagonal,
        )
        self._numbers = {
            "number": dr.opaque(mi.UInt32, self._lights.number),
            "max_depth": dr.opaque(mi.UInt32, self._max_depth),
            # If the size of the film changes later, only the spread of runs over pixels gets less even.
            "width": dr.opaque(mi.UInt32, get_image_size(self._scene)[0]),
        }

    @property
    def state(self) -> Any:
        """See `lobewise.render.tracing.points.IndirectMethod`."""
        return self._numbers, self._lighting.state

    @property
    def lights(self) -> LightSet:
        """The set of lights."""
        return self._lights

    def shade(self, points: Points, *, samples: Any, seed: Any, all_lights: bool = False) -> Indirect:
        """Return the light of some or all lights; see `lobewise.render.tracing.points.IndirectMethod`.

        A sample takes one run of about `LIGHTS_PER_SAMPLE` lights, in the order of their paths. Its weight makes the
        mean over seeds the sum over all lights. Neighbouring pixels and successive frames take runs far apart. With
        ``all_lights`` each sample takes all lights. Only mirrors and smooth glass have a hit distance, others have 0.
        """
        end, seed_value = make_opaque(samples), make_opaque(seed)
        runs = self._count_runs(mi.UInt32(1), all_lights)
        stride = dr.maximum(runs // end, 1)
        first_run = self._choose_run(points.pixel, runs, seed_value)

        def take(index: Any) -> tuple[Any, Any, Any, Any]:
            rng = make_rng(points.pixel, index, seed_value)
            walk = self._walk(points, rng, (first_run + index * stride) % runs, runs)
            return walk.diffuse, walk.specular, walk.hit_count, walk.hit_inverse

        return average_samples(take, end)

    def find_band_limit(self, points: Points, samples: int) -> float:
        """Return `find_sharpness_limit` of the lights that points see, radians."""
        return find_sharpness_limit(self.count_lights_seen(points, samples=samples))

    def count_lights_seen(self, points: Points, *, samples: int = 1, all_lights: bool = False) -> float:
        """Return the effective number of lights that a pixel sees, for `find_sharpness_limit`.

        It is ``(sum L_k)^2 / sum L_k^2`` with the light ``L_k`` of each light at a point, median over points. Hidden,
        distant or averted lights count little. BSDFs and cosines of the points are left out. Some hundred lit points
        are enough. ``samples`` and ``all_lights`` are those of `shade`.
        """
        runs = self._count_runs(make_opaque(samples), all_lights)
        run = self._choose_run(points.pixel, runs, mi.UInt32(0))
        worth = np.asarray(self._lighting.count_worth(points, run, runs))
        lit = worth[np.asarray(points.active) & (worth > 0.0)]
        return float(np.median(lit)) if lit.size else 1.0

    def _count_runs(self, samples: Any, all_lights: bool) -> Any:
        each = samples * LIGHTS_PER_SAMPLE
        runs = dr.maximum((self._numbers["number"] + each - 1) // each, 1)
        return mi.UInt32(1) if all_lights else runs

    def _choose_run(self, pixel: Any, runs: Any, seed: Any) -> Any:
        width = self._numbers["width"]
        return dr.mul_hi(pixel % width * _STEP_X + pixel // width * _STEP_Y + seed * _STEP_FRAME, runs)

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
        si = dr.select(walk.start, points.si, scene.ray_intersect(walk.ray, ~walk.start))
        later = ~walk.start
        met = si.is_valid()

        # Count the hit of the first mirror.
        walk.hit_count += dr.select(walk.looks, 1.0, 0.0)
        walk.hit_inverse += invert_distance(si, walk.looks & met)

        # Add hit emitters, except as direct light.
        emitted, weight = meet_emitter(scene, si, walk.last, later & (walk.bounces >= 2))
        self._add(walk, walk.bounces >= 2, emitted * weight, mi.Color3f(0))

        # Keep the part of the throughput that the clamp of virtual lights removes.
        geometry = walk.last_cosine * dr.abs(dr.dot(si.n, walk.ray.d)) / dr.square(si.t)
        beyond = 1.0 - dr.minimum(self._lighting.bound / geometry, 1.0)
        kept = dr.select(walk.last.is_delta, 1.0, beyond if self._compensates else 0.0)
        walk.throughput *= dr.select(later, kept, 1.0)
        walk.active = met & (walk.depth + 2 <= max_depth) & (dr.max(walk.throughput) > 0)
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
        found = scatter(scene, si, bsdf, walk.active, lit=lit & (walk.bounces >= 1), numbers=numbers)
        self._add(walk, found.lit, found.value * found.radiance * found.weight, mi.Color3f(0))

        is_delta = found.is_delta
        first = (walk.bounces == 0) & ~found.is_null
        if self._compensates:
            going = walk.active & first & ~is_delta
            _, share = split_scattering(self._materials, bsdf, si, found.chosen.wo, going)
            walk.share = dr.select(first, dr.select(is_delta, 0.0, share), walk.share)
        # Rays of smooth lobes go on only to compensate the clamp and, after the first scattering, to hit emitters.
        walk.active &= (dr.max(found.factor) > 0) & (is_delta | ~first | mi.Bool(self._compensates))
        walk.looks = walk.active & first & is_delta
        walk.ray = found.ray
        walk.throughput *= found.factor
        walk.depth += 1
        walk.bounces += dr.select(found.is_null, mi.UInt32(0), 1)
        walk.last = found.vertex
        walk.last_cosine = dr.abs(found.chosen.wo.z)
        walk.start = mi.Bool(False)

    def _add(self, walk: _Walk, active: Any, value: Any, diffuse: Any) -> None:
        """Add ``value``, whose diffuse part is ``diffuse`` before the first scattering, and the walk's share after."""
        value = dr.select(active, value, 0.0)
        before = walk.bounces == 0
        diffuse = dr.select(before, dr.select(active, diffuse, 0.0), value * walk.share)
        walk.diffuse += walk.throughput * diffuse
        walk.specular += walk.throughput * (value - diffuse)


def find_sharpness_limit(lights: float) -> float:
    """Return the band-limit tau (radians) of lobes that are lit by a number of lights, for `lobewise.denoise`.

    Each light takes ``2 pi / lights`` steradians of a receiver's hemisphere. A lobe of sharpness ``lambda`` covers
    ``4 pi / lambda`` steradians (``(int G)^2 / int G^2`` of its spherical Gaussian), so it sees ``2 lights / lambda``
    lights. Lobes sharper than ``lambda = 2 lights`` see less than one light: they are dark, or show its spike. After
    convolution with a Gaussian of ``tau^2 = 1 / (2 lights)`` no lobe is sharper. `VirtualLights.count_lights_seen`
    counts the lights; InputError if the number is not above 0.
    """
    if not (math.isfinite(lights) and lights > 0.0):
        raise InputError("lights", expected="a number above 0", got=name_value(lights), action="count those of a pixel")
    return min(1.0 / math.sqrt(2.0 * lights), 1.0)


def _require_part(name: str, value: Any) -> None:
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not 0.0 <= value <= 1.0:
        expected = "a fraction of the scene's diagonal, 0 to 1"
        raise InputError(name, expected=expected, got=name_value(value), action="0.05 is usual")
