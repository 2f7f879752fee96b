"""The devices that kernels run on: their names, why a device cannot be used, and their Halide targets.

Vulkan and CUDA are asked through their own libraries, because Halide reports neither names nor reasons.
"""

from __future__ import annotations

import ctypes
import ctypes.util
import os
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

from lobewise.backend.compiler import has_compiler, hl
from lobewise.backend.prebuilt import choose_library
from lobewise.errors import DeviceError, require_choice

DEVICES = ("cpu", "vulkan", "cuda", "metal")
SOFTWARE_TYPE = 4
"""VkPhysicalDeviceType of a device that the processor emulates."""
_GPU_TYPES = (1, 2)
_FEATURES = {
    "vulkan": ("Vulkan", "VulkanV13", "VulkanInt8", "VulkanInt16"),
    "cuda": ("CUDA",),
    "metal": ("Metal",),
}
_CUDA_CAPABILITIES = (30, 32, 35, 50, 61, 70, 75, 80, 86)
CARD_FILES = ("dri", "nvidia*", "dxg")
"""Files in /dev that drivers of graphics cards have: those of Linux, NVIDIA's, and that of Windows around WSL."""
VULKAN_MULTIPLE = 256
"""Sizes of allocations on a device are multiples of so many bytes. Otherwise the allocator of Halide 21's Vulkan
runtime may return too little memory (its issues 8868, 9223 and 9224)."""
VULKAN_BLOCK = 256
"""Memory that the allocator requests from Vulkan at a time, MiB."""


@dataclass(frozen=True)
class Device:
    """A place where kernels run."""

    name: str
    available: bool
    reason: str
    """Description of the device, or why it cannot be used."""
    is_software: bool = False
    """Whether the processor emulates the device, which is useful for tests only."""


@dataclass(frozen=True)
class _Found:
    """A driver's description of the device that Halide will choose."""

    name: str
    is_software: bool = False
    capability: int = 0


class _NoDeviceError(Exception):
    """A device cannot be used; the message says why."""


def list_devices() -> list[Device]:
    """Return all devices that this version has schedules for, whether they can be used here or not."""
    target = _name_host()
    described = f"{target.partition('-')[0]}, {count_host_lanes()} lanes of float32: {target}"
    listed = [Device("cpu", True, described)]
    for name in DEVICES[1:]:
        if not has_compiler():
            listed.append(Device(name, False, "needs Halide: pip install 'lobewise[jit]'"))
            continue
        try:
            seen = _find(name)
            listed.append(Device(name, True, seen.name, seen.is_software))
        except _NoDeviceError as problem:
            listed.append(Device(name, False, str(problem)))
    return listed


def choose_device(name: str) -> str:
    """Return the device of a name; "auto" chooses a graphics card if there is one, else the processor.

    Raises
    ------
    InputError
        If there is no device of that name.
    DeviceError
        If it cannot run here.
    """
    require_choice("device", name, ("auto", *DEVICES))
    if name == "cpu" or (name == "auto" and not may_have_card()):
        return "cpu"
    devices = {device.name: device for device in list_devices()}
    if name == "auto":
        cards = (each for each in ("cuda", "metal", "vulkan") if devices[each].available)
        return next((each for each in cards if not devices[each].is_software), "cpu")
    if not devices[name].available:
        raise DeviceError(
            "device", expected="one that runs here", got=name, action=f"{devices[name].reason}; use --device cpu"
        )
    return name


def may_have_card() -> bool:
    """Return whether this machine may have a graphics card.

    A Vulkan driver in software takes 0.05 s to say that it is software. On Linux files tell that there is no card.
    """
    return sys.platform != "linux" or any(any(Path("/dev").glob(name)) for name in CARD_FILES)


def make_target(device: str) -> hl.Target:
    """Return the target of a device, without Halide's checks of buffers: they are checked before a call."""
    library = choose_library() if device == "cpu" else None
    if library is not None:
        # A kernel that is compiled here runs beside kernels of the library, on vectors of the same width.
        return hl.Target(library.target)
    target = hl.get_host_target()
    names = ["NoAsserts", "NoBoundsQuery", *_FEATURES.get(device, ())]
    if device == "cuda":
        best = max((known for known in _CUDA_CAPABILITIES if known <= _find(device).capability), default=0)
        names += [f"CUDACapability{best}"] if best else []
    for name in names:
        target = target.with_feature(getattr(hl.TargetFeature, name))
    return target


@cache
def count_host_lanes() -> int:
    """Return the number of float32 in a vector of the processor's kernels."""
    library = choose_library()
    return int(hl.get_host_target().natural_vector_size(hl.Float(32))) if library is None else library.lanes


def _name_host() -> str:
    """Return the target of the processor's kernels, as Halide writes it."""
    library = choose_library()
    return str(hl.get_host_target().to_string()) if library is None else library.target


@cache
def _probe(name: str) -> _Found | str:
    finders: dict[str, Callable[[], _Found]] = {
        "vulkan": _look_up_vulkan,
        "cuda": _look_up_cuda,
        "metal": _look_up_metal,
    }
    try:
        return finders[name]()
    except _NoDeviceError as problem:
        return str(problem)


def _find(name: str) -> _Found:
    """Return the description of a device; the driver is asked once per process."""
    probed = _probe(name)
    if isinstance(probed, str):
        raise _NoDeviceError(probed)
    return probed


def _load(names: tuple[str, ...], missing: str) -> ctypes.CDLL:
    for name in names:
        try:
            return ctypes.CDLL(name)
        except OSError:
            continue
    raise _NoDeviceError(missing)


class _InstanceInfo(ctypes.Structure):
    """VkInstanceCreateInfo (Vulkan 1.3, section 4.2)."""

    _fields_ = (
        ("type", ctypes.c_int32),
        ("next", ctypes.c_void_p),
        ("flags", ctypes.c_uint32),
        ("application", ctypes.c_void_p),
        ("layer_count", ctypes.c_uint32),
        ("layers", ctypes.c_void_p),
        ("extension_count", ctypes.c_uint32),
        ("extensions", ctypes.c_void_p),
    )


class _DeviceProperties(ctypes.Structure):
    """The beginning of VkPhysicalDeviceProperties (Vulkan 1.3, section 5.1), with room for its limits."""

    _fields_ = (
        ("api", ctypes.c_uint32),
        ("driver", ctypes.c_uint32),
        ("vendor", ctypes.c_uint32),
        ("device", ctypes.c_uint32),
        ("kind", ctypes.c_int32),
        ("name", ctypes.c_char * 256),
        ("rest", ctypes.c_byte * 2048),
    )


def _look_up_vulkan() -> _Found:
    if sys.platform == "darwin":
        raise _NoDeviceError("not on macOS, which has Metal")
    names = ("vulkan-1.dll",) if sys.platform == "win32" else ("libvulkan.so.1", "libvulkan.so")
    library = _load(names, "no Vulkan loader; install the graphics driver (Debian: libvulkan1)")
    instance = ctypes.c_void_p()
    info = _InstanceInfo(type=1)
    if library.vkCreateInstance(ctypes.byref(info), None, ctypes.byref(instance)) != 0:
        raise _NoDeviceError("no Vulkan driver; install the graphics driver (Debian: mesa-vulkan-drivers)")
    try:
        count = ctypes.c_uint32(16)
        handles = (ctypes.c_void_p * count.value)()
        library.vkEnumeratePhysicalDevices(instance, ctypes.byref(count), handles)
        cards: list[_DeviceProperties] = []
        for handle in handles[: count.value]:
            properties = _DeviceProperties()
            library.vkGetPhysicalDeviceProperties(ctypes.c_void_p(handle), ctypes.byref(properties))
            cards.append(properties)
    finally:
        library.vkDestroyInstance(instance, None)
    if not cards:
        raise _NoDeviceError("no Vulkan device; install the graphics driver (Debian: mesa-vulkan-drivers)")
    # As Halide chooses: the first graphics card, else the first of all.
    chosen = next((each for each in cards if each.kind in _GPU_TYPES), cards[0])
    if chosen.api < (1 << 22 | 3 << 12):
        raise _NoDeviceError("a Vulkan device older than Vulkan 1.3; install a newer driver")
    name = chosen.name.decode("utf-8", "replace")
    return _Found(name, is_software=chosen.kind == SOFTWARE_TYPE)


def _look_up_cuda() -> _Found:
    names = ("nvcuda.dll",) if sys.platform == "win32" else ("libcuda.so.1", "libcuda.so")
    library = _load(names, "no CUDA driver; it comes with NVIDIA's graphics driver")
    count, handle = ctypes.c_int(), ctypes.c_int()
    if library.cuInit(0) != 0 or library.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value == 0:
        raise _NoDeviceError("no CUDA device")
    # As Halide chooses: the last one, unless its environment variable names another.
    visible = os.environ.get("HL_GPU_DEVICE", "")
    library.cuDeviceGet(ctypes.byref(handle), int(visible) if visible.isdigit() else count.value - 1)
    text = ctypes.create_string_buffer(256)
    library.cuDeviceGetName(text, len(text), handle)
    numbers = [ctypes.c_int(), ctypes.c_int()]
    for number, attribute in zip(numbers, (75, 76), strict=True):  # compute capability, major and minor
        library.cuDeviceGetAttribute(ctypes.byref(number), attribute, handle)
    major, minor = (number.value for number in numbers)
    name = text.value.decode("utf-8", "replace")
    return _Found(f"{name}, compute capability {major}.{minor}", capability=10 * major + minor)


def _look_up_metal() -> _Found:
    if sys.platform != "darwin":
        raise _NoDeviceError("only on macOS")
    if not hl.host_supports_target_device(hl.get_host_target().with_feature(hl.TargetFeature.Metal)):
        raise _NoDeviceError("no Metal device")
    return _Found("the system's default Metal device")
