"""The methods of computing indirect light by name. Each is prepared for the scene when it is first used."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from importlib import import_module
from typing import Any

from lobewise.errors import require_choice
from lobewise.interactive.settings import METHODS
from lobewise.render.moving.shapes import Box
from lobewise.render.stages import Stages
from lobewise.render.tracing.own_samples import OwnLight
from lobewise.render.tracing.points import IndirectMethod

_HOMES: dict[str, tuple[str, str]] = {
    "paths": ("tracing.paths", "PathLight"),
    "voxel_cones": ("voxels.cones", "VoxelCones"),
    "virtual_lights": ("virtual_lights.instant_radiosity", "VirtualLights"),
}
"""Module below `lobewise.render` and class of each method."""
_USUAL: dict[str, dict[str, Any]] = {"virtual_lights": {"kind": "gaussians"}}
"""Arguments of classes that options may replace. Clusters of lights have less error than points in every scene of
docs/developers/virtual_lights.md."""
_WITH_PROGRESS = ("voxel_cones",)
"""Methods that take seconds to prepare, and call ``progress`` meanwhile."""


class Methods:
    """The methods of computing indirect light in one scene.

    ``progress`` is called with ``(done, total)`` while a method prepares. ``options`` gives, by the name of a method,
    arguments of its class. Raises InputError if ``options`` names an unknown method.
    """

    def __init__(
        self,
        stages: Stages,
        progress: Callable[[int, int], None] | None = None,
        options: Mapping[str, Mapping[str, Any]] | None = None,
    ) -> None:
        for name in options or {}:
            require_choice("method", name, METHODS)
        self._stages = stages
        self._progress = progress
        self._options = dict(options or {})
        self._made: dict[str, Any] = {}
        self._pending: dict[str, list[Box] | None] = {}
        """Changes that methods have not followed, by their names; see `_update`."""

    def get(self, name: str) -> IndirectMethod:
        """Return a method, ready to shade.

        Raises InputError if there is no such method, or if the scene has nothing for it to work with.
        """
        require_choice("method", name, METHODS)
        if name not in self._made:
            self._made[name] = self._make(name)
        if name in self._pending:
            _update(self._made[name], self._pending.pop(name))
        method: IndirectMethod = self._made[name]
        return method

    def _make(self, name: str) -> Any:
        stages = self._stages
        if name == "paths" and stages.own_light is not None:
            return OwnLight(stages.scene, stages.own_light)
        module, kind = _HOMES[name]
        make = getattr(import_module(f"lobewise.render.{module}"), kind)
        more: dict[str, Any] = {"progress": self._progress} if name in _WITH_PROGRESS else {}
        if name == "paths":
            more.update(max_depth=stages.max_depth, through=True)
        return make(stages.scene, stages.materials, **{**more, **_USUAL.get(name, {}), **self._options.get(name, {})})

    def advance(self, name: str) -> None:
        """Prepare a method for the next frame: make it, let it follow the scene, or refine it after a change."""
        is_made = name in self._made and name not in self._pending
        method: Any = self.get(name)
        if is_made and hasattr(method, "refine"):
            method.refine()

    def note_move(self, boxes: Sequence[Box]) -> None:
        """Let each method follow shapes that moved, when it is next used; ``boxes`` held them before and after."""
        for name in self._made:
            pending = self._pending.setdefault(name, [])
            if pending is not None:
                pending.extend(boxes)

    def note_lights(self) -> None:
        """Let each method follow lights that changed, when it is next used."""
        self.note_move([])

    def note_scene(self) -> None:
        """Prepare each method anew, when it is next used."""
        self._pending.update(dict.fromkeys(self._made))


def _update(method: Any, boxes: Sequence[Box] | None) -> None:
    """Let a method follow a change of the scene.

    Shapes moved within some boxes, lights changed if there are no boxes, and anything may have changed if ``boxes`` is
    None.
    """
    if boxes and hasattr(method, "update_shapes"):
        method.update_shapes(boxes)
    elif boxes is not None and not boxes and hasattr(method, "update_lights"):
        method.update_lights()
    elif hasattr(method, "update"):
        method.update()
