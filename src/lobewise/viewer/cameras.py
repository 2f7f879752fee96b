"""Convert between the browser's camera and the camera of a scene."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.records.camera import Camera
from lobewise.viewer.messages import Description

Vector = NDArray[np.float64]

FAR_FOV = 0.8
"""Vertical angle of view, radians, of a browser's camera that stands for an orthographic one."""
_DISTANCE = 4.0
"""First distance from the browser's camera to its look-at point, in the browser's unit. Its keys fly 2 units a second,
whatever the scene's unit is."""
_MIN_FOV = 0.005
"""Vertical angle of view, radians, below which a camera stands for an orthographic one. The browser's controls do not
work with such angles, so the browser's camera stands nearer and sees as much at its look-at point."""


@dataclass(frozen=True)
class Pose:
    """A camera of the browser, in the browser's unit of length. Vectors have the shape (3,)."""

    position: Vector
    look_at: Vector
    """The point about which the camera orbits."""
    up: Vector
    """The axis of the orbit."""
    fov: float
    """Full vertical angle of view, radians."""


class CameraMap:
    """Maps the browser's camera to the camera of a scene."""

    def __init__(self, description: Description) -> None:
        camera = description.camera
        gap = float(np.dot(np.asarray(description.look_at) - camera.position, camera.forward))
        # With the look-at point behind the camera, any other point will do.
        gap = gap if gap > 1e-9 else 1.0
        self._far: tuple[float, float] | None = None
        """Of a far camera: its distance over that of the browser's camera, and its angle of view."""
        if camera.fov_y < _MIN_FOV:
            half_height = gap * float(np.tan(0.5 * camera.fov_y))
            self._scale = _DISTANCE * float(np.tan(0.5 * FAR_FOV)) / half_height
            self._far = gap / _DISTANCE, camera.fov_y
            look_at = self._scale * (camera.position + gap * camera.forward)
            self.start = Pose(look_at - _DISTANCE * camera.forward, look_at, choose_up(camera), FAR_FOV)
            return
        self._scale = _DISTANCE / gap
        position = self._scale * camera.position
        self.start = Pose(position, position + _DISTANCE * camera.forward, choose_up(camera), camera.fov_y)

    def to_camera(self, pose: Pose) -> Camera | None:
        """Return the camera of a scene; None if the browser's camera looks along the axis of its orbit."""
        forward = pose.look_at - pose.position
        across = float(np.linalg.norm(np.cross(forward, pose.up)))
        if not across > 1e-6 * float(np.linalg.norm(forward) * np.linalg.norm(pose.up)):
            return None
        if self._far is not None:
            ratio, angle = self._far
            return Camera(pose.look_at / self._scale - ratio * forward, forward, pose.up, angle)
        return Camera(position=pose.position / self._scale, forward=forward, up=pose.up, fov_y=pose.fov)


def choose_up(camera: Camera) -> Vector:
    """Return the world axis that is nearest to a camera's up, as the axis of orbits.

    Scenes do not say which axis is up. The axis is right if the camera is rolled by less than 45 degrees.
    """
    axis = np.zeros(3)
    largest = int(np.argmax(np.abs(camera.up)))
    axis[largest] = np.sign(camera.up[largest])
    return axis


def read_pose(camera: Any) -> Pose:
    """Return the pose of a browser's camera handle."""
    return Pose(
        np.array(camera.position, dtype=np.float64),
        np.array(camera.look_at, dtype=np.float64),
        np.array(camera.up_direction, dtype=np.float64),
        float(camera.fov),
    )


def place_camera(camera: Any, pose: Pose) -> None:
    """Move a browser's camera."""
    camera.up_direction = pose.up
    camera.position = pose.position
    camera.look_at = pose.look_at
    camera.fov = pose.fov
