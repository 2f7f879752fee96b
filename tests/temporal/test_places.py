"""Places against geometry in closed form: mirrors, spheres, cylinders; and against numerically traced reflections."""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.optimize import minimize

from lobewise.guides.places import add_grid, compute_virtual_places, estimate_curvature
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray

WIDTH, HEIGHT = 48, 32
CAMERA = Camera(position=(0.0, 0.0, 4.0), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.3)
MOVED = Camera(position=(0.3, -0.2, 4.1), forward=(-0.05, 0.02, -1.0), up=(0.1, 1.0, 0.0), fov_y=0.7)
# float32 places around 50 pixels, through positions and distances around 10.
ROUNDING = 2e-4

Vector = NDArray[np.float64]


def look(camera: Camera, point: Vector, width: int = WIDTH, height: int = HEIGHT) -> Vector:
    """Return column and row of world points (..., 3), pixel centres at whole numbers, from the angles of the view."""
    step = np.asarray(point, np.float64) - camera.position
    right = np.cross(camera.forward, camera.up)
    slopes = np.stack([step @ right, -(step @ camera.up)], axis=-1) / (step @ camera.forward)[..., None]
    focal = 0.5 * height / np.tan(0.5 * camera.fov_y)
    return slopes * focal + 0.5 * np.array([width, height]) - 0.5


def cast(camera: Camera) -> Vector:
    """Return the unit directions through the pixel centres."""
    return camera.make_ray_directions(WIDTH, HEIGHT).astype(np.float64)


AHEAD = (CAMERA.position + cast(CAMERA) * 3.0).astype(np.float32)
"""Points at a distance of 3."""


def hit_sphere(camera: Camera, centre: Vector, radius: float, far: bool = False) -> tuple[FloatArray, FloatArray]:
    """Return where rays hit a sphere that fills the image, and its outward normals."""
    rays = cast(camera)
    offset = camera.position - centre
    along = rays @ offset
    root = np.sqrt(along**2 - offset @ offset + radius**2)
    points = camera.position + (-along + (root if far else -root))[..., None] * rays
    return points.astype(np.float32), ((points - centre) / radius).astype(np.float32)


def reflect(direction: Vector, normal: Vector) -> Vector:
    """Return the mirror direction of rays that go along ``direction``."""
    return direction - 2.0 * np.sum(direction * normal, axis=-1, keepdims=True) * normal


def test_grid_is_added() -> None:
    motion = np.zeros((3, 5, 2), np.float32)
    motion[1, 2] = 0.25, -3.0
    places = add_grid(motion)
    assert places[1, 2].tolist() == [2.25, -2.0]
    assert places[2, 4].tolist() == [4.0, 2.0]
    assert motion[2, 4].tolist() == [0.0, 0.0]


@pytest.mark.parametrize("previous", [CAMERA, MOVED])
def test_flat_mirror_is_exact(previous: Camera) -> None:
    normal = np.array([0.3, -0.1, 1.0]) / np.linalg.norm([0.3, -0.1, 1.0])
    rays = cast(CAMERA)
    points = CAMERA.position - (CAMERA.position @ normal / (rays @ normal))[..., None] * rays
    distance = np.random.default_rng(1).uniform(0.1, 20.0, (HEIGHT, WIDTH))
    hits = points + distance[..., None] * reflect(rays, normal)
    mirrored = hits - 2.0 * (hits @ normal)[..., None] * normal
    places = compute_virtual_places(
        points.astype(np.float32), np.zeros((HEIGHT, WIDTH), np.float32), distance.astype(np.float32), CAMERA, previous
    )
    assert places.dtype == np.float32
    np.testing.assert_allclose(places, look(previous, mirrored), rtol=0.0, atol=ROUNDING)
    if previous is CAMERA:
        np.testing.assert_allclose(places, add_grid(np.zeros((HEIGHT, WIDTH, 2), np.float32)), rtol=0, atol=ROUNDING)


def trace_reflection(previous: Camera, hit: Vector, centre: Vector, radius: float, start: Vector) -> Vector:
    """Return the point of a sphere at which ``previous`` sees ``hit``: Fermat's stationary path, by optimisation.

    ``start`` is near it, on the same side of the sphere.
    """
    z = (start - centre) / np.linalg.norm(start - centre)
    x = np.cross(z, [0.0, 1.0, 0.0])
    x /= np.linalg.norm(x)
    frame = np.stack([x, np.cross(z, x)])

    def surface(slopes: Vector) -> Vector:
        direction = z + slopes @ frame
        return np.asarray(centre + radius * direction / np.linalg.norm(direction))

    def mismatch(slopes: Vector) -> float:
        point = surface(slopes)
        normal = (point - centre) / radius
        arriving, leaving = point - previous.position, hit - point
        mirrored = reflect(arriving / np.linalg.norm(arriving), normal)
        return float(np.sum((mirrored - leaving / np.linalg.norm(leaving)) ** 2))

    found = minimize(mismatch, np.zeros(2), method="Nelder-Mead", options={"xatol": 1e-10, "fatol": 1e-22})
    assert found.fun < 1e-16
    return surface(found.x)


# Radius, centre, which side is seen, curvature, distance of the hit. The concave hits lie within the focal length.
MIRRORS = [(2.0, -2.0, False, 0.5, 1.0), (2.0, -2.0, False, 0.5, 6.0), (9.0, 9.0, True, -1.0 / 9.0, 1.5)]


@pytest.mark.parametrize(("radius", "centre_z", "far", "curvature", "distance"), MIRRORS)
def test_curved_mirror_agrees_with_traced_reflection_near_the_axis(
    radius: float, centre_z: float, far: bool, curvature: float, distance: float
) -> None:
    # Both spheres touch the origin, 4 before the camera; the camera moves by a tenth, across and along.
    centre = np.array([0.0, 0.0, centre_z])
    previous = Camera(position=(0.08, -0.06, 4.05), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.6)
    points, outward = hit_sphere(CAMERA, centre, radius, far)
    field = np.full((HEIGHT, WIDTH), curvature, np.float32)
    places = compute_virtual_places(points, field, np.full_like(field, distance), CAMERA, previous)
    surface = look(previous, points.astype(np.float64))
    rays = cast(CAMERA)
    errors, gains = [], []
    for row, column in ((16, 24), (13, 26), (18, 20)):
        point = points[row, column].astype(np.float64)
        mirrored = reflect(rays[row, column], outward[row, column].astype(np.float64))
        seen = trace_reflection(previous, point + distance * mirrored, centre, radius, point)
        expected = look(previous, seen)
        errors.append(np.linalg.norm(places[row, column] - expected))
        gains.append(np.linalg.norm(surface[row, column] - expected))
    # Third order in the angles at the mirror, which are below 0.06: within 1 % of what the surface point is wrong by.
    assert max(errors) < 0.01 * min(gains), (errors, gains)


def test_infinite_hits_of_a_flat_mirror_do_not_move_with_the_camera() -> None:
    shape = HEIGHT, WIDTH
    shifted = Camera(position=(1.0, -2.0, 3.0), forward=CAMERA.forward, up=CAMERA.up, fov_y=CAMERA.fov_y)
    flat, infinite = np.zeros(shape, np.float32), np.full(shape, np.inf, np.float32)
    places = compute_virtual_places(AHEAD, flat, infinite, CAMERA, shifted)
    # A step of 2 over 3e6 at 50 pixels a radian, and rounding.
    np.testing.assert_allclose(places, add_grid(np.zeros((*shape, 2), np.float32)), rtol=0.0, atol=1e-3)


def test_infinite_hits_of_a_sphere_are_in_its_focus() -> None:
    shape = HEIGHT, WIDTH
    places = compute_virtual_places(
        AHEAD, np.full(shape, 0.5, np.float32), np.full(shape, np.inf, np.float32), CAMERA, MOVED
    )
    # The focal length is half the radius 2.
    focus = CAMERA.position + cast(CAMERA) * 4.0
    np.testing.assert_allclose(places, look(MOVED, focus), rtol=0.0, atol=1e-3)


@pytest.mark.parametrize("distance", [0.0, -1.0, np.nan])
def test_unknown_hits_have_no_place(distance: float) -> None:
    hits = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    hits[3, 4] = distance
    places = compute_virtual_places(AHEAD, np.zeros_like(hits), hits, CAMERA, MOVED)
    assert np.isnan(places[3, 4]).all()
    assert np.count_nonzero(np.isnan(places)) == 2


def test_concave_mirrors_have_no_place_from_their_focus_on() -> None:
    curvature = np.full((HEIGHT, WIDTH), -0.25, np.float32)
    hits = np.full_like(curvature, 1.0)
    hits[:, WIDTH // 2 :] = 2.5
    hits[0, 0], hits[1, 1] = 2.0, np.inf
    places = compute_virtual_places(AHEAD, curvature, hits, CAMERA, CAMERA)
    nowhere = hits > 1.5
    np.testing.assert_array_equal(np.isnan(places).all(axis=-1), nowhere)
    assert np.isfinite(places[~nowhere]).all()


def test_images_behind_the_previous_camera_have_no_place() -> None:
    hits = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    turned = Camera(position=CAMERA.position, forward=-CAMERA.forward, up=CAMERA.up, fov_y=0.6)
    assert not np.isfinite(compute_virtual_places(AHEAD, np.zeros_like(hits), hits, CAMERA, turned)).any()
    # The points themselves would be behind it as well, but not what lies 2 behind them.
    passed = Camera(position=(0.0, 0.0, 0.5), forward=CAMERA.forward, up=CAMERA.up, fov_y=0.6)
    assert np.isfinite(compute_virtual_places(AHEAD, np.zeros_like(hits), hits, CAMERA, passed)).all()


def test_strange_pixels_neither_warn_nor_spoil_others() -> None:
    hits, curvature = np.full((HEIGHT, WIDTH), 2.0, np.float32), np.full((HEIGHT, WIDTH), 0.1, np.float32)
    expected = compute_virtual_places(AHEAD, curvature, hits, CAMERA, MOVED)
    spoilt = AHEAD.copy(), curvature.copy(), hits.copy()
    spoilt[0][0, :4] = np.array([np.inf, -np.inf, np.nan, 1e30])[:, None]
    spoilt[0][1, 0] = CAMERA.position
    spoilt[2][0, :2] = np.inf
    spoilt[2][1, 0] = np.inf
    spoilt[1][2, :3] = 1e30, np.nan, -1e30
    spoilt[2][2, :3] = 1e30
    places = compute_virtual_places(*spoilt, CAMERA, MOVED)
    np.testing.assert_array_equal(places[3:], expected[3:])
    np.testing.assert_array_equal(places[:3, 4:], expected[:3, 4:])


@pytest.mark.parametrize("radius", [1.5, 4.0, 15.0])
def test_curvature_of_a_sphere(radius: float) -> None:
    points, outward = hit_sphere(CAMERA, np.array([0.1, 0.05, 1.0 - radius]), radius)
    # A chord is as much shorter as its normals differ less: exact but for float32.
    np.testing.assert_allclose(estimate_curvature(points, outward), 1.0 / radius, rtol=1e-3)


def test_curvature_of_the_inside_of_a_sphere_is_negative() -> None:
    points, outward = hit_sphere(CAMERA, np.array([0.0, 0.0, 3.0]), 5.0, far=True)
    np.testing.assert_allclose(estimate_curvature(points, -outward), -0.2, rtol=1e-3)


def test_curvature_of_a_cylinder_is_the_mean_of_its_own() -> None:
    # Along y; seen straight, rows and columns are its principal directions.
    rays, radius = cast(CAMERA), 3.0
    flat = rays * np.array([1.0, 0.0, 1.0])
    square = np.sum(flat**2, axis=-1)
    along = CAMERA.position[2] * flat[..., 2] / square
    reach = -along - np.sqrt(along**2 - (CAMERA.position[2] ** 2 - radius**2) / square)
    points = CAMERA.position + reach[..., None] * rays
    normal = points * np.array([1.0, 0.0, 1.0]) / radius
    curvature = estimate_curvature(points.astype(np.float32), normal.astype(np.float32))
    # Towards the sides a row of the image runs a little along the axis too.
    np.testing.assert_allclose(curvature[:, WIDTH // 4 : -WIDTH // 4], 0.5 / radius, rtol=0.05)
    np.testing.assert_allclose(curvature[HEIGHT // 2, WIDTH // 2], 0.5 / radius, rtol=0.01)


def test_planes_are_flat() -> None:
    points = (CAMERA.position + cast(CAMERA) / -cast(CAMERA)[..., 2:] * 3.0).astype(np.float32)
    normal = np.broadcast_to(np.array([0.0, 0.0, 1.0], np.float32), points.shape)
    assert (estimate_curvature(points, normal) == 0.0).all()


def test_a_crease_does_not_count() -> None:
    # A roof whose ridge runs down the image between two columns.
    slope = np.where(np.arange(WIDTH) < WIDTH // 2, -1.0, 1.0)
    normal = np.stack([0.6 * slope, 0.0 * slope, 0.0 * slope + 0.8], axis=-1)
    rays = cast(CAMERA)
    reach = -(normal @ CAMERA.position) / np.sum(normal * rays, axis=-1)
    points = CAMERA.position + reach[..., None] * rays
    field = np.broadcast_to(normal, points.shape).astype(np.float32)
    assert (estimate_curvature(points.astype(np.float32), field) == 0.0).all()


def test_the_edge_of_a_sphere_before_a_plane_does_not_count() -> None:
    points, normal = hit_sphere(CAMERA, np.array([0.0, 0.0, -2.0]), 2.0)
    plane = CAMERA.position + cast(CAMERA) / -cast(CAMERA)[..., 2:] * 9.0
    outside = (np.arange(WIDTH) >= 30) | (np.arange(HEIGHT)[:, None] < 7)
    points = np.where(outside[..., None], plane, points).astype(np.float32)
    normal = np.where(outside[..., None], np.array([0.0, 0.0, 1.0]), normal).astype(np.float32)
    curvature = estimate_curvature(points, normal)
    np.testing.assert_allclose(curvature[~outside], 0.5, rtol=1e-3)
    assert (curvature[outside] == 0.0).all()


def test_background_is_flat_and_does_not_count() -> None:
    points, normal = hit_sphere(CAMERA, np.array([0.0, 0.0, -2.0]), 2.0)
    points[:10], normal[:10] = 0.0, 0.0
    curvature = estimate_curvature(points, normal)
    assert (curvature[:9] == 0.0).all()
    np.testing.assert_allclose(curvature[10:], 0.5, rtol=1e-3)


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (5, 1), (1, 2), (2, 2)], ids=str)
def test_images_of_a_single_row_or_column(shape: tuple[int, int]) -> None:
    camera = Camera(position=(0.0, 0.0, 4.0), forward=(0.0, 0.0, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.3)
    rays = camera.make_ray_directions(shape[1], shape[0])
    points = (camera.position + 3.0 * rays).astype(np.float32)
    curvature = estimate_curvature(points, -rays)
    assert curvature.shape == shape
    assert (curvature <= 0.0).all()
    places = compute_virtual_places(points, np.zeros(shape, np.float32), np.ones(shape, np.float32), camera, camera)
    np.testing.assert_allclose(places, add_grid(np.zeros((*shape, 2), np.float32)), rtol=0.0, atol=ROUNDING)


def test_positions_that_are_no_numbers_are_flat() -> None:
    points, normal = hit_sphere(CAMERA, np.array([0.0, 0.0, -2.0]), 2.0)
    points[4, 5], points[9, 9], normal[20, 20] = np.nan, np.inf, np.nan
    points[30, 3] = 1e30
    curvature = estimate_curvature(points, normal)
    assert np.isfinite(curvature).all()
    assert curvature[4, 5] == curvature[20, 20] == 0.0
    # Their neighbours have one on the other side.
    np.testing.assert_allclose(curvature[[3, 4, 4, 20, 29], [5, 4, 6, 21, 3]], 0.5, rtol=1e-3)
