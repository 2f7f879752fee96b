"""Puts compiled kernels into a wheel and names the system in its tag; without them, the wheel requires their compiler.

The environment variable ``LOBEWISE_KERNELS`` names the folder that `releasing/libraries.py` made, and ``LOBEWISE_SBOM``
the bill of materials that `releasing/wheels.py` wrote, which comes to the folder ``sboms`` of the metadata (PEP 770).
Without kernels the wheel is for every system, and pip installs what ``lobewise[jit]`` adds along with it, wherever that
exists.
"""

from __future__ import annotations

import json
import os
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

COMPILER_EXTRA = "jit"
HALIDE_EXISTS = "python_version < '3.14' and (sys_platform != 'linux' or platform_machine == 'x86_64')"
"""Where Halide 21 has wheels, as a marker of PEP 508. Elsewhere a requirement would stop pip."""


class KernelsHook(BuildHookInterface):
    """Hook of the builds of wheels and source distributions."""

    PLUGIN_NAME = "custom"

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Add the libraries and their index to the wheel, or else the requirements of the compiler."""
        folder = os.environ.get("LOBEWISE_KERNELS", "")
        if not folder or self.target_name != "wheel" or version == "editable":
            compiler = self.metadata.core.optional_dependencies[COMPILER_EXTRA]
            build_data["dependencies"] += [f"{package}; {HALIDE_EXISTS}" for package in compiler]
            return
        index = json.loads((Path(folder) / "index.json").read_bytes())
        build_data["pure_python"] = False
        build_data["tag"] = f"py3-none-{index['wheel']}"
        build_data["force_include"][folder] = "lobewise/backend/prebuilt"
        build_data["sbom_files"].append(os.environ["LOBEWISE_SBOM"])
