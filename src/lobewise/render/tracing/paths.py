"""The path tracer: every sample of a pixel in one lane, so sums live in registers and need no atomics.

One kernel runs a loop over samples around a loop over bounces. Memory is per pixel, whatever the sample count; a
sample's random numbers depend on its pixel, its index and the seed alone, so neither tiles, chunks nor threads change a
bit of the result.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from lobewise.frame import LobeKind
from lobewise.render.bridge import dr, mi
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.split import find_diffuse_share
from lobewise.render.materials.surface import Surface, describe_material, make_no_surface
from lobewise.render.tracing.rays import make_rng

ROULETTE_DEPTH = 5
"""Paths of at least this length end at random, with the probability that Mitsuba's own path tracer uses."""


@dataclass(frozen=True)
class PathSettings:
    """What a pass computes.

    Parameters
    ----------
    max_depth : int
        Longest path, in vertices after the camera; 1 is light sources alone, 2 direct light.
    light : bool
        Whether to compute radiance; without it paths end when the first bounce has told what it sees.
    guides : bool
        Whether to split radiance by lobe and to sum surfaces, hits and squares.
    surfaces : bool
        With ``guides``: whether to sum albedos, of the first surface and of what its reflections see, and normals of
        the latter.
    fewest_bounces : int
        Leave out what was scattered less often: 0 keeps everything, 2 indirect light alone. Draws the same numbers.
    """

    max_depth: int
    light: bool = True
    guides: bool = True
    surfaces: bool = True
    fewest_bounces: int = 0


@dataclass
class Sample:
    """What one path brings (Dr.Jit arrays; a PyTree). Emission seen directly is in ``emitted`` alone.

    ``hit_normal`` and ``hit_albedo`` are those of the surface that a specular reflection sees, 0 where it sees none.
    """

    emitted: Any
    diffuse: Any
    specular: Any
    direct: Any
    indirect: Any
    diffuse_albedo: Any
    specular_albedo: Any
    hit_count: Any
    hit_inverse: Any
    hit_position: Any
    hit_normal: Any
    hit_albedo: Any


def make_sample() -> Sample:
    """Return what no path brings."""
    colors = [mi.Color3f(0) for _ in range(8)]  # separate objects: sums are updated in place
    return Sample(
        emitted=colors[0],
        diffuse=colors[1],
        specular=colors[2],
        direct=colors[3],
        indirect=colors[4],
        diffuse_albedo=colors[5],
        specular_albedo=colors[6],
        hit_count=mi.Float(0),
        hit_inverse=mi.Float(0),
        hit_position=mi.Vector3f(0),
        hit_normal=mi.Vector3f(0),
        hit_albedo=colors[7],
    )


@dataclass
class Sums:
    """Running sums over the samples of a pixel.

    ``halves`` are those over even and odd sample indices of (emitted, diffuse, specular); ``squares`` the sums of
    squared deviations from the mean of (color, diffuse, specular).
    """

    halves: list[Any]
    squares: list[Any]
    totals: list[Any]
    """Direct, indirect, diffuse albedo, specular albedo, hit count, sums of 1/t and of position/t, the normal and the
    albedo of what reflections see."""


def make_sums(width: int, guides: bool) -> Sums:
    """Return the sums of no samples for ``width`` pixels."""

    def zeros(kind: Any, count: int) -> list[Any]:
        return [dr.zeros(kind, width) for _ in range(count)]

    if not guides:
        return Sums(zeros(mi.Color3f, 1), [], [])
    totals = [*zeros(mi.Color3f, 4), *zeros(mi.Float, 2), *zeros(mi.Vector3f, 2), *zeros(mi.Color3f, 1)]
    return Sums(zeros(mi.Color3f, 6), zeros(mi.Color3f, 3), totals)


@dataclass
class _Path:
    """State of the loop over bounces."""

    active: Any
    ray: Any
    rng: Any
    throughput: Any
    share: Any
    eta: Any
    depth: Any
    bounces: Any
    last: Any
    last_pdf: Any
    last_delta: Any
    looks_specular: Any
    seeks: Any
    sample: Sample


def dispatch_surface(materials: dict[int, Material], bsdf: Any, si: Any, active: Any) -> Surface:
    """Return the guides at hits on any of the materials; lanes that are not active get zeros."""

    def describe(self: Any, si: Any, active: Any) -> Surface:
        material = materials.get(self.ptr)
        # Dr.Jit visits every BSDF that lives, nested ones and those of other scenes included.
        return make_no_surface() if material is None else describe_material(material, si, active)

    return dr.dispatch(bsdf, describe, si, active)  # type: ignore[no-any-return]


def dispatch_share(materials: dict[int, Material], bsdf: Any, si: Any, wo: Any, active: Any) -> Any:
    def share(self: Any, si: Any, wo: Any, active: Any) -> Any:
        material = materials.get(self.ptr)
        return mi.Color3f(0) if material is None else find_diffuse_share(material, si, wo, active)

    return dr.dispatch(bsdf, share, si, wo, active)


def is_mirror(surface: Surface) -> Any:
    """Return whether surfaces show nothing of their own: perfect mirrors and smooth glass."""
    return (surface.lobe_kind == float(LobeKind.DELTA)) & (dr.max(surface.diffuse_albedo) <= 0)


def find_seen_albedo(surface: Surface, si: Any) -> Any:
    """Return the albedo that a reflection sees, in [0, 1]: of both lobes together, and 1 where the side shines.

    Light sources of any strength are white, so that what is dark beside them differs most.
    """
    shines = si.shape.is_emitter() & (si.wi.z > 0)
    return dr.select(shines, 1.0, dr.clip(surface.diffuse_albedo + surface.specular_albedo, 0.0, 1.0))


def weigh(pdf: Any, other: Any) -> Any:
    """Return the power heuristic's weight (Veach 1997, section 9.2.4)."""
    weight = dr.square(pdf) / (dr.square(pdf) + dr.square(other))
    return dr.select(dr.isfinite(weight), weight, 0.0)


def _add(sample: Sample, bounces: Any, share: Any, value: Any, settings: PathSettings) -> None:
    """Add a contribution that the camera sees after ``bounces`` scatterings, ``share`` of it by the diffuse lobe."""
    if settings.fewest_bounces:
        value = dr.select(bounces >= settings.fewest_bounces, value, 0.0)
    if not settings.guides:
        sample.emitted += value
        return
    sample.emitted += dr.select(bounces == 0, value, 0.0)
    scattered = dr.select(bounces == 0, 0.0, value)
    sample.diffuse += scattered * share
    sample.specular += scattered * (1.0 - share)
    sample.direct += dr.select(bounces == 1, value, 0.0)
    sample.indirect += dr.select(bounces > 1, value, 0.0)


def trace_path(
    scene: Any, materials: dict[int, Material], ray: Any, rng: Any, settings: PathSettings, max_depth: Any
) -> Sample:
    """Trace one path per lane, with next-event estimation and multiple importance sampling at every vertex.

    Departs from Mitsuba's ``path`` integrator in what it keeps, not in what it estimates: the same sampling, weights
    and depths, but every contribution is told apart by the lobe of the first scattering. That lobe is not the sampled
    one: with several lobes the sample's weight is ``f / p`` of all of them, so each contribution is split by the shares
    that the lobes have of ``f``.
    """
    context = mi.BSDFContext()
    split = settings.guides

    def go_on(path: _Path) -> Any:
        return path.active

    def bounce(path: _Path) -> tuple[_Path]:
        sample = path.sample
        si = scene.ray_intersect(path.ray)
        found = si.is_valid()

        if split:
            # What the first bounce's specular lobe sees; 1/t and position/t, so that a miss counts as infinity.
            inverse = dr.select(found, dr.rcp(dr.maximum(si.t, 1e-12)), 0.0)
            sample.hit_count += dr.select(path.looks_specular, 1.0, 0.0)
            sample.hit_inverse += dr.select(path.looks_specular, inverse, 0.0)
            sample.hit_position += dr.select(path.looks_specular, mi.Vector3f(si.p) * inverse, 0.0)

        if settings.light:
            light = mi.DirectionSample3f(scene, si, path.last)
            light_pdf = scene.pdf_emitter_direction(path.last, light, ~path.last_delta)
            emitted = light.emitter.eval(si, path.last_pdf > 0)
            weight = weigh(path.last_pdf, light_pdf)
            _add(sample, path.bounces, path.share, path.throughput * emitted * weight, settings)

        going = found & (path.depth + 1 < max_depth)
        bsdf = si.bsdf(path.ray)
        first = going & (path.bounces == 0)

        local = mi.Vector3f(0, 0, 1)
        if settings.light:
            lit = going & mi.has_flag(bsdf.flags(), mi.BSDFFlags.Smooth)
            if settings.fewest_bounces:
                lit &= path.bounces + 1 >= settings.fewest_bounces
            point = mi.Point2f(path.rng.next_float32(), path.rng.next_float32())
            light, radiance = scene.sample_emitter_direction(si, point, True, lit)
            lit &= light.pdf != 0
            local = si.to_local(light.d)
        choice = path.rng.next_float32()
        point = mi.Point2f(path.rng.next_float32(), path.rng.next_float32())
        value, pdf, chosen, weight = bsdf.eval_pdf_sample(context, si, local, choice, point, going)

        if settings.light:
            seen = path.throughput * value * radiance * dr.select(light.delta, 1.0, weigh(light.pdf, pdf))
            share = path.share
            if split:
                share = dr.select(first, dispatch_share(materials, bsdf, si, local, first & lit), share)
            _add(sample, path.bounces + 1, share, dr.select(lit, seen, 0.0), settings)

        is_null = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Null)
        is_delta = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.Delta)
        if split:
            scatters = first & ~is_null
            share = dispatch_share(materials, bsdf, si, chosen.wo, scatters & ~is_delta)
            path.share = dr.select(scatters, dr.select(is_delta, 0.0, share), path.share)
            further = mi.Bool(False)
            if settings.surfaces:
                seeks = path.seeks & found
                surface = dispatch_surface(materials, bsdf, si, scatters | seeks)
                sample.diffuse_albedo += dr.select(scatters, surface.diffuse_albedo, 0.0)
                sample.specular_albedo += dr.select(scatters, surface.specular_albedo, 0.0)
                further = seeks & (is_null | (is_mirror(surface) & (dr.max(weight) > 0)))
            mirrors = mi.has_flag(chosen.sampled_type, mi.BSDFFlags.GlossyReflection) | mi.has_flag(
                chosen.sampled_type, mi.BSDFFlags.DeltaReflection
            )
            path.looks_specular = scatters & mirrors & (dr.max(weight) > 0)

        path.ray = si.spawn_ray(si.to_world(chosen.wo))
        path.throughput *= weight
        path.eta *= chosen.eta
        path.last = mi.Interaction3f(si)
        path.last_pdf = chosen.pdf
        path.last_delta = is_delta
        path.depth += dr.select(found, mi.UInt32(1), 0)
        if not settings.light:
            path.active = going & (((path.bounces == 0) & (is_null | path.looks_specular)) | further)
        path.bounces += dr.select(is_null, mi.UInt32(0), 1)

        if settings.light:
            strongest = dr.max(path.throughput)
            keep = dr.minimum(strongest * dr.square(path.eta), 0.95)
            gamble = path.depth >= ROULETTE_DEPTH
            survives = path.rng.next_float32() < keep
            path.throughput = dr.select(gamble, path.throughput * dr.rcp(keep), path.throughput)
            path.active = going & (~gamble | survives) & (strongest != 0)

        if split and settings.surfaces:
            # A path that ends within a chain of mirrors sees the last of them.
            further &= path.active
            seen = seeks & ~further
            sample.hit_normal += dr.select(seen, surface.normal, 0.0)
            sample.hit_albedo += dr.select(seen, find_seen_albedo(surface, si), 0.0)
            path.seeks = path.looks_specular | further
        return (path,)

    start = _Path(
        active=mi.Bool(True),
        ray=ray,
        rng=rng,
        throughput=mi.Color3f(1),
        share=mi.Color3f(0),
        eta=mi.Float(1),
        depth=mi.UInt32(0),
        bounces=mi.UInt32(0),
        last=dr.zeros(mi.Interaction3f),
        last_pdf=mi.Float(1),
        last_delta=mi.Bool(True),
        looks_specular=mi.Bool(False),
        seeks=mi.Bool(False),
        sample=make_sample(),
    )
    return dr.while_loop((start,), go_on, bounce, label="bounces")[0].sample  # type: ignore[no-any-return]


def _accumulate(sums: Sums, sample: Sample, index: Any, guides: bool) -> None:
    if not guides:
        sums.halves[0] += sample.emitted
        return
    parts = [sample.emitted, sample.diffuse, sample.specular]
    even = (index & 1) == 0
    color = parts[0] + parts[1] + parts[2]
    before = [sums.halves[i] + sums.halves[i + 3] for i in range(3)]
    means = [before[0] + before[1] + before[2], before[1], before[2]]
    # Welford 1962: the squared deviation grows by (x - mean)^2 n / (n + 1), which never cancels.
    count = mi.Float(index)
    rate = dr.select(index > 0, dr.rcp(count), 0.0)
    growth = count / (count + 1.0)
    for i, value in enumerate((color, parts[1], parts[2])):
        sums.squares[i] += dr.square(value - means[i] * rate) * growth
    for i, value in enumerate(parts):
        sums.halves[i] += dr.select(even, value, 0.0)
        sums.halves[i + 3] += dr.select(even, 0.0, value)
    more = (
        sample.direct,
        sample.indirect,
        sample.diffuse_albedo,
        sample.specular_albedo,
        sample.hit_count,
        sample.hit_inverse,
        sample.hit_position,
        sample.hit_normal,
        sample.hit_albedo,
    )
    for i, value in enumerate(more):
        sums.totals[i] += value


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

    Parameters
    ----------
    pixels : (int, int)
        First pixel (row-major) and how many.
    size : (int, int)
        Width and height of the image.
    scale : int
        Count every ``scale``-th pixel of a row and every ``scale``-th row only. A pixel's samples are the same bits.
    place : (int, int)
        Row and column of the first pixel that counts.
    listed : mitsuba.UInt32, optional
        The pixels themselves (row-major, of the whole image) that ``pixels`` counts, in place of a regular grid.
    """
    # Opaque numbers keep the compiled kernel valid for the next chunk, another size, and another depth.
    width, height = (dr.opaque(mi.UInt32, length) for length in size)
    counted = dr.arange(mi.UInt32, pixels[1]) + dr.opaque(mi.UInt32, pixels[0])
    if listed is not None:
        pixel = dr.gather(mi.UInt32, listed, counted)
        return _add_samples(scene, materials, sums, pixel, (width, height), samples, seed, settings)
    step, first_row, first_column = (dr.opaque(mi.UInt32, number) for number in (scale, *place))
    columns = (width - first_column + step - 1) // step
    pixel = (first_row + step * (counted // columns)) * width + first_column + step * (counted % columns)
    return _add_samples(scene, materials, sums, pixel, (width, height), samples, seed, settings)


def _add_samples(
    scene: Any,
    materials: dict[int, Material],
    sums: Sums,
    pixel: Any,
    size: tuple[Any, Any],
    samples: tuple[int, int],
    seed: int,
    settings: PathSettings,
) -> Sums:
    """Return ``sums`` with samples of the pixels ``pixel`` added, evaluated; ``size`` is opaque."""
    sensor = scene.sensors()[0]
    width, height = size
    column, row = pixel % width, pixel // width
    max_depth = dr.opaque(mi.UInt32, settings.max_depth)
    end = dr.opaque(mi.UInt32, samples[1])
    seed_value = dr.opaque(mi.UInt32, seed & 0xFFFFFFFF)

    def go_on(index: Any, sums: Sums) -> Any:
        return index < end

    def take(index: Any, sums: Sums) -> tuple[Any, Sums]:
        rng = make_rng(pixel, index, seed_value)
        x = (mi.Float(column) + rng.next_float32()) / mi.Float(width)
        y = (mi.Float(row) + rng.next_float32()) / mi.Float(height)
        ray, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(x, y), mi.Point2f(0.5))
        sample = trace_path(scene, materials, ray, rng, settings, max_depth)
        _accumulate(sums, sample, index, settings.guides)
        return index + 1, sums

    index = dr.opaque(mi.UInt32, samples[0])
    _, sums = dr.while_loop((index, sums), go_on, take, label="samples")
    dr.eval(sums)
    return sums
