"""The interface of methods for indirect light: first surfaces of pixels in, radiance by lobe and hit distances out.

All methods (paths, voxel cones, virtual lights) take `Points` and return `Indirect`. The chain that filters and shows
the light knows nothing else about them.
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

MAX_LAYERS = 32
"""Largest number of transparent surfaces that a ray through a pixel's centre passes."""

MIN_SURFACE_OPACITY = 0.5
"""Smallest opacity of the surface that a pixel shows. Its ray passes through less opaque surfaces."""


@dataclass
class Points:
    """The first surfaces at the centres of some pixels, one pixel per lane (Dr.Jit arrays; a PyTree).

    ``pixel`` is the row-major number of the pixel, and ``ray`` goes through its centre. ``active`` tells whether the
    ray hits a surface; ``si``, ``bsdf`` and ``surface`` describe the first one that is more opaque than not. ``hit`` is
    the preliminary hit of the ray; None where the first surface may be transparent.
    """

    pixel: Any
    ray: Any
    si: Any
    bsdf: Any
    surface: Surface
    active: Any
    hit: Any = None


@dataclass
class Indirect:
    """Radiance that was scattered at least twice before it reached the camera (Dr.Jit arrays; a PyTree).

    ``diffuse`` and ``specular`` (Color3f, linear, >= 0, albedo included) are split by the lobe of the first surface.
    ``hit_distance`` (Float) is the distance of the hit of its specular lobe: 0 if unknown, inf for a miss.

    A method that traces one ray for each sample also tells ``ray_weight`` (Float), the mean over the samples of the
    weight of `lobewise.records.sparse_frame.Rays`. Otherwise it is None.
    """

    diffuse: Any
    specular: Any
    hit_distance: Any
    ray_weight: Any = None


def assign_to_lobes(surface: Surface, diffuse: Any, specular: Any) -> tuple[Any, Any]:
    """Return diffuse and specular light, moved to the other part where a surface reflects nothing by the part's lobe.

    A pixel that looks through a pane or a mask has light of several surfaces, and the guides of one. The filters take
    no light of a lobe that the guides do not name.
    """
    no_specular = dr.max(surface.specular_albedo) <= 0
    no_diffuse = ~no_specular & (dr.max(surface.diffuse_albedo) <= 0)
    total = diffuse + specular
    return (
        dr.select(no_specular, total, dr.select(no_diffuse, 0.0, diffuse)),
        dr.select(no_diffuse, total, dr.select(no_specular, 0.0, specular)),
    )


def average_samples(take_sample: Callable[[Any], tuple[Any, ...]], samples: Any, *, rays: bool = False) -> Indirect:
    """Return the mean over a number of samples, not evaluated yet.

    ``take_sample`` takes the number of a sample. It returns the diffuse and specular radiance, whether a specular
    reflection was traced (Float, 0 or 1), and the inverse distance of its hit (0 for a miss). With ``rays`` it also
    returns the weight of the sample's ray.
    """

    def take(index: Any, *sums: Any) -> tuple[Any, ...]:
        return tuple(total + value for total, value in zip(sums, take_sample(index), strict=True))

    start = mi.Color3f(0), mi.Color3f(0), mi.Float(0), mi.Float(0)
    more = (mi.Float(0),) if rays else ()
    diffuse, specular, hits, inverse, *ray = repeat(take, mi.UInt32(0), samples, *start, *more, label="samples")
    share = dr.rcp(mi.Float(samples))
    distance = dr.select(inverse > 0, hits / inverse, dr.inf)
    ray_means = (value * share for value in ray)
    return Indirect(diffuse * share, specular * share, dr.select(hits > 0, distance, 0.0), *ray_means)


class IndirectMethod(Protocol):
    """A method for the indirect light of one scene."""

    @property
    def name(self) -> str:
        """Name by which users choose the method."""

    @property
    def worth(self) -> float:
        """Number of paths with as much noise as one sample of this method; filters adapt to it."""

    @property
    def state(self) -> Any:
        """Dr.Jit arrays that `shade` reads beside the scene (a PyTree), for replay by ``dr.freeze``; or None."""

    def get_band_limit(self, points: Points, samples: int) -> float:
        """Return the width of a lobe, radians, below which it shows single samples of the method; 0 for none.

        Light that is not sampled by the BRDF comes from few directions, and a sharp lobe sees single ones.
        """

    def shade(self, points: Points, *, samples: Any, seed: Any) -> Indirect:
        """Return the indirect light at points, not evaluated yet.

        Parameters
        ----------
        points : Points
            Any pixels, in any order. The light of a pixel does not depend on the other pixels.
        samples : int or mitsuba.UInt32
            Samples per pixel, >= 1: paths, sets of jittered cones, or subsets of lights.
        seed : int or mitsuba.UInt32
            The same seed gives the same bits. Use another one for every frame.
        """


@dataclass
class _Layers:
    ray: Any
    si: Any = starts_as("SurfaceInteraction3f")
    surface: Surface = field(default_factory=Surface)
    count: Any = starts_as("UInt32")
    active: Any = starts_as("Bool", True)


def trace_first_opaque(scene: Any, materials: dict[int, Material], ray: Any) -> tuple[Any, Surface]:
    """Return the first hit that is more opaque than not, and its guides."""

    def pass_through(state: _Layers) -> None:
        state.si = scene.ray_intersect(state.ray, state.active)
        state.surface = _describe(materials, state.ray, state.si, state.active)
        state.ray = state.si.spawn_ray(state.ray.d)
        state.count += 1
        state.active = state.si.is_valid() & (state.surface.opacity < MIN_SURFACE_OPACITY) & (state.count < MAX_LAYERS)

    if can_be_transparent(materials):
        end = follow(_Layers(ray), pass_through, "layers")
        return end.si, end.surface
    si = scene.ray_intersect(ray)
    return si, _describe(materials, ray, si, mi.Bool(True))


def _describe(materials: dict[int, Material], ray: Any, si: Any, active: Any) -> Surface:
    return dispatch_surface(materials, si.bsdf(ray), si, active & si.is_valid())


def can_be_transparent(materials: dict[int, Material]) -> bool:
    """Return whether any of the materials may let light pass."""
    return any(material.can_be_transparent for material in materials.values())


def trace_points(scene: Any, materials: dict[int, Material], pixel: Any, size: tuple[Any, Any]) -> Points:
    """Return the first surfaces at the centres of pixels, given by their row-major numbers.

    ``size`` is width and height of the image, opaque, so that kernels are not compiled for each size.
    """
    ray = make_ray(scene, pixel, size, mi.Point2f(0.5))
    if can_be_transparent(materials):
        si, surface = trace_first_opaque(scene, materials, ray)
        return Points(pixel, ray, si, si.bsdf(), surface, si.is_valid())
    hit = scene.ray_intersect_preliminary(ray)
    si = hit.compute_surface_interaction(ray)
    return Points(pixel, ray, si, si.bsdf(), _describe(materials, ray, si, mi.Bool(True)), si.is_valid(), hit)
