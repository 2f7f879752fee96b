"""What the exports are tested with: a C compiler, a device for shaders; where CI is set a missing one is a failure."""

import os
import shutil
from pathlib import Path
from typing import Any

import pytest

from lobewise.exporting.names import SHADER_LANGUAGES


def lack(reason: str) -> None:
    """Skip a test, or fail it in CI."""
    if os.environ.get("CI"):
        pytest.fail(f"CI must have it: {reason}")
    pytest.skip(reason)


def locate_program(name: str, package: str) -> str:
    """Return where a program is, or skip or fail and name the Debian package that has it."""
    found = shutil.which(name)
    if found is None:
        lack(f"no {name}; install {package}")
    assert found is not None
    return found


@pytest.fixture(scope="session")
def compiler() -> str:
    """Return the system's C compiler."""
    return locate_program("cc", "gcc")


@pytest.fixture(scope="session")
def cpp() -> str:
    """Return the system's C++ compiler."""
    return locate_program("g++", "g++")


@pytest.fixture(scope="session")
def graphics() -> Any:
    """Return a Vulkan device of wgpu; the software one will do."""
    # The window system's libraries complain of a missing folder, on the terminal.
    os.environ.setdefault("XDG_RUNTIME_DIR", "/tmp")
    try:
        import wgpu
    except ImportError:
        lack("wgpu is not installed: pip install lobewise[dev]")
    found = [each for each in wgpu.gpu.enumerate_adapters_sync() if each.info["backend_type"] == "Vulkan"]
    if not found:
        lack("no Vulkan device; install mesa-vulkan-drivers and libvulkan1")
    return found[0].request_device_sync()


@pytest.fixture(scope="session")
def glslang() -> str:
    """Return the reference compiler of GLSL and HLSL."""
    return locate_program("glslangValidator", "glslang-tools")


@pytest.fixture(scope="session")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder for compiled passes."""
    return tmp_path_factory.mktemp("passes")


@pytest.fixture(
    scope="module",
    params=[name if name == "wgsl" else pytest.param(name, marks=pytest.mark.nightly) for name in SHADER_LANGUAGES],
)
def language(request: pytest.FixtureRequest) -> str:
    """Return a shader language; without the reference compiler only WGSL."""
    if request.param != "wgsl":
        request.getfixturevalue("glslang")
    return str(request.param)
