"""Guides of scenes that Mitsuba's users have: instances, and surfaces that let light pass."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from lobewise.render import render_frame
from tests.render.any_scene import load, make_ball, make_room, make_texture

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
    assert moved.motion is not None
    assert moved.position is not None
    assert moved.alpha_u is not None
    balls = moved.alpha_u == np.float32(0.2)
    left = balls & (moved.position[..., 0] < 0.0)
    assert left.sum() > 10
    assert (moved.motion[left][:, 1] < -0.5).all()
    assert np.abs(moved.motion[~left]).max() < 1e-3


@pytest.mark.parametrize(
    "name",
    ["null", "mask", "mask of a mask", "pane", "bump map of a pane", "normal map of a mask", "blend", "diffuse"],
)
def test_what_passes_a_surface_is_what_its_samples_let_pass(mi: Any, name: str) -> None:
    from lobewise.render.bridge import dr
    from lobewise.render.materials.bsdfs import read_material
    from lobewise.render.materials.dispatch import find_null_transmission
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
    found = np.array(dr.zeros(mi.Color3f, 2) + find_null_transmission(read_material(bsdf), si, mi.Bool(True))).T
    samples = sample_bsdf(bsdf, view, 1 << 14)
    expected = np.where(samples.null[..., None], samples.weight, 0.0).mean(axis=1)
    assert expected.max() > 0.2 or name == "diffuse"
    np.testing.assert_allclose(found, expected, atol=0.01)


def test_a_ball_in_a_group_is_found_by_its_material(mi: Any) -> None:
    from lobewise.render.materials.lookup import _find_bsdf

    ball = make_ball({"type": "roughconductor", "id": "metal"})
    group = {"type": "shapegroup", "ball": ball}
    scene = mi.load_dict(make_room(mi, group=group, copy={"type": "instance", "a": {"type": "ref", "id": "group"}}))
    assert _find_bsdf(scene, "scene", "metal").class_name() == "RoughConductor"


def test_instances_are_rendered_with_the_materials_of_their_group(mi: Any) -> None:
    frame = render_frame(load("instances"), spp=4)
    assert (frame.gbuffer.lobe_kind == 3).sum() > 5
