"""The built-in scenes by name, described in plain Python; importing this loads nothing else."""

from __future__ import annotations

from importlib import import_module
from typing import Any

BUILT_IN = ("showroom", "brushed", "parlour", "sparks", "stilllife", "corridor", "kitchen", "street")

MOVING = ("showroom", "parlour")
"""Those of them in which objects move."""


def list_scenes() -> tuple[str, ...]:
    """Return the names of the built-in scenes."""
    return BUILT_IN


def list_moving_scenes() -> tuple[str, ...]:
    """Return the names of the built-in scenes in which objects move."""
    return MOVING


def describe_scene(name: str, width: int, height: int, time: float = 0.0) -> dict[str, Any]:
    """Return a scene of `list_scenes` at a time, in frames, as `lobewise.render.loading.build_scene` takes it."""
    module = import_module(f"lobewise.scenes.{name}")
    items: dict[str, Any] = (
        module.make_scene(width, height, time) if name in MOVING else module.make_scene(width, height)
    )
    return items


def describe_movers(name: str, time: float) -> dict[str, dict[str, Any]]:
    """Return the shapes that move of one of `list_moving_scenes`, by their ids, as they are at a time."""
    movers: dict[str, dict[str, Any]] = import_module(f"lobewise.scenes.{name}").make_movers(time)
    return movers
