"""Voxel cones: against closed forms, rays and the path tracer, and what each part of them promises alone."""

from collections.abc import Callable
from functools import lru_cache
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.render import render_frame
from tests.lobes.oracles.brdf import reflect_ggx_sg
from tests.mistakes import refuses
from tests.render.items import make_camera, make_square

pytestmark = pytest.mark.mitsuba

FURNACE = 0.08
"""The mean over a closed box: 1.5 % of light leaves at each bounce, so 0.06 was seen for an albedo of 0.8."""

FURNACE_PIXEL = 0.35
"""Every pixel of it: at the edges of the box, where interpolation reaches outside, up to 0.28 was seen."""

CORNELL = 0.08
"""Mean over the Cornell box; 0.02 was seen at 64 voxels and 0.01 at 128."""

CORNELL_SURFACE = 0.25
"""Mean over one of its walls or boxes; 0.17 was seen, for the wall beside a narrow gap."""

LIGHT_IN_THE_DARK = 0.02
"""Light of a bright room that reaches a dark one through a wall of two voxels."""

SLAB = 0.002
"""Opacity of a slab, whatever the steps: each is at least a thousandth of a voxel, so some are too long."""

PLACE = 1.5
"""Voxels between where a cone is stopped half and where a ray hits."""

AREA = 0.01
"""Area of a ball by counting the rays that hit it, 128 across."""

ROUNDING = 1e-5
"""Single precision."""

Cones = Callable[..., Any]


@pytest.fixture(scope="module")
def shade(mi: Any) -> Callable[..., tuple[Any, Any]]:
    """Return a function that shades all pixels of a scene, and what it shaded them with."""
    import drjit as dr

    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.tracing.points import trace_points
    from lobewise.render.voxels.cones import VoxelCones

    def run(scene: Any, *, samples: int = 4, seed: int = 1, method: Any = None, **options: Any) -> Any:
        materials = read_scene_materials(scene)
        method = method or VoxelCones(scene, materials, **options)
        width, height = (int(length) for length in scene.sensors()[0].film().crop_size())
        size = dr.opaque(mi.UInt32, width), dr.opaque(mi.UInt32, height)
        points = trace_points(scene, materials, dr.arange(mi.UInt32, width * height), size)
        light = method.shade(points, samples=samples, seed=seed)
        images = {
            "diffuse": np.array(light.diffuse).T.reshape(height, width, 3),
            "specular": np.array(light.specular).T.reshape(height, width, 3),
            "hit_distance": np.array(light.hit_distance).reshape(height, width),
        }
        return images, method

    return run


def look(mi: Any, origin: list[float], target: list[float], *, size: int = 16, fov: float = 60.0) -> dict[str, Any]:
    up = [0, 1, 0] if abs(np.dot(np.subtract(target, origin), [0, 1, 0])) < 0.9 else [1, 0, 0]
    return make_camera(mi, origin, target, up=up, size=(size, size), fov=fov)


def gray(value: float) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": [value] * 3}}


def make_furnace_box(mi: Any, albedo: float) -> Any:
    """Return a box that emits 1 from all its walls, seen from within: indirect light is a^2 / (1 - a)."""
    box = {
        "type": "cube",
        "flip_normals": True,
        "bsdf": gray(albedo),
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
    }
    return mi.load_dict({"type": "scene", "camera": look(mi, [-0.6, 0.2, -0.5], [0.3, -0.2, 1]), "box": box})


@pytest.mark.parametrize("albedo", [0.4, 0.8])
def test_closed_box_of_light_has_the_radiance_of_the_series(mi: Any, shade: Cones, albedo: float) -> None:
    images, _ = shade(make_furnace_box(mi, albedo), resolution=32, light_samples=32)
    expected = albedo**2 / (1.0 - albedo)
    assert abs(images["diffuse"].mean() / expected - 1.0) < FURNACE
    assert (np.abs(images["diffuse"] / expected - 1.0) < FURNACE_PIXEL).mean() > 0.99
    assert not images["specular"].any()
    assert not images["hit_distance"].any()  # no specular lobe: unknown


def test_bounces_are_the_terms_of_the_series(mi: Any, shade: Cones) -> None:
    for bounces, expected in ((0, 0.6**2), (1, 0.6**2 + 0.6**3)):
        images, _ = shade(make_furnace_box(mi, 0.6), resolution=32, light_samples=32, bounces=bounces)
        assert abs(images["diffuse"].mean() / expected - 1.0) < FURNACE, bounces


@lru_cache
def make_cornell(mi: Any, size: int = 48) -> Any:
    description = mi.cornell_box()
    description["sensor"]["film"].update(width=size, height=size)
    return mi.load_dict(description)


@pytest.mark.nightly
def test_cornell_box_agrees_with_paths(mi: Any, shade: Cones) -> None:

    scene = make_cornell(mi)
    reference = render_frame(scene, spp=256, seed=3, light="indirect")
    images, _ = shade(scene, samples=16, resolution=64)
    total, expected = images["diffuse"] + images["specular"], reference.radiance.color
    assert abs(total.mean() / expected.mean() - 1.0) < CORNELL
    # Walls and boxes are told apart by colour and normal.
    normal, albedo = np.round(reference.gbuffer.normal, 1), np.round(reference.gbuffer.diffuse_albedo, 1)
    keys = np.concatenate([normal, albedo], axis=-1).reshape(-1, 6)
    kinds, which, counts = np.unique(keys, axis=0, return_inverse=True, return_counts=True)
    big = [kind for kind in range(len(kinds)) if counts[kind] > 60 and kinds[kind].any()]
    assert len(big) >= 5
    for kind in big:
        mask = which.ravel() == kind
        ratio = total.reshape(-1, 3)[mask].mean() / expected.reshape(-1, 3)[mask].mean()
        assert abs(ratio - 1.0) < CORNELL_SURFACE, kinds[kind]


def test_same_seed_same_bits_and_another_jitters(mi: Any, shade: Cones) -> None:
    scene = make_cornell(mi)
    first, method = shade(scene, samples=1, seed=1, resolution=32, bounces=0)
    again, _ = shade(scene, samples=1, seed=1, resolution=32, bounces=0)
    other, _ = shade(scene, samples=1, seed=2, method=method)
    np.testing.assert_array_equal(first["diffuse"], again["diffuse"])
    assert (first["diffuse"] != other["diffuse"]).mean() > 0.5
    assert abs(first["diffuse"].mean() / other["diffuse"].mean() - 1.0) < 0.05


def test_another_seed_size_and_count_need_no_other_kernel(mi: Any, shade: Cones) -> None:
    from lobewise.render.bridge import dr, hold_garbage
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.tracing.points import trace_points
    from lobewise.render.voxels.cones import VoxelCones

    scene = make_cornell(mi)
    materials = read_scene_materials(scene)
    method = VoxelCones(scene, materials, resolution=32, bounces=0)

    def run(pixels: int, samples: int, seed: int) -> list[Any]:
        size = dr.opaque(mi.UInt32, 48), dr.opaque(mi.UInt32, 48)
        points = trace_points(scene, materials, dr.arange(mi.UInt32, pixels), size)
        dr.eval(points)
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            dr.eval(method.shade(points, samples=samples, seed=seed))
            return list(dr.kernel_history([dr.KernelType.JIT]))

    # Kernels hold every BSDF that is alive, so no old scene may become garbage in between.
    with hold_garbage():
        run(2304, 1, 1)
        for kernels in (run(2304, 1, 2), run(1000, 1, 3), run(2304, 3, 1)):
            assert kernels
            assert all(kernel["cache_hit"] for kernel in kernels)


def test_a_pixel_does_not_depend_on_the_others(mi: Any, shade: Cones) -> None:
    import drjit as dr

    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.tracing.points import trace_points

    scene = make_cornell(mi)
    images, method = shade(scene, samples=2, seed=7, resolution=32, bounces=0)
    pixels = np.array([1999, 3, 1200, 1200, 777])
    size = dr.opaque(mi.UInt32, 48), dr.opaque(mi.UInt32, 48)
    points = trace_points(scene, read_scene_materials(scene), mi.UInt32(pixels.astype(np.uint32)), size)
    few = np.array(method.shade(points, samples=2, seed=7).diffuse).T
    np.testing.assert_array_equal(few, images["diffuse"].reshape(-1, 3)[pixels])


@pytest.mark.sampled("25.0")
@pytest.mark.parametrize("turned", [0.0, 25.0])
def test_walls_of_two_voxels_do_not_leak(mi: Any, shade: Cones, turned: float) -> None:
    transform = mi.ScalarTransform4f
    turn = transform().rotate([0.3, 1, 0.2], turned) if turned else transform()
    # The wall between is 2 of 64 voxels thick; with the rooms turned it lies across the voxels.
    extent = 2.0 * (1.0 if not turned else 1.3)
    half = extent / 64.0

    def room(left: float, right: float) -> dict[str, Any]:
        middle, size = 0.5 * (left + right), 0.5 * (right - left)
        place = turn @ transform().translate([middle, 0, 0]).scale([size, 0.5, 0.5])
        return {"type": "cube", "flip_normals": True, "to_world": place, "bsdf": gray(0.7)}

    lamp = {
        "type": "sphere",
        "to_world": turn @ transform().translate([-0.5, 0.3, 0]),
        "radius": 0.1,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 20.0}},
    }

    def render(side: float) -> float:
        eye = np.array(turn @ mi.ScalarPoint3f(side * 0.9, 0.1, 0.3)).ravel()
        target = np.array(turn @ mi.ScalarPoint3f(side * 0.1, 0.0, -0.3)).ravel()
        items = {"bright": room(-1.0, -half), "dark": room(half, 1.0), "lamp": lamp}
        camera = look(mi, eye.tolist(), target.tolist(), fov=90.0)
        images, _ = shade(mi.load_dict({"type": "scene", "camera": camera, **items}), resolution=64, bounces=2)
        return float(images["diffuse"].mean())

    assert render(1.0) < LIGHT_IN_THE_DARK * render(-1.0)


def make_cone_tracer(mi: Any, scene: Any, resolution: int) -> Callable[..., Any]:
    """Return a function that traces cones, one for each of some shifts of the steps."""
    import drjit as dr

    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.voxels.cones import VoxelCones
    from lobewise.render.voxels.march import trace_cone

    grid = VoxelCones(scene, read_scene_materials(scene), resolution=resolution, bounces=0).grid

    def trace(origin: list[float], direction: list[float], tangent: float, count: int = 33) -> Any:
        towards = mi.Vector3f(*(np.array(direction) / np.linalg.norm(direction)).tolist())
        jitter = [dr.arange(mi.Float, count) * step for step in (0.618, 0.414, 0.732, 0.236)]
        jitter = [number - dr.floor(number) for number in jitter]
        point = mi.Point3f(*origin) + mi.Vector3f(0) * jitter[0]
        return trace_cone(grid, point, towards, towards, mi.Float(tangent), tuple(jitter), mi.Bool(True))

    return trace


@pytest.mark.parametrize("direction", [[0, 1, 0], [0.3, 1, 0.2], [1, 1, 0.1]])
@pytest.mark.parametrize("opacity", [0.5, 0.8])
def test_opacity_of_a_slab_does_not_depend_on_steps_or_angle(mi: Any, direction: list[float], opacity: float) -> None:
    slab = {"type": "mask", "opacity": opacity, "inner": {"type": "twosided", "inner": gray(0.5)}}
    place = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    frame = {"type": "cube", "to_world": mi.ScalarTransform4f().translate([0, -0.99, 0]).scale([1, 0.01, 1])}
    items = {"slab": {"type": "rectangle", "to_world": place, "bsdf": slab}, "frame": frame}
    scene = mi.load_dict({"type": "scene", **items, "lamp": {"type": "point", "position": [0, 3, 0]}})
    for resolution in (32, 64):
        trace = make_cone_tracer(mi, scene, resolution)
        cone = trace([-0.4 * direction[0], -0.4, 0.0], direction, 0.01)
        opaque = 1.0 - np.array(cone.transmittance)
        assert np.abs(opaque - opacity).max() < SLAB, opaque


def test_cones_stop_where_rays_hit(mi: Any) -> None:
    ball = {"type": "sphere", "radius": 1.0, "center": [0.1, 0.2, 0.3], "flip_normals": True, "bsdf": gray(0.5)}
    scene = mi.load_dict({"type": "scene", "ball": ball, "lamp": {"type": "point", "position": [0, 0, 0]}})
    trace = make_cone_tracer(mi, scene, 64)
    for direction in ([1, 0, 0], [0.3, -0.5, 0.8], [-1, 1, 1]):
        inverse = np.array(trace([0.1, 0.2, 0.3], direction, 0.005, count=256).inverse)
        assert (inverse > 0).mean() > 0.97  # of slanting walls single cones pass the corner of a voxel
        assert np.abs(1.0 / inverse[inverse > 0] - 1.0).max() < PLACE * 2.0 / 64


@pytest.mark.nightly
def test_hit_distance_of_a_mirror_is_that_of_rays(mi: Any, shade: Cones, make_box_scene: Cones) -> None:
    place = mi.ScalarTransform4f().translate([0, 0.05, 0.5]).rotate([1, 0, 0], -90)
    scene = make_box_scene({"mirror": make_square(place, bsdf={"type": "conductor"})}, size=32)
    images, _ = shade(scene, samples=1, resolution=128, bounces=0)
    guides = render_frame(scene, spp=1, seed=0).gbuffer
    shiny = guides.lobe_kind == 3
    found, expected = images["hit_distance"][shiny], guides.hit_distance[shiny]
    assert shiny.sum() > 50
    assert not images["hit_distance"][~shiny].any()
    met = np.isfinite(expected) & (expected > 0)
    assert np.median(np.abs(found[met] - expected[met])) < PLACE * 6.0 / 128
    assert (np.abs(found[met] - expected[met]) < 4.0 * PLACE * 6.0 / 128).mean() > 0.9
    assert images["specular"][shiny].mean() > 0.01


def test_rays_count_the_area_of_a_ball(mi: Any) -> None:
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.voxels.axis_hits import RAYS, Caster, cast_hits, measure_bounds

    both = {"type": "twosided", "inner": gray(0.5)}
    scene = mi.load_dict(
        {"type": "scene", "ball": {"type": "sphere", "radius": 1.5, "center": [1, 2, 3], "bsdf": both}}
    )
    bounds = measure_bounds(scene, 64)
    calls: list[None] = []
    hits = cast_hits(Caster(scene, read_scene_materials(scene)), bounds, lambda: calls.append(None))
    assert len(calls) == 3
    # Along each axis the ball shows its disc from both sides.
    seen = np.bincount(hits.axis) * (bounds.voxel / RAYS) ** 2
    assert np.abs(seen / (2.0 * np.pi * 1.5**2) - 1.0).max() < AREA
    center = np.array([1.0, 2.0, 3.0])[:, None]
    position, normal = np.array(hits.position), np.array(hits.normal)
    assert np.abs(np.linalg.norm(position - center, axis=0) - 1.5).max() < ROUNDING * 100
    axis = hits.axis
    assert (np.take_along_axis(normal, axis[None], axis=0) <= 0).all()
    np.testing.assert_allclose(np.array(hits.first), 0.5, atol=ROUNDING)
    place = np.stack([hits.cell % 64, hits.cell // 64 % 64, hits.cell // 64**2])
    middle = np.array(bounds.lower)[:, None] + (place + 0.5) * bounds.voxel
    assert np.abs(position - middle).max() < (0.5 + 1e-3) * bounds.voxel


def test_larger_voxels_show_the_nearer_of_two(mi: Any) -> None:
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.voxels.cones import VoxelCones
    from lobewise.render.voxels.grid import MAX_OPTICAL_DEPTH

    grid = VoxelCones(make_cornell(mi), read_scene_materials(make_cornell(mi)), resolution=32, bounces=0).grid
    row, values = np.array(grid.row), np.array(grid.values, dtype=np.float64).reshape(-1, 6, 4)
    starts = np.array(grid.starts)
    tau = values[..., 3:]
    alpha = 1.0 - np.exp(-tau)
    color = np.divide(values[..., :3], tau, out=np.zeros_like(values[..., :3]), where=tau > 0)
    for level in range(2):
        size = 32 >> level
        fine = row[starts[level] : starts[level] + size**3].reshape(size, size, size)  # z, y, x
        coarse = row[starts[level + 1] : starts[level + 1] + (size // 2) ** 3].reshape([size // 2] * 3)
        z, y, x = (
            (int(i[0]) for i in np.nonzero(coarse)) if level else np.argwhere(coarse)[len(np.argwhere(coarse)) // 3]
        )
        block = fine[2 * z : 2 * z + 2, 2 * y : 2 * y + 2, 2 * x : 2 * x + 2]
        for direction in range(6):
            axis, backwards = direction // 2, direction % 2
            pairs = np.moveaxis(block, 2 - axis, 0).reshape(2, 4)
            near, far = (pairs[1], pairs[0]) if backwards else (pairs[0], pairs[1])
            a, b = alpha[near, direction], alpha[far, direction]
            opacity = (a + (1 - a) * b).mean()
            light = (a * color[near, direction] + (1 - a) * b * color[far, direction]).mean(axis=0)
            found = values[coarse[z, y, x], direction]
            expected = min(-np.log1p(-min(opacity, 1 - 1e-12)), MAX_OPTICAL_DEPTH)
            assert abs(found[3] - expected) < 1e-4
            if opacity > 0:
                np.testing.assert_allclose(found[:3], light / opacity * expected, rtol=1e-4, atol=1e-7)


def test_diffuse_cones_share_the_hemisphere_as_the_cosine_does(mi: Any, rng: np.random.Generator) -> None:
    from lobewise.render.voxels.march import DIFFUSE_CONES, draw_diffuse_axis

    count = 1 << 14
    normal = np.array([0.48, -0.6, 0.64])
    even = (np.arange(count) + 0.5) / count
    draws = [mi.Float(rng.permutation(even).astype(np.float32)) for _ in range(3)]
    axes = []
    for number in range(DIFFUSE_CONES):
        axis = draw_diffuse_axis(
            mi.Vector3f(*normal.tolist()), mi.UInt32(number), draws[0], mi.Point2f(draws[1], draws[2])
        )
        axes.append(np.array(axis, dtype=np.float64))
        cosine = normal @ axes[-1]
        assert (cosine**2 >= 5.0 / 6.0 - 1e-4).all() if number == 0 else (cosine**2 <= 5.0 / 6.0 + 1e-4).all()
        # The square of the cosine is even between the bounds of each part.
        assert abs((cosine**2).mean() - (11.0 / 12.0 if number == 0 else 5.0 / 12.0)) < ROUNDING * 10
    together = np.concatenate(axes, axis=1)
    cosine = normal @ together
    np.testing.assert_allclose(np.linalg.norm(together, axis=0), 1.0, atol=ROUNDING)
    # Of max(n.w, 0) / pi: the mean of w is 2/3 n, that of w w^T is I/4 + n n^T / 4. Parts of the hemisphere vary less
    # than the whole, so this is more than four standard errors.
    bound = 1.0 / np.sqrt(DIFFUSE_CONES * count)
    assert np.abs(together.mean(axis=1) - normal * 2.0 / 3.0).max() < bound
    assert np.abs(together @ together.T / cosine.size - 0.25 * (np.eye(3) + np.outer(normal, normal))).max() < bound


def test_specular_cones_are_the_lobes_of_the_library(mi: Any, rng: np.random.Generator) -> None:
    from lobewise.render.voxels.march import DIFFUSE_TAN, MIN_TAN, compute_reflection

    alpha_u, alpha_v = rng.uniform(0.01, 0.4, (2, 500))
    cosine, azimuth = rng.uniform(0.3, 1.0, 500), rng.uniform(0.0, 2.0 * np.pi, 500)
    sine = np.sqrt(1.0 - cosine**2)
    view = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])
    arrays = (mi.Float(alpha.astype(np.float32)) for alpha in (alpha_u, alpha_v))
    axis, tangent = compute_reflection(
        mi.Vector3f(view.astype(np.float32)), mi.Vector3f(0, 0, 1), mi.Vector3f(1, 0, 0), *arrays
    )
    expected, sharpness = reflect_ggx_sg(view.T, alpha_u, alpha_v)
    above = expected[:, 2] > 0.02
    assert above.mean() > 0.9
    np.testing.assert_allclose(np.array(axis).T[above], expected[above], atol=1e-4)
    half = np.arccos(np.maximum(1.0 - 1.0 / sharpness, -1.0))
    wide = np.where(half < 1.4, np.tan(np.minimum(half, 1.4)), np.inf)
    np.testing.assert_allclose(np.array(tangent), np.clip(wide, MIN_TAN, DIFFUSE_TAN), rtol=2e-3)


@pytest.mark.nightly
def test_smooth_cones_see_a_lobe_without_noise(mi: Any, shade: Cones, make_box_scene: Cones) -> None:
    """What is left to chance is where in a step a cone looks, not where it goes."""
    metal = {"type": "roughconductor", "alpha": 0.2, "material": "Al"}
    scene = make_box_scene({"ball": {"type": "sphere", "center": [0, 0.8, 0], "radius": 0.7, "bsdf": metal}}, size=32)
    once, _ = shade(scene, samples=1, resolution=64)
    often, _ = shade(scene, samples=32, resolution=64)
    shiny = often["specular"].max(axis=-1) > 0.01
    assert shiny.sum() > 50
    ratio = once["specular"][shiny] / np.maximum(often["specular"][shiny], 1e-3)
    assert np.square(ratio - 1.0).mean() < 0.02


@pytest.mark.nightly
def test_glass_shows_what_is_behind_it(mi: Any, shade: Cones, make_box_scene: Cones) -> None:
    ball = {"type": "sphere", "center": [0, 0.8, 0], "radius": 0.7, "bsdf": {"type": "dielectric"}}
    scene = make_box_scene({"ball": ball}, size=32)
    reference = render_frame(scene, spp=256, seed=4, light="indirect")
    images, _ = shade(scene, samples=16, resolution=64)
    glass = reference.gbuffer.lobe_kind == 3
    assert glass.sum() > 50
    found, expected = images["specular"][glass].mean(), reference.radiance.specular[glass].mean()
    assert abs(found / expected - 1.0) < CORNELL_SURFACE


@pytest.mark.nightly
def test_light_of_the_sky_is_in_the_voxels_alone(mi: Any, shade: Cones) -> None:
    # A hemispherical bowl under a white sky; its own light reaches it, the sky's does not count.
    bowl = {"type": "twosided", "inner": gray(0.6)}
    wall = mi.ScalarTransform4f().translate([0, 1.0, -1])
    floor = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    items = {
        "floor": {"type": "rectangle", "to_world": floor, "bsdf": bowl},
        "wall": {"type": "rectangle", "to_world": wall, "bsdf": bowl},
        "camera": look(mi, [0, 1.5, 2.5], [0, 0, -0.5], size=24, fov=35.0),
        "sky": {"type": "constant"},
    }
    scene = mi.load_dict({"type": "scene", **items})
    reference = render_frame(scene, spp=128, seed=2, light="indirect").radiance.color
    images, _ = shade(scene, samples=16, resolution=64)
    assert abs(images["diffuse"].mean() / reference.mean() - 1.0) < CORNELL_SURFACE
    # A lone floor sees nothing but sky.
    del items["wall"]
    images, _ = shade(mi.load_dict({"type": "scene", **items}), resolution=64)
    assert images["diffuse"].mean() < 0.01 * 0.36


def test_update_follows_lights_and_shapes(mi: Any, shade: Cones) -> None:
    scene = make_furnace_box(mi, 0.5)
    before, method = shade(scene, resolution=16, bounces=0)
    parameters = mi.traverse(scene)
    name = next(key for key in dict(parameters) if key.endswith("radiance.value"))
    parameters[name] = 3.0
    parameters.update()
    stale, _ = shade(scene, method=method)
    np.testing.assert_array_equal(stale["diffuse"], before["diffuse"])
    method.update()
    brighter, _ = shade(scene, method=method)
    np.testing.assert_allclose(brighter["diffuse"], 3.0 * before["diffuse"], rtol=1e-4)
    name = next(key for key in dict(parameters) if key.endswith("vertex_positions"))
    parameters[name] = parameters[name] * 2.0
    parameters.update()
    voxel = float(method.grid.voxel[0])
    method.update()
    assert abs(float(method.grid.voxel[0]) / voxel - 2.0) < ROUNDING


def test_series_is_extended_to_its_limit(mi: Any) -> None:
    from lobewise.render.voxels.lighting import _extend

    start, gain = np.array([[1.0, 2.0], [3.0, 0.5], [0.0, 0.0]]), np.array([[0.5], [0.25], [0.0]])
    first = np.array([[0.4, 0.8], [0.1, 0.3], [0.0, 0.0]])
    members = [start, start + first, start + first * (1.0 + gain)]
    limit = _extend([mi.Color3f(member.astype(np.float32)) for member in members], np.array([1.0, 2.0]))
    np.testing.assert_allclose(np.array(limit), start + first / (1.0 - gain), rtol=ROUNDING)


def test_progress_is_told_to_its_end(mi: Any, shade: Cones) -> None:
    told: list[tuple[int, int]] = []
    shade(make_cornell(mi), samples=1, resolution=16, bounces=2, progress=lambda *step: told.append(step))
    assert told == [(done, 6) for done in range(1, 7)]


@pytest.mark.parametrize(
    ("options", "expected"),
    [
        ({"resolution": 100}, "one of 16, 32, 64, 128, 256"),
        ({"bounces": -1}, "an integer from 0 to 16"),
        ({"light_samples": 0}, "an integer from 1 to 1024"),
    ],
)
def test_numbers_out_of_range_are_errors(mi: Any, shade: Cones, options: dict[str, int], expected: str) -> None:
    ((name, value),) = options.items()
    with refuses(InputError, name, str(value), expected):
        shade(make_cornell(mi), **options)


def test_a_scene_without_surfaces_is_an_error(mi: Any) -> None:
    from lobewise.render.voxels.cones import VoxelCones

    with refuses(InputError, "scene", "0 of them, 0 wide"):
        VoxelCones(mi.load_dict({"type": "scene"}), {})
