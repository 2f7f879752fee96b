"""Images as kernels take and give them: lent to Halide without a copy, and kept on a device between two kernels.

On the processor a kernel reads and writes NumPy's memory. On another device an image that is read goes up, and one that
was written comes down only when NumPy asks for it: what the next kernel reads need not. Inside `stay_on_device` an
image goes up once, however many kernels read it.
"""

from __future__ import annotations

import ctypes
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, cast

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.errors import DeviceError, InputError, describe_problem
from lobewise.frame import FloatArray
from lobewise.kernels.devices import VULKAN_BLOCK, VULKAN_MULTIPLE, make_target
from lobewise.kernels.features import Feature

transfers: Counter[str] = Counter()
"""How many images went "up" to devices and came "down" in this process."""
Image = NDArray[Any]


def borrow(array: Image) -> Image:
    """Return a writable view of ``array``: Halide's Python buffers refuse read-only memory even for inputs."""
    if array.flags.writeable:
        return array
    # Up to the last element, whose place the strides tell, none of which is negative.
    length = sum((count - 1) * stride for count, stride in zip(array.shape, array.strides, strict=True))
    pointer = (ctypes.c_byte * (length + array.itemsize)).from_address(array.ctypes.data)
    return np.ndarray(array.shape, array.dtype, memoryview(pointer), 0, array.strides)


class DeviceImage(np.lib.mixins.NDArrayOperatorsMixin):
    """What a kernel wrote on a device; an array to everybody who reads it, which brings it down.

    Parameters
    ----------
    host : array
        Where it comes down to.
    buffer : halide.Buffer
        Of that memory and the device's.
    device : str
        A name from `list_devices`.
    part : callable, optional
        What is to be seen of ``host``: a view.
    """

    def __init__(self, host: Image, buffer: Any, device: str, part: Callable[[Image], Image] | None = None) -> None:
        self._host, self.buffer, self.device = host, buffer, device
        self._part = part
        view = host if part is None else part(host)
        self.shape, self.dtype, self.ndim = view.shape, view.dtype, view.ndim

    @property
    def is_whole(self) -> bool:
        """Whether it is all that the kernel wrote."""
        return self._part is None

    def view(self, part: Callable[[Image], Image]) -> DeviceImage:
        """Return a part of it, which stays on the device as well."""
        return DeviceImage(self._host, self.buffer, self.device, part)

    def fetch(self) -> Image:
        """Return it as an array, brought down if it is not yet."""
        if self.buffer.device_dirty():
            self.buffer.copy_to_host()
            transfers["down"] += 1
        return self._host if self._part is None else self._part(self._host)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Image:
        array = self.fetch()
        return array.astype(dtype) if dtype is not None and dtype != array.dtype else array.copy() if copy else array

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return getattr(ufunc, method)(*(_to_host(each) for each in inputs), **options)

    def __array_function__(self, function: Any, types: Any, inputs: Any, options: Any) -> Any:
        return function(*map(_to_host, inputs), **{name: _to_host(each) for name, each in options.items()})

    def __getitem__(self, key: Any) -> Any:
        return self.fetch()[key]

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getattr__(self, name: str) -> Any:
        # Methods of arrays (mean, reshape ...), asked for on the host.
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.fetch(), name)


def _to_host(value: Any) -> Any:
    if isinstance(value, DeviceImage):
        return value.fetch()
    return type(value)(map(_to_host, value)) if isinstance(value, (list, tuple)) else value


class _Stay(threading.local):
    """Images of this thread that are on a device already, by what tells their memory."""

    buffers: dict[Any, tuple[Image, Image, Any]] | None = None


_stay = _Stay()


@contextmanager
def stay_on_device() -> Iterator[None]:
    """Keep every image that kernels read on their device until the end; nobody may change one meanwhile."""
    before = _stay.buffers
    _stay.buffers = {} if before is None else before
    try:
        yield
    finally:
        _stay.buffers = before


def lend(image: Image, device: str) -> Any:
    """Return a buffer of an image for a kernel of ``device`` to read; hold the image until the kernel has returned.

    Raises
    ------
    DeviceError
        If the device cannot hold an image of this size.
    """
    if isinstance(image, DeviceImage):
        if image.device == device and image.is_whole:
            return image.buffer
        image = np.ascontiguousarray(image.fetch())
    if device == "cpu":
        return hl.Buffer(borrow(image))
    kept = _stay.buffers
    key = (device, image.ctypes.data, image.shape, image.strides, image.dtype.str)
    if kept is not None and key in kept:
        return kept[key][-1]
    _require_room(image.nbytes, device)
    # Memory that is repeated along an axis would be copied up more than it has.
    whole = np.ascontiguousarray(image) if 0 in image.strides else image
    buffer = hl.Buffer(borrow(whole))
    buffer.set_host_dirty(True)
    buffer.copy_to_device(make_target(device))
    transfers["up"] += 1
    if kept is not None:
        # Held, so that no other image comes to lie where this one does.
        kept[key] = image, whole, buffer
    return buffer


def make_output(shape: tuple[int, ...], device: str, memory: FloatArray | None = None) -> tuple[Any, FloatArray]:
    """Return a buffer for a kernel of ``device`` to write, and the image that it then is (`DeviceImage` elsewhere).

    ``memory`` of that shape is where the image lies, or comes down to.
    """
    host = np.empty(shape, dtype=np.float32) if memory is None else memory
    buffer = hl.Buffer(host)
    if device == "cpu":
        return buffer, host
    _require_room(host.nbytes, device)
    return buffer, cast(FloatArray, DeviceImage(host, buffer, device))


def _require_room(count: int, device: str) -> None:
    if device == "vulkan" and count >= VULKAN_BLOCK << 20 and count % VULKAN_MULTIPLE:
        raise DeviceError(
            describe_problem(
                "device",
                expected=f"images below {VULKAN_BLOCK} MiB, or of a multiple of {VULKAN_MULTIPLE} bytes, on vulkan",
                got=f"{count} bytes",
                action="use --device cpu, or crop the image to a width that is a multiple of 64",
            )
        )


def take_image(name: str, image: Image, shape: tuple[int, ...]) -> FloatArray:
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
    return _take(image)


def _take(image: Image) -> FloatArray:
    if isinstance(image, DeviceImage) and image.is_whole:
        return cast(FloatArray, image)
    return np.ascontiguousarray(image, dtype=np.float32)


def take_channel(image: FloatArray, channel: int) -> FloatArray:
    """Return one channel, (height, width), of an image (height, width, channels); it stays where it is."""
    if isinstance(image, DeviceImage):
        return cast(FloatArray, image.view(lambda whole: whole[..., channel]))
    return image[..., channel]


def take_mask(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return truth as the kernels take it."""
    return np.ascontiguousarray(mask).view(np.uint8)


def take_arrays(features: Sequence[Feature], size: tuple[int, int]) -> list[FloatArray]:
    """Return the arrays of every feature, one after the other; raise InputError where one does not fit."""
    return [_take_array(feature, array, size) for feature in features for array in feature.get_arrays()]


def take_parameters(features: Sequence[Feature]) -> list[float]:
    """Return the scalars of every feature, one after the other."""
    return [value for feature in features for value in feature.get_parameters()]


def _take_array(feature: Feature, array: Image, size: tuple[int, int]) -> FloatArray:
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
    return _take(array)
