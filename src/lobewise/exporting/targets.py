"""The targets that kernels can be compiled for ahead of time."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from lobewise.backend.compiler import hl
from lobewise.errors import DeviceError, InputError

PROCESSORS = ("x86-32", "x86-64", "arm-32", "arm-64", "wasm-32", "riscv-64")
VULKAN_FEATURES = ("vk_v13", "vk_int8", "vk_int16")
"""Features of a Vulkan device that the kernels need: the mask has one byte per pixel."""
GPU_APIS = {
    "cuda": "Cuda",
    "vulkan": "Vulkan",
    "opencl": "OpenCL",
    "d3d12compute": "D3D12Compute",
    "metal": "Metal",
    "webgpu": "WebGPU",
}
"""Words of a target that name a graphics API, and the names of the API in Halide's headers."""
_SYSTEMS = {"metal": ("osx", "ios"), "d3d12compute": ("windows",)}
"""Systems of a graphics API that not every system has."""


def parse_target(text: str) -> hl.Target:
    """Return the target of a name such as ``x86-64-linux-avx2-fma``; "host" is this machine.

    A Vulkan target also gets the `VULKAN_FEATURES`.

    Raises InputError if the name is unknown, and DeviceError if this Halide cannot compile for the target.
    """
    words = text.split("-")
    if text != "host" and "-".join(words[:2]) not in PROCESSORS and words[0] != "host":
        raise InputError(
            "target",
            expected=f"host, or processor-bits-system and features, with one of {', '.join(PROCESSORS)} first",
            got=repr(text),
            action="such as x86-64-linux-avx2-fma; see lobewise export --help",
        )
    if "vulkan" in words:
        text = "-".join([text, *(word for word in VULKAN_FEATURES if word not in words)])
    try:
        target = hl.Target(text)
    except hl.HalideError:
        raise InputError(
            "target",
            expected="names of processor, system and features that Halide knows",
            got=repr(text),
            action="such as x86-64-linux-avx2-fma; see lobewise export --help",
        ) from None
    apis = [word for word in words if word in GPU_APIS]
    if len(apis) > 1:
        raise refuse_target(text, f"{' and '.join(apis)} at once")
    if apis and not any(system in words for system in _SYSTEMS.get(apis[0], words)):
        raise refuse_target(text, f"{apis[0]} on another system than {' or '.join(_SYSTEMS[apis[0]])}")
    if not target.supported():
        raise refuse_target(text, "no compiler for it inside this Halide")
    return target


def refuse_target(text: str, reason: str) -> DeviceError:
    """Return the error for a target that the kernels cannot be compiled for."""
    return DeviceError(
        f"target {text!r}",
        expected="one that this Halide compiles the kernels for",
        got=reason,
        action="choose one of those that lobewise export --help lists",
    )


@contextmanager
def refusing_target(text: str) -> Iterator[None]:
    """Raise DeviceError with the compiler's reason where it cannot compile for a target."""
    try:
        yield
    except hl.HalideError as problem:
        reason = re.sub(r"\s+", " ", str(problem).removeprefix("Error: ")).strip().rstrip(".!")
        raise refuse_target(text, reason[:1].lower() + reason[1:200]) from problem


def get_gpu_api(target: str) -> str | None:
    """Return the graphics API of a target's name, a key of `GPU_APIS`; None for a target without one."""
    return next((word for word in target.split("-") if word in GPU_APIS), None)


def get_runtime_headers(target: str) -> list[Path]:
    """Return the C headers of Halide's runtime that a program for ``target`` includes."""
    folder = Path(hl.__file__).parent / "include"
    api = get_gpu_api(target)
    names = ["HalideRuntime.h", *([f"HalideRuntime{GPU_APIS[api]}.h"] if api else [])]
    return [folder / name for name in names]
