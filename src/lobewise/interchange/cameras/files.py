"""Cameras from files of their own: JSON, Mitsuba scenes, glTF, USD."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lobewise.errors import FileError, InputError
from lobewise.interchange.cameras.gltf import read_gltf_camera
from lobewise.interchange.cameras.mitsuba import read_mitsuba_camera
from lobewise.interchange.cameras.usd import read_usd_camera
from lobewise.io.documents import (
    describe_kind,
    parse_json,
    read_document,
    require_number,
    require_numbers,
    show_value,
)
from lobewise.io.files import PathLike
from lobewise.records.camera import Camera

MAX_JSON_BYTES = 1 << 20
_KEYS = ("position", "forward", "target", "up", "fov_y", "fov_x", "shift")


def read_camera_file(path: PathLike) -> Camera:
    """Return the camera of a file.

    The end of the name tells the format. A ``.json`` file holds ``position``, ``forward`` or ``target``, ``up`` (by
    default y) and ``fov_y``; it may hold ``fov_x`` and ``shift``. Angles are in degrees. A Mitsuba scene (``.xml``)
    gives its first sensor, a glTF file (``.gltf``, ``.glb``) the first node with a camera, and a USD file (``.usd``,
    ``.usda``, ``.usdc``, ``.usdz``; needs ``usd-core``) its first camera at the first time of the stage.

    Raises
    ------
    FileError
        If the file cannot be read, or its name has another end.
    InputError
        If the file has no camera, or the camera is no pinhole.
    MissingDependencyError
        If it is a USD file and ``usd-core`` is not installed.
    """
    file = Path(path)
    read = _READERS.get(file.suffix.lower())
    what = f"camera {str(path)!r}"
    if read is None:
        raise FileError(
            what,
            expected=f"a name that ends in {', '.join(_READERS)}",
            got=repr(file.suffix),
            action="write position, forward, up and fov_y into a .json",
        )
    try:
        return read(file)
    except InputError as problem:
        if repr(str(path)) in str(problem):
            raise
        raise InputError(f"{what}: {problem}") from None


def _read_json(path: Path) -> Camera:
    what = f"camera {str(path)!r}"
    document = parse_json(read_document(path, MAX_JSON_BYTES, what="camera", holds="a camera"), what=what)
    if not isinstance(document, dict):
        got = describe_kind(document)
        raise InputError(what, expected="an object", got=got, action="write position, forward, up and fov_y")
    for key in document:
        if key not in _KEYS:
            raise InputError(what, expected=f"keys among {', '.join(_KEYS)}", got=repr(key[:40]), action="leave it out")
    if "position" not in document or ("forward" in document) == ("target" in document):
        expected, got = "position, and either forward or target", ", ".join(document) or "nothing"
        raise InputError(what, expected=expected, got=got, action="say where the camera is and where it looks")
    vectors = {
        name: require_numbers(f"{what}, {name}", document[name], 3)
        for name in ("position", "forward", "target", "up")
        if name in document
    }
    angles = {name: _read_angle(f"{what}, {name}", document[name]) for name in ("fov_y", "fov_x") if name in document}
    if "fov_y" not in angles:
        got = "fov_x alone" if angles else "neither fov_y nor fov_x"
        action = "add fov_y: the vertical angle of view, or both"
        raise InputError(what, expected="fov_y, in degrees", got=got, action=action)
    shift = require_numbers(f"{what}, shift", document.get("shift", [0.0, 0.0]), 2)
    position, up = vectors["position"], vectors.get("up", np.array([0.0, 1.0, 0.0]))
    with np.errstate(over="ignore"):  # The camera refuses numbers that are not finite.
        forward = vectors["forward"] if "forward" in vectors else vectors["target"] - position
    if "target" in vectors and not forward.any():
        expected, got = "another point than position", f"{show_value(document['target'])} for both"
        raise InputError(f"{what}, target", expected=expected, got=got, action="write the point that the camera sees")
    return Camera(position, forward, up, angles["fov_y"], angles.get("fov_x"), (float(shift[0]), float(shift[1])))


def _read_angle(what: str, value: Any) -> float:
    """Return an angle of view in radians, from degrees."""
    known = "an angle between 0 and 180 degrees"
    angle = require_number(what, value, expected=known, action="40 is usual")
    if not 0.0 < angle < 180.0:
        raise InputError(what, expected=known, got=f"{angle:g}", action="40 is usual")
    return math.radians(angle)


_READERS: dict[str, Callable[[Path], Camera]] = {
    ".json": _read_json,
    ".xml": read_mitsuba_camera,
    **dict.fromkeys((".gltf", ".glb"), read_gltf_camera),
    **dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), read_usd_camera),
}
