"""Scenes by name, made in code from spheres, boxes and generated textures; and any scene file of the user's."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lobewise.errors import FileError, InputError, describe_problem, require_choice
from lobewise.render.variant import load_mitsuba

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

BUILT_IN = ("showroom", "brushed", "parlour", "sparks", "stilllife", "corridor", "kitchen", "street")

MOVING = ("showroom", "parlour")
"""Those of them in which objects move."""

DEFAULT_SIZE = 512
"""Pixels a side of a built-in scene."""

LARGEST_SIZE = 32768


def list_scenes() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return BUILT_IN


def list_moving_scenes() -> tuple[str, ...]:
    """Return the names of the built-in scenes in which objects move."""
    return MOVING


def load_scene(
    name_or_path: str | os.PathLike[str],
    *,
    width: int | None = None,
    height: int | None = None,
    time: float = 0.0,
) -> Any:
    """Load a built-in scene by name, or a Mitsuba XML file by path.

    Parameters
    ----------
    name_or_path : str or path
        One of `list_scenes`, or anything that ends in ``.xml`` or has a folder.
    width, height : int, optional
        Size of the image; by default that of the file, or 512x512 for a built-in scene. One alone keeps the
        file's aspect.
    time : float
        Where the objects of a scene of `list_moving_scenes` are, in frames after the beginning; 0 is where they stand
        when nothing moves.

    Returns
    -------
    mitsuba.Scene

    Raises
    ------
    InputError
        If the name is not that of a scene, the size is not 1 to 32768, Mitsuba does not understand the file, or there
        is a time and nothing moves.
    FileError
        If there is no such file, or it cannot be read.
    MissingDependencyError
        If Mitsuba or libLLVM is not installed.

    Notes
    -----
    A built-in scene is the same every time. Of a file Mitsuba merges what it can, in an order that is not: with several
    lights its random numbers differ from load to load.
    """
    for name, value in (("width", width), ("height", height)):
        if value is not None and not 1 <= value <= LARGEST_SIZE:
            raise InputError(
                describe_problem(
                    name, expected=f"an integer from 1 to {LARGEST_SIZE}", got=repr(value), action="pass another"
                )
            )
    text = os.fspath(name_or_path)
    if time != 0.0:
        _require_moving(text)
    if text in BUILT_IN:
        return _load_built_in(text, width or height or DEFAULT_SIZE, height or width or DEFAULT_SIZE, time)
    path = Path(text)
    if path.suffix.lower() != ".xml" and path.name == text and not path.exists():
        require_choice("scene", text, BUILT_IN)
    return _load_file(path, width, height)


@dataclass(frozen=True)
class MovingScene:
    """A built-in scene whose objects move; time is counted in frames.

    Parameters
    ----------
    name : str
        One of `list_moving_scenes`.
    width, height : int, optional
        As `load_scene` takes them.

    Raises
    ------
    InputError
        If nothing moves in that scene, or there is no such scene.
    """

    name: str
    width: int | None = None
    height: int | None = None

    def __post_init__(self) -> None:
        _require_moving(self.name)

    def load(self, time: float = 0.0) -> Any:
        """Return the ``mitsuba.Scene`` at a time."""
        return load_scene(self.name, width=self.width, height=self.height, time=time)

    def find_moves(self, time: float, before: float) -> dict[str, NDArray[np.float64]]:
        """Return, by the id of each moving shape, the matrix that takes its world points at ``time`` to ``before``."""
        # Not at the top: the scenes' names stand in the help of the program, which does not wait for NumPy.
        import numpy as np

        load_mitsuba()
        module = import_module(f"lobewise.render.scenes.{self.name}")
        now, then = (
            {name: np.array(item["to_world"].matrix, dtype=np.float64) for name, item in module.make_movers(at).items()}
            for at in (time, before)
        )
        return {name: then[name] @ np.linalg.inv(matrix) for name, matrix in now.items()}


def _require_moving(name: str) -> None:
    if name not in MOVING:
        raise InputError(
            describe_problem(
                "scene",
                expected=f"one whose objects move: {' or '.join(MOVING)}",
                got=repr(name),
                action="take one of them, or let the camera move alone",
            )
        )


def _load_built_in(name: str, width: int, height: int, time: float) -> Any:
    mi = load_mitsuba()
    module = import_module(f"lobewise.render.scenes.{name}")
    items = module.make_scene(width, height, time) if name in MOVING else module.make_scene(width, height)
    # Mitsuba's optimisation puts shapes and lights into another order each time, and with them the random numbers.
    return mi.load_dict(items, optimize=False)


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
