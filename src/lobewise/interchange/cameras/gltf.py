"""Cameras of glTF files: text (``.gltf``), or binary (``.glb``). Of ``.glb`` only the text in front is read.

Source: Khronos Group, "glTF 2.0 Specification", sections 3.5 (nodes), 3.10 (cameras) and 4.4 (GLB).
"""

from __future__ import annotations

import math
import os
import struct
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import FileError, InputError, require_integer
from lobewise.io.documents import describe_kind, parse_json, read_document, require_number, require_numbers
from lobewise.io.files import refusing, require_readable
from lobewise.records.camera import Camera

MAX_TEXT_BYTES = 64 << 20
"""Largest size of the text, bytes. Meshes and pictures behind the text do not count."""
GLB_MAGIC, GLB_JSON = 0x46546C67, 0x4E4F534A
_HEAD = struct.Struct("<5I")

Matrix = NDArray[np.float64]


def read_gltf_camera(path: Path) -> Camera:
    """Return the camera of the first node of a scene that has one.

    Raises
    ------
    FileError
        If the file cannot be read.
    InputError
        If the file has no camera, or the camera is no pinhole.
    """
    what = f"camera {str(path)!r}"
    scene = parse_json(_read_text(path, what), what=what, action="export it again")
    nodes = _take(scene, "nodes", list, what)
    numbers = [number for number, node in enumerate(nodes) if isinstance(node, dict) and "camera" in node]
    if not numbers:
        raise InputError(what, expected="a node with a camera", got="none", action="export cameras as well")
    cameras = _take(scene, "cameras", list, what)
    index = nodes[numbers[0]]["camera"]
    if not cameras:
        expected, got = "the camera that a node names", "no cameras at all"
        raise InputError(what, expected=expected, got=got, action="export it again")
    lens = cameras[require_integer(f"{what}, camera of node {numbers[0]}", index, 0, len(cameras) - 1)]
    kind = _take(lens, "type", str, what)
    if kind != "perspective":
        raise InputError(what, expected="a perspective camera", got=repr(kind[:40]), action="render with one")
    perspective = _take(lens, "perspective", dict, what)
    fov_y = require_number(f"{what}, yfov", perspective.get("yfov"))
    fov_x = None
    if "aspectRatio" in perspective:
        aspect = require_number(f"{what}, aspectRatio", perspective["aspectRatio"])
        fov_x = 2.0 * math.atan(math.tan(0.5 * fov_y) * aspect)
    matrix = _compute_placement(nodes, numbers[0], what)
    return Camera(matrix[:3, 3], -matrix[:3, 2], matrix[:3, 1], fov_y, fov_x)


def _read_text(path: Path, what: str) -> bytes:
    """Return the JSON of a text or binary file."""
    file = require_readable(path, what="camera", holds="a camera")
    with refusing(what, "a readable file", "check the disk"), file.open("rb") as stream:
        head = stream.read(_HEAD.size)
        if not head.startswith(struct.pack("<I", GLB_MAGIC)):
            return read_document(path, MAX_TEXT_BYTES, what="camera", holds="a camera")
        rest = os.fstat(stream.fileno()).st_size - len(head)
        size, kind = _HEAD.unpack(head)[3:] if len(head) == _HEAD.size else (0, 0)
        if kind != GLB_JSON or not 0 < size <= min(rest, MAX_TEXT_BYTES):
            raise FileError(
                what,
                expected=f"a .glb that begins with at most {MAX_TEXT_BYTES} bytes of JSON",
                got="something else" if kind != GLB_JSON else f"{size} bytes in a file of {rest + len(head)}",
                action="export it again",
            )
        return stream.read(size)


def _compute_placement(nodes: list[Any], number: int, what: str) -> Matrix:
    """Return the transform of a node and all nodes above it, (4, 4), for column vectors."""
    parents: dict[int, int] = {}
    for above, node in enumerate(nodes):
        if not isinstance(node, dict):
            raise InputError(f"{what}, node {above}", expected="an object", got=describe_kind(node), action="mend it")
        for child in _take(node, "children", list, what) if "children" in node else ():
            parents[require_integer(f"{what}, child of node {above}", child, 0, len(nodes) - 1)] = above
    matrix, passed = np.eye(4), set()
    step: int | None = number
    while step is not None:
        if step in passed:
            raise InputError(
                what, expected="nodes that form a tree", got=f"node {step} inside itself", action="export it again"
            )
        passed.add(step)
        with np.errstate(over="ignore", invalid="ignore"):  # The camera refuses numbers that are not finite.
            matrix = _make_transform(nodes[step], f"{what}, node {step}") @ matrix
        step = parents.get(step)
    return matrix


def _make_transform(node: dict[str, Any], what: str) -> Matrix:
    """Return the transform of a node alone, (4, 4), for column vectors."""
    if "matrix" in node:
        numbers = require_numbers(f"{what}, matrix", node["matrix"], 16, action="write 16 numbers")
        return numbers.reshape(4, 4).T
    x, y, z, w = require_numbers(f"{what}, rotation", node.get("rotation", [0.0, 0.0, 0.0, 1.0]), 4)
    matrix = np.eye(4)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix[:3, :3] = turn * require_numbers(f"{what}, scale", node.get("scale", [1.0, 1.0, 1.0]), 3)
    matrix[:3, 3] = require_numbers(f"{what}, translation", node.get("translation", [0.0, 0.0, 0.0]), 3)
    return matrix


def _take(table: Any, key: str, kind: type, what: str) -> Any:
    if not isinstance(table, dict):
        expected, got = f"an object that has {key!r}", describe_kind(table)
        raise InputError(what, expected=expected, got=got, action="export it again")
    value = table.get(key, [] if kind is list else None)
    if not isinstance(value, kind):
        word = describe_kind(kind())
        raise InputError(f"{what}, {key}", expected=word, got=describe_kind(value), action="export it again")
    return value
