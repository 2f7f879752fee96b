"""The built-in scenes, described in plain Python. Importing this package loads no scene."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

from lobewise.errors import InputError, require_choice

BUILT_IN = ("showroom", "brushed", "parlour", "sparks", "stilllife", "corridor", "kitchen", "street")

MOVING = ("showroom", "parlour")
"""Scenes with moving objects."""

BY_THEMSELVES = "by-themselves"
"""Word for the motion of these scenes' own objects, in place of the name of a file with paths."""


def list_scenes() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return BUILT_IN


def require_scene(scene: str) -> None:
    """Raise InputError or FileError unless a scene is built in, or a file."""
    from lobewise.io.files import require_readable

    path = Path(scene)
    if scene in BUILT_IN:
        return
    refuse_blender(path)
    if path.suffix.lower() != ".xml" and path.name == scene and not path.exists():
        require_choice("scene", scene, BUILT_IN)
    require_readable(path, what="scene")


def refuse_blender(path: Path) -> None:
    """Raise InputError for the name of a Blender file: Mitsuba cannot read it."""
    if path.suffix.lower() == ".blend":
        action = "render it in Blender to multilayer EXR, and pass that to lobewise denoise or view"
        raise InputError("scene", expected="a Mitsuba XML file", got=f"the Blender file {str(path)!r}", action=action)


def list_moving_scenes() -> tuple[str, ...]:
    """Return the names of the built-in scenes in which objects move."""
    return MOVING


def describe_scene(name: str, width: int, height: int, time: float = 0.0) -> dict[str, Any]:
    """Return the description of a scene of `list_scenes`, at a time in frames, for `lobewise.render.loading`."""
    module = import_module(f"lobewise.scenes.{name}")
    items: dict[str, Any] = (
        module.make_scene(width, height, time) if name in MOVING else module.make_scene(width, height)
    )
    return items


def describe_movers(name: str, time: float) -> dict[str, dict[str, Any]]:
    """Return the moving shapes of a scene of `list_moving_scenes` at a time in frames, by their ids."""
    movers: dict[str, dict[str, Any]] = import_module(f"lobewise.scenes.{name}").make_movers(time)
    return movers
