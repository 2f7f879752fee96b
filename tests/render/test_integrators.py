"""Whose light a frame holds: what the scene's integrator says, by paths of this package or by itself."""

from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.render.integrators import DEPTH, MAX_DEPTH, plan_light, tell_unseen
from lobewise.render.own_light import make_box_sensor
from tests.mistakes import refuses
from tests.render.items import make_camera, make_lamp, make_square
from tests.render.tolerances import Z_MEAN

pytestmark = pytest.mark.mitsuba

HEIGHT, WIDTH = 24, 32
CROPPED = {
    "film": {"type": "hdrfilm", "width": 64, "height": 48, "crop_width": 20, "crop_height": 12, "crop_offset_x": 5}
}
FOG = {"type": "homogeneous", "sigma_t": 3.0, "albedo": {"type": "rgb", "value": [0.8, 0.6, 0.4]}}


def make_scene(
    mi: Any, integrator: dict[str, Any] | None, *, fog: bool = False, bsdf: dict[str, Any] | None = None, **sensor: Any
) -> Any:
    """Return a ball on a floor under a lamp and a dim sky."""
    transform = mi.ScalarTransform4f
    look = make_camera(mi, [0, -4, 1], [0, 0, 0.5], up=[0, 0, 1], size=(WIDTH, HEIGHT), box=False, fov=40)
    items: dict[str, Any] = {
        "type": "scene",
        "sensor": {**look, **sensor},
        "floor": make_square(transform().scale(4)),
        "ball": {"type": "sphere", "center": [0, 0, 0.7], "radius": 0.6},
        "lamp": make_lamp(transform().translate([0, 0, 4]).rotate([1, 0, 0], 180), 5.0),
        "sky": {"type": "constant", "radiance": 0.1},
    }
    if integrator is not None:
        items["integrator"] = integrator
    if fog:
        items["ball"] |= {"bsdf": bsdf or {"type": "null"}, "interior": FOG}
    return mi.load_dict(items)


def check_light(mi: Any, scene: Any, frame: Any, spp: int = 256) -> None:
    """Test the mean of every quarter of an image against the scene's own render, in standard errors."""
    sensor = make_box_sensor(scene)
    theirs = np.stack(
        [np.array(scene.integrator().render(scene, sensor, seed=50 + k, spp=spp // 8))[..., :3] for k in range(8)]
    ).astype(np.float64)
    for rows in (np.s_[: HEIGHT // 2], np.s_[HEIGHT // 2 :]):
        for columns in (np.s_[: WIDTH // 2], np.s_[WIDTH // 2 :]):
            means = theirs[:, rows, columns].mean(axis=(1, 2))
            ours = frame.radiance.color[rows, columns].mean(axis=(0, 1), dtype=np.float64)
            error = means.std(axis=0, ddof=1) / np.sqrt(8.0) * np.sqrt(1.0 + spp / frame.spp) + 1e-5
            assert (np.abs(ours - means.mean(axis=0)) < Z_MEAN * 1.5 * error).all()


def test_a_ball_of_fog_is_as_bright_as_mitsuba_renders_it(mi: Any) -> None:
    from lobewise.render import render_frame

    scene = make_scene(mi, {"type": "volpath", "max_depth": 32}, fog=True)
    frame = render_frame(scene, spp=256)
    check_light(mi, scene, frame)
    # Which it is not by paths, that see no fog at all.
    without = render_frame(scene, spp=16, integrator="paths").radiance.color
    ball = np.s_[8:14, 13:19]
    assert abs(without[ball].mean() / frame.radiance.color[ball].mean() - 1.0) > 0.3
    assert frame.radiance.parts is None
    mean = 0.5 * (frame.half_a.color + frame.half_b.color)
    np.testing.assert_allclose(mean, frame.radiance.color, rtol=1e-5, atol=1e-6)
    assert not np.array_equal(frame.half_a.color, frame.half_b.color)
    assert frame.gbuffer.normal is not None
    assert frame.camera is not None


@pytest.mark.sampled("integrator5-False", "integrator6-False")
@pytest.mark.parametrize(
    ("integrator", "fog"),
    [
        ({"type": "volpathmis"}, True),
        ({"type": "prbvolpath", "max_depth": 16}, True),
        ({"type": "ptracer", "max_depth": 6}, False),
        ({"type": "prb", "max_depth": 8, "hide_emitters": True}, False),
        ({"type": "volpath", "max_depth": 8, "hide_emitters": True}, True),
        ({"type": "direct", "bsdf_samples": 0}, False),
        ({"type": "moment", "inner": {"type": "path", "max_depth": 3}}, False),
        ({"type": "aov", "aovs": "dd:depth", "inner": {"type": "direct", "hide_emitters": True}}, False),
    ],
)
def test_the_scenes_own_integrator_renders_what_paths_do_not(mi: Any, integrator: dict[str, Any], fog: bool) -> None:
    from lobewise.render import render_frame, render_reference

    scene = make_scene(mi, integrator, fog=fog)
    plan = plan_light(scene)
    assert plan.own is not None
    assert f"{integrator['type']!r}" in plan.sentence
    check_light(mi, scene, render_frame(scene, spp=65))
    check_light(mi, scene, render_reference(scene, spp=64))


@pytest.mark.sampled("None-8", "integrator1-65536", "integrator2-3", "integrator5-2", "integrator7-2")
@pytest.mark.parametrize(
    ("integrator", "depth"),
    [
        (None, DEPTH),
        ({"type": "path"}, MAX_DEPTH),
        ({"type": "path", "max_depth": 3}, 3),
        ({"type": "path", "max_depth": 6, "hide_emitters": True}, 6),
        ({"type": "volpath", "max_depth": 6, "hide_emitters": True}, 6),
        ({"type": "direct", "hide_emitters": True}, 2),
        ({"type": "prb", "max_depth": 4}, 4),
        ({"type": "direct"}, 2),
        ({"type": "volpath", "max_depth": 5}, 5),
        ({"type": "volpathmis", "max_depth": 3}, 3),
        ({"type": "aov", "aovs": "dd:depth", "inner": {"type": "path", "max_depth": 2}}, 2),
    ],
)
def test_paths_render_what_they_estimate_too(mi: Any, integrator: dict[str, Any] | None, depth: int) -> None:
    from lobewise.render import render_frame

    scene = make_scene(mi, integrator)
    plan = plan_light(scene)
    assert (plan.own, plan.max_depth, plan.sentence) == (None, depth, "")
    frame = render_frame(scene, spp=64)
    assert frame.radiance.parts is not None
    if integrator is not None:
        check_light(mi, scene, frame)


def test_what_asked_for_goes_first(mi: Any) -> None:
    scene = make_scene(mi, {"type": "path", "max_depth": 5})
    assert plan_light(scene, "paths", 3).max_depth == 3
    assert plan_light(scene, "scene").own is not None
    hidden = make_scene(mi, {"type": "prb", "max_depth": 5, "hide_emitters": True})
    plan = plan_light(hidden, "paths")
    assert plan.own is None
    assert "the scene's own 'prb' would give other light" in plan.sentence


def test_surfaces_that_hold_media_have_no_lobe(mi: Any) -> None:
    from lobewise.render import render_frame

    scene = make_scene(mi, {"type": "volpath"}, fog=True, bsdf={"type": "dielectric"})
    own, paths = (render_frame(scene, spp=4, integrator=name).gbuffer for name in ("auto", "paths"))
    for name, plain in (("alpha_u", 1.0), ("alpha_v", 1.0), ("lobe_kind", 0.0)):
        found, before = getattr(own, name), getattr(paths, name)
        assert (found[8:14, 13:19] == plain).all()
        assert not (before[8:14, 13:19] == plain).any()
        np.testing.assert_array_equal(found[-2:], before[-2:])


def test_media_that_nobody_renders_are_told(mi: Any) -> None:
    for integrator, whose in (({"type": "path"}, "the scene's integrator, 'path', does not"), (None, "paths do not")):
        plan = plan_light(make_scene(mi, integrator, fog=True))
        assert plan.own is None
        assert whose in plan.sentence
        assert plan_light(make_scene(mi, integrator)).sentence == ""


def test_the_same_seed_gives_the_same_light_and_another_other(mi: Any) -> None:
    from lobewise.render import render_frame

    scene = make_scene(mi, {"type": "volpath"}, fog=True)
    first, again, other = (render_frame(scene, spp=2, seed=seed).radiance.color for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert not np.array_equal(first, other)
    assert render_frame(scene, spp=1).half_a is None


def test_progress_counts_the_samples_of_an_own_integrator(mi: Any) -> None:
    from lobewise.render import render_frame

    told: list[tuple[int, int]] = []
    render_frame(
        make_scene(mi, {"type": "volpath"}, fog=True), spp=5, progress=lambda done, total: told.append((done, total))
    )
    assert told[0] == (0, 5 * HEIGHT * WIDTH)
    assert told[-1] == (5 * HEIGHT * WIDTH, 5 * HEIGHT * WIDTH)
    assert told == sorted(told)


@pytest.mark.parametrize(
    "sensor",
    [
        {},
        {"principal_point_offset_x": 0.2, "principal_point_offset_y": -0.1},
        {"fov_axis": "y"},
        {
            "film": {
                "type": "hdrfilm",
                "width": 64,
                "height": 48,
                "crop_width": 20,
                "crop_height": 12,
                "crop_offset_x": 5,
            }
        },
    ],
)
def test_the_copy_of_a_sensor_has_its_rays(mi: Any, sensor: dict[str, Any]) -> None:
    scene = make_scene(mi, None, **sensor)
    original, copy = scene.sensors()[0], make_box_sensor(scene)
    place = mi.Point2f([0.1, 0.5, 0.9], [0.3, 0.5, 0.8])
    for lens in (0.5, 0.1):
        rays = [each.sample_ray(0.0, 0.5, place, mi.Point2f(lens))[0] for each in (original, copy)]
        for name in ("o", "d"):
            first, second = (np.array(getattr(ray, name)) for ray in rays)
            np.testing.assert_allclose(first, second, atol=1e-5)


def test_mistakes_are_told(mi: Any) -> None:
    from lobewise.render import render_frame, render_pixels, render_sparse_frame

    fog = make_scene(mi, {"type": "volpath"}, fog=True)
    traced = make_scene(mi, {"type": "ptracer"})
    depth = make_scene(mi, {"type": "depth"})
    bare = make_scene(mi, {"type": "aov", "aovs": "dd:depth"})
    cases: list[tuple[str, str, Any]] = [
        ("integrator", "'scen'", lambda: render_frame(fog, spp=1, integrator="scen")),
        ("max_depth", "4", lambda: render_frame(fog, spp=1, max_depth=4)),
        ("light", "'indirect'", lambda: render_frame(fog, spp=1, light="indirect")),
        ("light", "'indirect'", lambda: render_sparse_frame(fog, spp=1, scale=2, light="indirect")),
        ("integrator", "'ptracer'", lambda: render_sparse_frame(traced, spp=1, scale=2)),
        ("integrator", "'ptracer'", lambda: render_pixels(traced, [0], [0], spp=1)),
        ("integrator", "'depth'", lambda: render_frame(depth, spp=1)),
        ("integrator", "'aov' without one inside", lambda: render_frame(bare, spp=1)),
        ("integrator", "none", lambda: plan_light(make_scene(mi, None), "scene")),
    ]
    for what, got, call in cases:
        with refuses(InputError, what, got):
            call()


def make_lens(mi: Any, radius: float, focus: float = 4.0) -> dict[str, Any]:
    return {"type": "thinlens", "aperture_radius": radius, "focus_distance": focus}


def test_a_lens_blurs_the_light_and_the_guides(mi: Any) -> None:
    from lobewise.render import render_frame, render_reference

    film = {"type": "hdrfilm", "width": WIDTH, "height": HEIGHT, "rfilter": {"type": "box"}}
    scene = make_scene(mi, {"type": "path", "max_depth": 6}, film=film, **make_lens(mi, 0.3, focus=1.5))
    plan = plan_light(scene)
    assert plan.lens
    assert "through the lens by 'path'" in plan.sentence
    frame = render_frame(scene, spp=256)
    check_light(mi, scene, frame)
    check_light(mi, scene, render_reference(scene, spp=64))
    theirs = np.array(mi.render(scene, spp=1024, seed=9))[..., :3]
    sharp = render_frame(make_scene(mi, {"type": "path", "max_depth": 6}), spp=256).radiance.color
    assert np.abs(frame.radiance.color - theirs).mean() < 0.5 * np.abs(sharp - theirs).mean()
    assert frame.half_a is not None
    assert frame.camera is not None
    assert frame.radiance.parts is None


def test_guides_through_a_narrow_lens_are_those_of_a_pinhole(mi: Any) -> None:
    from lobewise.render import render_frame

    lens = render_frame(make_scene(mi, None, **make_lens(mi, 1e-4)), spp=32, aov_only=True)
    plain = render_frame(make_scene(mi, None), spp=32, aov_only=True)
    np.testing.assert_allclose(lens.camera.position, plain.camera.position, atol=1e-6)
    inner = np.s_[4:14, 14:18]
    for name, tolerance in (("depth", 0.02), ("position", 0.03), ("normal", 0.05), ("diffuse_albedo", 0.01)):
        first, second = getattr(lens.gbuffer, name), getattr(plain.gbuffer, name)
        np.testing.assert_allclose(first[inner], second[inner], atol=tolerance)


def test_guides_through_a_wide_lens_are_means(mi: Any) -> None:
    from lobewise.render import render_frame

    wide = render_frame(make_scene(mi, None, **make_lens(mi, 0.6, focus=100.0)), spp=32, aov_only=True)
    # Around the ball's outline floor and ball are mixed.
    lengths = np.linalg.norm(wide.gbuffer.normal, axis=-1)
    assert ((lengths > 0.1) & (lengths < 0.9)).mean() > 0.1


def test_what_a_lens_cannot_have_is_told(mi: Any) -> None:
    from lobewise.render import get_camera, render_frame

    scene = make_scene(mi, {"type": "path"}, **make_lens(mi, 0.3))
    camera = get_camera(make_scene(mi, None))
    cases: list[tuple[str, str, Any]] = [
        ("integrator", "'paths'", lambda: render_frame(scene, spp=1, integrator="paths")),
        ("previous_camera", "one", lambda: render_frame(scene, spp=1, previous_camera=camera)),
        ("sensor", "'thinlens'", lambda: get_camera(scene)),
    ]
    for what, got, call in cases:
        with refuses(InputError, what, got):
            call()
    assert get_camera(make_scene(mi, None, **make_lens(mi, 0.0))).position.shape == (3,)


@pytest.mark.parametrize(
    ("integrator", "more", "told"),
    [
        (None, {}, ""),
        ({"type": "path"}, {}, ""),
        (
            None,
            {"fog": True},
            "There are participating media, which paths do not render; put 'volpath' into the scene to see them.",
        ),
        (
            {"type": "volpath"},
            {"fog": True},
            "With the method 'paths' all light is that of the scene's own 'volpath'; "
            "other methods show light of surfaces alone.",
        ),
        ({"type": "ptracer"}, {}, "The pictures show light by paths, not by the scene's own 'ptracer'."),
        (
            {"type": "path"},
            {"type": "thinlens", "aperture_radius": 0.1, "focus_distance": 4.0},
            "The picture is sharp while the camera moves, and is seen through the lens when the camera rests.",
        ),
    ],
)
def test_what_a_preview_does_not_show_is_named(mi, integrator, more, told):
    assert tell_unseen(make_scene(mi, integrator, **more)) == told


@pytest.mark.sampled("moment")
@pytest.mark.parametrize(
    "integrator",
    [
        {"type": "volpath", "max_depth": 32},
        {"type": "volpathmis", "max_depth": 32},
        {"type": "prbvolpath", "max_depth": 32},
        {"type": "moment", "inner": {"type": "volpath", "max_depth": 32}},
        {"type": "aov", "aovs": "dd:depth", "inner": {"type": "volpath", "max_depth": 32}},
    ],
    ids=lambda integrator: integrator["type"],
)
def test_single_pixels_have_the_light_of_whole_frames(mi: Any, integrator: dict[str, Any]) -> None:
    from lobewise.render import render_frame, render_pixels, render_sparse_frame

    scene = make_scene(mi, integrator, fog=True)
    sparse = render_sparse_frame(scene, spp=512, scale=2, place=(1, 0))
    assert sparse.gbuffer.lobe_kind is not None
    whole = render_frame(scene, spp=512, seed=1)
    seen = whole.radiance.color[1::2, ::2]
    noise = np.sqrt(2.0 * sparse.variance.color) + 1e-3
    z = (sparse.radiance.color - seen) / noise
    assert sparse.radiance.color.shape == seen.shape
    assert abs(z.mean()) < 0.3
    assert np.mean(np.abs(z) > 4.0) < 0.05
    again = render_pixels(scene, [1, 13], [2, 16], spp=512)
    expected = whole.radiance.color[[1, 13], [2, 16]]
    np.testing.assert_allclose(again.color[:, 0].mean(), expected.mean(), rtol=0.15)


def test_a_sparse_frame_through_a_lens(mi: Any) -> None:
    from lobewise.render import render_frame, render_sparse_frame

    scene = make_scene(mi, {"type": "path", "max_depth": 6}, **make_lens(mi, 0.5, focus=1.5))
    sparse = render_sparse_frame(scene, spp=512, scale=2)
    blurred = render_frame(scene, spp=512, seed=2)
    sharp = render_frame(make_scene(mi, {"type": "path", "max_depth": 6}), spp=512)
    errors = [np.abs(sparse.radiance.color - frame.radiance.color[::2, ::2]).mean() for frame in (blurred, sharp)]
    assert errors[0] < 0.3 * errors[1]
    np.testing.assert_allclose(np.median(sparse.gbuffer.depth), np.median(blurred.gbuffer.depth), rtol=0.05)
