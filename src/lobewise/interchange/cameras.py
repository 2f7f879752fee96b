"""Cameras of other renderers' files: read from their header, or found from the positions that pixels show.

Matrices in OpenEXR headers multiply row vectors: a point is ``[x y z 1] M``. Which way a renderer's camera looks along
its third axis, and what its screen spans, is told by its own matrices, not assumed.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.frame import FloatArray
from lobewise.interchange.preset import Preset
from lobewise.io.exr.container import Attribute, Part, Window
from lobewise.motion import project_points

Matrix = NDArray[np.float64]

MOST_SAMPLES = 20000
"""Pixels by which a camera is found."""
WORST_FIT = 1.5
"""Pixels between where a point is seen and where a camera shows it, in the median, from which the camera is not it.
Positions of one sample lie anywhere within the pixel filter."""
ROUNDS = 12


@dataclass(frozen=True)
class Located:
    """A camera, what told it, and whether its world is left-handed: then it stands in the mirror image, x turned."""

    camera: Camera
    told: str
    mirrored: bool = False


def read_camera_attributes(parts: Iterable[Part], part: Part) -> Located | None:
    """Return the camera that a file's header tells, for the data window of ``part``; else None."""
    found = {item.name.rpartition("/")[2]: item for one in parts for item in one.attributes}
    size = part.display_window
    aspect = _read(part.get("pixelAspectRatio"), "f", (1.0,))[0]
    located = None
    if "worldToCamera" in found:
        located = _read_matrices(found, size, aspect)
    elif "cameraTransform" in found and "cameraFov" in found:
        located = _read_vray(found, size, aspect)
    return None if located is None else replace(located, camera=_crop(located.camera, size, part.data_window))


def _read(item: Attribute | None, kinds: str, default: tuple[float, ...] = ()) -> tuple[float, ...]:
    """Return the numbers of an attribute of floats or doubles; ``default`` where it is none of so many."""
    if item is not None and len(item.value) in {struct.calcsize(f"<{kinds}")}:
        return struct.unpack(f"<{kinds}", item.value)
    return default


def _read_matrix(item: Attribute | None) -> Matrix | None:
    numbers = _read(item, "16f") or _read(item, "16d")
    matrix = np.array(numbers, dtype=np.float64).reshape(-1, 4)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-12:
        return None
    return matrix


def _read_matrices(found: dict[str, Attribute], size: Window, aspect: float) -> Located | None:
    """Return the camera of ``worldToCamera``, and of ``worldToNDC`` or an angle beside it."""
    to_camera, to_screen = _read_matrix(found.get("worldToCamera")), _read_matrix(found.get("worldToNDC"))
    if to_camera is None:
        return None
    to_world: Matrix = np.asarray(np.linalg.inv(to_camera), dtype=np.float64)
    rows: Matrix = to_world[:3, :3] / np.linalg.norm(to_world[:3, :3], axis=1, keepdims=True)
    right, up, axis = rows
    eye: Matrix = to_world[3, :3]
    if to_screen is not None:
        deep = np.append(axis, 0.0) @ to_screen
        if deep[3] < 0.0:
            axis, deep = -axis, -deep
        if deep[3] > 1e-9:
            mirrored = bool(np.cross(axis, up) @ right < 0.0)
            camera = _span(eye, axis, right, up, to_screen, deep, size, aspect)
            return Located(mirror(camera) if mirrored else camera, "worldToCamera and worldToNDC", mirrored)
    angle = _read(found.get("CameraFov"), "f") or _read(found.get("cameraFov"), "f")
    if not angle:
        return None
    # Without a screen nothing tells a left-handed world: in a right-handed one cameras look along -z.
    return Located(
        _aim(eye, -axis, up, float(np.tan(np.deg2rad(angle[0]) / 2.0)), size, aspect),
        "worldToCamera and the angle of view",
    )


def _span(
    eye: Matrix, axis: Matrix, right: Matrix, up: Matrix, to_screen: Matrix, deep: Matrix, size: Window, aspect: float
) -> Camera:
    """Return a camera whose screen is that of a matrix: from -1 to 1 or from 0 to 1, along both axes or the shorter."""
    across, upwards = (np.append(side, 0.0) @ to_screen / deep[3] for side in (right, up))
    middle = deep[:2] / deep[3]
    unit = 1.0 if np.abs(middle).max() < 0.25 else 0.5
    half_width, half_height = unit / abs(across[0]), unit / abs(upwards[1])
    shape = size.width * aspect / size.height
    if abs(half_width / half_height / shape - 1.0) > 0.02 and abs(half_width / half_height - 1.0) < 0.02:
        half_width, half_height = half_width * max(shape, 1.0), half_height * max(1.0 / shape, 1.0)
    return Camera(eye, axis, up, float(2.0 * np.arctan(half_height)), float(2.0 * np.arctan(half_width)))


def _aim(eye: Matrix, axis: Matrix, up: Matrix, half_width: float, size: Window, aspect: float) -> Camera:
    half_height = half_width * size.height / (size.width * aspect)
    return Camera(eye, axis, up, float(2.0 * np.arctan(half_height)), float(2.0 * np.arctan(half_width)))


def _read_vray(found: dict[str, Attribute], size: Window, aspect: float) -> Located | None:
    """Return the camera of V-Ray's attributes: rows right, up, back and position; the horizontal angle in degrees."""
    matrix = _read_matrix(found["cameraTransform"])
    angle = _read(found["cameraFov"], "f")
    if matrix is None or not angle or not 0.0 < angle[0] < 180.0:
        return None
    rows = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=1, keepdims=True)
    camera = _aim(matrix[3, :3], -rows[2], rows[1], float(np.tan(np.deg2rad(angle[0]) / 2.0)), size, aspect)
    return Located(camera, "cameraTransform and cameraFov")


def mirror(camera: Camera) -> Camera:
    """Return the camera in the mirror image of its world, x turned: there it sees what it saw, left and right kept."""
    turn = np.array([-1.0, 1.0, 1.0])
    return replace(camera, position=turn * camera.position, forward=turn * camera.forward, up=turn * camera.up)


def _crop(camera: Camera, whole: Window, part: Window) -> Camera:
    """Return the camera of a part of the image that a camera has."""
    if whole == part:
        return camera
    half_width, half_height = camera.get_half_extent(whole.width, whole.height)
    across, down = half_width / whole.width, half_height / whole.height
    x = (part.x_min + part.x_max - whole.x_min - whole.x_max) * across
    y = -(part.y_min + part.y_max - whole.y_min - whole.y_max) * down
    return replace(
        camera,
        fov_y=float(2.0 * np.arctan(part.height * down)),
        fov_x=float(2.0 * np.arctan(part.width * across)),
        shift=(camera.shift[0] + x, camera.shift[1] + y),
    )


def read_sample_count(parts: Iterable[Part], preset: Preset) -> int | None:
    """Return the samples per pixel that the header tells in the way of a preset, or None."""
    for part in parts:
        for item in part.attributes:
            squared = any(fnmatchcase(item.name, name) for name in preset.samples_squared)
            if squared or any(fnmatchcase(item.name, name) for name in preset.samples):
                count = _read_count(item)
                if count is not None:
                    return count * count if squared else count
    return None


def _read_count(item: Attribute) -> int | None:
    if item.type == "string":
        text = item.value.decode("ascii", "replace").strip()
        return int(text) if text.isdecimal() and int(text) > 0 else None
    numbers: Any = _read(item, {"int": "i", "float": "f", "double": "d"}.get(item.type, "i"))
    return int(numbers[0]) if numbers and numbers[0] >= 1 else None


@dataclass(frozen=True)
class CameraFit:
    """A camera that was found, how far points are from where it shows them (the median, in pixels), and `Located`."""

    camera: Camera
    error: float
    mirrored: bool = False


def measure_fit(camera: Camera, position: FloatArray, mask: NDArray[np.bool_]) -> float:
    """Return the median distance, pixels, of where a camera shows the points of some pixels to where they are seen."""
    height, width = mask.shape
    rows, columns = _choose_pixels(mask)
    seen = project_points(camera, position[rows, columns].astype(np.float64), width, height)
    apart = np.hypot(seen[:, 0] - columns - 0.5, seen[:, 1] - rows - 0.5)
    return float(np.median(np.where(np.isfinite(apart), apart, np.inf)))


def fit_camera(position: FloatArray, mask: NDArray[np.bool_]) -> CameraFit | None:
    """Return the pinhole camera that sees given points at given pixels; None where none does.

    The camera is first solved for as a projective one, from equations that are linear in its matrix (the direct linear
    transform, Hartley and Zisserman 2003, section 7.1), then as one with square pixels by Gauss-Newton steps, points
    that are further off than most counting less (Huber's weights): a position of one sample is not that of the pixel's
    centre, and at silhouettes it may be that of another surface.

    Parameters
    ----------
    position : array, shape (height, width, 3)
        World positions.
    mask : array, shape (height, width)
        Where there are any.
    """
    rows, columns = _choose_pixels(mask)
    if len(rows) < 100:
        return None
    points = position[rows, columns].astype(np.float64)
    center, spread = points.mean(axis=0), points.std()
    if not np.isfinite(points).all() or not spread > 0.0:
        return None
    height, width = mask.shape
    # Columns to the right and rows upwards, in units of half the height.
    x, y = (columns + 0.5 - 0.5 * width) / (0.5 * height), (0.5 * height - rows - 0.5) / (0.5 * height)
    for mirrored in (False, True):
        turn = np.array([-1.0, 1.0, 1.0]) if mirrored else np.ones(3)
        scaled = turn * (points - center) / spread
        start = _solve_projective(scaled, x, y)
        if start is None:
            return None
        # Right, up and forward of a camera in a right-handed world are a left-handed triple.
        if np.linalg.det(start[0]) > 0.0:
            continue
        state = _refine(scaled, x, y, *start)
        if state is None:
            return None
        rotation, eye, focal = state
        camera = Camera(turn * center + spread * eye, rotation[2], rotation[1], float(2.0 * np.arctan(1.0 / focal)))
        error = measure_fit(camera, (turn * position).astype(np.float32), mask)
        return CameraFit(camera, error, mirrored) if error < WORST_FIT else None
    return None


def _choose_pixels(mask: NDArray[np.bool_]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    rows, columns = np.nonzero(mask)
    step = max(1, len(rows) // MOST_SAMPLES)
    return rows[::step], columns[::step]


def _solve_projective(points: Matrix, x: Matrix, y: Matrix) -> tuple[Matrix, Matrix, float] | None:
    """Return rotation (rows right, up, forward), eye and focal length of the projective camera that fits best."""
    one = np.ones((len(points), 1))
    whole = np.hstack([points, one])
    zero = np.zeros_like(whole)
    for _ in range(2):
        across, upwards = np.hstack([whole, zero, -x[:, None] * whole]), np.hstack([zero, whole, -y[:, None] * whole])
        system = np.vstack([across, upwards])
        _, values, axes = np.linalg.svd(system.T @ system)
        if values[-2] < 1e-9 * values[0]:
            return None  # all points on one plane or line: many cameras see them so
        matrix = axes[-1].reshape(3, 4)
        depth = whole @ matrix[2]
        matrix = matrix if np.median(depth) > 0.0 else -matrix
        depth = whole @ matrix[2]
        error = np.hypot(x - whole @ matrix[0] / depth, y - whole @ matrix[1] / depth)
        kept = error <= 3.0 * np.median(error) + 1e-12
        whole, zero, x, y = whole[kept], zero[kept], x[kept], y[kept]
    scale = np.linalg.norm(matrix[2, :3])
    forward = matrix[2, :3] / scale
    right = matrix[0, :3] / scale
    right = right - (right @ forward) * forward
    up = matrix[1, :3] / scale
    up = up - (up @ forward) * forward
    focal = math.sqrt(max(float(np.linalg.norm(right)) * float(np.linalg.norm(up)), 1e-12))
    right = right / np.linalg.norm(right)
    up = up - (up @ right) * right
    up = up / np.linalg.norm(up)
    eye = -np.linalg.solve(matrix[:, :3], matrix[:, 3])
    return np.stack([right, up, forward]), eye, focal


def _refine(
    points: Matrix, x: Matrix, y: Matrix, rotation: Matrix, eye: Matrix, focal: float
) -> tuple[Matrix, Matrix, float] | None:
    """Return the camera with square pixels and a centred image that fits best, found from a near one."""
    for _ in range(ROUNDS):
        local = (points - eye) @ rotation.T
        ahead = local[:, 2] > 1e-6
        if ahead.mean() < 0.9:
            return None
        a, b, depth = local[ahead].T
        u, v = a / depth, b / depth
        left = np.concatenate([x[ahead] - focal * u, y[ahead] - focal * v])
        far = np.abs(left)
        scale = 1.5 * np.median(far) + 1e-12
        weight = np.sqrt(np.minimum(1.0, scale / np.maximum(far, 1e-300)))
        zero, inverse = np.zeros_like(u), focal / depth
        # Turning by (p, q, r) about right, up and forward, then moving along them, then the focal length.
        across = np.stack([-focal * u * v, focal * (1 + u * u), -focal * v, -inverse, zero, inverse * u, u], axis=1)
        upwards = np.stack([-focal * (1 + v * v), focal * u * v, focal * u, zero, -inverse, inverse * v, v], axis=1)
        slopes = np.concatenate([across, upwards]) * weight[:, None]
        step, *_ = np.linalg.lstsq(slopes, left * weight, rcond=None)
        if not np.isfinite(step).all():
            return None
        rotation = _turn(step[:3]) @ rotation
        eye = eye + rotation.T @ step[3:6]
        focal = float(focal + step[6])
        if focal <= 0.0:
            return None
        if np.abs(step).max() < 1e-9:
            break
    return rotation, eye, focal


def _turn(angles: Matrix) -> Matrix:
    """Return the rotation by the length of a vector about it (Rodrigues)."""
    angle = float(np.linalg.norm(angles))
    if angle < 1e-15:
        return np.eye(3)
    x, y, z = angles / angle
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Matrix = np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
    return turned
