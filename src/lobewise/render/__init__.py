"""Rendering, the only importer of Mitsuba. Importing this package does not import it: its first use does."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lobewise.errors import MissingDependencyError, describe_problem
from lobewise.render.variant import load_mitsuba

if TYPE_CHECKING:
    from lobewise.render.camera import get_camera, set_camera
    from lobewise.render.camera_path import find_orbit_centre, make_orbit, read_camera_path
    from lobewise.render.interactive import Session
    from lobewise.render.interactive_frame import InteractiveFrame, InteractiveSettings
    from lobewise.render.lookup import open_scene_material
    from lobewise.render.renderer import render_frame, render_pixels, render_reference, render_sparse_frame
    from lobewise.render.scenes import MovingScene, list_moving_scenes, list_scenes, load_scene
    from lobewise.render.sequence import render_sequence

__all__ = [
    "InteractiveFrame",
    "InteractiveSettings",
    "MovingScene",
    "Session",
    "find_orbit_centre",
    "get_camera",
    "list_moving_scenes",
    "list_scenes",
    "load_mitsuba",
    "load_scene",
    "make_orbit",
    "open_scene_material",
    "read_camera_path",
    "render_frame",
    "render_pixels",
    "render_reference",
    "render_sequence",
    "render_sparse_frame",
    "set_camera",
]

_HOMES = {
    "InteractiveFrame": "lobewise.render.interactive_frame",
    "InteractiveSettings": "lobewise.render.interactive_frame",
    "MovingScene": "lobewise.render.scenes",
    "Session": "lobewise.render.interactive",
    "find_orbit_centre": "lobewise.render.camera_path",
    "get_camera": "lobewise.render.camera",
    "list_moving_scenes": "lobewise.render.scenes",
    "list_scenes": "lobewise.render.scenes",
    "load_scene": "lobewise.render.scenes",
    "make_orbit": "lobewise.render.camera_path",
    "open_scene_material": "lobewise.render.lookup",
    "read_camera_path": "lobewise.render.camera_path",
    "render_frame": "lobewise.render.renderer",
    "render_pixels": "lobewise.render.renderer",
    "render_reference": "lobewise.render.renderer",
    "render_sequence": "lobewise.render.sequence",
    "render_sparse_frame": "lobewise.render.renderer",
    "set_camera": "lobewise.render.camera",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    try:
        return getattr(import_module(_HOMES[name]), name)
    except ModuleNotFoundError as error:
        if (error.name or "").split(".")[0] not in ("mitsuba", "drjit"):
            raise
        raise MissingDependencyError(
            describe_problem(
                "rendering",
                expected="the packages mitsuba and drjit",
                got=f"no module {error.name!r}",
                action="pip install 'lobewise[mitsuba]'",
            )
        ) from error
