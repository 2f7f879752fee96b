"""Loads Mitsuba scenes: built-in ones by name, and the user's scene files."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import FileError, InputError, choose_nearest, require_choice, require_integer
from lobewise.render.variant import load_mitsuba
from lobewise.scenes import describe_movers, describe_scene, list_moving_scenes, list_scenes, refuse_blender
from lobewise.scenes.limits import MAX_SIDE, require_shallow, require_size

__all__ = ["MovingScene", "build_scene", "list_moving_scenes", "list_scenes", "load_scene"]

DEFAULT_SIZE = 512
"""Default width and height of a built-in scene, pixels."""

_RESERVED = ("path", "parallel", "optimize")
"""Names that Mitsuba's loader uses for its own arguments."""

_OF_A_MESH = {
    "vertex_positions": "vertices",
    "vertex_normals": "normals",
    "vertex_texcoords": "uv",
    "faces": "faces",
}
"""Our names of the arrays of a mesh, by Mitsuba's names."""


def load_scene(
    name_or_path: str | os.PathLike[str],
    *,
    width: int | None = None,
    height: int | None = None,
    time: float = 0.0,
    parameters: Mapping[str, str] | None = None,
    merge: bool = True,
) -> Any:
    """Load a built-in scene by name, or a Mitsuba XML file by path.

    Parameters
    ----------
    name_or_path : str or path
        One of `lobewise.scenes.list_scenes`, or a path that ends in ``.xml`` or contains a folder.
    width, height : int, optional
        Size of the image, pixels; by default that of the file, or 512x512 for a built-in scene. If only one is given,
        the aspect of the file is kept.
    time : float
        Time in frames, for the objects of a scene of `lobewise.scenes.list_moving_scenes`.
    parameters : mapping of str to str, optional
        Values for ``$name`` in an XML file, in place of the file's own defaults.
    merge : bool
        Whether Mitsuba may merge the meshes of a file, which then lose their ids. Shapes that shall move must keep
        theirs.

    Returns
    -------
    mitsuba.Scene

    Raises
    ------
    InputError
        If there is no scene of this name, the size is not 1 to 32768, the elements of the file are more than 64 deep,
        Mitsuba does not understand it, a time is given although nothing moves, or the scene has no such parameter.
    FileError
        If the file does not exist or cannot be read.
    MissingDependencyError
        If Mitsuba or libLLVM is not installed.

    Notes
    -----
    A built-in scene renders to the same bits every time. In files Mitsuba merges shapes in an order that varies, so
    with several lights the random numbers of a file differ from load to load.
    """
    for name, value in (("width", width), ("height", height)):
        if value is not None:
            require_integer(name, value, 1, MAX_SIDE)
    text = os.fspath(name_or_path)
    if time != 0.0:
        _require_moving(text)
    if text in list_scenes():
        for name in parameters or {}:
            action = "leave it out: built-in scenes have none"
            raise InputError(f"parameter {name!r}", expected="an XML file", got=f"the scene {text!r}", action=action)
        size = width or height or DEFAULT_SIZE, height or width or DEFAULT_SIZE
        return build_scene(describe_scene(text, *size, time))
    path = Path(text)
    refuse_blender(path)
    if path.suffix.lower() != ".xml" and path.name == text and not path.exists():
        require_choice("scene", text, list_scenes())
    return _load_file(path, width, height, parameters or {}, merge)


@dataclass(frozen=True)
class MovingScene:
    """A built-in scene whose objects move; time is counted in frames.

    ``name`` is one of `lobewise.scenes.list_moving_scenes`, otherwise InputError is raised. ``width`` and ``height``
    are those of `load_scene`.
    """

    name: str
    width: int | None = None
    height: int | None = None

    def __post_init__(self) -> None:
        _require_moving(self.name)

    def load(self, time: float = 0.0) -> Any:
        """Return the ``mitsuba.Scene`` at a time."""
        return load_scene(self.name, width=self.width, height=self.height, time=time)

    def compute_moves(self, time: float, before: float) -> dict[str, NDArray[np.float64]]:
        """Return the matrix that maps world points at ``time`` to ``before`` for each moving shape, by its id."""
        load_mitsuba()
        now, then = (
            {
                name: np.array(_make_transform(item["to_world"]).matrix, dtype=np.float64)
                for name, item in describe_movers(self.name, at).items()
            }
            for at in (time, before)
        )
        return {name: then[name] @ np.linalg.inv(matrix) for name, matrix in now.items()}


def _require_moving(name: str) -> None:
    if name not in list_moving_scenes():
        expected = f"one whose objects move: {' or '.join(list_moving_scenes())}"
        got = repr(name)
        raise InputError("scene", expected=expected, got=got, action="take one of them, or move only the camera")


def build_scene(items: dict[str, Any]) -> Any:
    """Return the Mitsuba object of a description for ``mitsuba.load_dict`` with plain data in three places.

    ``to_world`` and ``to_uv`` may be steps: tuples of the name of a method of ``mitsuba.ScalarTransform4f`` and its
    arguments; the last step is applied first. Any array is a bitmap. A shape of type "mesh" has ``vertices``,
    ``normals``, ``uv`` and ``faces``, (n, 2 or 3) each.
    """
    # Mitsuba's optimisation reorders shapes and lights on every load, which would change the random numbers.
    return load_mitsuba().load_dict(_translate(items), optimize=False)


def _translate(value: Any, name: str = "") -> Any:
    if isinstance(value, np.ndarray):
        return load_mitsuba().Bitmap(value)
    if name in ("to_world", "to_uv") and isinstance(value, tuple):
        return _make_transform(value)
    if not isinstance(value, dict):
        return value
    if value.get("type") == "mesh":
        return _make_mesh(value)
    return {key: _translate(item, key) for key, item in value.items()}


def _make_transform(steps: tuple[tuple[Any, ...], ...]) -> Any:
    transform = load_mitsuba().ScalarTransform4f()
    for method, *arguments in steps:
        transform = getattr(transform, method)(*arguments)
    return transform


def _make_mesh(item: dict[str, Any]) -> Any:
    mi = load_mitsuba()
    properties = mi.Properties()
    properties["bsdf"] = mi.load_dict(_translate(item["bsdf"]))
    counts = {"vertex_count": len(item["vertices"]), "face_count": len(item["faces"])}
    mesh = mi.Mesh("mesh", **counts, has_vertex_normals=True, has_vertex_texcoords=True, props=properties)
    values = mi.traverse(mesh)
    for name, part in _OF_A_MESH.items():
        values[name] = item[part].ravel()
    values.update()
    return mesh


def _load_file(path: Path, width: int | None, height: int | None, parameters: Mapping[str, str], merge: bool) -> Any:
    if not path.is_file():
        got = "a folder" if path.is_dir() else "nothing there"
        raise FileError(str(path), expected="a Mitsuba XML file", got=got, action="check the path")
    for name in parameters:
        if name in _RESERVED:
            expected = f"a name other than {', '.join(_RESERVED)}, which Mitsuba's loader takes for itself"
            raise InputError("parameter", expected=expected, got=repr(name), action="rename it in the scene's file")
    require_shallow(path)
    mi = load_mitsuba()
    try:
        scene = mi.load_file(str(path), optimize=merge, **parameters)
    except (RuntimeError, OSError) as error:
        _refuse_unused(path, parameters, str(error))
        expected = "a scene that Mitsuba understands"
        action = "repair the file"
        raise InputError(str(path), expected=expected, got=_say_in_a_line(error), action=action) from error
    if not isinstance(scene, mi.Scene):
        got = f"a {type(scene).__name__}"
        raise InputError(str(path), expected="a <scene>", got=got, action="pass the file of a scene")
    if (width or height) and scene.sensors():
        _resize(mi, scene, width, height)
    for sensor in scene.sensors()[:1]:
        require_size(path, *map(int, sensor.film().size()))
    return scene


def _say_in_a_line(error: Exception) -> str:
    """Return Mitsuba's message, which quotes the file, as one line of printable characters."""
    text = " ".join(str(error).split())
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _refuse_unused(path: Path, parameters: Mapping[str, str], problem: str) -> None:
    """Raise InputError if Mitsuba's message says that the file does not use a parameter."""
    unused = [name for name in parameters if f"${name}={parameters[name]}" in problem]
    if not unused or "unused" not in problem:
        return
    known = sorted(set(re.findall(r"\$\{?(\w+)", path.read_text("utf-8", "replace"))))
    near = choose_nearest(unused[0], known)
    raise InputError(
        f"parameter {unused[0]!r}",
        expected=f"one of {', '.join(known)}, which {str(path)!r} uses"
        if known
        else f"none, as {str(path)!r} uses none",
        got=f"{unused[0]}={parameters[unused[0]]!r}",
        action=f"did you mean {near!r}?" if near else "leave it out",
    )


def _resize(mi: Any, scene: Any, width: int | None, height: int | None) -> None:
    parameters = mi.traverse(scene.sensors()[0])
    old_width, old_height = (int(value) for value in parameters["film.size"])
    new_width = width or max(1, round(old_width * (height or old_height) / old_height))
    new_height = height or max(1, round(old_height * new_width / old_width))
    parameters["film.size"] = [new_width, new_height]
    parameters.update()
