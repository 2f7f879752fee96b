"""The browser viewer, the only importer of viser. Importing this package imports neither viser nor a renderer."""

from __future__ import annotations

from lobewise.viewer.looks import FrameLook, SceneLook
from lobewise.viewer.server import Viewer

__all__ = ["FrameLook", "SceneLook", "Viewer"]
