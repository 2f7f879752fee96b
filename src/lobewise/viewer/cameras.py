"""The browser's camera as ours, and ours as the browser's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.viewer.messages import Description, Window

Vector = NDArray[np.float64]

FRAME_FOV = 0.8
"""Angle of view, radians, at which a finished frame hangs before the browser's camera."""
_DISTANCE = 4.0
"""Of the browser's camera from what it looks at: its keys fly 2 units a second, whatever the scene's unit is."""


@dataclass(frozen=True)
class Pose:
    """A camera of the browser, in its own unit of length."""

    # Where it is, the point about which it orbits, and the axis of that, shape (3,).
    position: Vector
    look_at: Vector
    up: Vector
    fov: float
    """Full vertical angle of view, radians."""


class CameraMap:
    """Between the browser's cameras and those of a scene, or the part of a finished frame that is looked at.

    What was found has the scene's own camera and the point that it looks at; without a camera it is a finished frame.
    """

    def __init__(self, found: Description) -> None:
        self._scene = found.camera is not None
        if found.camera is None:
            distance = 1.0 / float(np.tan(0.5 * FRAME_FOV))
            self._scale = 1.0
            self.start = Pose(np.array([0.0, 0.0, distance]), np.zeros(3), np.array([0.0, 1.0, 0.0]), FRAME_FOV)
            return
        camera = found.camera
        gap = float(np.dot(np.asarray(found.look_at) - camera.position, camera.forward))
        # Where nothing is in front of the camera, any point will do.
        gap = gap if gap > 1e-9 else 1.0
        self._scale = _DISTANCE / gap
        position = self._scale * camera.position
        self.start = Pose(position, position + _DISTANCE * camera.forward, find_up(camera), camera.fov_y)

    def to_camera(self, pose: Pose) -> Camera | None:
        """Return the camera of a scene; None where the browser's looks along its own axis, and of a finished frame."""
        forward = pose.look_at - pose.position
        across = float(np.linalg.norm(np.cross(forward, pose.up)))
        if not self._scene or not across > 1e-6 * float(np.linalg.norm(forward) * np.linalg.norm(pose.up)):
            return None
        return Camera(position=pose.position / self._scale, forward=forward, up=pose.up, fov_y=pose.fov)

    def to_window(self, pose: Pose, width: int, height: int) -> Window:
        """Return the picture area, and of a finished frame the part that the browser's camera looks at."""
        if self._scene:
            return Window(max(width, 1), max(height, 1))
        gap = float(np.linalg.norm(pose.look_at - pose.position))
        start = float(self.start.position[2])
        zoom = float(np.clip(start / max(gap, 1e-6), 0.5, 64.0))
        # The browser computes in single precision.
        zoom = 1.0 if abs(zoom - 1.0) < 1e-3 else zoom
        x, y = (0.0 if abs(value) < 1e-3 else float(np.clip(value, -2.0, 2.0)) for value in pose.look_at[:2])
        return Window(max(width, 1), max(height, 1), zoom, (x, y))


def find_up(camera: Camera) -> Vector:
    """Return the axis of the world that is nearest to a camera's up: what an orbit turns about.

    Scenes do not say which axis is up; a camera that is not rolled by more than 45 degrees does.
    """
    axis = np.zeros(3)
    largest = int(np.argmax(np.abs(camera.up)))
    axis[largest] = np.sign(camera.up[largest])
    return axis


def read_pose(camera: Any) -> Pose:
    """Return what a browser's camera handle says."""
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
