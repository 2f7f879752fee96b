"""Places of shapes over the frames of a sequence, read from a file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError, LobewiseError, require_choice
from lobewise.io.documents import describe_kind, parse_json, read_document, require_number, require_numbers
from lobewise.io.files import PathLike
from lobewise.records.camera import MAX_COORDINATE
from lobewise.render.moving.shapes import Matrix, ShapePlaces, check_transform

_MAX_BYTES = 64 << 20
"""Largest size of a file, bytes: a hundred thousand matrices."""
_OF_A_PATH = ("matrices", "keys", "axis", "about")
_OF_A_KEY = ("frame", "translate", "degrees", "scale")
_EXAMPLE = 'write {"cube": {"keys": [{"frame": 1}, {"frame": 9, "degrees": 90}]}}'


@dataclass(frozen=True)
class ObjectPath:
    """The places of one shape.

    Parameters
    ----------
    matrices : array, shape (frames, 4, 4)
        The places of a path of matrices; empty for a path of keys.
    frames : array, shape (keys,)
        The frames of the keys, increasing.
    values : array, shape (keys, 7)
        Translation, degrees and scales of each key.
    axis, about : array, shape (3,)
        Axis of all turns, and the point about which the shape turns and is scaled.
    """

    matrices: NDArray[np.float64]
    frames: NDArray[np.float64]
    values: NDArray[np.float64]
    axis: NDArray[np.float64]
    about: NDArray[np.float64]

    def compute_place(self, frame: float) -> Matrix:
        """Return the place at a frame, counted from 1. Before the first key and after the last one nothing moves."""
        if len(self.matrices):
            return np.asarray(self.matrices[round(frame) - 1])
        translate, (degrees,), scales = np.split(
            np.array([np.interp(frame, self.frames, values) for values in self.values.T]), (3, 4)
        )
        # Rodrigues' formula as a matrix.
        x, y, z = self.axis / np.linalg.norm(self.axis)
        cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
        angle = np.deg2rad(degrees)
        matrix = np.eye(4)
        matrix[:3, :3] += np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross
        matrix[:3, :3] *= scales
        matrix[:3, 3] = translate + self.about - matrix[:3, :3] @ self.about
        return matrix


@dataclass(frozen=True)
class ObjectPaths:
    """The places of shapes over time, by their ids, as `read_object_paths` reads them."""

    name: str
    """Name of the file in messages."""
    paths: Mapping[str, ObjectPath]

    def compute_places(self, frame: float) -> dict[str, Matrix]:
        """Return the matrix from each shape's place in the scene to its place at a frame, counted from 1."""
        return {name: path.compute_place(frame) for name, path in self.paths.items()}

    @property
    def last_frame(self) -> float:
        """The frame of the last key or matrix of all paths, counted from 1."""
        return max(float(len(path.matrices) or path.frames[-1]) for path in self.paths.values())

    def require_frames(self, count: int) -> None:
        """Raise InputError if a path of matrices ends before a frame."""
        for name, path in self.paths.items():
            if 0 < len(path.matrices) < count:
                expected = f"at least {count} matrices, one for each frame"
                got = str(len(path.matrices))
                raise InputError(
                    f"{self.name}, shape {name!r}", expected=expected, got=got, action="ask for fewer frames"
                )


@dataclass(frozen=True)
class PlacedScene:
    """A loaded scene whose shapes move along paths; a scene for `lobewise.render.render_sequence`.

    ``scene`` must be as it was loaded. Raises InputError if it lacks a shape of the paths, or if one cannot take its
    place.
    """

    scene: Any
    paths: ObjectPaths
    _places: ShapePlaces = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_places", ShapePlaces(self.scene))
        try:
            for path in self.paths.paths.values():
                frames = range(1, len(path.matrices) + 1) if len(path.matrices) else path.frames
                for frame in frames:
                    self._places.check(
                        {name: p.compute_place(frame) for name, p in self.paths.paths.items() if p is path}
                    )
        except LobewiseError as problem:
            raise problem.place_in(self.paths.name, InputError) from None

    def load(self, time: float = 0.0) -> Any:
        """Return the scene with its shapes at a time, in frames from 0."""
        self._places.place(self.paths.compute_places(time + 1))
        return self.scene

    def compute_moves(self, time: float, before: float) -> dict[str, Matrix]:
        """Return the matrix that maps world points at ``time`` to ``before`` for each shape, by its id."""
        now, then = (self.paths.compute_places(at + 1) for at in (time, before))
        return {name: then[name] @ np.linalg.inv(matrix) for name, matrix in now.items()}


def read_object_paths(path: PathLike) -> ObjectPaths:
    """Return the places in a JSON file: an object with a path for each shape that moves, by its id.

    A path is an object with either ``matrices`` or ``keys``.

    - ``matrices`` has a matrix for each frame: four lists of four numbers, the rows.
    - ``keys`` has objects with ``frame``, a number from 1, larger from key to key. ``translate`` (three numbers),
      ``degrees`` and ``scale`` (a number above 0, or three) are 0, 0 and 1 by default. Between keys they are
      interpolated, each by itself and linearly. The path may have ``axis`` (0 1 0 by default) and ``about`` (the
      origin): the shape is scaled and turned about this point, and then moved.

    Matrices and keys are in world space, and lead from the place of the shape in the scene.

    Raises
    ------
    FileError
        If the file cannot be read, or is not JSON.
    InputError
        If the file does not hold such an object, or a matrix is singular or mirrors.
    """
    name = f"moving objects {str(path)!r}"
    data = read_document(path, _MAX_BYTES, what="moving objects", holds="a JSON object of paths by shape id")
    entries = parse_json(data, what=name)
    if not isinstance(entries, dict) or not entries:
        got = "an empty object" if entries == {} else describe_kind(entries)
        raise InputError(name, expected="a JSON object of paths by shape id", got=got, action=_EXAMPLE)
    return ObjectPaths(name, {key: _make_path(f"{name}, shape {key!r}", entry) for key, entry in entries.items()})


def _make_path(name: str, entry: Any) -> ObjectPath:
    if not isinstance(entry, dict):
        raise InputError(name, expected="an object", got=describe_kind(entry), action=_EXAMPLE)
    for key in entry:
        require_choice(f"{name}, key", key, _OF_A_PATH)
    if ("matrices" in entry) == ("keys" in entry) or ("matrices" in entry and len(entry) > 1):
        expected = "matrices alone, or keys with axis and about"
        raise InputError(name, expected=expected, got=", ".join(entry) or "nothing", action=_EXAMPLE)
    kind = "matrices" if "matrices" in entry else "keys"
    items = entry[kind]
    if not isinstance(items, list) or not items:
        got = "an empty list" if items == [] else describe_kind(items)
        raise InputError(f"{name}, {kind}", expected="a list", got=got, action=_EXAMPLE)
    if kind == "matrices":
        matrices = [_read_matrix(f"{name}, matrix {number}", item) for number, item in enumerate(items, start=1)]
        return ObjectPath(np.array(matrices), np.empty(0), np.empty((0, 7)), np.array((0.0, 1.0, 0.0)), np.zeros(3))
    keys = np.array([_read_key(f"{name}, key {number}", item) for number, item in enumerate(items, start=1)])
    frames = keys[:, 0]
    if not (np.diff(frames) > 0.0).all():
        number = int(np.argmin(np.diff(frames) > 0.0))
        got = f"{frames[number]:g} and then {frames[number + 1]:g}"
        raise InputError(f"{name}, frame", expected="larger numbers from key to key", got=got, action="sort the keys")
    axis, about = (
        _read_numbers(f"{name}, {key}", entry[key], 3) if key in entry else np.array(default)
        for key, default in (("axis", (0.0, 1.0, 0.0)), ("about", (0.0, 0.0, 0.0)))
    )
    if not axis.any():
        raise InputError(f"{name}, axis", expected="a direction", got="a length of 0", action="write [0, 1, 0]")
    return ObjectPath(np.empty((0, 4, 4)), frames, keys[:, 1:], axis, about)


def _read_matrix(name: str, item: Any) -> Matrix:
    if not isinstance(item, list) or len(item) != 4:
        got = f"{len(item)} of them" if isinstance(item, list) else describe_kind(item)
        raise InputError(name, expected="four rows of four numbers", got=got, action="write [[1, 0, 0, 0], ...]")
    rows = [require_numbers(f"{name}, row {number}", row, 4) for number, row in enumerate(item, start=1)]
    return check_transform(name, np.array(rows))


def _read_key(name: str, item: Any) -> list[float]:
    """Return frame, translation, degrees and scales of a key."""
    if not isinstance(item, dict):
        raise InputError(name, expected="an object", got=describe_kind(item), action='write {"frame": 1}')
    for key in item:
        require_choice(f"{name}, key", key, _OF_A_KEY)
    if "frame" not in item:
        got = ", ".join(item) or "nothing"
        raise InputError(name, expected="a frame", got=got, action='write {"frame": 1, ...}')
    (frame,) = _read_numbers(f"{name}, frame", [item["frame"]], 1)
    if not frame >= 1.0:
        raise InputError(f"{name}, frame", expected="a number from 1", got=f"{frame:g}", action="count frames from 1")
    (degrees,) = _read_numbers(f"{name}, degrees", [item.get("degrees", 0.0)], 1)
    translate = _read_numbers(f"{name}, translate", item.get("translate", [0.0, 0.0, 0.0]), 3)
    scale = item.get("scale", 1.0)
    scales = _read_numbers(f"{name}, scale", scale if isinstance(scale, list) else [scale] * 3, 3)
    if not (scales > 0.0).all():
        raise InputError(f"{name}, scale", expected="numbers above 0", got=str(scale), action="leave the scale out")
    return [frame, *translate, degrees, *scales]


def _read_numbers(name: str, value: Any, count: int) -> NDArray[np.float64]:
    """Return so many numbers, which single precision holds."""
    numbers = np.array([require_number(name, value[0])]) if count == 1 else require_numbers(name, value, count)
    if not (np.abs(numbers) <= MAX_COORDINATE).all():
        action = "choose smaller units"
        raise InputError(name, expected="numbers that 32 bits hold", got=f"{np.abs(numbers).max():.2g}", action=action)
    return numbers
