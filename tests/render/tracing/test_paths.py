"""The path tracer against Mitsuba's own, against furnaces, and against itself."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from lobewise.records.frame import Frame
from tests.render.items import make_camera, make_lamp, make_square, rgb
from tests.render.tolerances import FRACTION_BEYOND, NOISE, Z_BLOCK, Z_MEAN, Z_USUAL

pytestmark = pytest.mark.mitsuba

SceneMaker = Callable[..., Any]


def ball(mi: Any, x: float, bsdf: dict[str, Any], y: float = 0.5, radius: float = 0.5) -> dict[str, Any]:
    return {"type": "sphere", "center": [x, y, 0.0], "radius": radius, "bsdf": bsdf}


def make_mixed_items(mi: Any) -> dict[str, Any]:
    """Return balls of every kind of lobe and wrapper, a masked one and a blend among them."""
    plastic = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.2, "diffuse_reflectance": rgb(0.7, 0.2, 0.1)}
    metal = {"type": "roughconductor", "distribution": "ggx", "alpha_u": 0.4, "alpha_v": 0.15}
    return {
        "plastic": ball(mi, -1.2, plastic),
        "metal": ball(mi, 0.0, {"type": "twosided", "inner": metal}),
        "blend": ball(mi, 1.2, {"type": "blendbsdf", "weight": 0.5, "a": metal, "b": {"type": "diffuse"}}),
        "masked": ball(mi, -0.6, {"type": "mask", "opacity": 0.6, "inner": plastic}, y=1.3, radius=0.35),
        "burley": ball(mi, 0.6, {"type": "principled", "roughness": 0.5, "metallic": 0.4}, y=1.3, radius=0.35),
        # Without a sky Mitsuba drops what a path found before it left the scene through a mask.
        "sky": {"type": "constant", "radiance": rgb(0.05, 0.06, 0.07)},
    }


def render_theirs(mi: Any, scene: Any, spp: int, seed: int, max_depth: int = 8) -> np.ndarray:
    integrator = mi.load_dict({"type": "path", "max_depth": max_depth})
    return np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed))[..., :3]


def pool(image: np.ndarray, size: int) -> np.ndarray:
    """Return means over blocks of size x size pixels."""
    height, width, channels = image.shape
    return image.reshape(height // size, size, width // size, size, channels).mean(axis=(1, 3))


def compare_with_mitsuba(
    mi: Any, scene: Any, spp: int, max_depth: int = 8, *, frame: Frame | None = None, has_sparks: bool = False
) -> None:
    """Test pixels, blocks of 4x4 and the mean over the image, in standard errors of two independent renders.

    The variance of a pixel is pooled over its block: alone, it is low just where a rare bright sample was missed.
    """
    from lobewise.render import render_frame

    frame = frame or render_frame(scene, spp=spp, seed=3, max_depth=max_depth)
    error = frame.radiance.color.astype(np.float64) - render_theirs(mi, scene, spp, 11, max_depth)
    variance = 2.0 * frame.variance.color.astype(np.float64) + 1e-8
    block_variance = pool(variance, 4)
    z = error / np.sqrt(np.kron(block_variance, np.ones((4, 4, 1))))
    assert np.mean(np.abs(z) > Z_USUAL) < FRACTION_BEYOND
    if not has_sparks:
        assert np.abs(pool(error, 4) / np.sqrt(block_variance / 16)).max() < Z_BLOCK
    assert np.abs(error.mean(axis=(0, 1)) / np.sqrt(variance.mean(axis=(0, 1)) / (z.size / 3))).max() < Z_MEAN


@pytest.mark.sampled("1")
@pytest.mark.parametrize("max_depth", [1, 2, 3, 8])
def test_agrees_with_mitsubas_path_integrator(mi: Any, make_box_scene: SceneMaker, max_depth: int) -> None:
    compare_with_mitsuba(mi, make_box_scene(make_mixed_items(mi)), 256, max_depth)


@pytest.mark.nightly
def test_agrees_with_mitsuba_on_smooth_surfaces_and_sky(mi: Any, make_box_scene: SceneMaker) -> None:
    items = {
        "mirror": ball(mi, -1.2, {"type": "conductor"}),
        "glass": ball(mi, 0.0, {"type": "dielectric"}),
        "lacquer": ball(mi, 1.2, {"type": "plastic", "diffuse_reflectance": rgb(0.2, 0.5, 0.3)}),
        "frosted": ball(mi, 0.0, {"type": "roughdielectric", "alpha": 0.3}, y=1.4, radius=0.35),
        "sky": {"type": "constant", "radiance": rgb(0.5, 0.7, 1.0)},
        "lamp": {"type": "point", "position": [1.0, 2.5, 2.0], "intensity": rgb(3.0, 3.0, 3.0)},
    }
    compare_with_mitsuba(mi, make_box_scene(items), 512)


@pytest.fixture(scope="module")
def mixed(mi: Any, make_box_scene: SceneMaker) -> Frame:
    from lobewise.render import render_frame

    return render_frame(make_box_scene(make_mixed_items(mi)), spp=16, seed=2)


def test_parts_add_up(mixed: Frame) -> None:
    radiance = mixed.radiance
    for image in (radiance.diffuse, radiance.specular, radiance.direct, radiance.indirect):
        assert image.min() >= 0
        assert image.max() > 0
    emitted = radiance.color - radiance.diffuse - radiance.specular
    assert np.allclose(radiance.direct + radiance.indirect + emitted, radiance.color, rtol=1e-4, atol=1e-5)
    assert emitted.min() > -1e-5


def test_emission_seen_directly_is_in_no_part(mi: Any) -> None:
    from lobewise.render import render_frame

    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": make_camera(mi, [0, 0, 5], box=False),
            "lamp": make_lamp(mi.ScalarTransform4f(), rgb(2.0, 3.0, 4.0)),
            "veil": make_square(mi.ScalarTransform4f().translate([0, 0, 1]), bsdf={"type": "null"}),
            "sky": {"type": "constant", "radiance": rgb(0.1, 0.2, 0.3)},
        }
    )
    radiance = render_frame(scene, spp=4).radiance
    assert np.allclose(radiance.color[4, 4], (2.0, 3.0, 4.0))
    assert np.allclose(radiance.color[0, 0], (0.1, 0.2, 0.3))
    for image in (radiance.diffuse, radiance.specular, radiance.direct, radiance.indirect):
        assert image.max() == 0


@pytest.mark.nightly
def test_direct_light_is_what_a_shorter_path_brings(mi: Any, make_box_scene: SceneMaker, mixed: Frame) -> None:
    """The first scattering draws the same random numbers whatever follows, so the parts agree to the bit."""
    from lobewise.render import render_frame

    scene = make_box_scene({name: item for name, item in make_mixed_items(mi).items() if name != "masked"})
    long, short = (render_frame(scene, spp=8, seed=2, max_depth=depth).radiance for depth in (8, 2))
    assert np.array_equal(long.direct, short.direct)
    assert short.indirect.max() == 0
    assert np.allclose(short.diffuse + short.specular, short.direct, rtol=1e-5, atol=1e-6)


def test_split_follows_the_first_bounce_alone(mi: Any, furnace: Callable[..., Frame]) -> None:
    """A mirror that shows a diffuse world is specular, however often light is scattered after it."""
    from lobewise.render import render_frame

    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": make_camera(mi, [0, 0, 3], box=False, fov=30.0),
            "mirror": {"type": "rectangle", "bsdf": {"type": "conductor"}},
            "world": {"type": "sphere", "radius": 10.0, "flip_normals": True, "bsdf": {"type": "diffuse"}},
            "lamp": {"type": "point", "position": [0, 4, 5], "intensity": rgb(50, 50, 50)},
        }
    )
    radiance = render_frame(scene, spp=16).radiance
    assert radiance.specular.min() > 0
    assert radiance.diffuse.max() == 0
    assert np.allclose(radiance.direct, 0)
    assert np.allclose(radiance.indirect, radiance.color)


@pytest.mark.nightly
def test_lobes_split_next_event_light_by_their_value(mi: Any) -> None:
    """Under a point light nothing but next-event estimation finds light: each part is that lobe's value, no noise."""
    from lobewise.render import render_frame

    bsdf = {"type": "roughplastic", "distribution": "ggx", "alpha": 0.3, "diffuse_reflectance": rgb(0.7, 0.3, 0.1)}
    scene = mi.load_dict(
        {
            "type": "scene",
            "sensor": make_camera(mi, [0, 3, 4], size=(2, 2), box=False, fov=0.1),
            "square": {"type": "rectangle", "bsdf": bsdf},
            "lamp": {"type": "point", "position": [0, -2, 2], "intensity": rgb(8, 8, 8)},
        }
    )
    radiance = render_frame(scene, spp=4).radiance
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0, 3, 4), mi.Vector3f(0, -0.6, -0.8)))
    out = si.to_local(mi.Vector3f(0, -(0.5**0.5), 0.5**0.5))
    for part, flags in (("diffuse", mi.BSDFFlags.Diffuse), ("specular", mi.BSDFFlags.Glossy)):
        context = mi.BSDFContext()
        context.type_mask = flags
        value = np.array(scene.shapes()[0].bsdf().eval(context, si, out)).ravel()
        assert value.min() > 0
        assert np.allclose(getattr(radiance, part), value, rtol=0.01), part  # 8 / distance^2 = 1


def test_white_furnace_keeps_all_light(furnace: Callable[..., Frame]) -> None:
    frame = furnace({"type": "diffuse", "reflectance": 1.0}, spp=256)
    assert np.allclose(frame.radiance.color.mean(), 1.0, atol=NOISE)
    mirror = furnace({"type": "conductor"}, spp=16)
    assert np.allclose(mirror.radiance.specular, 1.0, atol=1e-5)
