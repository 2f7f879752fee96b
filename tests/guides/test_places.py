"""Places of surfaces against the motion of `lobewise.motion`, and that what stands still finds itself."""

import numpy as np
import pytest

from lobewise.filters.history.reprojection_pass import SNAP_PIXELS
from lobewise.guides.places import compute_surface_places
from lobewise.records.camera import Camera, compute_motion
from lobewise.records.frame import FloatArray

SIZE = (37, 64)
CAMERA = Camera(position=(2.0, -3.0, 5.0), forward=(-0.1, 0.05, -1.0), up=(0.0, 1.0, 0.1), fov_y=0.8, fov_x=0.9)
MOVED = Camera(position=(2.3, -3.2, 4.9), forward=(-0.15, 0.1, -1.0), up=(0.1, 1.0, 0.0), fov_y=0.7)
# float32 at a hundred pixels.
ROUNDING = 2e-5


def make_wall(rng: np.random.Generator, size: tuple[int, int] = SIZE) -> tuple[FloatArray, FloatArray]:
    depth = rng.uniform(2.0, 9.0, size).astype(np.float32)
    position = CAMERA.position + depth[..., None] * CAMERA.make_ray_directions(size[1], size[0]).astype(np.float64)
    return position.astype(np.float32), depth


def make_grid(size: tuple[int, int] = SIZE) -> FloatArray:
    return np.stack(np.meshgrid(np.arange(size[1]), np.arange(size[0])), axis=-1).astype(np.float32)


def test_places_are_where_motion_leads(rng: np.random.Generator) -> None:
    position, depth = make_wall(rng)
    depth[3, 4], depth[5, 6], depth[7, 8] = 0.0, np.inf, np.nan
    position[10, 11], position[12, 13, 1] = np.nan, np.inf
    position[20, 20] = CAMERA.position + 3.0 * (CAMERA.position - position[20, 20])
    where, allowance = compute_surface_places(CAMERA, MOVED, (position, depth), None)
    assert allowance is None
    np.testing.assert_allclose(where, make_grid() + compute_motion(CAMERA, MOVED, position, depth), atol=ROUNDING)
    assert (where[[10, 12, 20], [11, 13, 20], 0] >= SIZE[1]).all()


@pytest.mark.parametrize("size", [(5, 7), (48, 4096)], ids=str)
def test_what_stands_still_finds_itself(rng: np.random.Generator, size: tuple[int, int]) -> None:
    where, _ = compute_surface_places(CAMERA, CAMERA, make_wall(rng, size), None)
    # Places within `SNAP_PIXELS` of a pixel's centre are that pixel, at 4K too.
    assert np.abs(where - make_grid(size)).max() < 0.7 * SNAP_PIXELS


def test_the_background_turns_and_does_not_shift(rng: np.random.Generator) -> None:
    position, depth = make_wall(rng)
    shifted = Camera(position=(0.0, 0.0, 0.0), forward=CAMERA.forward, up=CAMERA.up, fov_y=0.8, fov_x=0.9)
    where, _ = compute_surface_places(CAMERA, shifted, (position, np.zeros_like(depth)), None)
    np.testing.assert_allclose(where, make_grid(), atol=ROUNDING)


def test_what_moves_by_itself_is_allowed_for(rng: np.random.Generator) -> None:
    position, depth = make_wall(rng)
    camera_alone = compute_motion(CAMERA, MOVED, position, depth)
    own = rng.normal(size=(*SIZE, 2)).astype(np.float32)
    own[4, 5], own[6, 7, 0] = np.nan, np.inf
    where, allowance = compute_surface_places(CAMERA, MOVED, (position, depth), camera_alone + own)
    np.testing.assert_array_equal(where, make_grid() + (camera_alone + own))
    expected = np.hypot(own[..., 0], own[..., 1])
    expected[4, 5] = expected[6, 7] = 0.0
    np.testing.assert_allclose(allowance, expected, atol=2.0 * ROUNDING)
