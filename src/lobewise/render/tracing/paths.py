"""The path tracer. All samples of a pixel run in one lane, so sums live in registers and need no atomics.

One kernel runs a loop over samples around a loop over bounces. Memory does not depend on the number of samples. The
random numbers of a sample depend only on its pixel, its index and the seed, so neither tiles, chunks nor threads change
a bit of the result.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lobewise.render.bridge import dr, follow, mi, repeat, starts_as
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_share, dispatch_surface
from lobewise.render.tracing.light_sampling import Scattering, Vertex, make_eye, meet_emitter, scatter
from lobewise.render.tracing.points import Indirect, Points, average_samples
from lobewise.render.tracing.rays import draw_point, hides_emitters, invert_distance, make_opaque, make_ray, make_rng
from lobewise.render.tracing.samples import Sample, Sums, add_sample, make_sample

ROULETTE_DEPTH = 5
"""Length of paths, vertices after the camera, from which they end at random, as in Mitsuba's path tracer."""


@dataclass(frozen=True)
class PathSettings:
    """The images that a pass of the path tracer computes."""

    max_depth: int
    """Longest path, vertices after the camera: 1 shows only light sources, 2 adds direct light."""
    radiance: bool = True
    """Whether to compute radiance. Otherwise paths end at the hit of the first bounce."""
    guides: bool = True
    """Whether to split radiance by lobe and to sum guides and squares."""
    surfaces: bool = True
    """Whether the guides include albedos."""
    min_bounces: int = 0
    """Smallest number of scatterings of light that counts: 0 keeps all light, 2 only indirect light. The random numbers
    do not change."""
    through: bool = False
    """Whether light that was scattered once counts as well, if it passed a mask or a pane on its way to the surface.
    Shadow rays of `lobewise.render.tracing.direct` end at panes."""
    rays: bool = False
    """Whether to keep the first ray of a path. It needs ``guides``."""


@dataclass
class _Path:
    """State of the loop over bounces.

    ``share`` is the diffuse share of the first scattering. ``passed`` tells whether the path passed a surface
    unscattered after it. ``looks_specular`` tells whether the next hit is that of the first surface's specular
    reflection.
    """

    ray: Any
    rng: Any
    hit: Any
    active: Any = starts_as("Bool", True)
    throughput: Any = starts_as("Color3f", 1)
    share: Any = starts_as("Color3f")
    eta: Any = starts_as("Float", 1)
    depth: Any = starts_as("UInt32")
    bounces: Any = starts_as("UInt32")
    last: Vertex = field(default_factory=make_eye)
    passed: Any = starts_as("Bool")
    looks_specular: Any = starts_as("Bool")
    sample: Sample = field(default_factory=make_sample)


def trace_path(
    scene: Any,
    materials: dict[int, Material],
    ray: Any,
    rng: Any,
    settings: PathSettings,
    max_depth: Any,
    hit: Any = None,
) -> Sample:
    """Trace one path per lane, with next-event estimation and multiple importance sampling at every vertex.

    ``hit`` is the preliminary hit of the ray, if it is known.

    Sampling, weights and depths are those of Mitsuba's ``path`` integrator.
    Departs: contributions are split by the lobe of the first scattering. A sample's weight is ``f / p`` of all lobes
    together, so each contribution is split by the shares of the lobes in ``f``, not by the sampled lobe.
    """
    bounces = _Bounces(scene, materials, settings, max_depth)
    hit = scene.ray_intersect_preliminary(ray) if hit is None else hit
    start = _Path(ray, rng, hit, sample=make_sample(settings.rays))
    sample: Sample = follow(start, bounces.take, "bounces").sample
    return sample


@dataclass(frozen=True)
class _Bounces:
    """The body of the loop over bounces."""

    scene: Any
    materials: dict[int, Material]
    settings: PathSettings
    max_depth: Any

    def take(self, path: _Path) -> None:
        """Gather light at the hit, sample the next direction, and go to the next hit."""
        settings = self.settings
        si = path.hit.compute_surface_interaction(path.ray)
        if settings.guides:
            self._count_hit(path, si)
        if settings.radiance:
            emitted, weight = meet_emitter(self.scene, si, path.last, path.last.pdf > 0)
            if hides_emitters(self.scene):
                emitted = dr.select((path.bounces > 0) | si.is_valid(), emitted, 0.0)
            self._add_light(path, path.bounces, path.share, path.throughput * emitted * weight)
        going = si.is_valid() & (path.depth + 1 < self.max_depth)
        bsdf = si.bsdf(path.ray)
        scattering = self._scatter(path, si, bsdf, going)
        if settings.radiance:
            self._add_sampled_light(path, bsdf, scattering, going & (path.bounces == 0))
        if settings.guides:
            self._describe(path, bsdf, scattering, going & (path.bounces == 0))
        self._go_on(path, scattering, going)
        path.hit = self.scene.ray_intersect_preliminary(path.ray, False, path.active)

    def _count_hit(self, path: _Path, si: Any) -> None:
        """Add 1/t and position/t of the hit of the first specular reflection. A miss adds 0, as at infinity."""
        totals = path.sample.totals
        inverse = invert_distance(si, si.is_valid())
        totals.hit_count += dr.select(path.looks_specular, 1.0, 0.0)
        totals.hit_inverse += dr.select(path.looks_specular, inverse, 0.0)
        totals.hit_position += dr.select(path.looks_specular, mi.Vector3f(si.p) * inverse, 0.0)

    def _add_light(self, path: _Path, bounces: Any, share: Any, value: Any) -> None:
        """Add light that was scattered ``bounces`` times, with the diffuse share ``share``."""
        lobes, totals = path.sample.lobes, path.sample.totals
        if self.settings.min_bounces:
            counts = bounces >= self.settings.min_bounces
            if self.settings.through:
                counts |= (bounces > 0) & path.passed
            value = dr.select(counts, value, 0.0)
        if not self.settings.guides:
            lobes.emitted += value
            return
        lobes.emitted += dr.select(bounces == 0, value, 0.0)
        scattered = dr.select(bounces == 0, 0.0, value)
        lobes.diffuse += scattered * share
        lobes.specular += scattered * (1.0 - share)
        totals.direct += dr.select(bounces == 1, value, 0.0)
        totals.indirect += dr.select(bounces > 1, value, 0.0)

    def _scatter(self, path: _Path, si: Any, bsdf: Any, going: Any) -> Scattering:
        """Sample a light, if radiance is computed, and the BSDF."""
        settings = self.settings
        lit = going & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
        if settings.min_bounces:
            lit &= path.bounces + 1 >= settings.min_bounces
        light_point = draw_point(path.rng) if settings.radiance else None
        numbers = light_point, path.rng.next_float32(), draw_point(path.rng)
        return scatter(self.scene, si, bsdf, going, lit=lit, numbers=numbers)

    def _add_sampled_light(self, path: _Path, bsdf: Any, scattering: Scattering, first: Any) -> None:
        arriving = path.throughput * scattering.value * scattering.radiance * scattering.weight
        share = path.share
        if self.settings.guides:
            own = dispatch_share(self.materials, bsdf, scattering.si, scattering.to_light, first & scattering.lit)
            share = dr.select(first, own, share)
        self._add_light(path, path.bounces + 1, share, dr.select(scattering.lit, arriving, 0.0))

    def _describe(self, path: _Path, bsdf: Any, scattering: Scattering, first: Any) -> None:
        """Set the diffuse share of the first scattering, and add albedos."""
        scatters = first & ~scattering.is_null
        share = dispatch_share(
            self.materials, bsdf, scattering.si, scattering.chosen.wo, scatters & ~scattering.is_delta
        )
        path.share = dr.select(scatters, dr.select(scattering.is_delta, 0.0, share), path.share)
        if self.settings.surfaces:
            surface = dispatch_surface(self.materials, bsdf, scattering.si, scatters)
            totals = path.sample.totals
            totals.diffuse_albedo += dr.select(scatters, surface.diffuse_albedo, 0.0)
            totals.specular_albedo += dr.select(scatters, surface.specular_albedo, 0.0)
        kind, flags = scattering.chosen.sampled_type, mi.BSDFFlags
        mirrors = mi.has_flag(kind, flags.GlossyReflection) | mi.has_flag(kind, flags.DeltaReflection)
        path.looks_specular = scatters & mirrors & (dr.max(scattering.factor) > 0)
        self._keep_ray(path, bsdf, scattering, scatters)

    @staticmethod
    def _keep_ray(path: _Path, bsdf: Any, scattering: Scattering, scatters: Any) -> None:
        """Keep the path's first ray, if the pass keeps rays."""
        ray, flags = path.sample.ray, mi.BSDFFlags
        if ray is None:
            return
        transmits = mi.has_flag(bsdf.flags(), flags.GlossyTransmission)
        transmits |= mi.has_flag(bsdf.flags(), flags.DeltaTransmission)
        ray.known |= scatters & ~transmits
        ray.specular = dr.select(scatters, scattering.factor * (1.0 - path.share), ray.specular)

    def _go_on(self, path: _Path, scattering: Scattering, going: Any) -> None:
        """Go on in the sampled direction, or end the path by Russian roulette."""
        path.ray = scattering.ray
        path.throughput *= scattering.factor
        path.eta *= scattering.chosen.eta
        path.last = scattering.vertex
        path.depth += dr.select(scattering.si.is_valid(), mi.UInt32(1), 0)
        if not self.settings.radiance:
            path.active = going & (path.bounces == 0) & (scattering.is_null | path.looks_specular)
        path.passed |= scattering.is_null & (path.bounces > 0)
        path.bounces += dr.select(scattering.is_null, mi.UInt32(0), 1)
        if self.settings.radiance:
            strongest = dr.max(path.throughput)
            keep = dr.minimum(strongest * dr.square(path.eta), 0.95)
            gamble = path.depth >= ROULETTE_DEPTH
            survives = path.rng.next_float32() < keep
            path.throughput = dr.select(gamble, path.throughput * dr.rcp(keep), path.throughput)
            path.active = going & (~gamble | survives) & (strongest != 0)


def add_samples(
    scene: Any,
    materials: dict[int, Material],
    sums: Sums,
    *,
    pixels: tuple[int, int],
    size: tuple[int, int],
    samples: tuple[int, int],
    seed: int,
    settings: PathSettings,
    scale: int = 1,
    place: tuple[int, int] = (0, 0),
    listed: Any = None,
) -> Sums:
    """Return ``sums`` with the samples ``samples[0]`` to ``samples[1] - 1`` of a run of pixels added, evaluated.

    ``pixels`` holds the first pixel (row-major) and the number of pixels, ``size`` the width and height of the image.
    With ``scale``, only every ``scale``-th pixel of every ``scale``-th row counts, from row and column ``place`` on.
    ``listed`` holds numbers of pixels, which ``pixels`` then indexes. A pixel has the same bits in all three cases.
    """
    # Opaque numbers keep the compiled kernel valid for other chunks, sizes and depths.
    width, height = (dr.opaque(mi.UInt32, length) for length in size)
    counted = dr.arange(mi.UInt32, pixels[1]) + dr.opaque(mi.UInt32, pixels[0])
    if listed is not None:
        pixel = dr.gather(mi.UInt32, listed, counted)
    else:
        step, first_row, first_column = (dr.opaque(mi.UInt32, number) for number in (scale, *place))
        columns = (width - first_column + step - 1) // step
        pixel = (first_row + step * (counted // columns)) * width + first_column + step * (counted % columns)
    first, end, max_depth = (dr.opaque(mi.UInt32, number) for number in (*samples, settings.max_depth))
    seed_value = make_opaque(seed)

    def take(index: Any, sums: Sums) -> tuple[Sums]:
        rng = make_rng(pixel, index, seed_value)
        ray = make_ray(scene, pixel, (width, height), draw_point(rng))
        add_sample(sums, trace_path(scene, materials, ray, rng, settings, max_depth), index)
        return (sums,)

    (sums,) = repeat(take, first, end, sums, label="samples")
    dr.eval(sums)
    return sums


class PathLight:
    """Indirect light by path tracing: noisy but unbiased, the reference for other methods.

    Paths begin at the pixel's centre and use BSDF importance sampling, next-event estimation and Russian roulette.

    Parameters
    ----------
    scene : mitsuba.Scene
    materials : dict
        Materials of the scene; see `lobewise.render.materials.bsdfs.read_scene_materials`.
    max_depth : int
        Longest path, vertices after the camera. Below 3 there is no indirect light.
    through : bool
        See `PathSettings`; the interactive chain sets it.
    """

    name = "paths"
    worth = 1.0
    state = None

    def __init__(
        self, scene: Any, materials: dict[int, Material], *, max_depth: int = 8, through: bool = False
    ) -> None:
        self._scene = scene
        self._materials = materials
        self._settings = PathSettings(max_depth=max_depth, min_bounces=2, through=through, surfaces=False, rays=True)

    def get_band_limit(self, points: Points, samples: int) -> float:
        """Return 0, because directions are sampled by the lobes; see `IndirectMethod`."""
        return 0.0

    def shade(self, points: Points, *, samples: Any, seed: Any) -> Indirect:
        """Return the mean of ``samples`` paths; see `IndirectMethod`."""
        settings, albedo = self._settings, dr.sum(points.surface.specular_albedo)
        max_depth = dr.opaque(mi.UInt32, settings.max_depth)
        seed_value = make_opaque(seed)

        def take(index: Any) -> tuple[Any, ...]:
            rng = make_rng(points.pixel, index, seed_value)
            traced = trace_path(self._scene, self._materials, points.ray, rng, settings, max_depth, points.hit)
            assert traced.ray is not None
            # Radiance that passes a boundary is divided by the square of the index, and the albedo is not.
            weight = dr.select(traced.ray.known & (albedo > 0), dr.sum(traced.ray.specular) / albedo, 1.0)
            lobes, totals = traced.lobes, traced.totals
            return lobes.diffuse, lobes.specular, totals.hit_count, totals.hit_inverse, weight

        return average_samples(take, make_opaque(samples), rays=True)
