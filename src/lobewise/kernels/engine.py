"""The one seam to the devices: which there are and why one is missing, compiled kernels, buffers, calls."""

from __future__ import annotations

import ctypes
import threading
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from typing import Any

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.errors import DeviceError, InputError, describe_problem, require_choice
from lobewise.frame import FloatArray
from lobewise.kernels.cross_filter import PassFuncs, PassKey, Taps, describe_structure, make_pass
from lobewise.kernels.features import Feature
from lobewise.kernels.history import HISTORY_CHANNELS, ReprojectionFuncs, make_reprojection
from lobewise.kernels.schedules import schedule_cpu, schedule_reprojection_cpu

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
        self._kernels: dict[tuple[str, Hashable], Any] = {}
        self._lock = threading.Lock()

    def __len__(self) -> int:
        return len(self._kernels)

    def get(self, device: str, key: PassKey, features: Sequence[Feature]) -> Any:
        """Return the kernel of a filter pass."""

        def make(target: hl.Target) -> PassFuncs:
            funcs = make_pass(key, features)
            schedule_cpu(funcs, target)
            return funcs

        return self._get(device, key, make)

    def get_reprojection(self, device: str, features: Sequence[Feature]) -> Any:
        """Return the kernel that gathers a history."""

        def make(target: hl.Target) -> ReprojectionFuncs:
            funcs = make_reprojection(features)
            schedule_reprojection_cpu(funcs, target)
            return funcs

        return self._get(device, ("reprojection", *map(describe_structure, features)), make)

    def _get(self, device: str, key: Hashable, make: Callable[[hl.Target], PassFuncs | ReprojectionFuncs]) -> Any:
        with self._lock:
            if (device, key) not in self._kernels:
                target = hl.get_host_target()
                funcs = make(target)
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
        *(_take_array(feature, array, (height, width)) for feature in features for array in feature.get_arrays()),
    ]
    parameters = [value for feature in features for value in feature.get_parameters()]
    tint = np.ascontiguousarray(albedo) if albedo is not None else None
    fixed = [hl.Buffer(_borrow(array)) for array in held]
    tint_buffers = [hl.Buffer(_borrow(tint))] if tint is not None else []
    power = np.ascontiguousarray(strictness, dtype=np.float32) if strictness is not None else None
    powers = [hl.Buffer(_borrow(power))] if power is not None else []
    source: FloatArray = np.ascontiguousarray(radiance)
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
        kernel = _cache.get(device, key, features)
        shape = (height, width, key.channels) if last else (height, key.channels, width)
        target = np.empty(shape, dtype=np.float32)
        tints = tint_buffers if key.demodulate or key.modulate else []
        kernel(hl.Buffer(_borrow(source)), *tints, *fixed, step, *parameters, *powers, hl.Buffer(target))
        source = target
    return _split_output(source)


def run_upsampling(
    radiance: FloatArray,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    *,
    scale: int,
    place: tuple[int, int] = (0, 0),
    radius: int,
    albedo: FloatArray | None = None,
    modulate: bool = True,
    moment: bool = False,
    strictness: FloatArray | None = None,
    shaded_only: bool = False,
    device: str = "cpu",
) -> FilterOutput:
    """Bring radiance that was shaded at every ``scale``-th pixel to every pixel, by what the pixels have in common.

    A shaded sample at (row Y, column X) stands for the full-resolution pixel (Y scale + place[0], X scale + place[1]);
    its weight for another pixel is the product of the features' similarities between these two pixels. With scale 1
    this is the full form of `run_filter`.

    Parameters
    ----------
    radiance : array, shape (rows, columns, 3)
        Shaded samples, ``rows = ceil((height - place[0]) / scale)`` and so for columns. Bad ones get weight 0.
    mask : bool array, shape (height, width)
        False where a pixel has no meaning for these features: it neither gives nor takes.
    features : sequence of Feature
        On the full grid.
    scale : int
        Pixels from sample to sample, >= 1.
    place : (int, int)
        Row and column of the shaded pixel within each block of ``scale`` times ``scale``.
    radius : int
        Samples from the centre to the edge of the kernel, >= 0: (2 radius + 1)^2 of them are looked at.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance on the way in, at the shaded pixels, and multiplies it on the way out.
    modulate, moment, strictness
        As for `run_filter`.
    shaded_only : bool
        Compute the shaded pixels alone; the output has the shape of ``radiance``.
    device : str
        A name from `list_devices`.

    Returns
    -------
    FilterOutput
        Of shape (height, width).

    Raises
    ------
    InputError
        If the samples are not as many as the grid has.
    """
    height, width = mask.shape
    shaded = slice(place[0], None, scale), slice(place[1], None, scale)
    size = mask[shaded].shape
    if radiance.shape != (*size, 3):
        raise InputError(
            describe_problem(
                "shaded radiance",
                expected=f"shape {(*size, 3)}, every {scale}th of {width}x{height} pixels from row {place[0]}, "
                f"column {place[1]}",
                got=f"shape {radiance.shape}",
                action="check scale and place",
            )
        )
    structure = tuple(describe_structure(feature) for feature in features)
    key = PassKey(
        Taps.SQUARE,
        radius,
        structure,
        first=True,
        last=True,
        demodulate=albedo is not None,
        modulate=albedo is not None and modulate,
        moment=moment,
        strict=strictness is not None,
        paired=True,
    )
    kernel = _cache.get(device, key, features)
    arrays = [_take_array(feature, array, (height, width)) for feature in features for array in feature.get_arrays()]
    parameters = [value for feature in features for value in feature.get_parameters()]
    bits = np.ascontiguousarray(mask).view(np.uint8)
    tints = [] if albedo is None else [np.ascontiguousarray(albedo, dtype=np.float32)]
    powers = [] if strictness is None else [np.ascontiguousarray(strictness, dtype=np.float32)]
    # Every array is held in a local name until the last call has returned: Halide keeps no reference.
    source = np.ascontiguousarray(radiance, dtype=np.float32)
    guides: list[NDArray[Any]] = [bits, *arrays]
    whole = np.empty((*size, key.channels) if shaded_only else (height, width, key.channels), dtype=np.float32)

    def lend(held: Sequence[NDArray[Any]], part: tuple[slice, slice]) -> list[Any]:
        """Return the buffers of one pixel of every block; nothing is copied."""
        return [hl.Buffer(_borrow(array)[part]) for array in held]

    taps = [hl.Buffer(_borrow(source)), *lend(tints, shaded), *lend(guides, shaded), 1, *parameters]
    blocks = [place] if shaded_only else np.ndindex(min(scale, height), min(scale, width))
    for row, column in blocks:
        part = slice(row, None, scale), slice(column, None, scale)
        shift = float(scale), float(place[1] - column), float(place[0] - row)
        own = [*lend(tints if key.modulate else [], part), *lend(guides, part), *shift, *lend(powers, part)]
        kernel(*taps, *own, hl.Buffer(whole if shaded_only else whole[part]))
    return _split_output(whole)


def run_reprojection(
    past: FloatArray,
    places: FloatArray,
    masks: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    features: tuple[Sequence[Feature], Sequence[Feature]],
    *,
    device: str = "cpu",
) -> FloatArray:
    """Gather the history of every pixel from where it was in the frame before.

    Parameters
    ----------
    past : array, shape (height, width, 7)
        Sums of the frame before; see `lobewise.kernels.history`.
    places : array, shape (height, width, 2)
        Column and row where each pixel was, pixel centres at whole numbers; NaN or outside where it was nowhere.
    masks : pair of bool arrays, shape (height, width)
        Where a pixel has meaning, before and now.
    features : pair of sequences of Feature
        Of the frame before and of this one, of one structure; a pixel's history counts by their similarities.
    device : str
        A name from `list_devices`.

    Returns
    -------
    array, shape (height, width, 8)
        The sums here, and how much of each place agrees, 0 to 1 (and what `exp2` errs).
    """
    size = masks[1].shape
    kernel = _cache.get_reprojection(device, features[1])
    # Every array is held in a local name until the last call has returned: Halide keeps no reference.
    held = [np.ascontiguousarray(past, dtype=np.float32), np.ascontiguousarray(places, dtype=np.float32)]
    for mask, sides in zip(masks, features, strict=True):
        held.append(np.ascontiguousarray(mask).view(np.uint8))
        held += [_take_array(feature, array, size) for feature in sides for array in feature.get_arrays()]
    parameters = [value for feature in features[1] for value in feature.get_parameters()]
    buffers = [hl.Buffer(_borrow(array)) for array in held]
    split = 3 + sum(len(feature.get_arrays()) for feature in features[0])
    target = np.empty((*size, HISTORY_CHANNELS + 1), dtype=np.float32)
    kernel(*buffers[:split], *parameters, *buffers[split:], hl.Buffer(_borrow(target)))
    return target
