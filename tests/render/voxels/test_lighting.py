"""Voxels that follow a change of the scene, against voxels that are made anew in the changed scene."""

from typing import Any

import numpy as np
import pytest

from tests.render.items import make_lamp, rgb
from tests.render.moving.places import slide, turn

pytestmark = pytest.mark.mitsuba

RESOLUTION = 32
LAMP = "lamp.emitter.radiance.value"


def load(mi: Any) -> Any:
    """Return a gray box with a lamp, a red ball and a block."""
    transform = mi.ScalarTransform4f

    def gray(*value: float) -> dict[str, Any]:
        return {"type": "twosided", "inner": {"type": "diffuse", "reflectance": rgb(*value)}}

    above = transform().translate([0, 0.98, 0]).rotate([1, 0, 0], 90).scale(0.3)
    items = {
        "room": {"type": "cube", "flip_normals": True, "bsdf": gray(0.7, 0.6, 0.5)},
        "block": {
            "type": "cube",
            "to_world": transform().translate([0.4, -0.7, 0]).scale(0.25),
            "bsdf": gray(0.5, 0.5, 0.5),
        },
        "ball": {"type": "sphere", "center": [-0.4, -0.6, 0.1], "radius": 0.3, "bsdf": gray(0.8, 0.1, 0.1)},
        "lamp": make_lamp(above, rgb(4.0, 5.0, 6.0)),
    }
    return mi.load_dict({"type": "scene", **items}, optimize=False)


def make(scene: Any, **options: Any) -> Any:
    from lobewise.render.materials.bsdfs import read_scene_materials
    from lobewise.render.voxels.cones import VoxelCones

    return VoxelCones(scene, read_scene_materials(scene), **{"resolution": RESOLUTION, **options})


def read(method: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return radiance times optical depth and optical depth of every voxel of the finest level, black where empty."""
    grid = method.grid
    row, values = np.array(grid.row)[: RESOLUTION**3], np.array(grid.values, dtype=np.float64).reshape(-1, 6, 4)
    found = np.where((row > 0)[:, None, None], values[row], 0.0)
    return found[..., :3], found[..., 3]


def move(scene: Any, name: str, *way: float) -> Any:
    """Slide a shape of a scene; return the boxes that it was and is in."""
    from lobewise.render.moving.shapes import ShapePlaces

    return ShapePlaces(scene).place({name: slide(*way)})[name]


def settle(method: Any) -> None:
    for _ in range(100):
        if method.is_settled:
            return
        method.refine()
    raise AssertionError("the light does not settle")


def change_lamp(mi: Any, scene: Any, factors: tuple[float, ...]) -> None:
    values = mi.traverse(scene)
    values[LAMP] = values[LAMP] * mi.Color3f(*factors)
    values.update()


@pytest.mark.sampled("1")
@pytest.mark.parametrize("bounces", [0, 1, 3])
def test_light_that_fades_is_followed_at_once(mi: Any, bounces: int) -> None:
    scene = load(mi)
    method = make(scene, bounces=bounces)
    before, depth = read(method)
    change_lamp(mi, scene, (0.5, 0.25, 2.0))
    method.update_lights()
    after, same = read(method)
    np.testing.assert_array_equal(same, depth)
    assert np.abs(after - before * (0.5, 0.25, 2.0)).sum() < 0.005 * after.sum()
    assert after.sum() / (before * (0.5, 0.25, 2.0)).sum() == pytest.approx(1.0, abs=0.005)


@pytest.mark.sampled("0")
@pytest.mark.parametrize("bounces", [0, 1, 3])
def test_a_lamp_that_moved_lights_as_if_it_had_been_there(
    mi: Any, bounces: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    from lobewise.render.voxels import lighting

    monkeypatch.setattr(lighting, "FACES_PER_STEP", 1500)
    scene = load(mi)
    method = make(scene, bounces=bounces)
    method.update_shapes(move(scene, "lamp", 0.5, 0.0, -0.5))
    first, _ = read(method)
    settle(method)
    found, depth = read(method)
    expected, full = read(make(scene, bounces=bounces))
    np.testing.assert_allclose(depth, full, atol=1e-5)
    # The series of three bounces is extended to its limit in another way than by going on.
    assert np.abs(found - expected).sum() < 0.02 * expected.sum()
    # The direct light is right from the first step on.
    assert np.abs(first - expected).sum() < (0.01 if bounces == 0 else 0.15) * expected.sum()
    assert (np.abs(first - found).max() > 0.0) == (bounces > 0)


def test_shapes_that_moved_are_where_they_are(mi: Any) -> None:
    from lobewise.render.moving.shapes import ShapePlaces

    scene = load(mi)
    method, places = make(scene), ShapePlaces(scene)
    start, _ = read(method)
    for step in (1, 2):
        matrices = {"block": turn(20.0 * step, (0.4, 0, 0)), "ball": slide(0.07 * step, 0.05 * step, 0.0)}
        boxes = [box for pair in places.place(matrices).values() for box in pair]
        method.update_shapes(boxes)
    settle(method)
    (found, depth), (expected, full) = read(method), read(make(scene))
    np.testing.assert_allclose(depth, full, atol=1e-5)
    assert np.abs(found - expected).sum() < 0.02 * expected.sum()
    assert np.abs(start - expected).sum() > 0.05 * expected.sum()


def test_new_voxels_have_all_light_at_once(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """But for what they send each other more than twice. Other voxels have the light of before."""
    from lobewise.render.voxels import lighting

    monkeypatch.setattr(lighting, "FACES_PER_STEP", 50)
    scene = load(mi)
    method = make(scene)
    _, before = read(method)
    method.update_shapes(move(scene, "ball", 0.2, 0.3, 0.1))
    (found, depth), (expected, _) = read(method), read(make(scene))
    new = (depth > 0.0) & (before == 0.0)
    assert new.sum() > 200
    assert np.abs(found - expected)[new].sum() < 0.12 * expected[new].sum()


def test_only_columns_that_cross_a_box_are_cast_again(mi: Any) -> None:
    from lobewise.render.voxels.axis_hits import recast_hits

    scene = load(mi)
    method = make(scene, bounces=0)
    surfaces, rays = method._light.surfaces, []
    original = method._caster.cast

    def count(ray: Any) -> Any:
        rays.append(len(ray.o.x))
        return original(ray)

    method._caster.cast = count
    moved = move(scene, "ball", 0.1, 0.0, 0.0)
    hits = recast_hits(method._caster, surfaces.bounds, surfaces.hits, moved)
    # The ball and its step are 0.7 by 0.6 by 0.6 of a room that is 2 wide.
    share = (0.6 * 0.6 + 2.0 * 0.7 * 0.6) / (3.0 * 2.0 * 2.0)
    assert rays == [pytest.approx(share * 3.0 * (2 * RESOLUTION) ** 2, rel=0.35)]
    assert (np.diff(hits.key) >= 0).all()
    assert recast_hits(method._caster, surfaces.bounds, surfaces.hits, []) is surfaces.hits


def test_a_shape_that_leaves_the_grid_makes_it_anew(mi: Any) -> None:
    scene = load(mi)
    method = make(scene)
    voxel = float(method.grid.voxel[0])
    method.update_shapes(move(scene, "room", 1.0, 0.0, 0.0))
    assert float(method.grid.voxel[0]) > 1.2 * voxel
    assert float(method.grid.voxel[0]) == float(make(scene).grid.voxel[0])


def test_light_that_goes_on_in_the_dark(mi: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    from lobewise.render.voxels import lighting

    monkeypatch.setattr(lighting, "PASSES", 12)
    scene = load(mi)
    expected, _ = read(make(scene))
    change_lamp(mi, scene, (0.0, 0.0, 0.0))
    method = make(scene)
    assert not read(method)[0].any()
    change_lamp(mi, scene, (1.0, 1.0, 1.0))
    values = mi.traverse(scene)
    values[LAMP] = mi.Color3f(4.0, 5.0, 6.0)
    values.update()
    method.update_lights()
    settle(method)
    assert np.abs(read(method)[0] - expected).sum() < 0.02 * expected.sum()
