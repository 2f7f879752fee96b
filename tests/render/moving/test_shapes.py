"""Shapes that move in a loaded scene, against scenes that were built with the shapes at their new places."""

from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from tests.mistakes import refuses
from tests.render.items import make_camera
from tests.render.moving.places import slide, stretch, turn

pytestmark = pytest.mark.mitsuba

ROUNDING = 2e-5
"""Of positions some units wide, in single precision, computed in another order."""


def describe(mi: Any, place: np.ndarray) -> dict[str, Any]:
    """Return shapes of several kinds, each moved by ``place`` from where it is first."""
    transform = mi.ScalarTransform4f

    def put(*steps: Any) -> Any:
        first = np.eye(4)
        for step in steps:
            first = first @ np.array(step.matrix)
        return transform(place @ first)

    gray = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.5}}
    shift = transform().translate
    return {
        "ball": {"type": "sphere", "to_world": put(shift([-1.5, 0, 0]), transform().scale(0.6)), "bsdf": gray},
        "cube": {"type": "cube", "to_world": put(shift([1.5, 0, 0]), transform().scale(0.5)), "bsdf": gray},
        "card": {"type": "rectangle", "to_world": put(shift([0, 1.5, 0]), transform().scale(0.5)), "bsdf": gray},
        "pipe": {"type": "cylinder", "to_world": put(shift([0, -1.5, 0]), transform().scale(0.4)), "bsdf": gray},
    }


def load(mi: Any, place: np.ndarray, more: dict[str, Any] | None = None) -> Any:
    sensor = make_camera(mi, [1.0, 2.0, 7.0], size=(64, 64), fov=45)
    lamp = {"type": "point", "position": [0, 5, 5], "intensity": 10.0}
    items = {"sensor": sensor, "lamp": lamp, **describe(mi, place), **(more or {})}
    return mi.load_dict({"type": "scene", **items}, optimize=False)


def look(scene: Any) -> Any:
    from lobewise.render import render_frame

    return render_frame(scene, spp=1, aov_only=True, coverage=False).gbuffer


PLACES = {
    "slid": slide(0.2, -0.1, 0.3),
    "turned": turn(25.0, (0.5, 0, 0)),
    "scaled and turned": stretch(1.2, 1.2, 1.2) @ turn(40.0, (0, 0, 1)),
}


@pytest.mark.parametrize("place", PLACES.values(), ids=PLACES)
def test_moved_shapes_are_those_that_were_built_there(mi: Any, place: np.ndarray) -> None:
    from lobewise.render.moving.shapes import ShapePlaces

    scene = load(mi, np.eye(4))
    names = ("ball", "cube", "card", "pipe")
    assert set(ShapePlaces(scene).place(dict.fromkeys(names, place))) == set(names)
    found, expected, before = look(scene), look(load(mi, place)), look(load(mi, np.eye(4)))
    # Pixels whose ray passes an edge within rounding may see the other side of it.
    same = np.abs(found.position - expected.position).max(axis=-1) < ROUNDING
    assert same.mean() > 0.998
    assert (np.abs(found.normal - expected.normal).max(axis=-1)[same] < 1e-4).all()
    assert not np.allclose(found.position, before.position, atol=0.05)


def test_a_mesh_keeps_its_shading_normals(mi: Any) -> None:
    from lobewise.render.moving.shapes import ShapePlaces

    scene = load(mi, np.eye(4))
    values = mi.traverse(scene)
    tilted = np.array(values["cube.vertex_normals"]).reshape(-1, 3) + np.array([0.3, 0.2, 0.1])
    tilted /= np.linalg.norm(tilted, axis=-1, keepdims=True)
    values["cube.vertex_normals"] = mi.Float(tilted.ravel().astype(np.float32))
    values.update()
    matrix = turn(30.0, (1, 0, 0)) @ stretch(1.0, 2.0, 1.0)
    ShapePlaces(scene).place({"cube": matrix})
    expected = tilted @ np.linalg.inv(matrix[:3, :3])
    expected /= np.linalg.norm(expected, axis=-1, keepdims=True)
    found = np.array(mi.traverse(scene)["cube.vertex_normals"]).reshape(-1, 3)
    np.testing.assert_allclose(found, expected, atol=1e-6)


def test_places_count_from_the_first_one(mi: Any) -> None:
    from lobewise.render.moving.shapes import ShapePlaces

    scene = load(mi, np.eye(4))
    before, places = look(scene), ShapePlaces(scene)
    for step in (slide(0.3, 0, 0), turn(90.0, (0, 0, 0)), np.eye(4)):
        assert list(places.place({"ball": step, "cube": step})) == ["ball", "cube"]
        assert places.place({"ball": step}) == {}
    np.testing.assert_allclose(look(scene).position, before.position, atol=ROUNDING)


def test_moves_lead_back(mi: Any) -> None:
    from lobewise.render.moving.shapes import ShapePlaces

    places = ShapePlaces(load(mi, np.eye(4)))
    first, second = turn(20.0, (0, 0, 0)), slide(0, 0, 1) @ turn(70.0, (1, 0, 0))
    places.place({"ball": first})
    before = dict(places.transforms)
    assert places.compute_moves(before) == {}
    places.place({"ball": second, "cube": first})
    moves = places.compute_moves(before)
    point = np.array([0.3, -0.2, 0.4, 1.0])
    np.testing.assert_allclose(moves["ball"] @ second @ point, first @ point, atol=1e-12)
    np.testing.assert_allclose(moves["cube"] @ first @ point, point, atol=1e-12)


def test_an_instance_moves_and_tells_its_motion(mi: Any) -> None:
    from lobewise.render import get_camera, render_frame
    from lobewise.render.moving.shapes import ShapePlaces

    group = {"type": "shapegroup", "ball": {"type": "sphere", "radius": 0.4}}
    shift = mi.ScalarTransform4f().translate
    copies = {
        name: {"type": "instance", "to_world": shift([0, 0, z]), "group": {"type": "ref", "id": "group"}}
        for name, z in (("near", 2.0), ("far", -2.0))
    }
    scene = load(mi, np.eye(4), {"group": group, **copies})
    places = ShapePlaces(scene)
    places.place({"near": stretch(1.0, 1.5, 1.0)})
    before = dict(places.transforms)
    places.place({"near": slide(0.0, 0.1, 0.0) @ stretch(1.0, 1.5, 1.0)})
    camera = get_camera(scene)
    guides = render_frame(
        scene, spp=1, aov_only=True, previous_camera=camera, moves=places.compute_moves(before)
    ).gbuffer
    squeezed = (guides.position - (0.0, 0.1, 2.0)) / (1.0, 1.5, 1.0)
    near = (np.linalg.norm(squeezed, axis=-1) < 0.41) & (guides.depth > 0)
    assert near.sum() > 50
    assert (guides.motion[near][:, 1] > 0.5).all()
    assert np.abs(guides.motion[~near]).max() < 1e-3


@pytest.mark.parametrize(
    ("name", "matrix", "refused"),
    [
        ("bal", np.eye(4), ("shape",)),
        ("ball", np.eye(3), ("transform of 'ball'", "an array of shape (3, 3)")),
        ("ball", np.full((4, 4), np.nan), ("transform of 'ball'", "numbers that are not finite")),
        ("ball", "turned", ("transform of 'ball'", "an array of shape (0,)")),
        ("ball", np.eye(4) + np.eye(4)[::-1], ("transform of 'ball'", "[1.0, 0.0, 0.0, 1.0]")),
        ("cube", np.diag([1.0, 0.0, 1.0, 1.0]), ("transform of 'cube'", "a singular one")),
        ("cube", np.diag([-1.0, 1.0, 1.0, 1.0]), ("transform of 'cube'", "a mirroring one")),
        ("ball", stretch(1.0, 2.0, 1.0), ("transform of 'ball'", "another matrix")),
    ],
    ids=[*("unknown", "small", "not finite", "text", "last row", "singular", "mirroring", "uneven")],
)
def test_wrong_places_are_told_and_nothing_moves(mi: Any, name: str, matrix: Any, refused: tuple[str, ...]) -> None:
    from lobewise.render.moving.shapes import ShapePlaces

    scene = load(mi, np.eye(4))
    places = ShapePlaces(scene)
    with refuses(InputError, *refused):
        places.place({"card": slide(1, 0, 0), name: matrix})
    assert places.transforms == {}
    assert float(np.array(mi.traverse(scene)["card.to_world"].matrix).reshape(4, 4)[0, 3]) == 0.0


def test_shapes_without_ids_are_told(mi: Any, tmp_path: Any) -> None:
    from lobewise.render import load_scene
    from lobewise.render.moving.shapes import ShapePlaces

    path = tmp_path / "scene.xml"
    path.write_text(
        """<scene version="3.0.0"><sensor type="perspective"/><emitter type="constant"/>
        <bsdf type="diffuse" id="gray"/>
        <shape type="cube" id="one"><ref id="gray"/></shape><shape type="cube" id="two"><ref id="gray"/></shape>
        </scene>"""
    )
    for name, merge in (("one", False), ("two", False)):
        ShapePlaces(load_scene(path, merge=merge)).place({name: slide(1, 0, 0)})
    with refuses(InputError, "shape"):
        ShapePlaces(load_scene(path)).place({"one": slide(1, 0, 0)})


def test_a_lamp_lights_from_its_new_place(mi: Any) -> None:
    from lobewise.render import render_frame
    from lobewise.render.moving.shapes import ShapePlaces

    def light(z: float) -> Any:
        bulb = {"type": "sphere", "center": [0.0, 3.0, z], "radius": 0.3, "emitter": {"type": "area"}}
        return load(mi, np.eye(4), {"lamp": {"type": "point", "position": [0, 9, 0], "intensity": 1e-6}, "bulb": bulb})

    scene = light(2.0)
    before = render_frame(scene, spp=64).radiance.color
    ShapePlaces(scene).place({"bulb": slide(0, 0, 2)})
    expected, found = (render_frame(each, spp=64).radiance.color for each in (light(4.0), scene))
    assert np.abs(found - expected).mean() < 0.01 * expected.mean()
    assert np.abs(before - expected).mean() > 0.1 * expected.mean()


def test_boxes_before_and_after_are_told(mi: Any) -> None:
    from lobewise.render.moving.shapes import ShapePlaces

    before, after = ShapePlaces(load(mi, np.eye(4))).place({"cube": slide(0, 0, 0.5) @ stretch(1, 2, 1)})["cube"]
    np.testing.assert_allclose(before, [[1.0, -0.5, -0.5], [2.0, 0.5, 0.5]], atol=ROUNDING)
    np.testing.assert_allclose(after, [[1.0, -1.0, 0.0], [2.0, 1.0, 1.0]], atol=ROUNDING)
