"""Halide, which compiles kernels, and llvmlite, which loads them: both come with the extra ``lobewise[jit]``.

Modules that define kernels read `hl` as if it were ``import halide as hl``. Where Halide is not installed they can
still be imported, and the kernels that the package brings along still run; to define another kernel raises an error.
"""

from __future__ import annotations

import importlib.util
import platform
import sys
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lobewise.errors import FileError, MissingDependencyError

__all__ = [
    "choose_remedy",
    "declare_vars",
    "has_compiler",
    "hl",
    "is_installed",
    "load_llvm",
    "look_up_version",
    "refuse_compiling",
    "refuse_folder",
]

PYTHON_WITHOUT_HALIDE = (3, 14)
"""First Python for which Halide 21 has no wheels."""


def refuse_compiling(got: str) -> MissingDependencyError:
    """Return the error for a kernel that must be compiled where the compiler is absent; ``got`` says what came.

    Where both packages are installed the system did not let them load, most often for want of memory.
    """
    if is_installed():
        remedy = (
            "they are installed, but do not load: raise the memory limit of this process (ulimit -v), or reinstall them"
        )
    else:
        remedy = choose_remedy(sys.version_info[:2], sys.platform, platform.machine())
    return MissingDependencyError(
        "kernels",
        expected="Halide and llvmlite, to compile a kernel that is not in the package",
        got=got,
        action=remedy,
    )


def refuse_folder() -> FileError:
    """Return the error for a compiler that cannot make its temporary folder. It asks for ``/tmp``, not for TMPDIR."""
    return FileError(
        "kernels",
        expected="a folder /tmp that can be written, which Halide needs to compile a kernel",
        got="a folder that is read-only, full or missing",
        action="mount one there (docker run --tmpfs /tmp), let LOBEWISE_CACHE name a folder of compiled kernels, "
        "or install a wheel for this system, which brings its kernels along",
    )


def choose_remedy(python: tuple[int, ...], system: str, machine: str) -> str:
    """Return what to do where Halide is absent: install it where it has a wheel, else go where it has one."""
    if system == "linux" and machine != "x86_64":
        return f"use another machine: Halide has no wheel for Linux on {machine}"
    if python >= PYTHON_WITHOUT_HALIDE:
        return "use Python 3.10 to 3.13, for which Halide has wheels"
    return "pip install 'lobewise[jit]'"


class _Absent:
    """Stands for Halide's module where it cannot be imported."""

    def __init__(self, problem: str) -> None:
        self._problem = problem

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            # Python itself asks modules for such names, to print them for instance.
            raise AttributeError(name)
        raise refuse_compiling(self._problem)


if TYPE_CHECKING:
    import halide as hl
else:
    try:
        import halide as hl
    except (ImportError, OSError) as problem:
        hl = _Absent(str(problem))


def is_installed() -> bool:
    """Return whether the packages of the extra ``lobewise[jit]`` are here, whether they load or not."""
    return all(importlib.util.find_spec(name) for name in ("halide", "llvmlite"))


def has_compiler() -> bool:
    """Return whether kernels can be compiled here."""
    return not isinstance(hl, _Absent)


def declare_vars(*names: str) -> tuple[Any, ...]:
    """Return Halide's variables for the coordinates of kernels; None for each where Halide is absent."""
    return tuple(hl.Var(name) if has_compiler() else None for name in names)


@cache
def look_up_version() -> str:
    """Return Halide's version from the name of the folder that `pip` keeps beside it.

    `importlib.metadata` would import a library for mails, and parse the description of the package.
    """
    folder = next(Path(hl.__file__).parents[1].glob("halide-*.dist-info"), None)
    return "" if folder is None else folder.stem.partition("-")[2]


@cache
def load_llvm() -> Any:
    """Return llvmlite's binding of LLVM; raise MissingDependencyError if it is absent."""
    try:
        return importlib.import_module("llvmlite.binding")
    except (ImportError, OSError) as problem:
        raise refuse_compiling(str(problem)) from problem
