"""Disocclusion against exact visibility: a scene of planes, a ball and a box, every ray of it in closed form."""

import numpy as np
import pytest

from lobewise.errors import InputError, MissingChannelError
from lobewise.metrics import find_disoccluded
from lobewise.records.camera import Camera, project_points
from lobewise.records.frame import GBuffer
from tests.mistakes import refuses

WIDTH, HEIGHT = 120, 90
SKY, FLOOR, WALL, BALL, BOX = range(5)
RADIUS, HALF = 0.6, 0.5
EYE, AHEAD = np.array((0.0, 1.2, 5.0)), np.array((0.0, -0.1, -1.0))
BALL_AT, BOX_AT = np.array((-0.3, 0.7, 0.0)), np.array((0.6, 0.55, -1.0))
NOWHERE = np.zeros(3)


def hit(origin, rays, ball, box):
    """Return distance (inf for none), normal, and which thing it is, of the first hit along unit rays."""
    distance, normal = np.full(rays.shape[:-1], np.inf), np.zeros(rays.shape)
    thing = np.zeros(distance.shape, dtype=int)

    def take(t, n, number):
        nearer = (t > 1e-9) & (t < distance)
        distance[nearer], thing[nearer] = t[nearer], number
        normal[nearer] = np.broadcast_to(n, rays.shape)[nearer]

    with np.errstate(divide="ignore", invalid="ignore"):
        take(-origin[1] / rays[..., 1], np.array([0.0, 1.0, 0.0]), FLOOR)
        wall = (-6.0 - origin[2]) / rays[..., 2]
        take(np.where(origin[1] + wall * rays[..., 1] < 2.0, wall, np.inf), np.array([0.0, 0.0, 1.0]), WALL)
        half = (rays * (origin - ball)).sum(axis=-1)
        root = half**2 - ((origin - ball) ** 2).sum() + RADIUS**2
        t = -half - np.sqrt(root)
        take(t, (origin + t[..., None] * rays - ball) / RADIUS, BALL)
        slabs = np.stack([(box - HALF - origin) / rays, (box + HALF - origin) / rays])
        enter, leave = slabs.min(axis=0), slabs.max(axis=0)
        t = np.where(enter.max(axis=-1) <= leave.min(axis=-1), enter.max(axis=-1), np.inf)
        axis = enter.argmax(axis=-1)[..., None]
        face = np.zeros(rays.shape)
        np.put_along_axis(face, axis, -np.sign(np.take_along_axis(rays, axis, axis=-1)), axis=-1)
        take(t, face, BOX)
    return distance, normal, thing


class Shot:
    """A frame of the scene: the guides of every pixel's centre ray."""

    def __init__(self, camera, ball, box):
        self.camera, self.ball, self.box = camera, ball, box
        self.rays = camera.make_ray_directions(WIDTH, HEIGHT).astype(np.float64)
        distance, self.normal, self.thing = hit(camera.position, self.rays, ball, box)
        self.depth = np.where(np.isfinite(distance), distance, 0.0)
        seen = self.depth[..., None] > 0.0
        self.position = np.where(seen, camera.position + self.depth[..., None] * self.rays, 0.0)

    def get_edges(self):
        """Return the pixels beside another face of a thing, or beside another thing."""
        kind = self.thing * 64 + (np.rint(self.normal) @ [1, 3, 9]).astype(int) * (self.thing == BOX)
        padded = np.pad(kind, 1, mode="edge")
        around = [padded[1 + y : 1 + y + HEIGHT, 1 + x : 1 + x + WIDTH] for y in (-1, 0, 1) for x in (-1, 0, 1)]
        return np.ptp(np.stack(around), axis=0) > 0


def look_back(now, before):
    """Return exactly where every point of ``now`` was in ``before``, and whether it could not be seen there."""
    sky = now.depth == 0.0
    moved = {BALL: before.ball - now.ball, BOX: before.box - now.box}
    points = now.position + sum((now.thing == k)[..., None] * shift for k, shift in moved.items())
    points = np.where(sky[..., None], before.camera.position + 1e6 * now.rays, points)
    offset = points - before.camera.position
    distance = np.linalg.norm(offset, axis=-1)
    first, _, _ = hit(before.camera.position, offset / distance[..., None], before.ball, before.box)
    place = project_points(before.camera, points, WIDTH, HEIGHT).astype(np.float64)
    inside = ((place >= 0.0) & (place < (WIDTH, HEIGHT))).all(axis=-1)
    hidden = ~np.where(sky, ~np.isfinite(first), first >= distance * (1.0 - 1e-5)) | ~inside
    column, row = np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5)
    return place, place - np.stack([column, row], axis=-1), hidden


# Each: what the camera, the ball and the box have moved by since the frame before, and how far the camera has turned.
MOVES = {
    "nothing": (NOWHERE, NOWHERE, NOWHERE, 0.0),
    "objects aside": (NOWHERE, np.array((0.1, 0.0, 0.0)), np.array((0.3, 0.0, 0.0)), 0.0),
    "objects towards the camera": (NOWHERE, np.array((0.0, 0.0, 0.3)), np.array((0.0, 0.0, 0.4)), 0.0),
    "objects away": (NOWHERE, np.array((-0.1, 0.0, -0.4)), np.array((0.1, 0.0, -0.4)), 0.0),
    "camera aside": (np.array((0.15, 0.0, 0.0)), NOWHERE, NOWHERE, 0.0),
    "camera slowly": (np.array((0.02, 0.01, 0.0)), NOWHERE, NOWHERE, 0.0),
    "camera back": (np.array((0.0, 0.0, 0.4)), NOWHERE, NOWHERE, 0.0),
    "camera turns": (NOWHERE, NOWHERE, NOWHERE, 0.06),
    "everything": (np.array((0.1, 0.05, -0.1)), np.array((0.1, 0.0, 0.2)), np.array((-0.25, 0.0, 0.0)), 0.02),
}  # fmt: skip

UNCOVERING = ("objects aside", "camera aside", "camera back", "camera turns", "everything")


@pytest.mark.parametrize("guides", ["all", "depth alone", "position alone"])
@pytest.mark.parametrize("move", MOVES)
def test_it_agrees_with_exact_visibility_but_at_edges(move, guides):
    shift, ball, box, turn = MOVES[move]
    before = Shot(Camera(EYE, AHEAD, (0, 1, 0), 0.7), BALL_AT, BOX_AT)
    now = Shot(Camera(EYE + shift, AHEAD + np.array((turn, 0.0, 0.0)), (0, 1, 0), 0.7), BALL_AT + ball, BOX_AT + box)
    place, motion, hidden = look_back(now, before)
    given = [
        GBuffer(
            depth=None if guides == "position alone" else shot.depth,
            position=None if guides == "depth alone" else shot.position,
            normal=shot.normal if guides == "all" else None,
            motion=motion if shot is now else None,
        )
        for shot in (now, before)
    ]
    found = find_disoccluded(given[0], now.camera, given[1], before.camera)
    assert found.shape == (HEIGHT, WIDTH)
    # What a pixel with an edge in it shows is a matter of its centre; exact visibility is one of points.
    column, row = (np.clip(place[..., k].astype(int), 0, size - 1) for k, size in ((0, WIDTH), (1, HEIGHT)))
    sure = ~now.get_edges() & ~before.get_edges()[row, column]
    assert np.count_nonzero(sure) > 0.7 * WIDTH * HEIGHT
    assert np.argwhere((found != hidden) & sure).tolist() == []
    if move in UNCOVERING:
        assert np.count_nonzero(hidden & sure) > 20
    assert np.count_nonzero(found ^ hidden) < 0.15 * np.count_nonzero(hidden) + 60


def test_without_motion_points_are_taken_to_stand_still():
    camera = Camera(EYE, AHEAD, (0, 1, 0), 0.7)
    before = Shot(camera, BALL_AT, BOX_AT)
    now = Shot(camera, BALL_AT, BOX_AT + np.array((0.0, 0.0, 0.3)))
    _, motion, _ = look_back(now, before)
    front = (now.thing == BOX) & (now.normal[..., 2] > 0.5) & ~now.get_edges() & ~before.get_edges()
    base = {"depth": now.depth, "normal": now.normal}
    still = find_disoccluded(GBuffer(**base), camera, GBuffer(depth=before.depth, normal=before.normal), camera)
    assert still[front].all()
    found = find_disoccluded(
        GBuffer(**base, motion=motion), camera, GBuffer(depth=before.depth, normal=before.normal), camera
    )
    assert not found[front].any()


def test_normals_tell_faces_that_meet():
    # The floor right beside the box was hidden by the box's foot, which has nearly the same depth.
    camera = Camera(EYE, AHEAD, (0, 1, 0), 0.7)
    shape = (8, 8)
    depth = np.full(shape, 4.0)
    up, front = (np.broadcast_to(np.array(n), (*shape, 3)) for n in ((0.0, 1.0, 0.0), (0.0, 0.0, 1.0)))
    assert not find_disoccluded(GBuffer(depth=depth), camera, GBuffer(depth=depth), camera).any()
    seen = GBuffer(depth=depth, normal=front)
    assert find_disoccluded(GBuffer(depth=depth, normal=up), camera, seen, camera).all()
    assert not find_disoccluded(GBuffer(depth=depth, normal=front), camera, seen, camera).any()


def test_motion_that_is_not_finite_leads_nowhere():
    camera = Camera(EYE, AHEAD, (0, 1, 0), 0.7)
    depth, motion = np.full((4, 5), 2.0), np.zeros((4, 5, 2))
    motion[1, 2, 0], motion[3, 4, 1] = np.nan, np.inf
    found = find_disoccluded(GBuffer(depth=depth, motion=motion), camera, GBuffer(depth=depth), camera)
    assert np.argwhere(found).tolist() == [[1, 2], [3, 4]]


def test_mistakes():
    camera = Camera(EYE, AHEAD, (0, 1, 0), 0.7)
    good = GBuffer(depth=np.ones((4, 5)))
    with refuses(MissingChannelError, "previous_gbuffer"):
        find_disoccluded(good, camera, GBuffer(normal=np.ones((4, 5, 3))), camera)
    with refuses(InputError, "previous_gbuffer", "4x4", "the size of the frame, 5x4 pixels"):
        find_disoccluded(good, camera, GBuffer(depth=np.ones((4, 4))), camera)
