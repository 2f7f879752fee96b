"""Scenes by name, made in code from spheres, boxes and generated textures; and any scene file of the user's."""

from __future__ import annotations

import os
from importlib import import_module
from pathlib import Path
from typing import Any

from lobewise.errors import FileError, InputError, describe_problem, require_choice
from lobewise.render.variant import load_mitsuba

BUILT_IN = ("showroom", "brushed", "parlour", "sparks")

DEFAULT_SIZE = 512
"""Pixels a side of a built-in scene."""

LARGEST_SIZE = 32768


def list_scenes() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return BUILT_IN


def load_scene(name_or_path: str | os.PathLike[str], *, width: int | None = None, height: int | None = None) -> Any:
    """Load a built-in scene by name, or a Mitsuba XML file by path.

    Parameters
    ----------
    name_or_path : str or path
        One of `list_scenes`, or anything that ends in ``.xml`` or has a folder.
    width, height : int, optional
        Size of the image; by default that of the file, or 512x512 for a built-in scene. One alone keeps the
        file's aspect.

    Returns
    -------
    mitsuba.Scene

    Raises
    ------
    InputError
        If the name is not that of a scene, the size is not 1 to 32768, or Mitsuba does not understand the file.
    FileError
        If there is no such file, or it cannot be read.
    MissingDependencyError
        If Mitsuba or libLLVM is not installed.
    """
    for name, value in (("width", width), ("height", height)):
        if value is not None and not 1 <= value <= LARGEST_SIZE:
            raise InputError(
                describe_problem(
                    name, expected=f"an integer from 1 to {LARGEST_SIZE}", got=repr(value), action="pass another"
                )
            )
    text = os.fspath(name_or_path)
    if text in BUILT_IN:
        return _load_built_in(text, width or height or DEFAULT_SIZE, height or width or DEFAULT_SIZE)
    path = Path(text)
    if path.suffix.lower() != ".xml" and path.name == text and not path.exists():
        require_choice("scene", text, BUILT_IN)
    return _load_file(path, width, height)


def _load_built_in(name: str, width: int, height: int) -> Any:
    mi = load_mitsuba()
    module = import_module(f"lobewise.render.scenes.{name}")
    return mi.load_dict(module.make_scene(width, height))


def _load_file(path: Path, width: int | None, height: int | None) -> Any:
    if not path.is_file():
        got = "a folder" if path.is_dir() else "nothing there"
        raise FileError(describe_problem(str(path), expected="a Mitsuba XML file", got=got, action="check the path"))
    mi = load_mitsuba()
    try:
        scene = mi.load_file(str(path))
    except (RuntimeError, OSError) as error:
        raise InputError(
            describe_problem(
                str(path),
                expected="a scene that Mitsuba understands",
                got=" ".join(str(error).split()),
                action="mend the file",
            )
        ) from error
    if not isinstance(scene, mi.Scene):
        raise InputError(
            describe_problem(
                str(path), expected="a <scene>", got=f"a {type(scene).__name__}", action="pass the file of a scene"
            )
        )
    if (width or height) and scene.sensors():
        _resize(mi, scene, width, height)
    return scene


def _resize(mi: Any, scene: Any, width: int | None, height: int | None) -> None:
    parameters = mi.traverse(scene.sensors()[0])
    old_width, old_height = (int(value) for value in parameters["film.size"])
    new_width = width or max(1, round(old_width * (height or old_height) / old_height))
    new_height = height or max(1, round(old_height * new_width / old_width))
    parameters["film.size"] = [new_width, new_height]
    parameters.update()
