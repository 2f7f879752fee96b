"""Virtual lights against closed forms, against paths, and against themselves."""

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.metrics import rel_mse
from tests.mistakes import refuses
from tests.render.items import make_camera, make_square, rgb

pytestmark = pytest.mark.mitsuba

ROUNDING = 2e-4
"""Sums of some thousand terms in single precision."""

ROULETTE = 0.02
"""Share of 4096 quasi-random paths that go on, against its probability: three standard errors were they random."""

PATHS_NOISE = 0.03
"""Means over an image: 4096 light paths, or what is left of the noise of some hundred samples per pixel."""

SPIKES = 0.1
"""Means over glossy surfaces, where single lights stand out: four standard errors over seeds."""

HALF = {"type": "rgb", "value": [0.5, 0.4, 0.3]}
MIRROR = {"type": "conductor", "material": "Al"}
SMOOTH = {"type": "roughconductor", "alpha": 0.01}

Box = Callable[..., Any]


def view(scene: Any) -> Any:
    """Return what all pixel centres of a scene see."""
    from lobewise.render.bridge import dr, mi
    from lobewise.render.camera import get_image_size
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.tracing.points import trace_points

    width, height = get_image_size(scene)
    size = tuple(dr.opaque(mi.UInt32, length) for length in (width, height))
    return trace_points(scene, read_scene_materials(scene), dr.arange(mi.UInt32, width * height), size)


def make_lights(scene: Any, **options: Any) -> Any:
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.virtual_lights.instant_radiosity import VirtualLights

    return VirtualLights(scene, read_scene_materials(scene), **options)


def render_paths(scene: Any, points: Any, *, samples: int, max_depth: int = 8) -> Any:
    """Return indirect light of the same points by paths."""
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.tracing.paths import PathLight

    return PathLight(scene, read_scene_materials(scene), max_depth=max_depth).shade(points, samples=samples, seed=3)


def get_image(value: Any) -> np.ndarray:
    """Return a colour of every pixel, shape (1, pixels, 3)."""
    return np.array(value).T[None].astype(np.float64)


def total(light: Any) -> np.ndarray:
    return get_image(light.diffuse) + get_image(light.specular)


def make_cornell_box(mi: Any, alpha: float | None = None) -> Any:
    """Return the Cornell box, with an alpha its boxes are of copper."""
    items = mi.cornell_box()
    items["sensor"]["film"].update(width=32, height=32)
    if alpha is not None:
        copper = {"type": "roughconductor", "material": "Cu", "alpha": alpha, "distribution": "ggx"}
        items["small-box"]["bsdf"] = items["large-box"]["bsdf"] = copper
    return mi.load_dict(items)


@pytest.fixture(scope="module")
def cornell(mi: Any) -> Any:
    return make_cornell_box(mi)


@pytest.fixture(scope="module")
def cornell_paths(cornell: Any) -> np.ndarray:
    """Return the path tracer's picture, of the same pixel centres."""
    return total(render_paths(cornell, view(cornell), samples=1024))


@pytest.fixture(scope="module")
def hollow(mi: Any) -> Any:
    """Return the inside of a glowing sphere of radius 2, radiance 1, that reflects (0.5, 0.4, 0.3)."""
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": make_camera(mi, [0, 0, 1], [0, 0.2, 0], box=False, fov=60.0),
            "sphere": {
                "type": "sphere",
                "radius": 2.0,
                "flip_normals": True,
                "bsdf": {"type": "diffuse", "reflectance": HALF},
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
        }
    )


def test_points_of_the_sequence_fill_cells_evenly() -> None:
    from lobewise.render.virtual_lights.light_paths import make_halton

    points = make_halton(3 * 2**8, 4, 1)
    assert points.min() >= 0.0
    assert points.max() < 1.0
    # Any run of as many points as cells, from a multiple of it, has one in each: the radical inverse's law.
    for dimension, base, power in ((0, 2, 8), (1, 3, 5), (2, 5, 4), (3, 7, 3)):
        cells = base**power
        for start in range(0, len(points) - cells + 1, cells):
            found = np.floor(points[start : start + cells, dimension].astype(np.float64) * cells)
            assert np.array_equal(np.sort(found), np.arange(cells)), dimension
    # Neighbouring dimensions are not alike.
    assert np.abs(np.corrcoef(points.T) - np.eye(4)).max() < 0.1
    assert not np.array_equal(points, make_halton(3 * 2**8, 4, 2))


def test_power_of_the_lights_falls_as_the_surface_reflects(hollow: Any) -> None:
    lights = make_lights(hollow, count=4096, max_depth=6).lights
    flux, depth = np.array(lights.flux).T, np.array(lights.depth)
    emitted = math.pi * 4.0 * math.pi * 2.0**2
    for bounces in range(4):
        power = flux[depth == bounces + 1].sum(axis=0, dtype=np.float64)
        expected = emitted * np.array(HALF["value"]) ** bounces
        assert np.allclose(power, expected, rtol=ROULETTE * (1 + 2 * bounces)), bounces
    assert depth.max() == 4
    # What the roulette takes as chance it does not take as power: fluxes stay alike, in the strongest colour.
    np.testing.assert_allclose(flux[:, 0], emitted / 4096, rtol=1e-5)


def test_inside_a_sphere_all_light_is_known(hollow: Any) -> None:
    # Between any two points of a sphere the geometry term is 1 / (4 R^2), so only the roulette is left to chance.
    method = make_lights(hollow, count=4096, max_depth=64, clamp=0.0)
    found = total(method.shade(view(hollow), samples=1, seed=0, all_lights=True))
    rho = np.array(HALF["value"])
    np.testing.assert_allclose(found, np.broadcast_to(rho**2 / (1.0 - rho), found.shape), rtol=2 * ROULETTE)
    assert np.ptp(found, axis=1).max() < ROUNDING


CORNER = math.sqrt(4.0**2 + 4.0**2 + 4.0**2)
"""Diagonal of the box around the floor and the wall of `make_corner`."""


def make_corner(mi: Any, *, cone: float = 2.0, bsdf: dict[str, Any] | None = None, **items: Any) -> Any:
    """Return a spot that lights one place of a floor, beside a wall that the camera sees."""
    transform = mi.ScalarTransform4f
    gray = {"type": "twosided", "inner": {"type": "diffuse", "reflectance": HALF}}
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": make_camera(mi, [0, 1, 4], [0, 1, 0], box=False, fov=40.0),
            "floor": make_square(transform().rotate([1, 0, 0], -90).scale(2), bsdf=gray),
            "wall": make_square(transform().translate([0, 2, -1]).scale(2), bsdf=bsdf or gray),
            "spot": {
                "type": "spot",
                "to_world": transform().look_at(origin=[0.2, 3, 0], target=[0.2, 0, 0.3], up=[1, 0, 0]),
                "cutoff_angle": cone,
                "beam_width": cone,
                "intensity": {"type": "rgb", "value": 10.0},
            },
            **items,
        }
    )


def expect_one_light(method: Any, points: Any, bound: float = math.inf) -> np.ndarray:
    """Return what the one light of a corner gives its points, by hand: two Lambert surfaces."""
    place = np.array(method.lights.si.p).T[0].astype(np.float64)
    flux = np.array(method.lights.flux).T[0].astype(np.float64)
    position, normal = (np.array(value).T.astype(np.float64) for value in (points.si.p, points.si.n))
    away = place - position
    distance2 = (away**2).sum(axis=-1)
    towards = away / np.sqrt(distance2)[:, None]
    geometry = np.abs((towards * normal).sum(axis=-1)) * np.abs(towards[:, 1]) / distance2
    rho = np.array(HALF["value"]) / math.pi
    # Points of the floor lie in the light's own plane.
    geometry = np.where(np.abs(normal[:, 1]) > 0.5, 0.0, np.minimum(geometry, bound))
    return (rho**2 * flux * geometry[:, None])[None]


def test_one_light_is_the_closed_form(mi: Any) -> None:
    scene = make_corner(mi)
    points = view(scene)
    method = make_lights(scene, count=1, max_depth=3, clamp=0.0)
    assert method.lights.number == 1
    cone = 2.0 * math.pi * (1.0 - math.cos(math.radians(2.0)))
    np.testing.assert_allclose(np.array(method.lights.flux).T[0], 10.0 * cone, rtol=1e-3)
    found = method.shade(points, samples=1, seed=0)
    expected = expect_one_light(method, points)
    assert expected.max() > 0.0
    np.testing.assert_allclose(get_image(found.diffuse), expected, rtol=ROUNDING, atol=1e-9)
    assert get_image(found.specular).max() == 0.0
    assert np.array(found.hit_distance).max() == 0.0

    bound = 1.0 / (0.6 * CORNER) ** 2
    clamped = make_lights(scene, count=1, max_depth=3, clamp=0.6)
    expected_clamped = expect_one_light(clamped, points, bound)
    assert expected_clamped.max() < 0.9 * expected.max()
    np.testing.assert_allclose(
        total(clamped.shade(points, samples=1, seed=0)), expected_clamped, rtol=ROUNDING, atol=1e-9
    )


def test_lights_stay_until_they_are_traced_anew(mi: Any) -> None:
    scene = make_corner(mi)
    points = view(scene)
    method = make_lights(scene, count=1, max_depth=3, clamp=0.0)
    before = total(method.shade(points, samples=1, seed=0))
    params = mi.traverse(scene)
    params["spot.to_world"] = mi.Transform4f().look_at(origin=[0.2, 3, 0], target=[0.2, 0, 1.2], up=[1, 0, 0])
    params.update()
    np.testing.assert_array_equal(total(method.shade(points, samples=1, seed=0)), before)
    method.update()
    moved = total(method.shade(points, samples=1, seed=0))
    np.testing.assert_allclose(moved, expect_one_light(method, points), rtol=ROUNDING, atol=1e-9)
    assert not np.allclose(moved, before, rtol=0.05)


@pytest.mark.parametrize("opacity", [1.0, 0.25])
def test_screens_cast_shadows(mi: Any, opacity: float) -> None:
    transform = mi.ScalarTransform4f
    # From the floor to a height of 0.8, between light and wall.
    place = transform().translate([0, 0.3, -0.3]).scale([2, 0.5, 1])
    screen = {"type": "mask", "opacity": opacity, "inner": {"type": "diffuse"}}
    scene = make_corner(mi, screen=make_square(place, bsdf=screen))
    points = view(scene)
    method = make_lights(scene, count=1, max_depth=3, clamp=0.0)
    light = np.array(method.lights.si.p).T[0]
    position = np.array(points.si.p).T
    height = position[:, 1] * (light[2] + 0.3) / (light[2] - position[:, 2])
    wall = (position[:, 2] < -0.99) & (np.abs(height - 0.8) > 0.01)
    through = np.where(height < 0.8, 1.0 - opacity, 1.0)[None, :, None]
    found = get_image(method.shade(points, samples=1, seed=0).diffuse)[:, wall]
    expected = (expect_one_light(method, points) * through)[:, wall]
    assert 4 < (height[wall] < 0.8).sum() < wall.sum() - 4
    np.testing.assert_allclose(found, expected, rtol=ROUNDING, atol=1e-9)


def test_a_sphere_in_place_of_the_light_is_the_integral_over_its_cone(mi: Any) -> None:
    scene = make_corner(mi)
    points = view(scene)
    method = make_lights(scene, count=1, max_depth=3, radius=0.4 / CORNER)
    found = np.mean([total(method.shade(points, samples=64, seed=seed)) for seed in range(4)], axis=0)[0, :, 0]

    place = np.array(method.lights.si.p).T[0].astype(np.float64)
    flux = float(np.array(method.lights.flux)[0, 0])
    position, normal = (np.array(value).T.astype(np.float64) for value in (points.si.p, points.si.n))
    wall = np.abs(normal[:, 2]) > 0.5
    expected = np.zeros(len(position))
    for k in np.nonzero(wall)[0]:
        axis = place - position[k]
        distance = np.linalg.norm(axis)
        axis /= distance
        side = np.cross(axis, [1.0, 0.0, 0.0])
        side /= np.linalg.norm(side)
        other = np.cross(axis, side)
        least = math.sqrt(1.0 - (0.4 / distance) ** 2) if distance > 0.4 else -1.0
        cosine, phi = np.meshgrid(
            least + (1.0 - least) * (np.arange(400) + 0.5) / 400, 2.0 * math.pi * (np.arange(400) + 0.5) / 400
        )
        sine = np.sqrt(1.0 - cosine**2)[..., None]
        directions = cosine[..., None] * axis + sine * (np.cos(phi)[..., None] * side + np.sin(phi)[..., None] * other)
        both = np.maximum(directions[..., 2], 0.0) * np.maximum(-directions[..., 1], 0.0)
        solid_angle = 2.0 * math.pi * (1.0 - least)
        expected[k] = flux * (0.5 / math.pi) ** 2 * both.mean() * solid_angle / (math.pi * 0.4**2)
    # Some pixels lie within the sphere, some outside; 256 pairs of samples each.
    assert expected.max() > 0.0
    np.testing.assert_allclose(found[wall], expected[wall], atol=0.1 * expected.max())
    assert found[wall].sum() == pytest.approx(expected[wall].sum(), rel=0.02)


@pytest.mark.nightly
@pytest.mark.parametrize(
    ("options", "apart"), [({"radius": 2e-4}, 0.01), ({"kind": "gaussians", "cluster_size": 1}, 0.02)], ids=str
)
def test_small_spheres_and_clusters_of_one_are_points(cornell: Any, options: dict[str, Any], apart: float) -> None:
    points = view(cornell)
    plain = total(make_lights(cornell, count=64, clamp=0.0).shade(points, samples=1, seed=0, all_lights=True))
    small = total(make_lights(cornell, count=64, **options).shade(points, samples=1, seed=0, all_lights=True))
    # Only points that are nearer to a light than some radii, or than its share of the walls, see another thing.
    assert np.median(np.abs(small - plain)[plain > 0] / plain[plain > 0]) < 1e-3
    assert small.mean() == pytest.approx(plain.mean(), rel=apart)


@pytest.mark.nightly
def test_error_falls_as_lights_grow_in_number_and_the_clamp_opens(cornell: Any, cornell_paths: np.ndarray) -> None:
    points = view(cornell)
    errors = []
    for count, clamp in ((64, 0.08), (512, 0.04), (4096, 0.02)):
        method = make_lights(cornell, count=count, clamp=clamp)
        image = total(method.shade(points, samples=1, seed=0, all_lights=True))
        errors.append(rel_mse(image, cornell_paths))
    assert image.mean() == pytest.approx(cornell_paths.mean(), rel=PATHS_NOISE)
    assert errors[0] > 2.0 * errors[1] > 4.0 * errors[2]


@pytest.mark.nightly
def test_clamping_takes_light_and_compensation_brings_it_back(cornell: Any, cornell_paths: np.ndarray) -> None:
    points = view(cornell)
    before = np.full_like(cornell_paths, np.inf)
    for clamp in (0.0, 0.1, 0.2, 0.4):
        method = make_lights(cornell, count=1024, clamp=clamp)
        image = total(method.shade(points, samples=1, seed=0, all_lights=True))
        assert (image <= before * (1 + ROUNDING)).all()
        assert image.mean() < 0.99 * before.mean()
        before = image
    assert image.mean() < 0.8 * cornell_paths.mean()
    method = make_lights(cornell, count=1024, clamp=0.4, compensate=True)
    mended = total(method.shade(points, samples=64, seed=0))
    assert mended.mean() == pytest.approx(cornell_paths.mean(), rel=PATHS_NOISE)
    assert rel_mse(mended, cornell_paths) < 0.1 * rel_mse(image, cornell_paths)


@pytest.mark.nightly
def test_samples_are_parts_of_the_whole(cornell: Any) -> None:
    from lobewise.render.virtual_lights.point_walk import LIGHTS_PER_SAMPLE

    points = view(cornell)
    method = make_lights(cornell, count=512)
    whole = total(method.shade(points, samples=1, seed=0, all_lights=True))
    runs = math.ceil(method.lights.number / LIGHTS_PER_SAMPLE)
    assert runs > 16
    # As many samples as runs: every pixel takes each run once.
    np.testing.assert_allclose(total(method.shade(points, samples=runs, seed=5)), whole, rtol=1e-3)
    # One sample each: neighbours take different runs, and over seeds they take all.
    few = [total(method.shade(points, samples=1, seed=seed)) for seed in range(4 * runs)]
    assert np.median(np.abs(few[0] - whole)[whole > 0] / whole[whole > 0]) > 0.05
    np.testing.assert_allclose(np.mean(few, axis=0).mean(axis=1), whole.mean(axis=1), rtol=0.01)


@pytest.mark.sampled("gaussians")
@pytest.mark.parametrize("options", [{"compensate": True}, {"kind": "gaussians"}], ids=["points", "gaussians"])
def test_same_seed_same_bits_whatever_the_order(cornell: Any, options: dict[str, Any]) -> None:
    from lobewise.render.bridge import dr, mi
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.tracing.points import trace_points

    method = make_lights(cornell, count=256, **options)
    first = total(method.shade(view(cornell), samples=2, seed=7))
    method.update()
    np.testing.assert_array_equal(total(method.shade(view(cornell), samples=2, seed=7)), first)
    assert not np.array_equal(total(method.shade(view(cornell), samples=2, seed=8)), first)
    order = np.random.default_rng(0).permutation(32 * 32)[:100].astype(np.uint32)
    size = (dr.opaque(mi.UInt32, 32), dr.opaque(mi.UInt32, 32))
    some = trace_points(cornell, read_scene_materials(cornell), mi.UInt32(order), size)
    np.testing.assert_array_equal(total(method.shade(some, samples=2, seed=7)), first[:, order])
    other = make_lights(cornell, count=256, seed=1)
    assert not np.array_equal(np.array(other.lights.si.p), np.array(method.lights.si.p))


@pytest.mark.parametrize(("kind", "alpha"), [("points", None), ("gaussians", 0.1)])
def test_nothing_is_compiled_twice(mi: Any, kind: str, alpha: float | None) -> None:
    """Shade with other seeds and numbers of samples, after updates.

    Kernels hold every BSDF that is alive: where old scenes become garbage in between, kernels are compiled anew.
    """
    from lobewise.render.bridge import dr, hold_garbage

    scene = make_cornell_box(mi, alpha)
    method = make_lights(scene, kind=kind, count=256)

    def run(seed: int, samples: int) -> None:
        method.update()
        dr.eval(method.shade(view(scene), samples=samples, seed=seed))

    with hold_garbage(), dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        run(0, 1)
        dr.kernel_history_clear()
        run(1, 2)
        run(12345, 1)
        kernels = [kernel for kernel in dr.kernel_history() if kernel["type"] == dr.KernelType.JIT]
    assert len(kernels) >= 4
    assert all(kernel["cache_hit"] for kernel in kernels)


@pytest.mark.sampled("points-bsdf0", "gaussians-bsdf1")
@pytest.mark.parametrize(("kind", "bsdf"), [("points", MIRROR), ("gaussians", MIRROR), ("gaussians", SMOOTH)])
def test_mirrors_show_what_is_lit(mi: Any, kind: str, bsdf: dict[str, Any]) -> None:
    # A mirror shows the floor: its direct light counts, being scattered twice, and so does what lights it virtually.
    scene = make_corner(mi, cone=30.0, bsdf=bsdf)
    points = view(scene)
    method = make_lights(scene, kind=kind, count=4096, **({"clamp": 0.0} if kind == "points" else {}))
    paths = render_paths(scene, points, samples=4096)
    found = method.shade(points, samples=64, seed=0)
    mirror = np.abs(np.array(points.si.n)[2]) > 0.5
    assert 0.2 < mirror.mean() < 0.9
    assert get_image(found.diffuse)[:, mirror].max() == 0.0
    lit, expected = get_image(found.specular)[:, mirror], get_image(paths.specular)[:, mirror]
    assert expected.max() > 0.01
    assert lit.mean() == pytest.approx(expected.mean(), rel=PATHS_NOISE)
    distance, expected_distance = (np.array(light.hit_distance)[mirror] for light in (found, paths))
    if bsdf is MIRROR:
        np.testing.assert_allclose(distance, expected_distance, rtol=1e-3)
        assert np.array(found.hit_distance)[~mirror].max() == 0.0


@pytest.mark.nightly
@pytest.mark.parametrize("emitter", ["area", "point", "directional", "sky"])
def test_any_surface_and_emitter_agrees_with_paths(mi: Any, make_box_scene: Box, emitter: str) -> None:
    transform = mi.ScalarTransform4f
    texture = {"type": "bitmap", "data": mi.TensorXf(np.random.default_rng(1).random((8, 8, 3)) * 0.8)}
    plastic = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.3}
    plastic["diffuse_reflectance"] = texture
    bumps = np.full((8, 8, 3), 0.5)
    bumps[..., 2], bumps[::2, :, 0] = 1.0, 0.7
    bumpy = {"type": "normalmap", "normalmap": {"type": "bitmap", "raw": True, "data": mi.TensorXf(bumps)}}
    bumpy["bsdf"] = plastic
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha": 0.4}

    def ball(x: float, bsdf: dict[str, Any]) -> dict[str, Any]:
        return {"type": "sphere", "center": [x, 0.5, 0.0], "radius": 0.45, "bsdf": bsdf}

    items: dict[str, Any] = {"bumpy": ball(-0.7, bumpy), "metal": ball(0.7, {"type": "twosided", "inner": metal})}
    if emitter in ("area", "sky"):
        # Paths never find a lamp without extent behind a mask; light paths pass through.
        mask = {"type": "mask", "opacity": 0.5, "inner": {"type": "twosided", "inner": plastic}}
        items["sheet"] = make_square(transform().translate([0, 1.4, -1]).scale([0.8, 0.3, 1.0]), bsdf=mask)
    shine = rgb(3.0, 2.5, 2.0)
    if emitter == "point":
        items["light"] = {"type": "point", "position": [1, 2, 1], "intensity": shine}
    elif emitter == "directional":
        items["light"] = {"type": "directional", "direction": [0.4, -1, -0.5], "irradiance": shine}
    elif emitter == "sky":
        items["light"] = {"type": "constant", "radiance": {"type": "rgb", "value": 0.5}}
    scene = make_box_scene(items, size=16)
    points = view(scene)
    method = make_lights(scene, count=1 << 15, clamp=0.1, compensate=True)
    found, paths = method.shade(points, samples=128, seed=0), render_paths(scene, points, samples=4096)
    for name, tolerance in (("diffuse", PATHS_NOISE), ("specular", SPIKES)):
        mine, theirs = get_image(getattr(found, name)), get_image(getattr(paths, name))
        assert theirs.mean() > 0.003
        assert mine.mean() == pytest.approx(theirs.mean(), rel=tolerance), name
        assert np.median(mine) == pytest.approx(np.median(theirs), rel=tolerance), name


def test_black_surfaces_give_no_light(mi: Any) -> None:
    black = {"type": "conductor", "material": "none", "specular_reflectance": {"type": "rgb", "value": 0.0}}
    items = {"type": "scene", "a": {"type": "sphere", "bsdf": black}, "b": {"type": "constant"}}
    scene = mi.load_dict({**items, "sensor": {"type": "perspective"}})
    assert make_lights(scene, count=16).lights.number == 0


def test_what_is_recorded_can_be_replayed(mi: Any) -> None:
    from lobewise.render.bridge import dr
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.tracing.points import trace_points

    scene = make_corner(mi, cone=30.0)
    points = view(scene)
    method = make_lights(scene, count=256)
    materials = read_scene_materials(scene)

    @dr.freeze(state_fn=lambda *_, **__: (scene, method.state))
    def replay(pixel: Any, width: Any, samples: Any, seed: Any) -> list[Any]:
        points = trace_points(scene, materials, pixel, (width, width))
        light = method.shade(points, samples=samples, seed=seed)
        return [light.diffuse, light.specular]

    params = mi.traverse(scene)
    for turn, (samples, seed) in enumerate([(1, 0), (2, 7), (1, 12345), (1, 12345)]):
        if turn == 2:
            params["spot.to_world"] = mi.Transform4f().look_at(origin=[0.2, 3, 0], target=[0.2, 0, 1.0], up=[1, 0, 0])
            params.update()
            method.update()
        expected = total(method.shade(points, samples=samples, seed=seed))
        assert expected.max() > 0.0
        pixel = dr.arange(mi.UInt32, 64)
        dr.eval(pixel)
        found = replay(pixel, *(dr.opaque(mi.UInt32, number) for number in (8, samples, seed)))
        np.testing.assert_array_equal(get_image(found[0]) + get_image(found[1]), expected)
    assert replay.n_recordings == 1


@pytest.mark.parametrize("number", [0, 1])
def test_no_light_is_an_error(mi: Any, number: int) -> None:
    items: dict[str, Any] = {"type": "scene", "ball": {"type": "sphere"}}
    if number:
        items["dark"] = {"type": "point", "position": [2, 0, 0], "intensity": {"type": "rgb", "value": 0.0}}
    with refuses(InputError, "scene", f"{number} emitters and no light from them"):
        make_lights(mi.load_dict(items))


@pytest.mark.parametrize(
    "wrong", [{"count": 0}, {"max_depth": 2}, {"clamp": -0.1}, {"radius": 1.5}, {"seed": -1}, {"clamp": "much"}]
)
def test_wrong_numbers_are_errors(cornell: Any, wrong: dict[str, Any]) -> None:
    with refuses(InputError, next(iter(wrong))):
        make_lights(cornell, **wrong)


def test_sharpness_limit_is_where_a_lobe_holds_one_light() -> None:
    from lobewise.render.virtual_lights.instant_radiosity import compute_sharpness_limit

    for lights in (4.0, 8.0, 100.0):
        sharpness = 1.0 / compute_sharpness_limit(lights) ** 2
        # Effective solid angle of the spherical Gaussian by quadrature, times lights per steradian.
        cosine = -1.0 + 2.0 * (np.arange(20000) + 0.5) / 20000
        lobe = np.exp(sharpness * (cosine - 1.0))
        solid_angle = 2.0 * math.pi * 2.0 * lobe.mean() ** 2 / (lobe**2).mean()
        assert lights / (2.0 * math.pi) * solid_angle == pytest.approx(1.0, rel=1e-3)
    assert compute_sharpness_limit(0.01) == 1.0
    with refuses(InputError, "lights", "0.0"):
        compute_sharpness_limit(0.0)


def test_lights_seen_are_counted_by_their_worth(hollow: Any) -> None:
    # In red all lights of a sphere are alike; at a point each sends flux * rho / pi * cos / d^2 = ... / (2 R d).
    method = make_lights(hollow, count=64, max_depth=3, clamp=0.0)
    points = view(hollow)
    found = method.count_lights_seen(points, all_lights=True)
    places, position = (np.array(value).T.astype(np.float64) for value in (method.lights.si.p, points.si.p))
    light = 1.0 / np.linalg.norm(places[None] - position[:, None], axis=-1)
    worth = light.sum(axis=1) ** 2 / (light**2).sum(axis=1)
    assert found == pytest.approx(np.median(worth), rel=1e-3)
    assert 1.0 <= method.count_lights_seen(points) < found
