"""Rendering, the only importer of Mitsuba. Importing this package does not import it: its first use does."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from lobewise.render.variant import load_mitsuba

if TYPE_CHECKING:
    from lobewise.render.camera import get_camera, set_camera
    from lobewise.render.camera_path import find_orbit_centre, make_orbit, read_camera_path
    from lobewise.render.loading import MovingScene, load_scene
    from lobewise.render.materials.lookup import open_scene_material
    from lobewise.render.renderer import render_frame, render_pixels, render_reference, render_sparse_frame
    from lobewise.render.sequence import render_sequence
    from lobewise.scenes import list_moving_scenes, list_scenes

__all__ = [
    "MovingScene",
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
    "MovingScene": "lobewise.render.loading",
    "find_orbit_centre": "lobewise.render.camera_path",
    "get_camera": "lobewise.render.camera",
    "list_moving_scenes": "lobewise.scenes",
    "list_scenes": "lobewise.scenes",
    "load_scene": "lobewise.render.loading",
    "make_orbit": "lobewise.render.camera_path",
    "open_scene_material": "lobewise.render.materials.lookup",
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
    return getattr(import_module(_HOMES[name]), name)
