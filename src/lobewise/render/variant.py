"""Finds a libLLVM that works, imports Mitsuba with it, and sets its variant. No other module sets them."""

from __future__ import annotations

import ctypes
import glob
import os
import re
import subprocess
import sys
from collections.abc import Iterable
from typing import Any

from lobewise.errors import DeviceError, MissingDependencyError, require_choice

LIBRARY_VARIABLE = "DRJIT_LIBLLVM_PATH"
"""Environment variable with the path of the LLVM library that Dr.Jit loads."""

MIN_LLVM = 16
"""Oldest major version of LLVM that works. LLVM 15 crashes on the instruction ``fminimum`` of Mitsuba 3.9."""

PREFERRED_LLVM = 19
"""Major version of LLVM that the tests run with."""

VARIANTS = {"cpu": "llvm_ad_rgb", "cuda": "cuda_ad_rgb"}

_SEARCH_PATTERNS = {
    "linux": (
        "/usr/lib/*-linux-gnu/libLLVM*.so*",
        "/usr/lib/llvm-*/lib/libLLVM*.so*",
        "/usr/lib/llvm*/lib*/libLLVM*.so*",
        "/usr/lib64/libLLVM*.so*",
        "/usr/lib64/llvm*/lib*/libLLVM*.so*",
        "/usr/lib/libLLVM*.so*",
        "/usr/local/lib/libLLVM*.so*",
        "/usr/local/llvm*/lib/libLLVM*.so*",
    ),
    "darwin": (
        "/opt/homebrew/opt/llvm*/lib/libLLVM*.dylib",
        "/usr/local/opt/llvm*/lib/libLLVM*.dylib",
        "/opt/local/libexec/llvm-*/lib/libLLVM*.dylib",
    ),
}


def parse_llvm_version(path: str) -> int | None:
    """Return the major version in a library's path, or None.

    Examples
    --------
    >>> parse_llvm_version("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1"), parse_llvm_version("/opt/libLLVM.so")
    (19, None)
    """
    folder, name = os.path.split(path)
    for text, pattern in (
        (name, r"libLLVM[-.]?(\d+)"),
        (name, r"libLLVM\.(?:so|dylib)\.(\d+)"),
        (folder, r"llvm[-@]?(\d+)"),
    ):
        match = re.search(pattern, text)
        if match:
            return int(match.group(1))
    return None


def query_llvm_version(path: str) -> int | None:
    """Return the major version that the library reports, or None if it cannot be loaded or is older than 16.

    LLVM's C interface has ``LLVMGetVersion`` since version 16.
    """
    try:
        library = ctypes.CDLL(path)
        get_version = library.LLVMGetVersion
    except (OSError, AttributeError):
        return None
    major, minor, patch = ctypes.c_uint(), ctypes.c_uint(), ctypes.c_uint()
    get_version(ctypes.byref(major), ctypes.byref(minor), ctypes.byref(patch))
    return int(major.value)


def list_llvm_libraries() -> list[str]:
    """Return the paths of all libLLVM in the usual places and in the linker's cache."""
    patterns = list(_SEARCH_PATTERNS.get(sys.platform, ()))
    if os.environ.get("CONDA_PREFIX"):
        patterns.append(os.path.join(os.environ["CONDA_PREFIX"], "lib", "libLLVM*"))
    paths = [path for pattern in patterns for path in sorted(glob.glob(pattern))]
    if sys.platform == "linux":
        paths += _list_linker_cache()
    return list(dict.fromkeys(paths))


def _list_linker_cache() -> list[str]:
    for program in ("ldconfig", "/sbin/ldconfig", "/usr/sbin/ldconfig"):
        try:
            listing = subprocess.run([program, "-p"], capture_output=True, text=True, timeout=10, check=True).stdout
        except (OSError, subprocess.SubprocessError):
            continue
        return re.findall(r"=> (\S*libLLVM\S*)", listing)
    return []


def rank_llvm_libraries(paths: Iterable[str]) -> list[str]:
    """Return the libraries worth trying: the preferred version first, then newest first, unknown versions last."""
    known = [(parse_llvm_version(path), path) for path in paths]
    usable = [(version, path) for version, path in known if version is None or version >= MIN_LLVM]
    usable.sort(key=lambda item: (item[0] is None, item[0] != PREFERRED_LLVM, -(item[0] or 0), len(item[1])))
    return [path for _, path in usable]


def locate_llvm() -> str:
    """Return the path of a libLLVM that Mitsuba can use: that in `LIBRARY_VARIABLE` if it is set.

    Raises
    ------
    MissingDependencyError
        If there is no libLLVM of version 16 or newer, or the library in the variable does not load or is too old.
    """
    chosen = os.environ.get(LIBRARY_VARIABLE)
    if chosen:
        version = query_llvm_version(chosen)
        if version is None or version < MIN_LLVM:
            expected = f"the path of a libLLVM of version {MIN_LLVM} or newer"
            action = "unset it to search the usual places, or name another library"
            raise MissingDependencyError(LIBRARY_VARIABLE, expected=expected, got=chosen, action=action)
        return chosen
    candidates = list_llvm_libraries()
    for path in rank_llvm_libraries(candidates):
        if (query_llvm_version(path) or 0) >= MIN_LLVM:
            return path
    raise MissingDependencyError(
        "libLLVM",
        expected=f"version {MIN_LLVM} or newer, which Mitsuba needs to render on the CPU",
        got=", ".join(candidates) if candidates else "none on this machine",
        action="install it (Debian and Ubuntu: apt install libllvm19; Fedora: dnf install llvm-libs; "
        f"macOS: brew install llvm), or set {LIBRARY_VARIABLE} to its path",
    )


def load_mitsuba(device: str = "auto") -> Any:
    """Import Mitsuba with a variant that the renderer supports, and return the module.

    Parameters
    ----------
    device : {"auto", "cpu", "cuda"}
        ``auto`` keeps a supported variant that is already set. Otherwise it takes CUDA if Dr.Jit finds a device, and
        the CPU if not.

    Raises
    ------
    InputError
        If ``device`` is none of the three.
    MissingDependencyError
        If the ``mitsuba`` package is not installed, or on the CPU no libLLVM that works.
    DeviceError
        If CUDA was asked for and is not available, or another supported variant is already in use.
    """
    require_choice("device", device, ("auto", *VARIANTS))
    from lobewise.render.bridge import dr, mi

    current = mi.variant()
    if current in VARIANTS.values():
        if device != "auto" and VARIANTS[device] != current:
            action = "start another process: scenes cannot move between Mitsuba's variants"
            raise DeviceError("device", expected=f"the one in use, {current}", got=repr(device), action=action)
        return mi

    has_cuda = bool(dr.has_backend(dr.JitBackend.CUDA)) if device != "cpu" else False
    if device == "cuda" and not has_cuda:
        got = "none that Dr.Jit can use"
        raise DeviceError("device 'cuda'", expected="an NVIDIA GPU and its driver", got=got, action="pass device='cpu'")
    chosen = "cuda" if has_cuda else "cpu"
    if chosen == "cpu" and sys.platform != "win32":  # on Windows Dr.Jit searches PATH for LLVM-C.dll itself
        os.environ[LIBRARY_VARIABLE] = locate_llvm()
    mi.set_variant(VARIANTS[chosen])
    return mi
