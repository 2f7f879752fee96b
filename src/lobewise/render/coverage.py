"""Coverage: the shares of every pixel's area that show the surfaces at the centres of its 3x3 neighbours.

Filters work with one surface per pixel, that of its centre. So their results have stairs at silhouettes and at the
edges of textures. With coverage a pixel can be composited afterwards: the sum over its 3x3 neighbours of share times
filtered value. Camera rays are cheap compared with paths. A fixed pattern of them finds the shares, and with them means
of normals and albedos without noise.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from lobewise.records.camera import Camera
from lobewise.render.bridge import dr, follow, mi, repeat, starts_as
from lobewise.render.camera import is_flat
from lobewise.render.materials.bsdfs import Material
from lobewise.render.materials.dispatch import dispatch_surface, dispatch_transmission
from lobewise.render.materials.surface import Surface
from lobewise.render.tracing.points import MAX_LAYERS, MIN_SURFACE_OPACITY, trace_points
from lobewise.render.tracing.rays import hides_emitters, make_ray

RAYS = 16
"""Rays of the pattern: each of 16 rows and each of 16 columns of the pixel holds one."""

NORMAL_SCALE = 0.2
"""Angle between normals at distance 1, radians."""

PLANE_SCALE = 2.0
"""Distance of a point from another point's tangent plane at distance 1, in widths of a pixel on the surface."""

ALPHA_SCALE = 0.3
"""Difference of the natural logarithms of alphas at distance 1."""

MIN_ALPHA = 1e-3
"""Smallest alpha in comparisons: all smaller ones count as this one."""

ALBEDO_SCALE = 0.1
"""Difference of albedos, diffuse plus specular, at distance 1: root mean square over the colours."""

OTHER_KIND_DISTANCE = 4.0
"""Squared distance added if the kind of lobe, or the lobe table, differs."""

MISS_DISTANCE = 1e6
"""Squared distance added if only one of two rays hits a surface: larger than all others, so the last choice."""

SCREEN_WEIGHT = 0.3
"""Squared distance per squared pixel between the ray and the centre: of alike surfaces the nearest is chosen.

None of the constants is critical: with one of the scales halved or doubled, or with this weight between 0.03 and 1,
albedos composited from those of the centres are at most a twentieth further from the true means. With a larger weight
more pixels show only their own centre.
"""

MIN_LIGHT_SHARE = 1e-3
"""Share of the light of a ray that masks let through. Below it, surfaces behind the masks are ignored."""

_NEIGHBOURS = tuple((row, column) for row in (-1, 0, 1) for column in (-1, 0, 1))


@dataclass
class _Look:
    """Properties of the surface that a ray hits, for comparison (Dr.Jit arrays; a PyTree); all 0 for a miss."""

    is_hit: Any
    position: Any
    normal: Any
    log_alpha: Any
    albedo: Any
    lobe_kind: Any
    material: Any


@dataclass
class _Sums:
    """Running sums over the rays of a pixel (Dr.Jit arrays; a PyTree)."""

    counts: list[Any] = field(default_factory=lambda: [mi.Float(0) for _ in _NEIGHBOURS])
    """Number of rays that were assigned to each neighbour."""
    normal: Any = starts_as("Vector3f")
    diffuse_albedo: Any = starts_as("Color3f")
    specular_albedo: Any = starts_as("Color3f")
    emission: Any = starts_as("Color3f")


@dataclass
class _Layers:
    """State of a ray on its way through masks: the first surface more opaque than not, and sums over all surfaces."""

    ray: Any
    si: Any = starts_as("SurfaceInteraction3f")
    surface: Surface = field(default_factory=Surface)
    settled: Any = starts_as("Bool")
    light: Any = starts_as("Float", 1)
    """Share that is not opaque, of the surfaces so far."""
    passing: Any = starts_as("Color3f", 1)
    """Share of light that the surfaces so far let pass."""
    normal: Any = starts_as("Vector3f")
    diffuse_albedo: Any = starts_as("Color3f")
    specular_albedo: Any = starts_as("Color3f")
    emission: Any = starts_as("Color3f")
    count: Any = starts_as("UInt32")
    active: Any = starts_as("Bool", True)


def trace_coverage(
    scene: Any,
    materials: dict[int, Material],
    camera: Camera,
    *,
    pixels: tuple[int, int],
    size: tuple[int, int],
    emission: bool = True,
) -> dict[str, Any]:
    """Return the guides that describe the areas of a run of pixels, as Dr.Jit arrays by their names in `GBuffer`.

    ``coverage`` is a list of nine Float, ``mean_normal`` a Vector3f, and ``mean_diffuse_albedo``,
    ``mean_specular_albedo`` and, with ``emission``, ``mean_emission`` are Color3f. ``pixels`` holds the first pixel
    (row-major) of the run and their number, ``size`` the width and height of the image. The pattern of rays is the same
    in every pixel, and a pixel's values do not depend on the run.
    """
    # Trace the centres of the run, and of one more row and pixel on each side.
    begin = max(pixels[0] - size[0] - 1, 0)
    end = min(sum(pixels) + size[0] + 1, size[0] * size[1])
    width, height, first = (dr.opaque(mi.UInt32, number) for number in (*size, begin))
    centre = dr.arange(mi.UInt32, end - begin) + first
    points = trace_points(scene, materials, centre, (width, height))
    centres = _make_look(points.si, points.surface)
    dr.eval(centres)

    pixel = dr.arange(mi.UInt32, pixels[1]) + dr.opaque(mi.UInt32, pixels[0])
    column, row = mi.Int32(pixel % width), mi.Int32(pixel // width)
    flat, eye = is_flat(scene), mi.Point3f(*(float(value) for value in camera.position))
    angle = dr.opaque(mi.Float, camera.get_pixel_angle(size[1]))
    neighbours, inside = _gather_neighbours(centres, column, row, mi.Int32(width), mi.Int32(height), mi.Int32(first))

    def take(index: Any, sums: _Sums) -> tuple[_Sums]:
        x, y = place_ray(index)
        ray = make_ray(scene, pixel, (width, height), mi.Point2f(x, y))
        layers = _look_through(scene, materials, ray)
        look = _make_look(layers.si, layers.surface)
        footprint = angle * dr.norm(layers.si.p - (eye if flat else ray.o))
        distances = [_compute_distance(look, neighbours[k], footprint) + _compute_shift(x, y, k) for k in range(9)]
        # Assign the ray to the pixel itself unless a neighbour is nearer.
        best, least = mi.UInt32(4), distances[4]
        for k in (0, 1, 2, 3, 5, 6, 7, 8):
            nearer = inside[k] & (distances[k] < least)
            best, least = dr.select(nearer, k, best), dr.select(nearer, distances[k], least)
        for k in range(9):
            sums.counts[k] += dr.select(best == k, 1.0, 0.0)
        sums.normal += layers.normal
        sums.diffuse_albedo += layers.diffuse_albedo
        sums.specular_albedo += layers.specular_albedo
        sums.emission += layers.emission
        return (sums,)

    (sums,) = repeat(take, mi.UInt32(0), RAYS, _Sums(), label="coverage")
    means = {
        "coverage": [count / RAYS for count in sums.counts],
        "mean_normal": sums.normal / RAYS,
        "mean_diffuse_albedo": dr.clip(sums.diffuse_albedo / RAYS, 0.0, 1.0),
        "mean_specular_albedo": dr.clip(sums.specular_albedo / RAYS, 0.0, 1.0),
    }
    if emission:
        means["mean_emission"] = sums.emission / RAYS
    dr.eval(means)
    return means


def _gather_neighbours(
    centres: _Look, column: Any, row: Any, width: Any, height: Any, first: Any
) -> tuple[list[_Look], list[Any]]:
    """Return the centres around each pixel, in the order of `_NEIGHBOURS`, and whether each lies inside the image.

    ``first`` is the number of the pixel with the first of the centres.
    """
    neighbours, inside = [], []
    for down, right in _NEIGHBOURS:
        x, y = column + right, row + down
        there = (x >= 0) & (y >= 0) & (x < width) & (y < height)
        neighbours.append(dr.gather(_Look, centres, mi.UInt32(y * width + x - first), there))
        inside.append(there)
    return neighbours, inside


def place_ray(index: Any) -> tuple[Any, Any]:
    """Return the place of the pattern's ray ``index`` in a pixel, right and down from its corner, in (0, 1).

    Source: Hammersley's points, a (0, 4, 2)-net in base 2 (Niederreiter 1992, section 4.1): each of the pixel's 4x4,
    2x8 and 8x2 blocks holds one ray as well.
    """
    return (mi.Float(index) + 0.5) / RAYS, (mi.Float(dr.brev(index) >> 28) + 0.5) / RAYS


def _look_through(scene: Any, materials: dict[int, Material], ray: Any) -> _Layers:
    """Return the first surface on a ray that is more opaque than not, and the sums over all surfaces on it.

    Normals and albedos are weighted by opacity. Emission of lamps and of the background is weighted by the share that
    surfaces in front let through.
    """

    transparent = any(material.can_be_transparent for material in materials.values())

    def add(state: _Layers) -> _Layers:
        si = scene.ray_intersect(state.ray, mi.RayFlags.All, True, state.active)
        is_hit = state.active & si.is_valid()
        surface = dispatch_surface(materials, si.bsdf(state.ray), si, is_hit)
        share = dr.select(is_hit, state.light * surface.opacity, 0.0)
        emitted = si.emitter(scene, state.active).eval(si, state.active)
        if hides_emitters(scene):
            emitted = dr.select(si.is_valid(), emitted, 0.0)
        state.emission += dr.select(state.active, state.passing * emitted, 0.0)
        state.normal += share * surface.normal
        state.diffuse_albedo += share * surface.diffuse_albedo
        state.specular_albedo += share * surface.specular_albedo
        state.light *= 1.0 - surface.opacity
        if transparent:
            state.passing *= dispatch_transmission(materials, si.bsdf(state.ray), si, is_hit)
        state.count += 1
        state.si = dr.select(state.settled, state.si, si)
        state.surface = dr.select(state.settled, state.surface, surface)
        state.settled |= ~is_hit | (surface.opacity >= MIN_SURFACE_OPACITY)
        state.ray = si.spawn_ray(state.ray.d)
        state.active = is_hit & (state.light > MIN_LIGHT_SHARE) & (state.count < MAX_LAYERS)
        return state

    if not transparent:
        return add(_Layers(ray))
    end: _Layers = follow(_Layers(ray), add, "layers")
    return end


def _make_look(si: Any, surface: Surface) -> _Look:
    is_hit = si.is_valid()
    seen = {
        "position": mi.Vector3f(si.p),
        "normal": surface.normal,
        "log_alpha": dr.log(dr.maximum(mi.Vector2f(surface.alpha_u, surface.alpha_v), MIN_ALPHA)),
        "albedo": surface.diffuse_albedo + surface.specular_albedo,
        "lobe_kind": surface.lobe_kind,
        "material": surface.material,
    }
    return _Look(is_hit, **{name: dr.select(is_hit, value, 0.0) for name, value in seen.items()})


def _compute_distance(look: _Look, centre: _Look, footprint: Any) -> Any:
    """Return the squared distance between the surfaces of a ray and of a pixel centre; 0 if both miss.

    Departs: the chord between the normals approximates their angle; at a right angle it is a tenth shorter.
    """
    offset = look.position - centre.position
    planes = dr.square(dr.dot(look.normal, offset)) + dr.square(dr.dot(centre.normal, offset))
    distance = dr.squared_norm(look.normal - centre.normal) * NORMAL_SCALE**-2
    distance += dr.select(planes > 0, 0.5 * planes * dr.rcp(dr.square(PLANE_SCALE * footprint)), 0.0)
    distance += dr.squared_norm(look.log_alpha - centre.log_alpha) * ALPHA_SCALE**-2
    distance += dr.squared_norm(look.albedo - centre.albedo) * (ALBEDO_SCALE**-2 / 3.0)
    other = (look.lobe_kind != centre.lobe_kind) | (look.material != centre.material)
    distance += dr.select(other, OTHER_KIND_DISTANCE, 0.0)
    return distance + dr.select(look.is_hit != centre.is_hit, MISS_DISTANCE, 0.0)


def _compute_shift(x: Any, y: Any, k: int) -> Any:
    """Return the part of the squared distance that the way on the screen to the centre of neighbour ``k`` adds."""
    down, right = _NEIGHBOURS[k]
    return SCREEN_WEIGHT * (dr.square(x - 0.5 - right) + dr.square(y - 0.5 - down))
