"""The browser's camera as ours."""

from dataclasses import replace

import numpy as np
import pytest

from lobewise.interactive.settings import InteractiveSettings
from lobewise.records.camera import Camera
from lobewise.viewer.cameras import CameraMap, Pose, choose_up
from lobewise.viewer.messages import Description

Z_UP = Camera(position=(3.0, -900.0, 40.0), forward=(0.0, 1.0, -0.2), up=(0.0, 0.0, 1.0), fov_y=0.7)
FAR = Camera(position=(2.0, -9000.0, 1800.0), forward=(0.0, 1.0, -0.2), up=(0.0, 0.0, 1.0), fov_y=3e-4)
Y_UP = Camera(position=(0.0, 0.2, 0.3), forward=(0.1, -0.2, -1.0), up=(0.0, 1.0, 0.0), fov_y=0.7)


def describe(camera: Camera, gap: float) -> Description:
    """Return a scene whose camera looks at a point at a distance."""
    at = camera.position + gap * camera.forward
    return Description(InteractiveSettings(), 64, 64, camera, (float(at[0]), float(at[1]), float(at[2])))


class TestScenes:
    @pytest.mark.parametrize(("camera", "gap"), [(Z_UP, 850.0), (Y_UP, 0.3), (FAR, 9200.0)])
    def test_the_start_is_the_scenes_own_camera(self, camera, gap):
        cameras = CameraMap(describe(camera, gap))
        back = cameras.to_camera(cameras.start)
        for name in ("position", "forward", "up"):
            np.testing.assert_allclose(getattr(back, name), getattr(camera, name), rtol=1e-9, atol=1e-9)
        assert back.fov_y == camera.fov_y

    @pytest.mark.parametrize(("camera", "gap"), [(Z_UP, 850.0), (Y_UP, 0.3)])
    def test_whatever_the_unit_the_keys_fly_at_one_pace(self, camera, gap):
        cameras = CameraMap(describe(camera, gap))
        start = cameras.start
        assert np.linalg.norm(start.look_at - start.position) == pytest.approx(4.0)
        # Half the way to what is looked at, there and here.
        step = 0.5 * (start.look_at - start.position)
        moved = cameras.to_camera(replace(start, position=start.position + step, look_at=start.look_at + step))
        np.testing.assert_allclose(moved.position, camera.position + 0.5 * gap * camera.forward, rtol=1e-9)

    def test_a_camera_that_stands_for_parallel_rays(self):
        cameras = CameraMap(describe(FAR, 9200.0))
        start, at = cameras.start, FAR.position + 9200.0 * FAR.forward
        assert start.fov == pytest.approx(0.8)
        # Both see as much at the look-at point, and half the distance shows half as much.
        near = cameras.to_camera(replace(start, position=0.5 * (start.position + start.look_at)))
        np.testing.assert_allclose(near.position, 0.5 * (FAR.position + at), rtol=1e-9)
        assert near.fov_y == FAR.fov_y
        seen = np.linalg.norm(start.look_at - start.position) * np.tan(0.5 * start.fov)
        step = np.array([seen, 0.0, 0.0])
        aside = replace(start, position=start.position + step, look_at=start.look_at + step)
        moved = cameras.to_camera(aside)
        np.testing.assert_allclose(moved.position - FAR.position, [9200.0 * np.tan(1.5e-4), 0.0, 0.0], atol=1e-6)

    def test_the_axis_of_the_orbit(self):
        np.testing.assert_array_equal(choose_up(Z_UP), [0.0, 0.0, 1.0])
        np.testing.assert_array_equal(choose_up(Y_UP), [0.0, 1.0, 0.0])
        np.testing.assert_array_equal(choose_up(replace(Y_UP, up=(0.1, -1.0, 0.2))), [0.0, -1.0, 0.0])

    def test_a_camera_that_looks_along_its_axis_is_none(self):
        cameras = CameraMap(describe(Y_UP, 1.0))
        pose = Pose(np.zeros(3), np.array([0.0, -1.0, 0.0]), np.array([0.0, 1.0, 0.0]), 0.7)
        assert cameras.to_camera(pose) is None
        assert cameras.to_camera(replace(pose, look_at=np.zeros(3))) is None

    def test_a_scene_without_anything_ahead(self):
        cameras = CameraMap(Description(InteractiveSettings(), 64, 64, Y_UP, (0.0, 5.0, 90.0)))
        np.testing.assert_allclose(cameras.to_camera(cameras.start).forward, Y_UP.forward)
