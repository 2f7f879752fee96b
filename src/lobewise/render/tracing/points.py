"""The interface of indirect light: first surfaces of some pixels in, radiance by lobe and hit distances out.

Whatever computes indirect light (paths, voxel cones, virtual lights) takes `Points` and gives `Indirect`; the chain
that filters and shows it knows no more of it than that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from lobewise.render.bridge import dr, follow, mi, repeat, starts_as
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_surface
from lobewise.render.materials.surface import Surface
from lobewise.render.tracing.rays import make_ray

MOST_LAYERS = 32
"""How many transparent surfaces the pixel-centre ray may pass."""

OPAQUE_FROM = 0.5
"""Opacity from which a masked surface is the one that a pixel shows."""


@dataclass
class Points:
    """What the centres of some pixels see, one pixel per lane (Dr.Jit arrays; a PyTree).

    ``pixel`` is the pixel's number in the image, row-major; ``ray`` goes through its centre; ``active`` tells whether
    it meets a surface, and ``si``, ``bsdf`` and ``surface`` hold that one, the first that is more opaque than not.
    """

    pixel: Any
    ray: Any
    si: Any
    bsdf: Any
    surface: Surface
    active: Any


@dataclass
class Indirect:
    """Radiance that was scattered at least twice before it reached the camera (Dr.Jit arrays; a PyTree).

    ``diffuse`` and ``specular`` (Color3f, linear, >= 0, albedo included) are told apart by the lobe of the camera's own
    surface; ``hit_distance`` (Float) is how far away is what its specular lobe sees: 0 unknown, inf nothing.
    """

    diffuse: Any
    specular: Any
    hit_distance: Any


def average_samples(take_sample: Callable[[Any], tuple[Any, Any, Any, Any]], samples: Any) -> Indirect:
    """Return the mean over a number of samples, not evaluated yet.

    ``take_sample`` returns, for the number of a sample, its diffuse and specular radiance, whether it was reflected to
    see anything (Float, 0 or 1) and the inverse of the distance of what it saw.
    """

    def take(index: Any, *sums: Any) -> tuple[Any, ...]:
        return tuple(total + value for total, value in zip(sums, take_sample(index), strict=True))

    start = mi.Color3f(0), mi.Color3f(0), mi.Float(0), mi.Float(0)
    diffuse, specular, hits, inverse = repeat(take, mi.UInt32(0), samples, *start, label="samples")
    share = dr.rcp(mi.Float(samples))
    distance = dr.select(inverse > 0, hits / inverse, dr.inf)
    return Indirect(diffuse * share, specular * share, dr.select(hits > 0, distance, 0.0))


class IndirectMethod(Protocol):
    """A way of computing indirect light in a scene that it was made for."""

    @property
    def name(self) -> str:
        """What users choose it by."""

    @property
    def worth(self) -> float:
        """How many paths one of its samples is worth, by their noise: what filters adapt to."""

    @property
    def state(self) -> Any:
        """The Dr.Jit arrays that a replay of `shade` (``dr.freeze``) reads beside the scene (a PyTree), or None."""

    def find_band_limit(self, points: Points, samples: int) -> float:
        """Return the angle, radians, below which a lobe shows the method's samples instead of the scene; 0 for none.

        Light that is not sampled by the BRDF is made of few directions, which a sharp lobe tells apart.
        """

    def shade(self, points: Points, *, samples: Any, seed: Any) -> Indirect:
        """Return the indirect light at points, not evaluated yet.

        Parameters
        ----------
        points : Points
            Any pixels, in any order; what a pixel gets does not depend on the others.
        samples : int or mitsuba.UInt32
            How much to spend on each, >= 1: paths, jittered cones or subsets of lights.
        seed : int or mitsuba.UInt32
            Same seed, same bits; another seed for every frame.
        """


@dataclass
class _Layers:
    ray: Any
    si: Any = starts_as("SurfaceInteraction3f")
    surface: Surface = field(default_factory=Surface)
    count: Any = starts_as("UInt32")
    active: Any = starts_as("Bool", True)


def find_first_opaque(scene: Any, materials: dict[int, Material], ray: Any) -> tuple[Any, Surface]:
    """Return the first hit that is more opaque than not, and its guides."""

    def look(ray: Any, active: Any) -> tuple[Any, Surface]:
        si = scene.ray_intersect(ray, active)
        return si, dispatch_surface(materials, si.bsdf(ray), si, active & si.is_valid())

    if not any(material.can_be_transparent for material in materials.values()):
        return look(ray, mi.Bool(True))

    def pass_through(state: _Layers) -> None:
        state.si, state.surface = look(state.ray, state.active)
        state.ray = state.si.spawn_ray(state.ray.d)
        state.count += 1
        state.active = state.si.is_valid() & (state.surface.opacity < OPAQUE_FROM) & (state.count < MOST_LAYERS)

    end = follow(_Layers(ray), pass_through, "layers")
    return end.si, end.surface


def find_points(scene: Any, materials: dict[int, Material], pixel: Any, size: tuple[Any, Any]) -> Points:
    """Return what the centres of pixels see, by their numbers, row-major.

    ``size`` is width and height of the image; opaque, so that another size needs no other kernel.
    """
    ray = make_ray(scene, pixel, size, mi.Point2f(0.5))
    si, surface = find_first_opaque(scene, materials, ray)
    return Points(pixel, ray, si, si.bsdf(), surface, si.is_valid())
