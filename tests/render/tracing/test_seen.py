"""What reflections see, and normals over areas, against planes whose colours and places are known."""

from typing import Any

import numpy as np
import pytest

from lobewise.records.frame import GBuffer
from tests.render.items import make_camera
from tests.render.tolerances import EXACT

pytestmark = pytest.mark.mitsuba

EYE = (0.0, 2.0, 6.0)
RED = (0.7, 0.2, 0.1)
WALL_Z = -4.0
MIRROR = {"type": "conductor"}
COVERAGE = 2.0 / 16.0
"""What 16 rays say of the share of a slanted edge, or of two, which cut through several of the 16 by 16 cells."""


def make_plane(mi: Any, *, bsdf: dict[str, Any], **place: Any) -> dict[str, Any]:
    """Return a wall at ``z``, turned towards the camera or, with ``away``, from it; without ``z`` the floor."""
    transform = mi.ScalarTransform4f()
    if "z" in place:
        transform = transform.translate([0, 0, place["z"]]).rotate([0, 1, 0], 180.0 * place.get("away", False))
    else:
        transform = transform.rotate([1, 0, 0], -90)
    return {"type": "rectangle", "to_world": transform.scale(100), "bsdf": bsdf}


def paint(color: tuple[float, float, float]) -> dict[str, Any]:
    return {"type": "diffuse", "reflectance": {"type": "rgb", "value": list(color)}}


def shine(plane: dict[str, Any], radiance: float) -> dict[str, Any]:
    return {**plane, "emitter": {"type": "area", "radiance": radiance}}


def render(mi: Any, *, spp: int = 8, max_depth: int = 8, aov_only: bool = False, **items: Any) -> GBuffer:
    from lobewise.render import render_frame

    sensor = make_camera(mi, EYE, [0, 1, 0], size=(24, 16), fov=50.0)
    scene = mi.load_dict({"type": "scene", "sensor": sensor, **items})
    return render_frame(scene, spp=spp, max_depth=max_depth, aov_only=aov_only).gbuffer


def mark_floor(gbuffer: GBuffer) -> np.ndarray:
    """Return which pixels see the floor in all of their area: the rows well below the wall."""
    row = np.arange(gbuffer.shape[0])[:, None] + np.zeros(gbuffer.shape)
    floor = row > 12
    assert np.allclose(gbuffer.position[floor][:, 1], 0.0, atol=1e-4)
    return floor


@pytest.mark.parametrize("aov_only", [False, True])
def test_mirror_sees_the_wall(mi: Any, aov_only: bool) -> None:
    floor, wall = make_plane(mi, bsdf=MIRROR), make_plane(mi, z=WALL_Z, bsdf=paint(RED))
    gbuffer = render(mi, floor=floor, wall=wall, aov_only=aov_only)
    on_floor = mark_floor(gbuffer)
    assert np.allclose(gbuffer.hit_albedo[on_floor], RED, atol=EXACT)
    assert np.allclose(gbuffer.hit_normal[on_floor], (0, 0, 1), atol=EXACT)
    # The wall reflects nothing specularly, so it sees nothing.
    assert not gbuffer.hit_albedo[0].any()
    assert not gbuffer.hit_normal[0].any()


def test_both_lobes_count_and_the_normal_faces_the_ray(mi: Any) -> None:
    """Plastic seen from behind: its albedo is that which it has as the first surface."""
    plastic = {"type": "twosided", "inner": {"type": "roughplastic", "alpha": 0.3}}
    gbuffer = render(
        mi, floor=make_plane(mi, bsdf=MIRROR), wall=make_plane(mi, z=WALL_Z, away=True, bsdf=plastic), spp=64
    )
    on_floor = mark_floor(gbuffer)
    assert np.allclose(gbuffer.hit_normal[on_floor], (0, 0, 1), atol=EXACT)
    # Row 2 sees the wall nearly head-on, and so does row 13 in the floor.
    both = gbuffer.diffuse_albedo[2] + gbuffer.specular_albedo[2]
    assert both.min() > gbuffer.diffuse_albedo[2].max() + 0.03
    assert np.allclose(gbuffer.hit_albedo[13, 8:16], both[8:16].mean(), atol=0.02)


def test_what_sees_nothing_is_black(mi: Any) -> None:
    gbuffer = render(mi, floor=make_plane(mi, bsdf=MIRROR), sky={"type": "constant"})
    on_floor = mark_floor(gbuffer)
    assert np.isinf(gbuffer.hit_distance[on_floor]).all()
    assert not gbuffer.hit_albedo.any()
    assert not gbuffer.hit_normal.any()


@pytest.mark.sampled("False")
@pytest.mark.parametrize("away", [False, True])
def test_light_source_is_white_on_the_side_that_shines(mi: Any, away: bool) -> None:
    wall = make_plane(mi, z=WALL_Z, away=away, bsdf={"type": "twosided", "inner": paint(RED)})
    gbuffer = render(mi, floor=make_plane(mi, bsdf=MIRROR), wall=shine(wall, 0.01))
    on_floor = mark_floor(gbuffer)
    assert np.allclose(gbuffer.hit_albedo[on_floor], RED if away else 1.0, atol=EXACT)
    assert np.allclose(gbuffer.hit_normal[on_floor], (0, 0, 1), atol=EXACT)


@pytest.mark.sampled("False")
@pytest.mark.parametrize("aov_only", [False, True])
def test_mirrors_are_followed_as_deep_as_paths_go(mi: Any, aov_only: bool) -> None:
    """Floor and front wall are mirrors; behind the camera stands a painted wall."""
    items = {
        "floor": make_plane(mi, bsdf=MIRROR),
        "wall": make_plane(mi, z=WALL_Z, bsdf=MIRROR),
        "back": make_plane(mi, z=30.0, away=True, bsdf=paint(RED)),
    }
    gbuffer = render(mi, **items, aov_only=aov_only)
    on_floor = mark_floor(gbuffer)
    assert np.allclose(gbuffer.hit_position[on_floor][:, 2], WALL_Z, atol=1e-3)
    assert np.allclose(gbuffer.hit_albedo[on_floor], RED, atol=EXACT)
    assert np.allclose(gbuffer.hit_normal[on_floor], (0, 0, -1), atol=EXACT)
    # Floor, wall and the back are three vertices; with two the path ends at the mirror, which is white.
    short = render(mi, **items, aov_only=aov_only, max_depth=2)
    assert np.allclose(short.hit_albedo[on_floor], 1.0, atol=EXACT)
    assert np.allclose(short.hit_normal[on_floor], (0, 0, 1), atol=EXACT)


def test_path_that_ends_by_chance_sees_the_mirror_where_it_ends(mi: Any) -> None:
    """Between two dark mirrors roulette ends every path, with light, long before its greatest depth."""
    mirror = {"type": "conductor", "specular_reflectance": 0.2}
    ceiling = mi.ScalarTransform4f().translate([0, 4, 0]).rotate([1, 0, 0], 90).scale(1000)
    gbuffer = render(
        mi,
        floor=make_plane(mi, bsdf=mirror),
        ceiling={"type": "rectangle", "to_world": ceiling, "bsdf": mirror},
        max_depth=64,
    )
    on_floor = mark_floor(gbuffer)
    assert np.allclose(gbuffer.hit_albedo[on_floor], 0.2, atol=EXACT)
    assert np.allclose(np.abs(gbuffer.hit_normal[on_floor][:, [0, 2]]), 0.0, atol=EXACT)


@pytest.mark.sampled("glass")
@pytest.mark.parametrize(
    "pane",
    [
        {"type": "dielectric", "int_ior": 1.0001, "ext_ior": 1.0},
        {"type": "mask", "opacity": 0.0, "inner": {"type": "diffuse"}},
    ],
    ids=["glass", "mask"],
)
def test_what_stands_behind_a_pane(mi: Any, pane: dict[str, Any]) -> None:
    """The index is so close to 1 that next to nothing is reflected."""
    gbuffer = render(
        mi,
        floor=make_plane(mi, bsdf=MIRROR),
        pane=make_plane(mi, z=WALL_Z, bsdf=pane),
        wall=make_plane(mi, z=WALL_Z - 1.0, bsdf=paint(RED)),
    )
    on_floor = mark_floor(gbuffer)
    assert np.allclose(gbuffer.hit_albedo[on_floor], RED, atol=EXACT)
    assert np.allclose(gbuffer.hit_normal[on_floor], (0, 0, 1), atol=EXACT)


def test_mirror_ray_that_would_go_on_counts_only_alone(mi: Any) -> None:
    from lobewise.render.images import finish_seen
    from lobewise.render.tracing.samples import make_sums

    totals = make_sums(4, True).totals
    # Three samples and a mirror ray that ends; that goes on; no samples and one that goes on; nothing at all.
    totals.hit_count = mi.Float([3, 3, 0, 0])
    totals.hit_normal = mi.Vector3f([3, 3, 0, 0], 0, 0)
    totals.hit_albedo = mi.Color3f([0.6, 0.6, 0, 0], 0, 0)
    guides = {
        "mirror_count": mi.Float(1, 1, 1, 0),
        "mirror_ends": mi.Float(1, 0, 0, 0),
        "mirror_normal": mi.Vector3f(0, [1, 1, 1, 0], 0),
        "mirror_albedo": mi.Color3f([1, 1, 1, 0], 0, 0),
    }
    normal, albedo = finish_seen(totals, guides)
    assert np.allclose(normal, [(0.75, 0.25, 0), (1, 0, 0), (0, 1, 0), (0, 0, 0)])
    assert np.allclose(albedo[:, 0], [0.4, 0.2, 1.0, 0.0])


@pytest.mark.parametrize("max_depth", [1, 8])
def test_mean_normal_is_that_of_what_the_pixel_covers(mi: Any, max_depth: int) -> None:
    """Floor and wall meet at z = -4, and the wall ends at 3: shares by sending a grid of rays to planes by hand."""
    wall = mi.ScalarTransform4f().translate([0, -7, WALL_Z]).scale(10)
    gbuffer = render(
        mi,
        floor=make_plane(mi, bsdf=paint(RED)),
        wall={"type": "rectangle", "to_world": wall, "bsdf": paint(RED)},
        spp=1,
        max_depth=max_depth,
        aov_only=True,
    )
    height, width = gbuffer.shape
    half = np.tan(np.deg2rad(25.0))
    grid = 16
    x = (np.arange(width * grid) + 0.5) / (width * grid) * 2 - 1
    y = (1 - (np.arange(height * grid) + 0.5) / (height * grid) * 2) * height / width
    forward = np.array((0.0, -1.0, -6.0)) / np.sqrt(37.0)
    up = np.array((0.0, 6.0, -1.0)) / np.sqrt(37.0)
    rays = forward + half * (x[None, :, None] * np.array((1.0, 0.0, 0.0)) + y[:, None, None] * up)
    t = (WALL_Z - EYE[2]) / rays[..., 2]
    where = EYE + t[..., None] * rays
    on_wall = (where[..., 1] > 0) & (where[..., 1] < 3) & (np.abs(where[..., 0]) < 10)
    on_floor = (rays[..., 1] < 0) & ~on_wall
    on_floor &= np.abs(np.array(EYE[2]) - EYE[1] / rays[..., 1] * rays[..., 2]) < 100
    normal = on_wall[..., None] * np.array((0.0, 0.0, 1.0)) + on_floor[..., None] * np.array((0.0, 1.0, 0.0))
    expected = normal.reshape(height, grid, width, grid, 3).mean(axis=(1, 3))
    assert np.allclose(gbuffer.mean_normal, expected, atol=COVERAGE)
    length = np.linalg.norm(expected, axis=-1)
    # A grid misses slivers at pixel borders: inside is what the rows above and below cover too.
    inside = (
        (length == 1.0) & (expected == np.roll(expected, 1, 0)).all(-1) & (expected == np.roll(expected, -1, 0)).all(-1)
    )
    assert 0.5 < inside.mean() < 0.99
    assert np.allclose(gbuffer.mean_normal[inside], gbuffer.normal[inside], atol=EXACT)
    edge = (length > 0.1) & (length < 0.9)
    assert edge.any()
    assert np.all(np.linalg.norm(gbuffer.mean_normal[edge], axis=-1) < 0.95)
