"""The camera of a Mitsuba scene as a `lobewise.frame.Camera`, and the motion between two cameras."""

from __future__ import annotations

from typing import Any

import numpy as np

from lobewise.errors import InputError, describe_problem
from lobewise.frame import Camera, FloatArray
from lobewise.render.bridge import mi

RAY_TOLERANCE = 1e-4
"""Largest difference, per component of a unit direction, between the sensor's rays and the pinhole's."""


def get_image_size(scene: Any) -> tuple[int, int]:
    """Return ``(width, height)`` of the film of the scene's first sensor."""
    width, height = scene.sensors()[0].film().size()
    return int(width), int(height)


def get_camera(scene: Any) -> Camera:
    """Return the pinhole camera of a scene's first sensor.

    Raises
    ------
    InputError
        If the scene has no sensor, or its rays are not those of a pinhole camera with square-on film: another type
        of sensor, a mirrored ``to_world``, a crop window, a shifted principal point.
    """
    if not scene.sensors():
        raise InputError(
            describe_problem(
                "scene", expected="a sensor", got="none", action="add <sensor type='perspective'> to the scene"
            )
        )
    sensor = scene.sensors()[0]
    if sensor.class_name() != "PerspectiveCamera":
        raise InputError(
            describe_problem(
                "sensor",
                expected="type 'perspective'",
                got=str(sensor.class_name()),
                action="reflection lobes need one viewpoint for all pixels; use a perspective sensor",
            )
        )
    width, height = get_image_size(scene)
    parameters = mi.traverse(sensor)
    fov_x = float(np.deg2rad(np.array(parameters["x_fov"]).item()))
    matrix = np.array(parameters["to_world"].matrix, dtype=np.float64).reshape(4, 4)
    fov_y = 2.0 * np.arctan(np.tan(0.5 * fov_x) * height / width)
    camera = Camera(position=matrix[:3, 3], forward=matrix[:3, 2], up=matrix[:3, 1], fov_y=float(fov_y))

    corners = np.array([[0, 0, width - 1, width - 1], [0, height - 1, 0, height - 1]])
    film = (corners + 0.5) / [[width], [height]]
    rays, _ = sensor.sample_ray(0.0, 0.5, mi.Point2f(film.astype(np.float32)), mi.Point2f(0.5))
    expected = camera.make_ray_directions(width, height)[corners[1], corners[0]]
    error = float(np.abs(np.array(rays.d).T - expected).max())
    if not error < RAY_TOLERANCE:
        raise InputError(
            describe_problem(
                "sensor",
                expected="a pinhole whose film is centred and not mirrored",
                got=f"rays that differ by {error:.2g} from it",
                action="remove crop windows, principal point offsets and negative scales from the sensor",
            )
        )
    return camera


def project_points(camera: Camera, points: FloatArray, width: int, height: int) -> FloatArray:
    """Return the pixel coordinates of world points, shape (..., 2): column and row, pixel centres at .5.

    A point behind the camera has no image; its coordinates are not finite.
    """
    half_width, half_height = camera.get_half_extent(width, height)
    offset = points - camera.position
    ahead = offset @ camera.forward
    scale = np.divide(1.0, ahead, out=np.full_like(ahead, np.nan), where=ahead > 0)
    x = (offset @ camera.right) * scale / half_width
    y = (offset @ camera.up) * scale / half_height
    return np.stack([(x + 1.0) * 0.5 * width, (1.0 - y) * 0.5 * height], axis=-1).astype(np.float32)


def compute_motion(camera: Camera, previous: Camera, position: FloatArray, depth: FloatArray) -> FloatArray:
    """Return where each pixel's surface point was in the previous frame, relative to the pixel.

    Only the camera moves. Where there is no surface (depth 0) the background counts as infinitely far: it turns with
    the camera and does not shift. A point that lay behind the previous camera has no place there; it moves by twice
    the image, so that it is outside.

    Parameters
    ----------
    position : (height, width, 3)
        World positions; ignored where the depth is 0.
    depth : (height, width)
        Distances along the rays, 0 where there is no surface.

    Returns
    -------
    (height, width, 2)
        Pixels, previous minus current, x right and y down.
    """
    height, width = depth.shape
    rays = camera.make_ray_directions(width, height).astype(np.float64)
    points = np.where(depth[..., None] > 0, position, rays + previous.position)
    before = project_points(previous, points, width, height)
    column, row = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    motion = before - np.stack([column, row], axis=-1)
    outside = np.array([2.0 * width, 2.0 * height])
    return np.where(np.isfinite(motion), motion, outside).astype(np.float32)
