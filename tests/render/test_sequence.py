"""Sequences: what stands still is the same to the bit, what moves says from where, and pieces make the whole."""

from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from lobewise.errors import InputError
from lobewise.records.camera import Camera, project_points
from lobewise.records.frame import Frame, GBuffer
from lobewise.records.sparse_frame import AnyFrame, SparseFrame, list_places
from tests.mistakes import refuses

pytestmark = pytest.mark.mitsuba

SIZE = 20


@pytest.fixture(scope="module")
def scene(mi: Any) -> Any:
    from lobewise.render import load_scene

    return load_scene("showroom", width=SIZE)


@pytest.fixture(scope="module")
def orbit(scene: Any) -> list[Camera]:
    from lobewise.render import find_orbit_centre, get_camera, make_orbit

    return make_orbit(get_camera(scene), find_orbit_centre(scene), 5, 2.0)


def list_guides(gbuffer: GBuffer) -> dict[str, np.ndarray]:
    """Return the guides that are there, but for the motion."""
    return {name: value for name, value in vars(gbuffer).items() if value is not None and name != "motion"}


def assert_same(one: AnyFrame, other: AnyFrame) -> None:
    for part in ("radiance", "gbuffer"):
        for name, image in vars(getattr(one, part)).items():
            np.testing.assert_array_equal(image, getattr(getattr(other, part), name), err_msg=name)


@pytest.mark.parametrize("scale", [1, 2])
def test_guides_of_a_still_camera_are_the_same_bits_and_its_light_is_not(scene: Any, scale: int) -> None:
    from lobewise.render import get_camera, render_sequence

    first, second, third = render_sequence(scene, [get_camera(scene)] * 3, spp=2, scale=scale, seed=7)
    assert first.gbuffer.motion is None
    for frame in (second, third):
        assert list_guides(frame.gbuffer).keys() == list_guides(first.gbuffer).keys()
        for name, image in list_guides(frame.gbuffer).items():
            np.testing.assert_array_equal(image, getattr(first.gbuffer, name), err_msg=name)
        # The position of a pixel centre in single precision.
        assert np.abs(frame.gbuffer.motion).max() < 1e-3
    if scale == 1:
        assert not np.array_equal(first.radiance.color, second.radiance.color)
        assert not np.array_equal(second.half_a.color, third.half_a.color)


def test_light_is_that_of_single_frames_of_successive_seeds(scene: Any, orbit: list[Camera]) -> None:
    from lobewise.render import render_frame, render_sequence, set_camera

    for index, frame in enumerate(render_sequence(scene, orbit[:2], spp=2, seed=7, light="indirect")):
        set_camera(scene, orbit[index])
        alone = render_frame(scene, spp=2, seed=7 + index, light="indirect")
        np.testing.assert_array_equal(frame.radiance.color, alone.radiance.color)
        assert frame.radiance.direct is None
        np.testing.assert_array_equal(frame.camera.position, alone.camera.position)


@pytest.mark.nightly
def test_shaded_places_follow_their_order(scene: Any, orbit: list[Camera]) -> None:
    from lobewise.render import render_sequence

    frames = list(render_sequence(scene, orbit, spp=1, scale=2))
    assert all(isinstance(frame, SparseFrame) for frame in frames)
    assert [frame.place for frame in frames] == [*list_places(2), list_places(2)[0]]


@pytest.mark.sampled("3")
@pytest.mark.parametrize("scale", [1, 3])
def test_pieces_of_a_path_are_the_frames_of_the_whole(scene: Any, orbit: list[Camera], scale: int) -> None:
    from lobewise.render import render_sequence

    whole = list(render_sequence(scene, orbit[:4], spp=1, scale=scale, seed=3))
    rest = list(render_sequence(scene, orbit[:4], spp=1, scale=scale, seed=3, first=2))
    assert len(rest) == 2
    for one, other in zip(whole[2:], rest, strict=True):
        assert_same(one, other)


def test_frames_come_one_at_a_time(scene: Any, orbit: list[Camera], monkeypatch: pytest.MonkeyPatch) -> None:
    from lobewise.render import render_sequence, sequence

    moved: list[Camera] = []
    monkeypatch.setattr(sequence, "set_camera", lambda scene, camera: moved.append(camera))
    frames = render_sequence(scene, orbit, spp=1, scale=4)
    assert isinstance(frames, Iterator)
    assert moved == []
    next(frames)
    assert moved == orbit[:1]


@pytest.mark.nightly
def test_references_are_the_radiance_alone(scene: Any, orbit: list[Camera]) -> None:
    from lobewise.render import render_sequence

    frame = next(render_sequence(scene, orbit, spp=2, seed=7, reference=True))
    whole = next(render_sequence(scene, orbit, spp=2, seed=7))
    assert isinstance(frame, Frame)
    assert frame.gbuffer.position is None
    assert np.allclose(frame.radiance.color, whole.radiance.color, rtol=1e-4, atol=1e-5)


@pytest.mark.parametrize(
    ("change", "what"),
    [({"first": 5}, "first"), ({"scale": 17}, "scale"), ({"scale": 2, "reference": True}, "reference")],
)
def test_impossible_sequences_are_refused_at_once(
    scene: Any, orbit: list[Camera], change: dict[str, Any], what: str
) -> None:
    from lobewise.render import render_sequence

    with refuses(InputError, what):
        render_sequence(scene, orbit, **{"spp": 1, **change})


class TestMovingObjects:
    STEPS = 8
    """Frames between the two that are compared: at 96 pixels a side, objects move by several pixels."""

    @staticmethod
    def slide(point: np.ndarray, by: tuple[float, float, float]) -> np.ndarray:
        return point - np.array(by)

    @staticmethod
    def turn(point: np.ndarray, centre: tuple[float, float, float], degrees: float) -> np.ndarray:
        """Return the points turned back about a vertical axis; positive degrees turn from z to x."""
        angle = np.deg2rad(-degrees)
        x, y, z = np.moveaxis(point - np.array(centre), -1, 0)
        turned = np.stack([np.cos(angle) * x + np.sin(angle) * z, y, np.cos(angle) * z - np.sin(angle) * x], axis=-1)
        return turned + np.array(centre)

    def list_objects(self, name: str, position: np.ndarray) -> list[tuple[np.ndarray, np.ndarray]]:
        """Return of each moving object at time `STEPS` its pixels, and where their points were at time 0.

        By geometry alone: what lies within a ball or a turned box, and what the scene says of its path.
        """

        def in_ball(centre: tuple[float, float, float], radius: float) -> np.ndarray:
            return np.linalg.norm(position - np.array(centre), axis=-1) < radius + 1e-3

        def in_box(before: np.ndarray, centre: tuple[float, float, float], half: float, degrees: float) -> np.ndarray:
            local = self.turn(before, centre, degrees) - np.array(centre)
            inside = np.abs(local)[..., [0, 2]].max(axis=-1) < half + 1e-3
            return inside & (before[..., 1] > 1e-3) & (np.abs(local[..., 1]) < centre[1] + 1e-3)

        steps = self.STEPS
        if name == "showroom":
            ball = in_ball((-0.5 - 0.028 * steps, 0.45, 0.9), 0.45)
            cube = self.turn(position, (2.3, 0.32, 1.5), 2.5 * steps)
            return [
                (ball, self.slide(position, (-0.028 * steps, 0.0, 0.0))),
                (in_box(cube, (2.3, 0.32, 1.5), 0.32, 30.0), cube),
            ]
        by = (-0.024 * steps, 0.0, -0.007 * steps)
        pearl = in_ball((0.55 + by[0], 0.88, 0.45 + by[2]), 0.16)
        stool = self.turn(self.slide(position, (-0.012 * steps, 0.0, 0.0)), (1.7, 0.2, 1.85), 0.5 * steps)
        return [(pearl, self.slide(position, by)), (in_box(stool, (1.7, 0.2, 1.85), 0.30, 20.0), stool)]

    @pytest.mark.parametrize("name", ["showroom", "parlour"])
    @pytest.mark.parametrize("degrees", [0.0, -1.5])
    @pytest.mark.nightly
    def test_motion_leads_to_where_the_point_was(self, mi: Any, name: str, degrees: float) -> None:
        from lobewise.render import MovingScene, find_orbit_centre, get_camera, make_orbit, render_frame, set_camera

        size, moving = 96, MovingScene(name, 96)
        scene = moving.load(0)
        cameras = make_orbit(get_camera(scene), find_orbit_centre(scene), 2, degrees)
        before = render_frame(scene, spp=1, aov_only=True)
        scene = moving.load(self.STEPS)
        set_camera(scene, cameras[1])
        frame = render_frame(
            scene, spp=1, aov_only=True, previous_camera=cameras[0], moves=moving.compute_moves(self.STEPS, 0)
        )
        guides = frame.gbuffer
        objects = self.list_objects(name, guides.position.astype(np.float64))
        row, column = np.mgrid[:size, :size]
        where = np.stack([column, row], axis=-1) + 0.5 + guides.motion
        for pixels, was in objects:
            assert pixels.sum() > 20
            ahead = (was - cameras[0].position) @ cameras[0].forward
            half = np.tan(0.5 * cameras[0].fov_y)
            x = 0.5 * size * (1.0 + (was - cameras[0].position) @ cameras[0].right / ahead / half)
            y = 0.5 * size * (1.0 - (was - cameras[0].position) @ cameras[0].up / ahead / half)
            # Positions and matrices in single precision, at some 10 pixels a unit.
            np.testing.assert_allclose(where[pixels], np.stack([x, y], axis=-1)[pixels], atol=2e-3)
            found = np.floor(where).astype(int).clip(0, size - 1)
            there = before.gbuffer.position[found[..., 1], found[..., 0]]
            # The pixel centre that is nearest lies up to 0.7 pixels away, across a surface that may be steep.
            view = cameras[0].position - was
            distance = np.linalg.norm(view, axis=-1)
            cosine = np.abs(np.sum(view * guides.normal, axis=-1)) / distance
            footprint = 0.75 * distance * cameras[0].get_pixel_angle(size) / np.maximum(cosine, 0.25)
            near = np.linalg.norm(there - was, axis=-1) < footprint
            assert near[pixels].mean() > 0.8
            stays = np.linalg.norm(there - guides.position, axis=-1) < footprint
            assert stays[pixels].mean() < 0.5

    def test_reflected_motion_is_that_of_the_hit(self, mi: Any) -> None:
        from lobewise.render import MovingScene, render_frame

        moving = MovingScene("showroom", 96)
        scene = moving.load(self.STEPS)
        moves = moving.compute_moves(self.STEPS, 0)
        camera = render_frame(scene, spp=1, aov_only=True).camera
        known = {"spp": 1, "aov_only": True, "previous_camera": camera}
        assert render_frame(scene, **known).gbuffer.reflected_motion is None
        guides = render_frame(scene, **known, moves=moves).gbuffer
        found = guides.reflected_motion
        # With a single sample the hit is the mean of the sample and of the mirror ray, which mostly see one object.
        ball = np.linalg.norm(guides.hit_position - np.array([-0.5 - 0.028 * self.STEPS, 0.45, 0.9]), axis=-1) < 0.47
        smooth = ball & (guides.alpha_u < 0.15)
        assert smooth.sum() > 10
        expected = np.array([0.028 * self.STEPS, 0.0, 0.0])
        assert np.mean(np.linalg.norm(found[smooth] - expected, axis=-1) < 1e-4) > 0.8
        moved = np.abs(found).max(axis=-1) > 0.0
        assert 0.005 < moved.mean() < 0.2

    def test_what_stands_still_moves_with_the_camera_alone(self, mi: Any) -> None:
        from lobewise.render import MovingScene, get_camera, render_sequence

        moving = MovingScene("showroom", 32)
        camera = get_camera(moving.load())
        second = list(render_sequence(moving, [camera] * 2, spp=1, scale=4))[1]
        moved = np.linalg.norm(second.gbuffer.motion, axis=-1)
        position = second.gbuffer.position
        ball = np.linalg.norm(position - np.array([-0.528, 0.45, 0.9]), axis=-1) < 0.451
        cube = (np.abs(position - np.array([2.3, 0.32, 1.5])).max(axis=-1) < 0.46) & (position[..., 1] > 1e-4)
        assert ball.sum() > 5
        assert moved[ball].min() > 0.1
        assert moved[~ball & ~cube].max() < 1e-3

    @pytest.mark.sampled("showroom")
    @pytest.mark.parametrize("name", ["showroom", "parlour"])
    def test_objects_move_slowly_and_touch_nothing(self, mi: Any, name: str) -> None:
        from lobewise.render import MovingScene, get_camera
        from lobewise.render.loading import build_scene
        from lobewise.scenes import describe_movers

        moving = MovingScene(name, 512)
        scene = moving.load()
        camera = get_camera(scene)

        def compute_bounds(box: Any) -> np.ndarray:
            return np.array([np.array(box.min).ravel(), np.array(box.max).ravel()], dtype=np.float64)

        still = {
            each.id(): compute_bounds(each.bbox())
            for each in scene.shapes()
            if each.id() not in describe_movers(name, 0.0)
        }
        for time in range(33):
            moves = moving.compute_moves(time + 1, time)
            movers = describe_movers(name, time)
            bounds = {key: compute_bounds(build_scene(item).bbox()) for key, item in movers.items()}
            for key, mine in bounds.items():
                others = {**still, **{other: each for other, each in bounds.items() if other != key}}
                for other, box in others.items():
                    overlap = np.minimum(mine[1], box[1]) - np.maximum(mine[0], box[0])
                    assert overlap.min() < 1e-3, f"{key} meets {other} at {time}"
                corners = mine[[[i >> axis & 1 for axis in range(3)] for i in range(8)], [0, 1, 2]]
                # To the next frame, by the same path in the other direction.
                after = np.concatenate([corners, np.ones((8, 1))], axis=-1) @ np.linalg.inv(moves[key]).T
                shift = project_points(camera, after[:, :3], 512, 512) - project_points(camera, corners, 512, 512)
                if time < 31:
                    assert 1.0 < np.linalg.norm(shift, axis=-1).max() < 4.5, f"{key} at {time}"

    def test_moves_of_what_is_not_there_are_errors(self, scene: Any) -> None:
        from lobewise.render import get_camera, render_frame

        camera = get_camera(scene)
        for moves, what in (({"golden": np.eye(4)}, "moves"), ({"gold": np.eye(3)}, "moves['gold']")):
            with refuses(InputError, what):
                render_frame(scene, spp=1, aov_only=True, previous_camera=camera, moves=moves)
