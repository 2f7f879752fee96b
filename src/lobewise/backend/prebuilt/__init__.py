"""Kernels that come compiled with the package: one library for each level of processors, and an index of all kernels.

A wheel for one system brings them along in the folder of this file; a source install has none. A library holds kernels
and Halide's runtime. `releasing/libraries.py` of the repository makes libraries and index.
"""

from __future__ import annotations

import ctypes
import hashlib
import json
import platform
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

from lobewise.backend.compiler import has_compiler
from lobewise.errors import MissingDependencyError

PACKAGE_ROOT = Path(__file__).parents[2]
FOLDER = Path(__file__).parent
INDEX_NAME = "index.json"
_SYSTEMS = {"win32": "windows", "darwin": "macos"}
_MACHINES = {"amd64": "x86-64", "x86_64": "x86-64", "arm64": "arm-64", "aarch64": "arm-64"}


@dataclass(frozen=True)
class Library:
    """A loaded library of kernels.

    Parameters
    ----------
    target : str
        Halide's target that the kernels are compiled for.
    lanes : int
        Number of float32 in a vector of this target.
    kernels : mapping
        By identity (`lobewise.backend.jit.identify_kernel`): name and packed parameters of each kernel.
    code : ctypes.CDLL
        The library.
    """

    target: str
    lanes: int
    kernels: Mapping[str, tuple[str, list[Any]]]
    code: Any = field(repr=False)

    def find(self, name: str) -> int:
        """Return the address of a function; raise LookupError if the library has none of this name."""
        try:
            return int(ctypes.cast(getattr(self.code, name), ctypes.c_void_p).value or 0)
        except AttributeError:
            raise LookupError(name) from None


def name_system() -> str:
    """Return the system and kind of processor that this process runs on, as libraries name them."""
    system = _SYSTEMS.get(sys.platform, "linux" if sys.platform.startswith("linux") else sys.platform)
    machine = platform.machine().lower()
    return f"{system}-{_MACHINES.get(machine, machine)}"


def name_symbol(identity: str) -> str:
    """Return the name of a kernel's function in a library."""
    return f"kernel_{identity}"


@cache
def choose_library() -> Library | None:
    """Return the best library that this processor runs; None if kernels must be compiled.

    Raises
    ------
    MissingDependencyError
        If the libraries are of other code or of another system, and no compiler is installed.
    """
    return open_library(FOLDER)


def has_kernels() -> bool:
    """Return whether kernels can run here: the package brought them along, or a compiler is installed."""
    try:
        return has_compiler() or choose_library() is not None
    except MissingDependencyError:
        return False


def open_library(folder: Path) -> Library | None:
    """Return the best library of a folder; see `choose_library`."""
    try:
        index = json.loads((folder / INDEX_NAME).read_bytes())
    except FileNotFoundError:
        return None
    problem = _describe_problem(index)
    if not problem:
        for level in index["levels"]:
            code = ctypes.CDLL(str(folder / level["file"]))
            if code.lobewise_runs_here():
                # A level lists the kernels whose parameters are not those of the first level.
                return Library(level["target"], level["lanes"], {**index["kernels"], **level["kernels"]}, code)
        problem = f"a processor without the instructions of {index['levels'][-1]['target']}"
    if has_compiler():
        return None
    raise MissingDependencyError(
        "kernels",
        expected="compiled kernels of this code for this machine",
        got=problem,
        action="install lobewise again, or pip install 'lobewise[jit]' to compile them here",
    )


def _describe_problem(index: Mapping[str, Any]) -> str:
    """Return why the libraries of an index cannot be used, or an empty text."""
    if index["system"] != name_system():
        return f"kernels for {index['system']} on {name_system()}"
    for name, digest in index["sources"].items():
        path = PACKAGE_ROOT / name
        if not path.is_file() or digest_source(path) != digest:
            return f"kernels that were made before {name} changed"
    return ""


def digest_source(path: Path) -> str:
    """Return the digest of a module's text, whatever its line breaks."""
    return hashlib.sha256(path.read_bytes().replace(b"\r\n", b"\n")).hexdigest()[:32]
