"""The camera of a Mitsuba scene as a `lobewise.frame.Camera`, and back."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.errors import InputError, name_value
from lobewise.render.bridge import mi

RAY_TOLERANCE = 1e-4
"""Largest difference, per component of a unit direction, between the rays of a sensor and of its pinhole camera."""

LENS = "ThinLensCamera"
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
    if chosen is not None:
        return chosen
    if not scene.sensors():
        raise InputError(
            "scene", expected="a sensor", got="none", action="add <sensor type='perspective'> to the scene"
        )
    return scene.sensors()[0]


def get_image_size(scene: Any) -> tuple[int, int]:
    """Return ``(width, height)`` of the crop window of the sensor's film, which is by default the whole film."""
    width, height = get_sensor(scene).film().crop_size()
    return int(width), int(height)


PLUGINS = {"PerspectiveCamera": "perspective", LENS: "thinlens", "OrthographicCamera": "orthographic"}
"""Names of sensors in scene files, by class name."""


def has_lens(scene: Any) -> bool:
    """Return whether a scene is seen through a lens that is wider than a pinhole."""
    sensor = get_sensor(scene)
    return sensor.class_name() == LENS and bool(
        np.array(mi.traverse(sensor)["aperture_radius"]).item() > MAX_PINHOLE_RADIUS
    )


def _get_perspective_sensor(scene: Any, *, lens: bool = False) -> Any:
    sensor = get_sensor(scene)
    kind = str(sensor.class_name())
    if kind != "PerspectiveCamera" and not (kind == LENS and (lens or not has_lens(scene))):
        action = "reflection lobes need one viewpoint for all pixels; use a perspective sensor"
        if kind == LENS:
            action = "only whole frames are rendered through a lens; use a perspective sensor"
        expected = "type 'perspective' or, for whole frames, 'thinlens'"
        raise InputError("sensor", expected=expected, got=repr(PLUGINS.get(kind, kind)), action=action)
    return sensor


def get_camera(scene: Any, *, lens: bool = False) -> Camera:
    """Return the pinhole camera of a scene's sensor; with ``lens`` also the pinhole in the middle of a lens.

    The ``shift`` of the camera holds a shifted principal point and an off-centre crop window.

    Raises
    ------
    InputError
        If the scene has no sensor, or the sensor's rays are not those of a pinhole camera with a perpendicular film:
        because of its type, or because ``to_world`` mirrors.
    """
    sensor = _get_perspective_sensor(scene, lens=lens)
    width, height = get_image_size(scene)
    parameters = mi.traverse(sensor)
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    # The angle is that of the whole film; a crop window shows a part of it.
    half_width = np.tan(0.5 * np.deg2rad(np.array(parameters["x_fov"]).item())) * width / sensor.film().size()[0]
    fov_y = 2.0 * np.arctan(half_width * height / width)
    camera = Camera(position=matrix[:3, 3], forward=matrix[:3, 2], up=matrix[:3, 1], fov_y=float(fov_y))

    def find_directions(film: NDArray[np.float64]) -> NDArray[np.float64]:
        rays, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(film.astype(np.float32)), mi.Point2f(0.5))
        return np.array(rays.d, dtype=np.float64).T

    edges = find_directions(np.array([[0.0, 1.0], [0.0, 1.0]]))
    # Project opposite corners onto the plane at distance 1. Their mean is the centre of the image.
    plane = edges / (edges @ camera.forward)[:, None] @ np.stack([camera.right, camera.up], axis=-1)
    shift = plane.mean(axis=0)
    if np.abs(shift).max() > RAY_TOLERANCE:
        camera = replace(camera, shift=(float(shift[0]), float(shift[1])))
    corners = np.array([[0, 0, width - 1, width - 1], [0, height - 1, 0, height - 1]])
    directions = find_directions((corners + 0.5) / [[width], [height]])
    expected = camera.make_ray_directions(width, height)[corners[1], corners[0]]
    error = float(np.abs(directions - expected).max())
    if not error < RAY_TOLERANCE:
        got = f"rays that differ from it by {error:.2g}"
        action = "remove negative scales from the sensor"
        raise InputError("sensor", expected="a pinhole whose film is centred and not mirrored", got=got, action=action)
    return camera


def set_camera(scene: Any, camera: Camera) -> None:
    """Move a scene's sensor to a camera. `get_camera` then returns this camera in single precision.

    The size of the image does not change.

    Raises
    ------
    InputError
        If the scene has no perspective sensor, the camera's pixels are not square, or the camera's shift is not that of
        the sensor.
    """
    sensor = _get_perspective_sensor(scene)
    width, height = get_image_size(scene)
    if not np.allclose(camera.shift, get_camera(scene).shift, atol=RAY_TOLERANCE):
        action = "give the sensor principal_point_offset_x and _y"
        raise InputError("camera shift", expected="that of the sensor", got=name_value(camera.shift), action=action)
    half_width, half_height = camera.get_half_extent(width, height)
    if not np.isclose(half_width * height, half_height * width, rtol=RAY_TOLERANCE):
        expected = f"square pixels on an image of {width}x{height}"
        got = f"pixels {half_width * height / (half_height * width):.4g} times as wide as high"
        raise InputError("camera fov_x", expected=expected, got=got, action="leave fov_x out")
    matrix = np.eye(4)
    # Mitsuba's x points to the left of the image.
    matrix[:3] = np.stack([-camera.right, camera.up, camera.forward, camera.position], axis=-1)
    parameters = mi.traverse(sensor)
    parameters["to_world"] = mi.Transform4f(matrix.astype(np.float32))
    whole = half_width * sensor.film().size()[0] / width
    parameters["x_fov"] = float(np.rad2deg(2.0 * np.arctan(whole)))
    parameters.update()
