"""Guides of scenes that Mitsuba's users have: instances, and surfaces that let light pass."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.render import render_frame
from tests.mistakes import refuses
from tests.render.any_scene import load, make_ball, make_flat_sensor, make_room, make_sensor, make_texture

pytestmark = pytest.mark.mitsuba

GUIDES = ("depth", "position", "normal", "alpha_u", "lobe_kind", "diffuse_albedo", "specular_albedo")


def make_copies(mi: Any, *, instances: bool) -> Any:
    """Return a room with two rough balls, which are instances of one ball or balls of their own."""
    at = mi.ScalarTransform4f
    where = {"left": at().translate([-0.7, 0.5, 0]).scale(0.5), "right": at().translate([0.6, 0.4, 0.3]).scale(0.4)}
    paint = {"type": "roughplastic", "alpha": 0.2, "diffuse_reflectance": {"type": "rgb", "value": [0.1, 0.7, 0.2]}}
    if not instances:
        balls = {name: {"type": "sphere", "to_world": place, "bsdf": paint} for name, place in where.items()}
        return mi.load_dict(make_room(mi, **balls))
    group = {"type": "shapegroup", "ball": {"type": "sphere", "bsdf": paint}}
    copies = {
        name: {"type": "instance", "to_world": place, "shapegroup": {"type": "ref", "id": "group"}}
        for name, place in where.items()
    }
    return mi.load_dict(make_room(mi, group=group, **copies))


def test_instances_have_the_guides_of_what_they_repeat(mi: Any) -> None:
    frames = [render_frame(make_copies(mi, instances=some), spp=64).gbuffer for some in (True, False)]
    shown = frames[1].alpha_u == np.float32(0.2)
    assert shown.sum() > 20
    for name in GUIDES:
        first, second = (getattr(guides, name)[shown] for guides in frames)
        np.testing.assert_allclose(first, second, atol=0.02, err_msg=name)


def test_an_instance_moves_by_its_own_name(mi: Any) -> None:
    scene = make_copies(mi, instances=True)
    still = render_frame(scene, spp=1, aov_only=True)
    moved = render_frame(
        scene,
        spp=1,
        aov_only=True,
        previous_camera=still.camera,
        moves={"left": mi.ScalarTransform4f().translate([0.0, 0.3, 0.0]).matrix},
    ).gbuffer
    assert moved.alpha_u is not None
    balls = moved.alpha_u == np.float32(0.2)
    left = balls & (moved.position[..., 0] < 0.0)
    assert left.sum() > 10
    assert (moved.motion[left][:, 1] < -0.5).all()
    assert np.abs(moved.motion[~left]).max() < 1e-3


@pytest.mark.parametrize(
    "name", ["null", "mask", "mask of a mask", "pane", "bump map of a pane", "normal map of a mask", "blend", "diffuse"]
)
def test_what_passes_a_surface_is_what_its_samples_let_pass(mi: Any, name: str) -> None:
    from lobewise.render.bridge import dr
    from lobewise.render.materials.bsdfs import read_material
    from lobewise.render.materials.dispatch import compute_null_transmission
    from lobewise.render.materials.probe import make_hits, sample_bsdf

    paint = {"type": "diffuse", "reflectance": 0.5}
    mask = {"type": "mask", "opacity": 0.3, "inner": paint}
    pane = {"type": "thindielectric", "specular_transmittance": {"type": "rgb", "value": [0.9, 0.3, 0.5]}}
    texture = make_texture(mi, 0.5, 0.5)
    bsdf = mi.load_dict(
        {
            "null": {"type": "null"},
            "mask": mask,
            "mask of a mask": {"type": "mask", "opacity": 0.5, "inner": mask},
            "pane": pane,
            "bump map of a pane": {"type": "bumpmap", "texture": texture, "inner": pane},
            "normal map of a mask": {
                "type": "normalmap",
                "normalmap": {"type": "rgb", "value": [0.6, 0.5, 0.9]},
                "inner": mask,
            },
            "blend": {"type": "blendbsdf", "weight": 0.25, "first": pane, "second": mask},
            "diffuse": paint,
        }[name]
    )
    view = np.array([[0.6, 0.0, 0.8], [0.0, 0.6, -0.8]])
    si = make_hits(view)
    found = np.array(dr.zeros(mi.Color3f, 2) + compute_null_transmission(read_material(bsdf), si, mi.Bool(True))).T
    samples = sample_bsdf(bsdf, view, 1 << 14)
    expected = np.where(samples.null[..., None], samples.weight, 0.0).mean(axis=1)
    assert expected.max() > 0.2 or name == "diffuse"
    np.testing.assert_allclose(found, expected, atol=0.01)


def test_a_ball_in_a_group_is_found_by_its_material(mi: Any) -> None:
    from lobewise.render.materials.lookup import _look_up_bsdf

    ball = make_ball({"type": "roughconductor", "id": "metal"})
    group = {"type": "shapegroup", "ball": ball}
    scene = mi.load_dict(make_room(mi, group=group, copy={"type": "instance", "a": {"type": "ref", "id": "group"}}))
    assert _look_up_bsdf(scene, "scene", "metal").class_name() == "RoughConductor"


@pytest.mark.nightly
def test_instances_are_rendered_with_the_materials_of_their_group(mi: Any) -> None:
    frame = render_frame(load("instances"), spp=4)
    assert (frame.gbuffer.lobe_kind == 3).sum() > 5


@pytest.mark.sampled("cropped")
@pytest.mark.parametrize(
    "changes",
    [{}, {"film": {"width": 40, "crop_width": 24, "crop_height": 16, "crop_offset_x": 9, "crop_offset_y": 3}}],
    ids=["whole", "cropped"],
)
def test_parallel_rays_are_those_of_a_far_pinhole(mi: Any, changes: dict[str, Any]) -> None:
    from lobewise.records.camera import project_points

    scene = mi.load_dict(make_room(mi, sensor=make_flat_sensor(mi, **changes), object=make_ball({"type": "plastic"})))
    frame = render_frame(scene, spp=256)
    height, width = frame.gbuffer.shape
    seen = project_points(frame.camera, frame.gbuffer.position, width, height)
    found = frame.gbuffer.depth > 0
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    assert found.mean() > 0.5
    np.testing.assert_allclose(seen[found], np.stack([column, row], axis=-1)[found], atol=0.02)
    depth = np.linalg.norm(frame.gbuffer.position[found] - frame.camera.position, axis=-1)
    np.testing.assert_allclose(frame.gbuffer.depth[found], depth, rtol=1e-6)
    theirs = np.array(mi.render(scene, spp=1024))[..., :3]
    assert np.abs(frame.radiance.color - theirs).mean() < 0.06 * theirs.mean()
    assert frame.gbuffer.coverage[..., 4].mean() > 0.7


def test_an_orthographic_sensor_moves_as_its_far_pinhole(mi: Any) -> None:
    """Twice as near it sees half as much; beside, it sees what a sensor that Mitsuba moved sees."""
    from lobewise.render import get_camera, set_camera

    scene = mi.load_dict(make_room(mi, sensor=make_flat_sensor(mi)))
    start = get_camera(scene)
    for _ in range(50):
        set_camera(scene, start)
    np.testing.assert_allclose(get_camera(scene).position, start.position, rtol=1e-5)
    side = 0.7 * start.right + 0.2 * start.up
    set_camera(scene, replace(start, position=start.position + side))
    sensor = make_flat_sensor(mi)
    moved = {**sensor, "to_world": mi.ScalarTransform4f().translate(side) @ sensor["to_world"]}
    frames = [
        render_frame(each, spp=1, aov_only=True).gbuffer.position
        for each in (scene, mi.load_dict(make_room(mi, sensor=moved)))
    ]
    np.testing.assert_allclose(*frames, atol=1e-3)
    middle = np.array(scene.bbox().center()).reshape(3)
    ahead = float((middle - start.position) @ start.forward)
    set_camera(scene, replace(start, position=start.position + 0.5 * ahead * start.forward))
    near = render_frame(scene, spp=1, aov_only=True).gbuffer.position
    sensor["to_world"] = sensor["to_world"].scale([0.5, 0.5, 1.0])
    half = render_frame(mi.load_dict(make_room(mi, sensor=sensor)), spp=1, aov_only=True).gbuffer.position
    np.testing.assert_allclose(near, half, atol=1e-3)


def test_an_orthographic_frame_is_told_and_keeps_its_camera_in_a_file(mi: Any, tmp_path: Path) -> None:
    import lobewise
    from lobewise.render.integrators import plan_light, tell_unseen

    scene = mi.load_dict(make_room(mi, sensor=make_flat_sensor(mi)))
    assert "orthographic" in plan_light(scene).sentence
    assert "orthographic" in tell_unseen(scene)
    frame = render_frame(scene, spp=2)
    lobewise.write_frame(tmp_path / "flat.exr", frame)
    again = lobewise.read_frame(tmp_path / "flat.exr")
    np.testing.assert_allclose(again.camera.position, frame.camera.position)
    assert again.camera.fov_y == pytest.approx(frame.camera.fov_y)
    assert np.isfinite(lobewise.denoise(again).image).all()


def test_a_mirrored_orthographic_sensor_is_refused(mi: Any) -> None:
    sensor = make_flat_sensor(mi)
    sensor["to_world"] = sensor["to_world"].scale([-1.0, 1.0, 1.0])
    with refuses(InputError, "sensor"):
        render_frame(mi.load_dict(make_room(mi, sensor=sensor)), spp=1)


def test_light_behind_a_tinted_pane_is_tinted(mi: Any) -> None:
    tint = np.array([0.9, 0.3, 0.5])
    pane = {"type": "thindielectric", "specular_transmittance": {"type": "rgb", "value": list(tint)}}
    where = mi.ScalarTransform4f().look_at([0, 0, 3], [0, 0, 0], [0, 1, 0])
    sensor = make_sensor(mi, to_world=where, fov=20.0)
    scene = mi.load_dict({"type": "scene", "sensor": sensor, "pane": {"type": "rectangle", "bsdf": pane},
                          "sky": {"type": "constant", "radiance": 2.0}})  # fmt: skip
    frame = render_frame(scene, spp=1024)
    # Both faces of a pane of index 1.5046 / 1.000277 reflect 2 r / (1 + r) of the light from straight ahead.
    index = 1.5046 / 1.000277
    reflected = ((index - 1.0) / (index + 1.0)) ** 2
    expected = 2.0 * tint * (1.0 - 2.0 * reflected / (1.0 + reflected))
    middle = np.s_[10:14, 10:14]
    np.testing.assert_allclose(frame.gbuffer.mean_emission[middle].mean(axis=(0, 1)), expected, rtol=0.01)
    scattered = frame.radiance.diffuse + frame.radiance.specular
    emitted = (frame.radiance.color - scattered)[middle].mean(axis=(0, 1))
    np.testing.assert_allclose(emitted, expected, rtol=0.03)
