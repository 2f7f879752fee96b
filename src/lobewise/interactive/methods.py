"""The methods of indirect light by name, each made for the scene when it is first asked for."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from typing import Any

from lobewise.errors import require_choice
from lobewise.render.stages import Stages
from lobewise.render.tracing.points import IndirectMethod

_HOMES = {
    "paths": ("tracing.paths", "PathLight"),
    "voxel_cones": ("voxels.cones", "VoxelCones"),
    "virtual_lights": ("virtual_lights.instant_radiosity", "VirtualLights"),
}

METHODS = tuple(_HOMES)
"""Ways of computing indirect light."""

PREPARED = ("voxel_cones",)
"""Those that take a while to get ready, and tell how far they are."""


class Methods:
    """What computes indirect light in one scene.

    ``progress`` is called with ``(done, total)`` while a method prepares; ``options`` are, by the name of a method,
    arguments of its class that differ from their defaults: InputError where there is none of that name.
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

    def get(self, name: str) -> IndirectMethod:
        """Return a method, ready to shade; InputError if there is none, or the scene has nothing that it needs."""
        require_choice("method", name, METHODS)
        if name not in self._made:
            module, kind = _HOMES[name]
            make = getattr(import_module(f"lobewise.render.{module}"), kind)
            more: dict[str, Any] = {"progress": self._progress} if name in PREPARED else {}
            more.update(self._options.get(name, {}))
            self._made[name] = make(self._stages.scene, self._stages.materials, **more)
        method: IndirectMethod = self._made[name]
        return method

    def update(self) -> None:
        """Take notice of what changed in the scene."""
        for method in self._made.values():
            if hasattr(method, "update"):
                method.update()
