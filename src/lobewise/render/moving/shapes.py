"""The places of a scene's shapes, which move in the loaded scene."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lobewise.errors import InputError, choose_nearest, name_value
from lobewise.records.camera import MAX_COORDINATE
from lobewise.render.bridge import dr, mi

Matrix = NDArray[np.float64]
"""A matrix (4, 4) that maps world points; the last row is 0 0 0 1."""

Box = NDArray[np.float64]
"""Lower and upper corner of a box that holds a shape, (2, 3)."""

MAX_CONDITION = 1e6
"""Largest ratio of the scales of a matrix. Beyond it positions in single precision say nothing."""
SIMILARITY_TOLERANCE = 1e-4
"""Largest relative difference between the scales of a matrix that counts as a rotation with one scale."""
MAX_LISTED_IDS = 12
"""Largest number of ids that an error lists."""


def check_transform(name: str, value: ArrayLike) -> Matrix:
    """Return a matrix in double precision.

    Raises
    ------
    InputError
        If it is not finite and (4, 4), its last row is not 0 0 0 1, it cannot be inverted, or it mirrors.
    """
    try:
        matrix = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        matrix = np.empty(0)
    if matrix.shape != (4, 4) or not (np.abs(matrix) <= MAX_COORDINATE).all():
        got = f"an array of shape {matrix.shape}"
        if matrix.shape == (4, 4):
            got = "numbers that are not finite" if not np.isfinite(matrix).all() else "numbers too large for 32 bits"
        raise InputError(name, expected="a finite matrix of shape (4, 4)", got=got, action="pass a world transform")
    if not np.array_equal(matrix[3], (0.0, 0.0, 0.0, 1.0)):
        got = name_value(matrix[3].tolist())
        action = "write the translation into the last column"
        raise InputError(name, expected="a matrix with the last row 0 0 0 1", got=got, action=action)
    scales = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    if not scales[2] * MAX_CONDITION > scales[0]:
        action = "let no scale be 0"
        raise InputError(name, expected="a matrix that can be inverted", got="a singular one", action=action)
    if np.linalg.det(matrix[:3, :3]) < 0.0:
        action = "leave the negative scale out"
        raise InputError(name, expected="a matrix that does not mirror", got="a mirroring one", action=action)
    return matrix


def measure_box(shape: Any) -> Box:
    """Return the corners (2, 3) of a shape's box. Meshes that Mitsuba has merged have no valid box of their own."""
    if shape.is_mesh():
        vertices = np.array(shape.vertex_positions_buffer(), dtype=np.float64).reshape(-1, 3)
        return np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    box = shape.bbox()
    return np.stack([np.array(box.min, dtype=np.float64), np.array(box.max, dtype=np.float64)])


def _is_similarity(matrix: Matrix) -> bool:
    """Return whether a matrix turns, moves and scales by one number."""
    scales = np.linalg.svd(matrix[:3, :3], compute_uv=False)
    return bool(scales[0] - scales[2] <= SIMILARITY_TOLERANCE * scales[0])


class ShapePlaces:
    """The shapes of a scene by their ids, with the matrix that led each from its first place to the present one.

    The first places are those at the construction. Places are set in the loaded scene, whose acceleration structure
    follows; meshes lose no shading normals.
    """

    def __init__(self, scene: Any) -> None:
        self._scene = scene
        self._shapes = {str(shape.id()): shape for shape in scene.shapes() if shape.id()}
        self._starts: dict[str, dict[str, Any]] = {}
        self._parameters: Any = None
        self.transforms: dict[str, Matrix] = {}
        """Matrices of the shapes that were moved, by id; those of other shapes are the identity."""
        self.keeps_addresses = True
        """Whether all arrays of meshes lie where they lay at the construction."""

    def get_shape(self, name: str) -> Any:
        """Return a shape by its id; raise InputError if there is none."""
        if name in self._shapes:
            return self._shapes[name]
        known = sorted(self._shapes)
        listed = ", ".join(known[:MAX_LISTED_IDS]) + (" ..." if len(known) > MAX_LISTED_IDS else "")
        near = choose_nearest(name, known)
        raise InputError(
            "shape",
            expected=f"the id of a shape: {listed}" if known else "a shape with an id",
            got=repr(name),
            action=f"did you mean {near!r}?" if near else "load a file with load_scene(..., merge=False), to keep ids",
        )

    def check(self, transforms: Mapping[str, ArrayLike]) -> dict[str, Matrix]:
        """Return transforms in double precision.

        Raises
        ------
        InputError
            If there is no shape of an id, if `check_transform` refuses a matrix, if a shape that is neither a mesh nor
            an instance shall be sheared or scaled unevenly, or if a shape of a kind cannot move.
        """
        checked = {}
        for name, value in transforms.items():
            shape = self.get_shape(name)
            matrix = checked[name] = check_transform(f"transform of {name!r}", value)
            kind = str(shape.class_name())
            keys = set(mi.traverse(shape).keys()) if name not in self._starts else set(self._starts[name])
            if "vertex_positions" not in keys and "to_world" not in keys:
                action = "make it a mesh"
                raise InputError(f"shape {name!r}", expected="a kind that can move", got=kind, action=action)
            if "to_world" in keys and kind != "Instance" and not _is_similarity(matrix):
                expected = f"a rotation, a translation and one scale, as the shape is a {kind.lower()}"
                action = "make the shape a mesh, or scale evenly"
                raise InputError(f"transform of {name!r}", expected=expected, got="another matrix", action=action)
        return checked

    def place(self, transforms: Mapping[str, ArrayLike]) -> dict[str, tuple[Box, Box]]:
        """Move shapes to places relative to their first ones.

        Return the boxes before and after of those that were elsewhere before, by id.

        Raises InputError as `check` does; then nothing has moved.
        """
        checked = self.check(transforms)
        moved = [name for name in checked if not np.array_equal(checked[name], self.get_transform(name))]
        if not moved:
            return {}
        if self._parameters is None:
            self._parameters = mi.traverse(self._scene)
        before = {name: measure_box(self._shapes[name]) for name in moved}
        for name in moved:
            self._write(name, checked[name])
            self.transforms[name] = checked[name]
        self._parameters.update()
        return {name: (before[name], measure_box(self._shapes[name])) for name in moved}

    def get_transform(self, name: str) -> Matrix:
        """Return the matrix from a shape's first place to its present one."""
        return self.transforms.get(name, np.eye(4))

    def compute_moves(self, before: Mapping[str, Matrix]) -> dict[str, Matrix]:
        """Return the matrix that maps present world points to earlier ones, of each shape that moved since.

        ``before`` is a copy of `transforms` at the earlier time.
        """
        moves = {}
        for name, matrix in self.transforms.items():
            earlier = before.get(name, np.eye(4))
            if not np.array_equal(matrix, earlier):
                moves[name] = earlier @ np.linalg.inv(matrix)
        return moves

    def _write(self, name: str, matrix: Matrix) -> None:
        """Set the parameters of one shape, without telling the scene."""
        keys = self._list_keys(name)
        start = self._starts.setdefault(name, {key: self._read(key, keys[key]) for key in keys})
        if "to_world" in keys:
            value = np.asarray(matrix @ start["to_world"], dtype=np.float32)
            self._parameters[keys["to_world"]] = type(self._parameters[keys["to_world"]])(value)
            return
        points = start["vertex_positions"] @ matrix[:3, :3].T + matrix[:3, 3]
        self._fill(keys["vertex_positions"], points)
        if start.get("vertex_normals") is not None:
            # Set them as well: Mitsuba would compute normals from the faces instead.
            normals = start["vertex_normals"] @ np.linalg.inv(matrix[:3, :3])
            normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-20)
            self._fill(keys["vertex_normals"], normals)

    def _fill(self, key: str, vectors: Matrix) -> None:
        """Set an array of a mesh, (count, 3)."""
        numbers = vectors.ravel().astype(np.float32)
        buffer = self._parameters[key]
        if dr.backend_v(buffer) == dr.JitBackend.LLVM:
            # Functions that Dr.Jit 1.5 replays read from the address of the first array, so write there.
            dr.sync_thread()
            buffer.numpy()[:] = numbers
            self._parameters.set_dirty(key)
        else:
            self._parameters[key] = mi.Float(numbers)
            self.keeps_addresses = False

    def _list_keys(self, name: str) -> dict[str, str]:
        """Return the names of a shape's own parameters among those of the scene, by their names in the shape."""
        shape, keys = self._shapes[name], {}
        for key, (_, _, node, _) in self._parameters.properties.items():
            last = key.rpartition(".")[2]
            if last in ("to_world", "vertex_positions", "vertex_normals") and node is shape:
                keys[last] = key
        return keys

    def _read(self, last: str, key: str) -> Any:
        value = self._parameters[key]
        if last == "to_world":
            return np.array(value.matrix, dtype=np.float64).reshape(4, 4)
        numbers = np.array(value, dtype=np.float64)
        return numbers.reshape(-1, 3) if numbers.size else None
