"""What must be alike on every machine, so that every frame has the bits that one process gives it."""

from __future__ import annotations

import platform
from collections.abc import Mapping

import lobewise

DISTRIBUTIONS = {"NumPy": "numpy", "Halide": "halide", "OpenEXR": "OpenEXR"}
"""Libraries that take part in every result, by the name that users know."""
PEER = ("Open Image Denoise", "pyoidn")


def describe_environment(*, with_oidn: bool) -> dict[str, str]:
    """Return the versions of this process by name; ``with_oidn`` includes Open Image Denoise, or "none"."""
    versions = {"lobewise": lobewise.__version__, "Python": shorten_version(platform.python_version())}
    versions |= {name: _look_up_version(distribution) for name, distribution in DISTRIBUTIONS.items()}
    if with_oidn:
        from lobewise.peers import has_oidn

        versions[PEER[0]] = _look_up_version(PEER[1]) if has_oidn() else "none"
    return versions


def shorten_version(text: str) -> str:
    """Return the first two numbers of a version of Python; the third changes no result."""
    return ".".join(text.split(".")[:2])


def compare_environments(here: Mapping[str, str], there: Mapping[str, str]) -> str:
    """Return the first difference, such as "Halide 20.0.0 instead of 21.0.0"; empty where there is none."""
    for name, version_here in here.items():
        if there.get(name, "none") != version_here:
            return f"{name} {there.get(name, 'none')} instead of {version_here}"
    return ""


def _look_up_version(distribution: str) -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(distribution)
    except PackageNotFoundError:
        return "none"
