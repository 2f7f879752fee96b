"""The kernels of windows in time, against closed forms."""

import numpy as np
import pytest

from lobewise.filters.windows.following import follow_back, follow_on, sample_cubic
from lobewise.filters.windows.weighing import compare_pilots, estimate_relative_bias, estimate_variance
from lobewise.guides.places import estimate_curvature, make_grid
from lobewise.guides.screen_hits import estimate_screen_hits
from lobewise.records.camera import Camera

SHAPE = (24, 40)


def make_ramp() -> np.ndarray:
    """Return an image that a spline of degree 2 reproduces."""
    grid = make_grid(SHAPE)
    x, y = grid[..., 0], grid[..., 1]
    return np.stack([x, 0.1 * y * y, 0.02 * x * y + 3.0], axis=-1).astype(np.float32)


class TestSampleCubic:
    def test_a_pixel_is_itself(self, rng):
        image = rng.normal(size=(*SHAPE, 3)).astype(np.float32)
        values, known = sample_cubic(image, make_grid(SHAPE))
        assert known.all()
        assert np.array_equal(values, image)

    def test_it_is_exact_for_degree_two(self, rng):
        places = make_grid(SHAPE) + rng.uniform(0.02, 0.48, (*SHAPE, 2)).astype(np.float32)
        values, known = sample_cubic(make_ramp(), places)
        inner = (slice(3, -3), slice(3, -3))
        assert known[inner].all()
        x, y = places[..., 0], places[..., 1]
        wanted = np.stack([x, 0.1 * y * y, 0.02 * x * y + 3.0], axis=-1)
        np.testing.assert_allclose(values[inner], wanted[inner], rtol=1e-4, atol=1e-4)

    def test_it_knows_its_borders(self):
        places = make_grid(SHAPE)
        places[0, 0] = (-0.6, 0.0)
        places[0, 1] = (SHAPE[1] - 0.4, 0.0)
        places[0, 2] = np.nan
        places[0, 3] = (-0.4, SHAPE[0] - 0.6)
        values, known = sample_cubic(make_ramp(), places)
        assert known[0, :4].tolist() == [False, False, False, True]
        assert not values[0, :3].any()

    def test_bad_values_do_not_spread(self):
        image = make_ramp()
        image[10, 10] = np.nan
        values, known = sample_cubic(image, make_grid(SHAPE) + np.float32(0.5))
        assert np.isfinite(values).all()
        assert np.count_nonzero(~known[2:-2, 2:-2]) == 16


class TestFollow:
    def test_even_motion_leads_there_and_back(self):
        motion = np.broadcast_to(np.float32([-1.5, 0.75]), (*SHAPE, 2))
        grid = make_grid(SHAPE)
        np.testing.assert_allclose(follow_back(grid, motion), grid + motion)
        np.testing.assert_allclose(follow_on(grid, np.zeros_like(motion), motion), grid - motion)

    def test_a_growing_thing_is_followed(self):
        # The thing grows by a tenth about the middle: the next frame leads each point back to its place.
        middle = np.float32([20.0, 12.0])
        grid = make_grid(SHAPE)
        motion = (grid - middle) / np.float32(1.1) + middle - grid
        found = follow_on(grid, np.zeros_like(motion), motion)
        wanted = (grid - middle) * np.float32(1.1) + middle
        inner = (slice(3, -3), slice(3, -3))
        # The nearest pixel tells its motion, which differs by a tenth per pixel.
        assert np.abs(found - wanted)[inner].max() < 0.1

    def test_bad_motion_keeps_the_guess(self):
        motion = np.full((*SHAPE, 2), np.nan, np.float32)
        guess = np.broadcast_to(np.float32([2.0, 0.0]), (*SHAPE, 2))
        np.testing.assert_allclose(follow_on(make_grid(SHAPE), guess, motion), make_grid(SHAPE) + guess)


class TestWeighing:
    def test_noise_alone_is_no_bias(self, rng):
        own, other = (1.0 + 0.3 * rng.normal(size=(*SHAPE, 3)).astype(np.float32) for _ in range(2))
        found = estimate_relative_bias(own, other, np.ones(SHAPE, np.float32))
        assert found.mean() < 0.15

    def test_a_change_of_light_is_found(self, rng):
        own, other = (1.0 + 0.3 * rng.normal(size=(*SHAPE, 3)).astype(np.float32) for _ in range(2))
        other[:, 20:] += 0.6
        found = estimate_relative_bias(own, other, np.ones(SHAPE, np.float32))
        # The squared change over the variance of the samples is 4.
        assert 3.0 < np.median(found[4:-4, 24:-4]) < 5.5
        assert np.median(found[4:-4, 4:16]) < 0.2

    def test_pixels_without_a_match_do_not_count(self, rng):
        own = np.ones((*SHAPE, 3), np.float32)
        other = own.copy()
        other[:, 20:] = 50.0
        agreement = np.ones(SHAPE, np.float32)
        agreement[:, 20:] = 0.0
        assert estimate_relative_bias(own, other, agreement).max() < 1e-3
        assert compare_pilots(own, other, agreement).max() == 0.0

    def test_noise_is_the_variance(self, rng):
        pilot = np.full((*SHAPE, 3), 2.0, np.float32)
        samples = pilot + 0.5 * rng.normal(size=pilot.shape).astype(np.float32)
        assert estimate_variance(samples, pilot)[4:-4, 4:-4].mean() == pytest.approx(0.25, rel=0.1)

    def test_without_noise_the_variance_is_above_zero(self):
        pilot = np.full((*SHAPE, 3), 2.0, np.float32)
        assert estimate_variance(pilot, pilot).min() > 0.0


def make_room() -> tuple[Camera, np.ndarray, np.ndarray, np.ndarray]:
    """Return a mirror floor y = 0 before a wall z = -4, seen from above: camera, position, depth, normal."""
    camera = Camera(position=(0.0, 1.0, 2.0), forward=(0.0, -0.25, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.8)
    height, width = 96, 128
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    with np.errstate(divide="ignore"):
        floor = np.where(rays[..., 1] < 0.0, -1.0 / rays[..., 1], np.inf)
    wall = -6.0 / rays[..., 2]
    on_floor = floor < wall
    distance = np.minimum(floor, wall)
    position = camera.position + distance[..., None] * rays
    normal = np.where(on_floor[..., None], (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))
    depth = np.linalg.norm(position - camera.position, axis=-1)
    return camera, *(image.astype(np.float32) for image in (position, depth, normal))


class TestScreenHits:
    def test_a_mirror_floor_shows_the_wall(self):
        camera, position, depth, normal = make_room()
        hits = estimate_screen_hits(camera, position, depth, normal, np.zeros(depth.shape, np.float32))
        view = (position - camera.position) / depth[..., None]
        mirrored = view * (1.0, -1.0, 1.0)
        found = (normal[..., 1] > 0.5) & (hits > 0.0)
        truth = (-4.0 - position[found][:, 2]) / mirrored[found][:, 2]
        assert found.mean() > 0.15
        assert np.median(np.abs(hits[found] / truth - 1.0)) < 0.05
        assert np.quantile(np.abs(hits[found] / truth - 1.0), 0.95) < 0.2

    def test_what_the_camera_does_not_see_is_unknown(self):
        camera, position, depth, normal = make_room()
        hits = estimate_screen_hits(camera, position, depth, normal, np.zeros(depth.shape, np.float32))
        # Above the camera's height the wall reflects what lies behind the camera.
        high = (normal[..., 2] > 0.5) & (position[..., 1] > 1.05)
        assert np.count_nonzero(high) > 500
        assert not hits[high].any()

    def test_strong_curvature_makes_the_distance_unimportant(self):
        camera, position, depth, normal = make_room()
        hits = estimate_screen_hits(camera, position, depth, normal, np.full(depth.shape, 10.0, np.float32))
        assert np.isinf(hits[(normal[..., 2] > 0.5) & (position[..., 1] > 1.05)]).all()

    def test_background_has_no_hit(self):
        camera, position, depth, normal = make_room()
        depth = depth.copy()
        depth[:4] = 0.0
        curvature = estimate_curvature(position, normal)
        assert not estimate_screen_hits(camera, position, depth, normal, curvature)[:4].any()
