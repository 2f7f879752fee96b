"""Reflections of objects that move, and in mirrors that move, against geometry in closed form and traced rays."""

from dataclasses import replace

import numpy as np
import pytest

from lobewise.filters.history.sums import split_sums
from lobewise.guides.places import add_grid, compute_virtual_places
from lobewise.guides.reflections import MIN_MIRROR_MOTION, Mirror, MovedReflections, compute_moved_reflections
from lobewise.recipes.temporal import TemporalFilter
from lobewise.records.camera import Camera, compute_motion
from lobewise.records.frame import FloatArray, Frame, GBuffer, Radiance
from tests.temporal.test_places import (
    CAMERA,
    HEIGHT,
    MOVED,
    ROUNDING,
    WIDTH,
    Vector,
    cast,
    hit_sphere,
    look,
    reflect,
    trace_reflection,
)

SHAPE = HEIGHT, WIDTH
FLAT = np.zeros(SHAPE, np.float32)
NORMAL = np.array([0.3, -0.1, 1.0]) / np.linalg.norm([0.3, -0.1, 1.0])


def fill(vector: Vector) -> FloatArray:
    """Return an image of one vector."""
    return np.broadcast_to(vector, (*SHAPE, 3)).astype(np.float32)


def hit_plane(camera: Camera, normal: Vector, offset: float = 0.0) -> Vector:
    """Return where rays hit the plane ``normal . p = offset``."""
    rays = cast(camera)
    return np.asarray(camera.position + ((offset - camera.position @ normal) / (rays @ normal))[..., None] * rays)


def mirror_points(points: Vector, normal: Vector, offset: float = 0.0) -> Vector:
    """Return points mirrored in the plane ``normal . p = offset``."""
    return np.asarray(points - 2.0 * (points @ normal - offset)[..., None] * normal)


def follow(
    points: Vector,
    distance: Vector,
    motion: Vector,
    *,
    normal: Vector = NORMAL,
    previous: Camera = CAMERA,
    before: Mirror | None = None,
    surface: tuple[FloatArray, FloatArray | None] | None = None,
) -> MovedReflections:
    """Return the reflections in a flat mirror."""
    now = Mirror(points.astype(np.float32), fill(normal))
    places = surface or (add_grid(np.zeros((*SHAPE, 2), np.float32)), None)
    given = distance.astype(np.float32), motion.astype(np.float32)
    return compute_moved_reflections((now, before or now), FLAT, *given, places, (CAMERA, previous))


@pytest.fixture
def distance(rng: np.random.Generator) -> Vector:
    return rng.uniform(0.5, 20.0, SHAPE)


@pytest.mark.parametrize("previous", [CAMERA, MOVED])
def test_what_stands_still_is_where_it_is_without_motion(previous: Camera, distance: Vector) -> None:
    points = hit_plane(CAMERA, NORMAL)
    distance[3, 4:7] = 0.0, np.inf, np.nan
    found = follow(points, distance, np.zeros((*SHAPE, 3)), previous=previous)
    places = compute_virtual_places(points.astype(np.float32), FLAT, distance.astype(np.float32), CAMERA, previous)
    np.testing.assert_allclose(found.places, places, rtol=0.0, atol=1e-5)
    if previous is CAMERA:
        np.testing.assert_allclose(found.hit_distance, distance, rtol=1e-5)
    np.testing.assert_array_equal(found.hit_distance[3, 4:7], distance[3, 4:7].astype(np.float32))


@pytest.mark.parametrize("previous", [CAMERA, MOVED])
def test_a_hit_that_moves_is_mirrored_where_it_was(
    previous: Camera, distance: Vector, rng: np.random.Generator
) -> None:
    points, motion = hit_plane(CAMERA, NORMAL), rng.uniform(-0.2, 0.2, (*SHAPE, 3))
    was = points + distance[..., None] * reflect(cast(CAMERA), NORMAL) + motion
    image = mirror_points(was, NORMAL)
    found = follow(points, distance, motion, previous=previous)
    np.testing.assert_allclose(found.places, look(previous, image), rtol=0.0, atol=ROUNDING)
    # The ray of the previous camera to the image crosses the mirror where the reflection was seen.
    eye = previous.position
    share = (eye @ NORMAL) / ((eye - image) @ NORMAL)
    crossing = eye + share[..., None] * (image - eye)
    np.testing.assert_allclose(found.hit_distance, np.linalg.norm(was - crossing, axis=-1), rtol=1e-4)


def test_a_mirror_that_moves_shows_the_image_behind_its_earlier_plane(distance: Vector) -> None:
    turned = np.array([0.33, -0.08, 1.0]) / np.linalg.norm([0.33, -0.08, 1.0])
    points, points_before = hit_plane(CAMERA, NORMAL), hit_plane(CAMERA, turned, 0.05)
    # Any point of the earlier plane tells where it was: take those of the same pixels.
    surface = add_grid(np.zeros((*SHAPE, 2), np.float32)), np.full(SHAPE, 1.0, np.float32)
    before = Mirror(points_before.astype(np.float32), fill(turned))
    hits = points + distance[..., None] * reflect(cast(CAMERA), NORMAL)
    motion = np.full((*SHAPE, 3), (0.05, 0.0, -0.02))
    found = follow(points, distance, motion, before=before, surface=surface)
    expected = look(CAMERA, mirror_points(hits + motion, turned, 0.05))
    np.testing.assert_allclose(found.places, expected, rtol=0.0, atol=10.0 * ROUNDING)
    # Near its axis a mirror that turns does not move itself.
    axis = np.full(SHAPE, 1.0, np.float32)
    axis[:, 20:24] = 0.0
    turning = follow(points, distance, motion, before=before, surface=(surface[0], axis))
    np.testing.assert_array_equal(turning.places, found.places)
    # A mirror that moves less than rounding stands still.
    still = surface[0], np.full(SHAPE, 0.5 * MIN_MIRROR_MOTION, np.float32)
    same = follow(points, distance, motion, before=before, surface=still)
    np.testing.assert_array_equal(same.places, follow(points, distance, motion).places)


@pytest.mark.parametrize("spoil", ["outside", "nowhere", "another surface"])
def test_a_mirror_that_was_not_seen_before_stands_still(spoil: str, distance: Vector) -> None:
    points, motion = hit_plane(CAMERA, NORMAL), np.full((*SHAPE, 3), 0.1)
    places, turned = add_grid(np.zeros((*SHAPE, 2), np.float32)), fill(NORMAL)
    if spoil == "outside":
        places = places + np.float32(500.0)
    elif spoil == "nowhere":
        places = np.full_like(places, np.nan)
    else:
        turned = fill(np.array([1.0, 0.0, -0.2]))
    surface = places, np.full(SHAPE, 3.0, np.float32)
    before = Mirror(np.zeros((*SHAPE, 3), np.float32), turned)
    found = follow(points, distance, motion, before=before, surface=surface)
    np.testing.assert_array_equal(found.places, follow(points, distance, motion).places)


def test_motion_that_is_no_number_is_none(distance: Vector) -> None:
    points, motion = hit_plane(CAMERA, NORMAL), np.full((*SHAPE, 3), 0.1)
    expected = follow(points, distance, motion)
    motion[0, :3] = np.array([np.nan, np.inf, -np.inf])[:, None]
    found = follow(points, distance, motion)
    still = follow(points, distance, np.zeros_like(motion))
    np.testing.assert_array_equal(found.places[0, :3], still.places[0, :3])
    np.testing.assert_array_equal(found.places[1:], expected.places[1:])


@pytest.mark.parametrize("step", [(0.05, 0.0, 0.0), (0.0, 0.04, 0.0), (0.02, -0.02, 0.06)])
def test_in_a_ball_it_is_where_a_traced_reflection_is(step: tuple[float, float, float]) -> None:
    radius, centre, distance = 2.0, np.array([0.0, 0.0, -2.0]), 1.0
    points, normal = hit_sphere(CAMERA, centre, radius)
    now = Mirror(points, normal)
    curvature = np.full(SHAPE, 1.0 / radius, np.float32)
    motion = np.broadcast_to(np.float32(step), points.shape)
    places = add_grid(np.zeros((*SHAPE, 2), np.float32))
    given = curvature, np.full(SHAPE, distance, np.float32), np.ascontiguousarray(motion)
    found = compute_moved_reflections((now, now), *given, (places, None), (CAMERA, CAMERA))
    rays, errors, ways = cast(CAMERA), [], []
    for row, column in ((16, 24), (13, 26), (18, 20)):
        point, outward = (each[row, column].astype(np.float64) for each in now)
        was = point + distance * reflect(rays[row, column], outward) + np.array(step)
        seen = trace_reflection(CAMERA, was, centre, radius, point)
        errors.append(np.linalg.norm(found.places[row, column] - look(CAMERA, seen)))
        ways.append(np.linalg.norm(look(CAMERA, seen) - places[row, column]))
        assert found.hit_distance[row, column] == pytest.approx(np.linalg.norm(was - seen), rel=0.01)
    # Third order in the angles at the mirror. A step straight away from the mirror moves the image little.
    assert max(errors) < 0.03 * max(ways) + 0.01, (errors, ways)


# A mirror on the floor y = 0 under a ceiling with a pattern, which is carried along by the ceiling's motion.
ROOM = (40, 56)
CEILING = 1.5
EYE = Camera(position=(0.0, 1.0, 3.0), forward=(0.0, -0.45, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.5)


def make_pattern(points: Vector) -> FloatArray:
    """Return the light of points of the ceiling, (height, width, 3), > 0."""
    waves = [np.sin(5.0 * points[..., 0] + k) * np.cos(4.0 * points[..., 2] - k) for k in range(3)]
    return (1.0 + 0.8 * np.stack(waves, axis=-1)).astype(np.float32)


def make_room(shift: float, step: float | None, noise: float = 0.0, seed: int = 0) -> Frame:
    """Return the mirror under a ceiling that has slid by ``shift``, the last ``step`` of it since the frame before.

    With ``noise`` the light is multiplied by a gamma variate of that relative variance, which the frame knows.
    """
    height, width = ROOM
    rays = EYE.make_ray_directions(width, height).astype(np.float64)
    way = -EYE.position[1] / rays[..., 1]
    position = EYE.position + way[..., None] * rays
    out = rays * np.array([1.0, -1.0, 1.0])
    distance = CEILING / out[..., 1]
    hits = position + distance[..., None] * out
    specular = make_pattern(hits - np.array([shift, 0.0, 0.0]))
    grain = np.random.default_rng(seed).gamma(1.0 / noise, noise, (*ROOM, 1)) if noise else 1.0
    size = (*ROOM, 3)
    still = compute_motion(EYE, EYE, position.astype(np.float32), way.astype(np.float32))
    moved = None if step is None else np.broadcast_to(np.float32([-step, 0.0, 0.0]), size)
    guides = GBuffer(
        depth=way,
        position=position,
        normal=np.broadcast_to(np.float32([0.0, 1.0, 0.0]), size),
        alpha_u=np.full(ROOM, 0.01),
        lobe_kind=np.ones(ROOM),
        diffuse_albedo=np.zeros(size),
        specular_albedo=np.ones(size),
        hit_distance=distance,
        motion=still,
        reflected_motion=moved,
    )
    black = np.zeros(size, np.float32)
    spread = noise * specular**2
    variance = Radiance(spread, diffuse=black, specular=spread)
    noisy = (specular * grain).astype(np.float32)
    return Frame(Radiance(noisy, diffuse=black, specular=noisy), guides, EYE, variance=variance, spp=4)


def measure_room(guided: bool, step: float = 0.02) -> tuple[float, float]:
    """Return the error of the last image of a ceiling that slides, and the median length of the specular history."""
    temporal = TemporalFilter(radius=0, device="cpu")
    for number in range(16):
        told = step if guided and number else None
        result = temporal.add(make_room(step * number, told, noise=0.1, seed=number))
    frames = split_sums(temporal.get_state()["sums/specular"]).frames
    # The ceiling slides by half a pixel a frame or more: the left of the image is new.
    inside = (slice(4, -4), slice(20, -4))
    difference = result.image - make_room(step * number, None).radiance.color
    return float(np.sqrt(np.mean(difference[inside] ** 2))), float(np.median(frames[inside]))


@pytest.mark.parametrize("step", [0.02, 0.1])
def test_a_history_follows_what_is_reflected(step: float) -> None:
    (error, frames), (other, _) = measure_room(True, step), measure_room(False, step)
    # The noise of a single frame is a third. Without the guide a history follows another part of the ceiling.
    assert frames > 4.0
    assert error < 0.12
    assert other > 0.18


def test_without_the_guide_nothing_changes_but_for_what_moves() -> None:
    still = make_room(0.0, None)
    told = replace(still, gbuffer=replace(still.gbuffer, reflected_motion=np.zeros((*ROOM, 3), np.float32)))
    plain, followed = (TemporalFilter(radius=1, device="cpu") for _ in range(2))
    for _ in range(3):
        images = plain.add(still).image, followed.add(told).image
    np.testing.assert_allclose(*images, rtol=1e-4)
