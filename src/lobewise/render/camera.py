"""The camera of a Mitsuba scene as a `lobewise.records.frame.Camera`, and back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from typing import Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError, name_value
from lobewise.records.camera import PINHOLE_DISTANCE_OVER_VIEW, Camera
from lobewise.render.bridge import mi

RAY_TOLERANCE = 1e-4
"""Largest difference, per component of a unit direction, between the rays of a sensor and of its pinhole camera."""

LENS = "ThinLensCamera"
FLAT = "OrthographicCamera"
MAX_DEPTH_OVER_VIEW = 4.0
"""Depth of a scene, over the half height of an orthographic view, up to which the pinhole in its place moves away. At a
larger distance single precision would blur the places of pixels."""
MAX_PINHOLE_RADIUS = 1e-6
"""Largest radius of a lens that counts as a pinhole, world units. Mitsuba turns a radius of 0 into a tiny one."""

_chosen: ContextVar[Any] = ContextVar("sensor", default=None)


@contextmanager
def use_sensor(sensor: Any) -> Iterator[None]:
    """Render with a sensor in place of the scene's first one, inside a ``with`` block."""
    before = _chosen.set(sensor)
    try:
        yield
    finally:
        _chosen.reset(before)


def get_sensor(scene: Any) -> Any:
    """Return the sensor that a scene is rendered with: its first one, or that of `use_sensor`.

    Raises
    ------
    InputError
        If the scene has no sensor.
    """
    chosen = _chosen.get()
    return list_sensors(scene)[0] if chosen is None else chosen


def list_sensors(scene: Any) -> list[Any]:
    """Return the sensors of a scene; raise InputError if there is none."""
    sensors: list[Any] = scene.sensors()
    if not sensors:
        action = "add <sensor type='perspective'> to the scene"
        raise InputError("scene", expected="a sensor", got="none", action=action)
    return sensors


def get_image_size(scene: Any) -> tuple[int, int]:
    """Return ``(width, height)`` of the crop window of the sensor's film, which is by default the whole film."""
    width, height = get_sensor(scene).film().crop_size()
    return int(width), int(height)


PLUGINS = {"PerspectiveCamera": "perspective", LENS: "thinlens", FLAT: "orthographic"}
"""Names of sensors in scene files, by class name."""


def has_lens(scene: Any) -> bool:
    """Return whether a scene is seen through a lens that is wider than a pinhole."""
    sensor = get_sensor(scene)
    return sensor.class_name() == LENS and bool(
        np.array(mi.traverse(sensor)["aperture_radius"]).item() > MAX_PINHOLE_RADIUS
    )


def is_flat(scene: Any) -> bool:
    """Return whether a scene is seen by an orthographic sensor, whose rays are parallel."""
    return bool(get_sensor(scene).class_name() == FLAT)


def _get_perspective_sensor(scene: Any, *, lens: bool = False) -> Any:
    sensor = get_sensor(scene)
    kind = str(sensor.class_name())
    if kind != "PerspectiveCamera" and not (kind == LENS and (lens or not has_lens(scene))):
        action = "lobewise renders images that one viewpoint sees; use a perspective sensor"
        if kind == LENS:
            action = "only whole frames are rendered through a lens; use a perspective sensor"
        expected = "type 'perspective', 'orthographic' or, for whole frames, 'thinlens'"
        raise InputError("sensor", expected=expected, got=repr(PLUGINS.get(kind, kind)), action=action)
    return sensor


def get_camera(scene: Any, *, lens: bool = False) -> Camera:
    """Return the pinhole camera of a scene's sensor; with ``lens`` also the pinhole in the middle of a lens.

    The ``shift`` of the camera holds a shifted principal point and an off-centre crop window. In place of an
    orthographic sensor stands a pinhole so far away that its rays are nearly parallel.

    Raises
    ------
    InputError
        If the scene has no sensor, or the sensor's rays are not those of a pinhole camera with a perpendicular film:
        because of its type, or because ``to_world`` mirrors.
    """
    if is_flat(scene):
        return _FlatView(scene).get_camera()
    sensor = _get_perspective_sensor(scene, lens=lens)
    width, height = get_image_size(scene)
    parameters = mi.traverse(sensor)
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    # The angle is that of the whole film; a crop window shows a part of it.
    half_width = np.tan(0.5 * np.deg2rad(np.array(parameters["x_fov"]).item())) * width / sensor.film().size()[0]
    fov_y = 2.0 * np.arctan(half_width * height / width)
    camera = Camera(position=matrix[:3, 3], forward=matrix[:3, 2], up=matrix[:3, 1], fov_y=float(fov_y))

    def compute_directions(film: NDArray[np.float64]) -> NDArray[np.float64]:
        rays, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(film.astype(np.float32)), mi.Point2f(0.5))
        return np.array(rays.d, dtype=np.float64).T

    edges = compute_directions(np.array([[0.0, 1.0], [0.0, 1.0]]))
    # Project opposite corners onto the plane at distance 1. Their mean is the centre of the image.
    plane = edges / (edges @ camera.forward)[:, None] @ np.stack([camera.right, camera.up], axis=-1)
    shift = plane.mean(axis=0)
    if np.abs(shift).max() > RAY_TOLERANCE:
        camera = replace(camera, shift=(float(shift[0]), float(shift[1])))
    corners = np.array([[0, 0, width - 1, width - 1], [0, height - 1, 0, height - 1]])
    directions = compute_directions((corners + 0.5) / [[width], [height]])
    x, y = camera.get_plane(width, height)
    # Only four rays are compared: to make all of them would take longer than to move the camera.
    rays = camera.forward + x[corners[0], None] * camera.right + y[corners[1], None] * camera.up
    expected = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    error = float(np.abs(directions - expected).max())
    if not error < RAY_TOLERANCE:
        _refuse_rays(error)
    return camera


def _refuse_rays(error: float) -> NoReturn:
    got = f"rays that differ from it by {error:.2g}"
    action = "remove negative scales from the sensor"
    raise InputError("sensor", expected="a camera whose film is centred and not mirrored", got=got, action=action)


class _FlatView:
    """The rectangle that a scene's orthographic sensor sees, measured on its rays.

    ``middle`` is its centre on the sensor's near plane, ``half`` its half width and half height, and ``ahead`` the
    distance from it, along ``forward``, to the middle of the scene.
    """

    def __init__(self, scene: Any) -> None:
        sensor = get_sensor(scene)
        rays, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f([0, 1, 0], [0, 0, 1]), mi.Point2f(0.5))
        corners = np.array(rays.o, dtype=np.float64).T
        across, down = 0.5 * (corners[1:] - corners[0])
        self.size = get_image_size(scene)
        self.half = float(np.linalg.norm(across)), float(np.linalg.norm(down))
        self.matrix = np.array(mi.traverse(sensor)["to_world"].matrix, dtype=np.float64).reshape(4, 4)
        self.scale = np.linalg.norm(self.matrix[:3, :3], axis=0)
        # Mitsuba's x points to the left of the image.
        left, self.up, self.forward = (self.matrix[:3, :3] / self.scale).T
        self.right = -left
        error = float(np.abs(np.cross(self.forward, self.up) - self.right).max())
        if not error < RAY_TOLERANCE:
            _refuse_rays(error)
        self.middle = corners[0] + across + down
        box = scene.bbox()
        self._extent = np.array(box.extents(), dtype=np.float64).reshape(3)
        self.centre = np.array(box.center(), dtype=np.float64).reshape(3)
        self.ahead = float((self.centre - self.middle) @ self.forward)

    def get_camera(self) -> Camera:
        """Return the pinhole that sees the plane through the middle of the scene as the sensor does."""
        width, height = self.size
        depth = float(np.abs(self._extent @ np.abs(self.forward)))
        view = float(np.clip(depth, self.half[1], MAX_DEPTH_OVER_VIEW * self.half[1]))
        distance = PINHOLE_DISTANCE_OVER_VIEW * view
        position = self.middle + (self.ahead - distance) * self.forward
        camera = Camera(position, self.forward, self.up, 2.0 * float(np.arctan(self.half[1] / distance)))
        aspect = self.half[0] * height / (self.half[1] * width)
        square = abs(aspect - 1.0) < RAY_TOLERANCE
        return camera if square else camera.with_pixel_aspect(width, height, aspect)

    def move(self, scene: Any, camera: Camera) -> None:
        """Move the sensor so that it sees what a far camera sees at the middle of the scene."""
        distance = max(float((self.centre - camera.position) @ camera.forward), 1e-6 * self.half[1])
        half_height = distance * float(np.tan(0.5 * camera.fov_y))
        ratio = half_height / self.half[1]
        # The sensor stands beside the middle of the view if the film is cropped, and behind its near plane.
        aside = np.stack([self.right, self.up, self.forward]) @ (self.matrix[:3, 3] - self.middle)
        aside[:2] *= ratio
        turn = np.stack([camera.right, camera.up, camera.forward], axis=-1)
        matrix = np.eye(4)
        matrix[:3, :3] = turn * self.scale * [-ratio, ratio, 1.0]
        matrix[:3, 3] = camera.position + (distance - self.ahead) * camera.forward + turn @ aside
        parameters = mi.traverse(get_sensor(scene))
        parameters["to_world"] = mi.Transform4f(matrix.astype(np.float32))
        parameters.update()


def make_matrix(camera: Camera) -> NDArray[np.float64]:
    """Return the matrix (4, 4) ``to_world`` of a sensor that stands where a camera stands."""
    matrix = np.eye(4)
    # Mitsuba's x points to the left of the image.
    matrix[:3] = np.stack([-camera.right, camera.up, camera.forward, camera.position], axis=-1)
    return matrix


def set_camera(scene: Any, camera: Camera) -> None:
    """Move a scene's sensor to a camera. `get_camera` then returns this camera in single precision.

    The size of the image does not change.

    Raises
    ------
    InputError
        If the scene has neither a perspective sensor nor a lens, the camera's pixels are not square, or the camera's
        shift is not that of the sensor.
    """
    width, height = get_image_size(scene)
    if not np.allclose(camera.shift, get_camera(scene, lens=True).shift, atol=RAY_TOLERANCE):
        action = "give the sensor principal_point_offset_x and _y"
        raise InputError("camera shift", expected="that of the sensor", got=name_value(camera.shift), action=action)
    half_width, half_height = camera.get_half_extent(width, height)
    if not np.isclose(half_width * height, half_height * width, rtol=RAY_TOLERANCE):
        expected = f"square pixels on an image of {width}x{height}"
        got = f"pixels {half_width * height / (half_height * width):.4g} times as wide as high"
        raise InputError("camera fov_x", expected=expected, got=got, action="leave fov_x out")
    if is_flat(scene):
        _FlatView(scene).move(scene, camera)
        return
    sensor = _get_perspective_sensor(scene, lens=True)
    parameters = mi.traverse(sensor)
    parameters["to_world"] = mi.Transform4f(make_matrix(camera).astype(np.float32))
    whole = half_width * sensor.film().size()[0] / width
    parameters["x_fov"] = float(np.rad2deg(2.0 * np.arctan(whole)))
    parameters.update()
