"""The program, Python, the platform, the terminal, and what renders and filters: devices, kernels, LLVM."""

from __future__ import annotations

import os
import platform
import shutil
import sys
import time
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import lobewise
from lobewise.backend.devices import list_devices
from lobewise.backend.prebuilt import choose_library, has_kernels
from lobewise.cli.bench.machine import describe_machine
from lobewise.cli.doctor.report import Problem, Section, name_path
from lobewise.errors import LobewiseError, MissingDependencyError
from lobewise.render.variant import LIBRARY_VARIABLE, locate_llvm, query_llvm_version
from lobewise.work.limits import GIB, measure_machine_memory

TEST_PIXELS = 16
"""Width and height of the image that is filtered as a test."""


def examine_program() -> Section:
    """Return which lobewise runs."""
    facts = {"version": lobewise.__version__, "folder": name_path(Path(lobewise.__file__).parent)}
    commit = describe_machine().get("commit")
    return Section("lobewise", {**facts, **({"commit": commit} if commit else {})})


def examine_python() -> Section:
    """Return which Python runs."""
    kind = "virtual" if sys.prefix != sys.base_prefix else "conda" if os.environ.get("CONDA_PREFIX") else "none"
    return Section(
        "Python",
        {
            "version": f"{platform.python_version()} ({platform.python_implementation()})",
            "program": name_path(sys.executable or "unknown"),
            "environment": kind,
        },
    )


def examine_platform() -> Section:
    """Return system, processor and memory."""
    machine = describe_machine()
    facts = {
        "system": platform.platform(),
        "machine": platform.machine(),
        "processor": machine["processor"],
        "cores": f"{machine['cores']}, of which filters use {machine['threads']}",
    }
    size = measure_machine_memory()
    memory = {} if size is None else {"memory": f"{size / GIB:.1f} GiB"}
    return Section("Platform", facts | memory)


def examine_terminal() -> Section:
    """Return what standard output is."""
    columns, rows = shutil.get_terminal_size((80, 24))
    stream = sys.stdout
    return Section(
        "Terminal",
        {
            "output": "a terminal" if stream is not None and stream.isatty() else "a file or a pipe",
            "size": f"{columns} columns, {rows} rows",
            "encoding": getattr(stream, "encoding", None) or "unknown",
            "TERM": os.environ.get("TERM", "") or "not set",
            "colours": "off (NO_COLOR)" if os.environ.get("NO_COLOR") else "as the terminal has them",
        },
    )


def examine_devices() -> Section:
    """Return the devices on which filters run. A machine without a graphics card has no problem."""
    try:
        devices = list_devices()
    except LobewiseError as problem:
        return Section("Devices", {"cpu": f"no: {problem}"})
    facts = {}
    for one in devices:
        emulated = ", emulated by the processor" if one.is_software else ""
        facts[one.name] = f"{'yes' if one.available else 'no'}: {one.reason}{emulated}"
    return Section("Devices", facts)


def examine_kernels() -> Section:
    """Return where kernels come from, and whether one runs."""
    facts = {}
    try:
        library = choose_library()
        facts["in the package"] = "none" if library is None else library.target
    except LobewiseError as problem:
        facts["in the package"] = f"none: {problem}"
    facts["compiler"] = f"Halide {_look_up_version('halide')}, llvmlite {_look_up_version('llvmlite')}"
    start = time.perf_counter()
    try:
        _filter_image()
    except Exception as problem:  # whatever stops a filter is what the report is for
        facts["test"] = "failed"
        reason, action = str(problem).rstrip("."), "do what the message says, or report it"
        if isinstance(problem, MissingDependencyError):
            reason, action = problem.fault, problem.action
        reason = " ".join(reason.split()) or type(problem).__name__
        what, is_fatal = f"no filter of lobewise runs on the processor ({reason})", has_kernels() or not _has_peer()
        what += "" if is_fatal else ", so Open Image Denoise denoises alone"
        return Section("Kernels", facts, (Problem(what, action, is_fatal),))
    size = f"{TEST_PIXELS}x{TEST_PIXELS}"
    facts["test"] = f"filtered an image of {size} pixels in {time.perf_counter() - start:.2f} s"
    return Section("Kernels", facts)


def examine_mitsuba() -> Section:
    """Return whether `lobewise render` and `view` can render: Mitsuba, and LLVM for the processor."""
    version = _look_up_version("mitsuba")
    if version == "not installed":
        return Section("Mitsuba", {"mitsuba": "not installed; needed to render (pip install 'lobewise[mitsuba]')"})
    try:
        path = locate_llvm()
    except MissingDependencyError as problem:
        found = Problem(f"rendering: {problem.fault}", problem.action)
        return Section("Mitsuba", {"mitsuba": version, "LLVM": "none"}, (found,))
    facts = {"mitsuba": version, "LLVM": f"{query_llvm_version(path)}, {path}"}
    named = os.environ.get(LIBRARY_VARIABLE)
    return Section("Mitsuba", {**facts, LIBRARY_VARIABLE: named} if named else facts)


def _has_peer() -> bool:
    try:
        from lobewise.peers import has_oidn
    except ImportError:
        return False  # without NumPy, which is a problem of its own
    return has_oidn()


def _filter_image() -> None:
    """Filter a small image on the processor."""
    # The report must be made where NumPy cannot be imported.
    import numpy as np

    side = TEST_PIXELS
    color = np.full((side, side, 3), 0.5, np.float32)
    normal = np.zeros((side, side, 3), np.float32)
    normal[..., 2] = 1.0
    frame = lobewise.Frame(lobewise.Radiance(color), lobewise.GBuffer(normal=normal))
    image = lobewise.denoise(frame, quality="fast", similarity="normal", radius=1, device="cpu", with_oidn=False).image
    if not np.allclose(image, color, atol=1e-3):
        raise RuntimeError("an even image came out uneven")


def _look_up_version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "not installed"
