"""Cameras from files of their own: JSON, Mitsuba scenes, glTF, USD."""

from __future__ import annotations

import json
import math
import struct
from collections.abc import Mapping
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from numpy.typing import NDArray

from lobewise.camera import Camera
from lobewise.errors import FileError, InputError
from lobewise.interchange.cameras.usd import read_usd_camera
from lobewise.io.files import PathLike, read_bytes

LARGEST_FILE = 256 << 20
USD = (".usd", ".usda", ".usdc", ".usdz")
GLB_MAGIC, GLB_JSON = 0x46546C67, 0x4E4F534A
Matrix = NDArray[np.float64]


def read_camera_file(path: PathLike) -> Camera:
    """Return the camera of a file.

    By the end of its name: ``.json`` holds ``position``, ``forward`` or ``target``, ``up`` (by default y), and one of
    ``fov_y``, ``fov_x`` or both, in degrees, perhaps ``shift``; of a Mitsuba scene (``.xml``) the first sensor is
    taken, of glTF (``.gltf``, ``.glb``) the first node with a camera, of USD (``.usd``, ``.usda``, ``.usdc``,
    ``.usdz``; with ``usd-core``) the first camera, at the first of its times.

    Raises
    ------
    FileError
        If the file cannot be read, or is none of those.
    InputError
        If there is no camera in it, or one that is no pinhole.
    MissingDependencyError
        If it is a USD file and ``usd-core`` is not installed.
    """
    file = Path(path)
    if file.suffix.lower() in USD:
        return read_usd_camera(file)
    readers = {".json": _read_json, ".xml": _read_mitsuba, ".gltf": _read_gltf, ".glb": _read_gltf}
    if file.suffix.lower() not in readers:
        raise FileError(
            f"camera {str(path)!r}",
            expected=f"a name that ends in {', '.join((*readers, *USD))}",
            got=repr(file.suffix),
            action="write position, forward, up and fov_y into a .json",
        )
    data = read_bytes(file, LARGEST_FILE, holds="a camera")
    try:
        return readers[file.suffix.lower()](data, f"camera {str(path)!r}")
    except (ValueError, KeyError, IndexError, TypeError, ElementTree.ParseError, struct.error) as problem:
        if isinstance(problem, InputError):
            raise
        raise FileError(
            f"camera {str(path)!r}",
            expected="a camera",
            got=" ".join(f"{type(problem).__name__}: {problem}".split()),
            action="see docs/renderers.md for what it may hold",
        ) from None


def _read_json(data: bytes, what: str) -> Camera:
    given = json.loads(data)
    known = ("position", "forward", "target", "up", "fov_y", "fov_x", "shift")
    for key in given:
        if key not in known:
            raise InputError(what, expected=f"keys among {', '.join(known)}", got=repr(key), action="leave it out")
    position = np.asarray(given["position"], np.float64)
    forward = given["forward"] if "forward" in given else np.asarray(given["target"], np.float64) - position
    angles = {name: math.radians(float(given[name])) for name in ("fov_y", "fov_x") if name in given}
    if not angles:
        raise InputError(what, expected="fov_y or fov_x, in degrees", got="neither", action="add one")
    camera = Camera(position, forward, given.get("up", (0.0, 1.0, 0.0)), angles.get("fov_y", 1.0), angles.get("fov_x"))
    shift = tuple(given.get("shift", (0.0, 0.0)))
    return Camera(position, camera.forward, camera.up, camera.fov_y, camera.fov_x, shift)


def _read_mitsuba(data: bytes, what: str) -> Camera:
    scene = ElementTree.fromstring(data)
    sensors = list(scene.iter("sensor"))
    if not sensors:
        raise InputError(what, expected="a sensor", got="none", action="give the file of the scene itself")
    sensor = sensors[0]
    if sensor.get("type") not in ("perspective", "thinlens"):
        raise InputError(
            what, expected="a perspective sensor", got=repr(sensor.get("type")), action="write the camera as JSON"
        )
    defaults = {item.get("name"): item.get("value") for item in scene.iter("default")}
    values = {item.get("name"): _fill(item.get("value", ""), defaults) for item in sensor if item.get("value")}
    film = next(iter(sensor.iter("film")), None)
    sizes = {} if film is None else {item.get("name"): _fill(item.get("value", ""), defaults) for item in film}
    width, height = float(sizes.get("width", 768)), float(sizes.get("height", 576))
    matrix = np.eye(4)
    for transform in sensor.iter("transform"):
        for step in transform:
            matrix = _make_step(step, defaults) @ matrix
    angle = float(values.get("fov", 50.0)) if "focal_length" not in values else None
    if angle is None:
        # Of 35 mm film, whose diagonal is 43.27 mm.
        focal = float(values["focal_length"].removesuffix("mm"))
        angle, axis = math.degrees(2.0 * math.atan(0.5 * math.hypot(36.0, 24.0) / focal)), "diagonal"
    else:
        axis = values.get("fov_axis", "x")
    half_width = _find_half_width(math.tan(math.radians(angle) / 2.0), axis, width / height)
    half_height = half_width * height / width
    part = [float(sizes.get(f"crop_{name}", whole)) for name, whole in (("width", width), ("height", height))]
    start = [float(sizes.get(f"crop_offset_{axis}", 0.0)) for axis in "xy"]
    moved = [float(values.get(f"principal_point_offset_{axis}", 0.0)) for axis in "xy"]
    # The centre of the image, from that of the film in units of its half extent: columns to the right, rows downwards.
    across = (2.0 * start[0] + part[0]) / width - 1.0 + 2.0 * moved[0]
    down = (2.0 * start[1] + part[1]) / height - 1.0 + 2.0 * moved[1]
    return Camera(
        matrix[:3, 3],
        matrix[:3, 2],
        matrix[:3, 1],
        2.0 * math.atan(half_height * part[1] / height),
        shift=(half_width * across, -half_height * down),
    )


def _find_half_width(half: float, axis: str, aspect: float) -> float:
    """Return half the width at distance 1 of a half extent along an axis by Mitsuba's names."""
    if axis == "smaller":
        axis = "y" if aspect > 1.0 else "x"
    elif axis == "larger":
        axis = "x" if aspect > 1.0 else "y"
    if axis == "y":
        return half * aspect
    return half if axis == "x" else half / math.hypot(1.0, 1.0 / aspect)


def _fill(text: str, defaults: Mapping[str | None, str | None]) -> str:
    for name, value in defaults.items():
        text = text.replace(f"${name}", value or "")
    return text


def _make_step(step: ElementTree.Element, defaults: Mapping[str | None, str | None]) -> Matrix:
    """Return one step of a Mitsuba transform, (4, 4), for column vectors."""

    def take(name: str, default: str = "0, 0, 0") -> Matrix:
        words = _fill(step.get(name, default), defaults).replace(",", " ").split()
        return np.array([float(word) for word in words])

    matrix = np.eye(4)
    if step.tag == "matrix":
        return take("value").reshape(4, 4)
    if step.tag == "lookat":
        origin, target, up = take("origin"), take("target"), take("up", "0, 1, 0")
        forward = (target - origin) / np.linalg.norm(target - origin)
        left = np.cross(up, forward)
        left /= np.linalg.norm(left)
        matrix[:3] = np.stack([left, np.cross(forward, left), forward, origin], axis=1)
    elif step.tag == "translate":
        matrix[:3, 3] = take("value") if step.get("value") else [take(axis, "0")[0] for axis in "xyz"]
    elif step.tag == "scale":
        factor = take("value") if step.get("value") else np.array([take(axis, "1")[0] for axis in "xyz"])
        matrix[:3, :3] = np.diag(np.broadcast_to(factor, 3))
    elif step.tag == "rotate":
        axis = take("value") if step.get("value") else np.array([take(name, "0")[0] for name in "xyz"])
        matrix[:3, :3] = _turn(axis, math.radians(float(_fill(step.get("angle", "0"), defaults))))
    else:
        raise ValueError(f"a transform with <{step.tag}>")
    return matrix


def _turn(axis: Matrix, angle: float) -> Matrix:
    x, y, z = axis / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    turned: Matrix = np.eye(3) + math.sin(angle) * cross + (1.0 - math.cos(angle)) * cross @ cross
    return turned


def _read_gltf(data: bytes, what: str) -> Camera:
    if data[:4] == struct.pack("<I", GLB_MAGIC):
        size, kind = struct.unpack_from("<II", data, 12)
        if kind != GLB_JSON:
            raise ValueError("a .glb without JSON")
        data = data[20 : 20 + size]
    scene = json.loads(data)
    nodes = scene.get("nodes", [])
    parents = {child: number for number, node in enumerate(nodes) for child in node.get("children", [])}
    found = [number for number, node in enumerate(nodes) if "camera" in node]
    if not found:
        raise InputError(what, expected="a node with a camera", got="none", action="export cameras as well")
    number: int | None = found[0]
    lens = scene["cameras"][nodes[found[0]]["camera"]]
    if lens.get("type") != "perspective":
        raise InputError(what, expected="a perspective camera", got=repr(lens.get("type")), action="render with one")
    matrix = np.eye(4)
    while number is not None:
        matrix = _make_node(nodes[number]) @ matrix
        number = parents.get(number)
    fov_y = float(lens["perspective"]["yfov"])
    aspect = lens["perspective"].get("aspectRatio")
    fov_x = None if aspect is None else 2.0 * math.atan(math.tan(0.5 * fov_y) * float(aspect))
    return Camera(matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1], fov_y, fov_x)


def _make_node(node: dict[str, Any]) -> Matrix:
    """Return the transform of a node, (4, 4), for column vectors."""
    if "matrix" in node:
        return np.array(node["matrix"], np.float64).reshape(4, 4).T
    x, y, z, w = node.get("rotation", (0.0, 0.0, 0.0, 1.0))
    matrix = np.eye(4)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix[:3, :3] = turn * np.array(node.get("scale", (1.0, 1.0, 1.0)))
    matrix[:3, 3] = node.get("translation", (0.0, 0.0, 0.0))
    return matrix
