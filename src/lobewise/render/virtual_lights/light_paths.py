"""Virtual lights from light paths.

Each light is one hit of a path that begins at an emitter (Keller 1997, "Instant Radiosity"). It emits light with the
BSDF of its surface, so a set of lights keeps all data that a BSDF needs."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.render.bridge import dr, follow, mi, starts_as
from lobewise.render.materials.bsdfs import Material
from lobewise.render.tracing.points import MAX_LAYERS

QUASI_BOUNCES = 6
"""Bounces with quasi-random numbers. Later bounces, which few paths reach, have pseudo-random numbers."""

MAX_SURVIVAL = 0.95
"""Largest probability that a light path goes on, as in Mitsuba's path tracer."""

# Random numbers per emission and per bounce.
_OF_EMISSION, _OF_BOUNCE = 5, 4


@dataclass
class LightSet:
    """Virtual lights in the order of their paths, one per lane (Dr.Jit arrays, evaluated).

    ``si`` and ``bsdf`` describe the surface. ``incoming`` is the direction to the light's source (unit vector, local to
    ``si``), ``cosine`` its cosine with the geometric normal, and ``flux`` (Color3f) the arriving light. ``depth``
    counts the surfaces from the emitter on, including this one. ``number`` counts the lights; an empty set holds one
    dark light.
    """

    si: Any
    bsdf: Any
    incoming: Any
    cosine: Any
    flux: Any
    depth: Any
    number: int = 1

    @property
    def arrays(self) -> tuple[Any, ...]:
        """All fields except the number."""
        return self.si, self.bsdf, self.incoming, self.cosine, self.flux, self.depth


@dataclass
class _Walk:
    ray: Any
    rng: Any
    active: Any = starts_as("Bool", True)
    throughput: Any = starts_as("Color3f", 1)
    bounce: Any = starts_as("UInt32")


def _list_primes(number: int) -> list[int]:
    primes: list[int] = []
    candidate = 2
    while len(primes) < number:
        if all(candidate % prime for prime in primes):
            primes.append(candidate)
        candidate += 1
    return primes


def make_halton(count: int, dimensions: int, seed: int) -> NDArray[np.float32]:
    """Return the first points of a scrambled Halton sequence, shape (count, dimensions), in [0, 1).

    The digits of each place are permuted at random, because the unpermuted digits of large bases are correlated.

    Source: Halton 1960; random digit permutations as in Owen 2017, "A randomized Halton algorithm in R". Every point is
    uniformly distributed, and runs of points are spread evenly.
    """
    rng = np.random.default_rng(seed)
    points = np.empty((count, dimensions), dtype=np.float32)
    for dimension, base in enumerate(_list_primes(dimensions)):
        value = np.zeros(count)
        rest, scale = np.arange(count), 1.0
        # Digits beyond the precision of a float change nothing.
        while scale > 2.0**-26:
            scale /= base
            value += scale * rng.permutation(base)[rest % base]
            rest = rest // base
        points[:, dimension] = np.minimum(value, 1.0 - 2.0**-24)
    return points


def measure_sphere(scene: Any) -> tuple[NDArray[np.float64], float]:
    """Return centre and radius of the sphere around the bounding box of all shapes.

    Departs from ``scene.bbox()``, which lacks the meshes that Mitsuba 3.9 merges: their boxes are not valid.
    """
    boxes = []
    for shape in scene.shapes():
        if not shape.bbox().valid() and shape.is_mesh():
            shape.recompute_bbox()
        if shape.bbox().valid():
            boxes.append(shape.bbox())
    if not boxes:
        return np.zeros(3), 1.0
    low = np.min([np.asarray(box.min, dtype=np.float64).ravel() for box in boxes], axis=0)
    high = np.max([np.asarray(box.max, dtype=np.float64).ravel() for box in boxes], axis=0)
    return 0.5 * (low + high), float(np.linalg.norm(high - low)) / 2.0


class LightPaths:
    """Paths from the emitters of a scene. They do not change while the scene does not change.

    ``count`` is the number of paths, ``most_surfaces`` the largest number of surfaces on each, and ``seed`` the seed of
    the scrambling.
    """

    def __init__(self, scene: Any, count: int, most_surfaces: int, seed: int) -> None:
        self._scene = scene
        self._count = count
        self._slots = most_surfaces
        dimensions = _OF_EMISSION + _OF_BOUNCE * min(most_surfaces - 1, QUASI_BOUNCES)
        self._points = mi.Float(make_halton(count, dimensions, seed).ravel())
        self._dimensions = dimensions
        self._seed = seed

    def trace(self) -> LightSet:
        """Return the lights that the paths leave; InputError if no light leaves the emitters."""
        origin, direction, flux = self._trace_rays()
        strongest = dr.max(flux)
        lit_slots = dr.compress((strongest > 0) & dr.isfinite(strongest))
        number = len(lit_slots)
        if not number:
            lit_slots = mi.UInt32(0)
        ray = mi.Ray3f(dr.gather(mi.Point3f, origin, lit_slots), dr.gather(mi.Vector3f, direction, lit_slots))
        si = self._scene.ray_intersect(ray)
        lights = LightSet(
            si=si,
            bsdf=si.bsdf(),
            incoming=mi.Vector3f(si.wi),
            cosine=dr.abs(dr.dot(si.n, ray.d)),
            flux=dr.gather(mi.Color3f, flux, lit_slots) if number else mi.Color3f(0),
            depth=lit_slots % dr.opaque(mi.UInt32, self._slots) + 1,
            number=number,
        )
        dr.make_opaque(*lights.arrays)
        return lights

    def _trace_rays(self) -> tuple[Any, Any, Any]:
        """Return origin, direction and flux of each path's ray to each of its surfaces; flux 0 if there is none."""
        scene = self._scene
        slots, dimensions = dr.opaque(mi.UInt32, self._slots), dr.opaque(mi.UInt32, self._dimensions)
        share = dr.opaque(mi.Float, 1.0 / self._count)
        path = dr.arange(mi.UInt32, self._count)
        size = self._count * self._slots
        origin, direction, flux = dr.zeros(mi.Point3f, size), dr.zeros(mi.Vector3f, size), dr.zeros(mi.Color3f, size)

        def draw(place: Any) -> Any:
            return dr.gather(mi.Float, self._points, path * dimensions + place)

        first = [draw(mi.UInt32(k)) for k in range(_OF_EMISSION)]
        place, aim = mi.Point2f(*first[1:3]), mi.Point2f(*first[3:])
        ray, power, emitter = scene.sample_emitter_ray(0.0, first[0], place, aim, True)
        power = power * share * self._widen(ray, emitter)
        if not dr.any((dr.max(power) > 0) & dr.isfinite(dr.max(power))):
            expected = "an emitter that sends light out"
            got = f"{len(scene.emitters())} emitters and no light from them"
            raise InputError("scene", expected=expected, got=got, action="add one, or switch one on")
        rng = mi.PCG32()
        state, sequence = mi.sample_tea_32(path, dr.opaque(mi.UInt32, self._seed & 0xFFFFFFFF))
        rng.seed(initstate=state, initseq=sequence)

        def bounce(walk: _Walk) -> None:
            si = scene.ray_intersect(walk.ray)
            bsdf = si.bsdf(walk.ray)
            is_hit = si.is_valid()
            slot = path * slots + walk.bounce
            leaves_light = is_hit & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            dr.scatter(origin, walk.ray.o, slot, leaves_light)
            dr.scatter(direction, walk.ray.d, slot, leaves_light)
            dr.scatter(flux, walk.throughput * power, slot, leaves_light)

            going = is_hit & (walk.bounce + 1 < slots)
            place = _OF_EMISSION + _OF_BOUNCE * walk.bounce
            quasi = place + _OF_BOUNCE <= dimensions
            numbers = []
            for k in range(_OF_BOUNCE):
                drawn = dr.gather(mi.Float, self._points, path * dimensions + place + k, quasi)
                numbers.append(dr.select(quasi, drawn, walk.rng.next_float32()))
            walk.throughput *= sample_onward(si, bsdf, walk.ray, numbers, going)
            strongest = dr.max(walk.throughput)
            chance = dr.minimum(strongest, MAX_SURVIVAL)
            walk.active = going & (numbers[3] < chance)
            walk.throughput *= dr.select(walk.active, dr.rcp(chance), 0.0)
            walk.bounce += 1

        follow(_Walk(ray, rng), bounce, "light paths")
        dr.eval(origin, direction, flux)
        return origin, direction, flux

    def _widen(self, ray: Any, emitter: Any) -> Any:
        """Move the origins of rays from infinite emitters onto `measure_sphere`, and return the factor of their power.

        Mitsuba starts them on the scene's own bounding sphere, which may be too small.
        """
        box = self._scene.bbox()
        # Without a valid box Mitsuba uses a sphere of this size around the origin.
        old_center, old_radius = np.zeros(3), float(mi.math.RayEpsilon)
        if box.valid():
            old_center = np.asarray(box.center(), dtype=np.float64).ravel()
            old_radius = max(old_radius, math.dist(np.ravel(box.min), np.ravel(box.max)) / 2.0)
        center, radius = measure_sphere(self._scene)
        flags, kinds = emitter.flags(), mi.EmitterFlags
        distant = mi.has_flag(flags, kinds.Infinite) | mi.has_flag(flags, kinds.DeltaDirection)
        grown = dr.opaque(mi.Float, radius / old_radius)
        old, new = (mi.Point3f(*(dr.opaque(mi.Float, float(x)) for x in place)) for place in (old_center, center))
        ray.o = dr.select(distant, new + (ray.o - old) * grown, ray.o)
        return dr.select(distant, dr.square(grown), 1.0)


def sample_onward(si: Any, bsdf: Any, ray: Any, numbers: list[Any], active: Any) -> Any:
    """Replace ``ray`` by the next one of a light path and return the factor of its flux (Color3f).

    The BSDF is evaluated as for a camera path, with the directions swapped. So shading normals, normal maps and
    refraction give the same image as camera paths (Veach 1997, section 5.3).
    """
    context = mi.BSDFContext(mi.TransportMode.Importance)
    chosen, weight = bsdf.sample(context, si, numbers[0], mi.Point2f(numbers[1], numbers[2]), active)
    onward = si.to_world(chosen.wo)
    is_delta = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
    value = evaluate_towards(si, bsdf, si.wi, chosen.wo, active & ~is_delta)
    cosine_in, cosine_out = dr.abs(dr.dot(si.n, ray.d)), dr.abs(dr.dot(si.n, onward))
    smooth = value * (cosine_out / (cosine_in * chosen.pdf))
    factor = dr.select(is_delta, weight, smooth)
    onward_ray = si.spawn_ray(onward)
    ray.o, ray.d, ray.maxt = onward_ray.o, onward_ray.d, onward_ray.maxt
    return dr.select(active & (dr.max(weight) > 0) & dr.isfinite(dr.max(factor)), factor, 0.0)


def evaluate_towards(si: Any, bsdf: Any, incoming: Any, outgoing: Any, active: Any) -> Any:
    """Return ``f cos`` of light from ``incoming`` to ``outgoing`` (both local to ``si``, pointing away from it).

    The cosine is that of the incoming direction.
    """
    turned = mi.SurfaceInteraction3f(si)
    turned.wi = mi.Vector3f(outgoing)
    return bsdf.eval(mi.BSDFContext(), turned, incoming, active)


class Visibility:
    """Visibility between surfaces and places of a scene."""

    def __init__(self, scene: Any, materials: dict[int, Material]) -> None:
        self._scene = scene
        self._is_clear = not any(material.can_be_transparent for material in materials.values())

    def see(self, si: Any, place: Any, active: Any) -> Any:
        """Return the visibility of a place (Color3f): 0 or 1, or in between behind masked surfaces."""
        ray = si.spawn_ray_to(place)
        if self._is_clear:
            return mi.Color3f(dr.select(active & ~self._scene.ray_test(ray, active), 1.0, 0.0))

        def pass_through(ray: Any, through: Any, layers: Any) -> tuple[Any, Any, Any]:
            hit = self._scene.ray_intersect(ray)
            met = hit.is_valid()
            passed = hit.bsdf().eval_null_transmission(hit, met)
            through *= dr.select(met, passed, 1.0)
            onward = hit.spawn_ray_to(place)
            layers = dr.select(met & (dr.max(through) > 0), layers - 1, 0)
            # A light behind `MAX_LAYERS` layers counts as hidden.
            through = dr.select(met & (layers == 0), 0.0, through)
            return onward, through, layers

        start = (ray, mi.Color3f(dr.select(active, 1.0, 0.0)), dr.select(active, mi.UInt32(MAX_LAYERS), 0))
        return dr.while_loop(start, lambda *state: state[2] > 0, pass_through, label="visibility")[1]
