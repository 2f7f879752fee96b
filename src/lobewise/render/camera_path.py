"""Cameras of the frames of a sequence: on an orbit, or read from a file."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError, name_value
from lobewise.io.cameras import make_camera
from lobewise.io.documents import describe_kind, parse_json, read_document
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera
from lobewise.render.bridge import mi
from lobewise.render.camera import get_camera

Vector = NDArray[np.float64]

SLOW_ORBIT = 0.25
"""Speed of an orbit, degrees per frame. At it no surface of the built-in scenes moves by more than 2.3 pixels per frame
at 512x512."""

_MAX_BYTES = 16 << 20
"""Largest size of a file with a camera path, bytes: a hundred thousand frames."""
_KEYS = ("position", "target", "forward", "up", "fov_y")


def find_orbit_centre(scene: Any) -> Vector:
    """Return the surface point in the middle of the image, or the middle of the scene if there is no surface."""
    camera = get_camera(scene, lens=True)
    ray = mi.Ray3f(mi.Point3f(*map(float, camera.position)), mi.Vector3f(*map(float, camera.forward)))
    hit = scene.ray_intersect(ray)
    point = hit.p if bool(hit.is_valid()[0]) else scene.bbox().center()
    return np.array(point, dtype=np.float64).reshape(3)


def make_orbit(camera: Camera, centre: ArrayLike, frames: int, degrees_per_frame: float = SLOW_ORBIT) -> list[Camera]:
    """Return the cameras of an orbit about ``centre`` that begins at ``camera``.

    Parameters
    ----------
    camera : Camera
        The first camera of the path.
    centre : array_like, shape (3,)
        Point about which the camera turns; the axis is the camera's own up.
    frames : int
        Number of cameras, at least 1.
    degrees_per_frame : float
        Angle from frame to frame, degrees; positive values move the camera to its right.

    Raises
    ------
    InputError
        If ``frames`` is below 1, or the centre or the angle is not finite.
    """
    pivot = np.asarray(centre, dtype=np.float64)
    for name, got, expected, good in (
        ("frames", frames, "at least 1", frames >= 1),
        ("centre", centre, "three finite numbers", pivot.shape == (3,) and np.isfinite(pivot).all()),
        ("degrees_per_frame", degrees_per_frame, "a finite number", np.isfinite(degrees_per_frame)),
    ):
        if not good:
            raise InputError(name, expected=expected, got=name_value(got), action="pass another")

    def turn(vector: Vector, angle: float) -> Vector:
        """Rotate about the camera's up by Rodrigues' formula."""
        axis = camera.up
        along = axis * (axis @ vector)
        return np.asarray(along + np.cos(angle) * (vector - along) + np.sin(angle) * np.cross(axis, vector))

    path = []
    for angle in np.deg2rad(degrees_per_frame) * np.arange(frames):
        position = pivot + turn(camera.position - pivot, angle)
        path.append(replace(camera, position=position, forward=turn(camera.forward, angle)))
    return path


def read_camera_path(path: PathLike, camera: Camera) -> list[Camera]:
    """Return the cameras in a JSON file: a list of objects, one for each frame.

    Each object has ``position`` and either ``target``, a point, or ``forward``, a direction, as lists of three numbers
    in world space. It may have ``up``, by default (0, 1, 0), and ``fov_y``, the full vertical angle of view in degrees,
    by default that of ``camera``.

    Raises
    ------
    FileError
        If the file cannot be read, or is not JSON.
    InputError
        If the file does not hold such a list.
    """
    name = f"camera path {str(path)!r}"
    data = read_document(path, _MAX_BYTES, what="camera path", holds="a JSON list of cameras")
    entries = parse_json(data, what=name)
    if not isinstance(entries, list) or not entries:
        got = "an empty list" if entries == [] else describe_kind(entries)
        action = 'write [{"position": [0, 1, 5], "target": [0, 0, 0]}, ...]'
        raise InputError(name, expected="a JSON list of cameras, one for each frame", got=got, action=action)
    return [
        make_camera(f"{name}, entry {number}", entry, _KEYS, camera.fov_y)
        for number, entry in enumerate(entries, start=1)
    ]
