"""The one seam to the devices: which there are and why one is missing, compiled kernels, buffers, calls."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.errors import DeviceError, InputError, describe_problem, require_choice
from lobewise.frame import FloatArray
from lobewise.kernels.cross_filter import PassKey, Taps, describe_structure, make_pass
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
    # Up to the last element, whose place the strides tell, none of which is negative.
    length = sum((count - 1) * stride for count, stride in zip(array.shape, array.strides, strict=True))
    pointer = (ctypes.c_byte * (length + array.itemsize)).from_address(array.ctypes.data)
    return np.ndarray(array.shape, array.dtype, memoryview(pointer), 0, array.strides)


class Compilable(Protocol):
    """The scheduled functions of a kernel."""

    out: hl.Func
    arguments: list[Any]


class _KernelCache:
    """Compiled kernels of this process, by structure; safe to use from several threads."""

    def __init__(self) -> None:
        self._kernels: dict[tuple[str, Hashable], Any] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kernels)

    def get(self, device: str, key: Hashable, make: Callable[[hl.Target], Compilable]) -> Any:
        """Return the kernel of ``key``, which ``make`` gives the scheduled functions of."""
        with self._lock:
            if (device, key) not in self._kernels:
                # Every buffer is made and checked here, so a kernel need not ask again: that halves its compilation.
                target = hl.get_host_target()
                for name in ("NoAsserts", "NoBoundsQuery"):
                    target = target.with_feature(getattr(hl.TargetFeature, name))
                funcs = make(target)
                self._kernels[device, key] = hl.Pipeline(funcs.out).compile_to_callable(funcs.arguments, target)
            return self._kernels[device, key]


_cache = _KernelCache()


def count_compiled_kernels() -> int:
    """Return how many kernels this process has compiled."""
    return len(_cache)


def get_kernel(device: str, key: Hashable, make: Callable[[hl.Target], Compilable]) -> Any:
    """Return a compiled kernel, compiled now if it is the first of its ``key``."""
    return _cache.get(device, key, make)


def take_image(name: str, image: NDArray[Any], shape: tuple[int, ...]) -> FloatArray:
    """Return an image as the kernels take it; raise InputError where it is none of this shape."""
    if image.shape != shape or image.dtype.kind not in "fiub":
        raise InputError(
            describe_problem(
                name,
                expected=f"real numbers of shape {shape}",
                got=f"{image.dtype} of shape {image.shape}",
                action="give one value, or one row of channels, for every pixel",
            )
        )
    return np.ascontiguousarray(image, dtype=np.float32)


def take_arrays(features: Sequence[Feature], size: tuple[int, int]) -> list[FloatArray]:
    """Return the arrays of every feature, one after the other; raise InputError where one does not fit."""
    return [_take_array(feature, array, size) for feature in features for array in feature.get_arrays()]


def take_parameters(features: Sequence[Feature]) -> list[float]:
    """Return the scalars of every feature, one after the other."""
    return [value for feature in features for value in feature.get_parameters()]


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
    moment : (height, width), optional
        Weighted mean of the squared luminance of the samples, over their albedo.
    """

    image: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray
    moment: FloatArray | None = None


def _split_output(pixels: FloatArray) -> FilterOutput:
    """Return what a last pass wrote, (height, width, channels), channel by channel."""
    image, *rest = (np.ascontiguousarray(pixels[..., k]) for k in (slice(0, 3), *range(3, pixels.shape[2])))
    return FilterOutput(image, *rest)


def run_filter(
    radiance: FloatArray,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    *,
    form: str,
    radius: int,
    albedo: FloatArray | None = None,
    modulate: bool = True,
    moment: bool = False,
    strictness: FloatArray | None = None,
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
    modulate : bool
        Whether it does the latter.
    moment : bool
        Whether to average the squared luminance as well.
    strictness : array, shape (height, width), optional
        Power to which each pixel raises the weights of its taps, > 0.
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
        *take_arrays(features, (height, width)),
    ]
    parameters = take_parameters(features)
    tint = take_image("albedo", albedo, (height, width, 3)) if albedo is not None else None
    fixed = [hl.Buffer(_borrow(array)) for array in held]
    tint_buffers = [hl.Buffer(_borrow(tint))] if tint is not None else []
    power = take_image("strictness", strictness, (height, width)) if strictness is not None else None
    powers = [hl.Buffer(_borrow(power))] if power is not None else []
    source = take_image("radiance", radiance, (height, width, 3))
    for number, (taps, reach, step) in enumerate(passes):
        first, last = number == 0, number == len(passes) - 1
        key = PassKey(
            taps,
            reach,
            structure,
            first,
            last,
            demodulate=albedo is not None and first,
            modulate=albedo is not None and last and modulate,
            moment=moment,
            strict=strictness is not None,
        )

        def make(target: hl.Target, key: PassKey = key) -> Compilable:
            funcs = make_pass(key, features)
            schedule_cpu(funcs, target)
            return funcs

        kernel = get_kernel(device, key, make)
        shape = (height, width, key.channels) if last else (height, key.channels, width)
        target = np.empty(shape, dtype=np.float32)
        tints = tint_buffers if key.demodulate or key.modulate else []
        kernel(hl.Buffer(_borrow(source)), *tints, *fixed, step, *parameters, *powers, hl.Buffer(target))
        source = target
    return _split_output(source)
