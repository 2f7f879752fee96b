"""The one seam to the devices: which there are and why one is missing, compiled kernels, buffers, calls."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.errors import DeviceError, InputError, describe_problem, require_choice
from lobewise.frame import FloatArray
from lobewise.kernels.cross_filter import SUM_CHANNELS, PassKey, Taps, describe_structure, make_pass
from lobewise.kernels.features import Feature
from lobewise.kernels.schedules import schedule_cpu

DEVICES = ("cpu",)
FORMS = ("full", "separable", "atrous")
ATROUS_LEVELS = 5


@dataclass(frozen=True)
class Device:
    """A place where kernels run."""

    name: str
    available: bool
    reason: str
    """What it is, or why it cannot be used."""


def list_devices() -> list[Device]:
    """Return every device that this version has schedules for."""
    target = hl.get_host_target()
    lanes = target.natural_vector_size(hl.Float(32))
    return [Device("cpu", True, f"{target.arch.name.lower()}, {lanes} lanes of float32: {target.to_string()}")]


def choose_device(name: str) -> str:
    """Return the device for ``name`` ("auto" takes the fastest that is available).

    Raises
    ------
    InputError
        If there is no device of that name.
    DeviceError
        If it cannot run here.
    """
    require_choice("device", name, ("auto", *DEVICES))
    devices = {device.name: device for device in list_devices()}
    if name == "auto":
        return "cpu"
    if not devices[name].available:
        raise DeviceError(
            describe_problem(
                "device", expected="one that runs here", got=name, action=f"{devices[name].reason}; use --device cpu"
            )
        )
    return name


def _borrow(array: NDArray[Any]) -> NDArray[Any]:
    """Return a writable view of ``array``: Halide's Python buffers refuse read-only memory even for inputs."""
    if array.flags.writeable:
        return array
    pointer = (ctypes.c_byte * max(array.nbytes, 1)).from_address(array.ctypes.data)
    view: NDArray[Any] = np.frombuffer(memoryview(pointer), dtype=array.dtype, count=array.size).reshape(array.shape)
    return view


class _KernelCache:
    """Compiled passes of this process, by structure; safe to use from several threads."""

    def __init__(self) -> None:
        self._kernels: dict[tuple[str, PassKey], Any] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kernels)

    def get(self, device: str, key: PassKey, features: Sequence[Feature]) -> Any:
        with self._lock:
            if (device, key) not in self._kernels:
                target = hl.get_host_target()
                funcs = make_pass(key, features)
                schedule_cpu(funcs, target)
                self._kernels[device, key] = hl.Pipeline(funcs.out).compile_to_callable(funcs.arguments, target)
            return self._kernels[device, key]


_cache = _KernelCache()


def count_compiled_kernels() -> int:
    """Return how many kernels this process has compiled."""
    return len(_cache)


def _take_array(feature: Feature, array: NDArray[Any], size: tuple[int, int]) -> FloatArray:
    """Return an input of a feature as the kernels take it; raise InputError where it is no image of this size."""
    if array.ndim not in (2, 3) or array.shape[:2] != size or array.dtype.kind not in "fiub":
        raise InputError(
            describe_problem(
                f"an array of feature {feature.name!r}",
                expected=f"real numbers of shape {size} or {(*size, 'channels')}",
                got=f"{array.dtype} of shape {array.shape}",
                action="give one value, or one row of channels, for every pixel of the frame",
            )
        )
    return np.ascontiguousarray(array, dtype=np.float32)


@dataclass(frozen=True)
class FilterOutput:
    """What a filter run gives.

    Parameters
    ----------
    image : (height, width, 3)
        Filtered radiance; 0 where no tap had any weight.
    weight_sum, effective_samples : (height, width)
        Sum of the weights; ``(sum w)^2 / sum w^2``.
    """

    image: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray


def run_filter(
    radiance: FloatArray,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    *,
    form: str,
    radius: int,
    albedo: FloatArray | None = None,
    device: str = "cpu",
) -> FilterOutput:
    """Run the cross filter.

    Parameters
    ----------
    radiance : array, shape (height, width, 3)
        Linear radiance. NaN, infinite and negative pixels get weight 0 and are filled from their neighbours.
    mask : bool array, shape (height, width)
        False where a pixel has no meaning for these features: it neither gives nor takes.
    features : sequence of Feature
        Their similarities are multiplied.
    form : {"full", "separable", "atrous"}
        All (2r+1)^2 taps; a row pass and a column pass; five 5x5 passes with doubling steps (``radius`` is unused).
    radius : int
        Kernel radius, pixels, >= 0.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance on the way in and multiplies it on the way out.
    device : str
        A name from `list_devices`.

    Returns
    -------
    FilterOutput
    """
    structure = tuple(describe_structure(feature) for feature in features)
    passes: list[tuple[Taps, int, int]]
    if form == "full":
        passes = [(Taps.SQUARE, radius, 1)]
    elif form == "separable":
        passes = [(Taps.HORIZONTAL, radius, 1), (Taps.VERTICAL, radius, 1)]
    else:
        require_choice("form", form, FORMS)
        passes = [(Taps.ATROUS, 0, 2**level) for level in range(ATROUS_LEVELS)]
    height, width = mask.shape
    # Every array is held in a local name until the last call has returned: Halide keeps no reference.
    mask_bytes = np.ascontiguousarray(mask).view(np.uint8)
    held: list[NDArray[Any]] = [
        mask_bytes,
        *(_take_array(feature, array, (height, width)) for feature in features for array in feature.get_arrays()),
    ]
    parameters = [value for feature in features for value in feature.get_parameters()]
    tint = np.ascontiguousarray(albedo) if albedo is not None else None
    fixed = [hl.Buffer(_borrow(array)) for array in held]
    tint_buffers = [hl.Buffer(_borrow(tint))] if tint is not None else []
    source: FloatArray = np.ascontiguousarray(radiance)
    for number, (taps, reach, step) in enumerate(passes):
        first, last = number == 0, number == len(passes) - 1
        demodulate = albedo is not None and (first or last)
        key = PassKey(taps, reach, structure, first, last, demodulate)
        kernel = _cache.get(device, key, features)
        shape = (height, width, SUM_CHANNELS) if last else (height, SUM_CHANNELS, width)
        target = np.empty(shape, dtype=np.float32)
        tints = tint_buffers if demodulate else []
        kernel(hl.Buffer(_borrow(source)), *tints, *fixed, step, *parameters, hl.Buffer(target))
        source = target
    return FilterOutput(
        np.ascontiguousarray(source[..., :3]),
        np.ascontiguousarray(source[..., 3]),
        np.ascontiguousarray(source[..., 4]),
    )
