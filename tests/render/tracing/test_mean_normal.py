"""Normals over areas, against planes whose places are known."""

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


def render(mi: Any, *, spp: int = 8, max_depth: int = 8, aov_only: bool = False, **items: Any) -> GBuffer:
    from lobewise.render import render_frame

    sensor = make_camera(mi, EYE, [0, 1, 0], size=(24, 16), fov=50.0)
    scene = mi.load_dict({"type": "scene", "sensor": sensor, **items})
    return render_frame(scene, spp=spp, max_depth=max_depth, aov_only=aov_only).gbuffer


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
