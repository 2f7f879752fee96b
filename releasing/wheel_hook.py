"""Puts compiled kernels into a wheel, and names the system in its tag.

The environment variable ``LOBEWISE_KERNELS`` names the folder that `releasing/libraries.py` made. Without it the wheel
is for every system, and has no compiled kernels.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface


class KernelsHook(BuildHookInterface):
    """Hook of the build of wheels; an editable install has no compiled kernels."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the libraries and their index to the wheel."""
        folder = os.environ.get("LOBEWISE_KERNELS", "")
        if not folder or version == "editable":
            return
        index = json.loads((Path(folder) / "index.json").read_bytes())
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{index['wheel']}"
        build_data["force_include"][folder] = "lobewise/backend/prebuilt"
