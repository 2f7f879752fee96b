"""Cameras and sample counts from the headers of other renderers' files.

Matrices in OpenEXR headers multiply row vectors: a point is ``[x y z 1] M``. The matrices of
a file show which way its camera looks along the third axis, and what its screen spans.
"""

from __future__ import annotations

import struct
from collections.abc import Iterable
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.interchange.cameras.fitting import mirror
from lobewise.interchange.cameras.places import Place
from lobewise.interchange.preset import Preset
from lobewise.io.exr.container import Attribute, Part, Window
from lobewise.io.exr.header import read_pixel_aspect
from lobewise.records.camera import Camera

Matrix = NDArray[np.float64]

MAX_DIGITS = 9
"""Largest number of digits of a sample count. No renderer takes more samples."""


@dataclass(frozen=True)
class Located:
    """A camera, its source, and whether its world is left-handed. If so, the camera is mirrored: x is negated."""

    camera: Camera
    source: str
    mirrored: bool = False


def read_camera_attributes(parts: Iterable[Part], part: Part) -> Located | None:
    """Return the camera in a file's header, for the data window of ``part``. Return None if there is none."""
    attributes = {item.name.rpartition("/")[2]: item for one in parts for item in one.attributes}
    size = part.display_window
    aspect = read_pixel_aspect(part) or 1.0
    located = None
    if "worldToCamera" in attributes:
        located = _read_matrices(attributes, size, aspect)
    elif "cameraTransform" in attributes and "cameraFov" in attributes:
        located = _read_vray(attributes, size, aspect)
    if located is None:
        return None
    window = part.data_window
    return replace(located, camera=Place.of(part).crop(located.camera, window.height, window.width))


def _read(item: Attribute | None, kinds: str) -> tuple[float, ...]:
    """Return the numbers of an attribute in the struct format ``kinds``. Return none if its size differs."""
    if item is not None and len(item.value) in {struct.calcsize(f"<{kinds}")}:
        return struct.unpack(f"<{kinds}", item.value)
    return ()


def _read_matrix(item: Attribute | None) -> Matrix | None:
    numbers = _read(item, "16f") or _read(item, "16d")
    matrix = np.array(numbers, dtype=np.float64).reshape(-1, 4)
    if matrix.shape != (4, 4) or not np.isfinite(matrix).all() or abs(np.linalg.det(matrix)) < 1e-12:
        return None
    return matrix


def _read_matrices(attributes: dict[str, Attribute], size: Window, aspect: float) -> Located | None:
    """Return the camera of ``worldToCamera``, and of ``worldToNDC`` or an angle beside it."""
    to_camera, to_screen = _read_matrix(attributes.get("worldToCamera")), _read_matrix(attributes.get("worldToNDC"))
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
    angle = _read(attributes.get("CameraFov"), "f") or _read(attributes.get("cameraFov"), "f")
    if not angle:
        return None
    # Without a screen matrix the world is assumed to be right-handed, where cameras look along -z.
    return Located(
        _aim(eye, -axis, up, float(np.tan(np.deg2rad(angle[0]) / 2.0)), size, aspect),
        "worldToCamera and the angle of view",
    )


def _span(
    eye: Matrix, axis: Matrix, right: Matrix, up: Matrix, to_screen: Matrix, deep: Matrix, size: Window, aspect: float
) -> Camera:
    """Return the camera of a screen matrix. The screen is [-1, 1] or [0, 1], along both axes or the shorter one."""
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


def _read_vray(attributes: dict[str, Attribute], size: Window, aspect: float) -> Located | None:
    """Return the camera of V-Ray's attributes: rows right, up, back and position; the horizontal angle in degrees."""
    matrix = _read_matrix(attributes["cameraTransform"])
    angle = _read(attributes["cameraFov"], "f")
    if matrix is None or not angle or not 0.0 < angle[0] < 180.0:
        return None
    rows = matrix[:3, :3] / np.linalg.norm(matrix[:3, :3], axis=1, keepdims=True)
    camera = _aim(matrix[3, :3], -rows[2], rows[1], float(np.tan(np.deg2rad(angle[0]) / 2.0)), size, aspect)
    return Located(camera, "cameraTransform and cameraFov")


def read_sample_count(parts: Iterable[Part], preset: Preset) -> int | None:
    """Return the samples per pixel from the attributes that a preset names, or None."""
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
        return int(text) if text.isdecimal() and len(text) <= MAX_DIGITS and int(text) > 0 else None
    numbers: Any = _read(item, {"int": "i", "float": "f", "double": "d"}.get(item.type, "i"))
    return int(numbers[0]) if numbers and 1 <= numbers[0] < 10**MAX_DIGITS else None
