"""Images as kernels take and give them: lent to Halide without a copy, and kept on a device between two kernels.

On the processor a kernel reads and writes NumPy's memory. On another device an image that is read goes up, once in a
`device_scope` however many kernels read it, and one that was written comes down only by `download`.

Memory of a device is taken in multiples of 256 bytes and given back in the opposite order of its taking, and everything
that a kernel reads or writes is there before it starts: only so does the allocator of Halide 21's Vulkan runtime never
hand out too little memory, or memory that is in use.
"""

from __future__ import annotations

import ctypes
import threading
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import cache, wraps
from typing import Any, TypeVar, cast, overload

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.devices import VULKAN_MULTIPLE
from lobewise.backend.runtime import get_runtime
from lobewise.errors import InputError
from lobewise.images import FloatArray

transfers: Counter[str] = Counter()
"""How many images went "up" to devices and came "down" in this process."""


class _Dimension(ctypes.Structure):
    """halide_dimension_t."""

    _fields_ = (
        ("min", ctypes.c_int32),
        ("extent", ctypes.c_int32),
        ("stride", ctypes.c_int32),
        ("flags", ctypes.c_uint32),
    )


class _RawBuffer(ctypes.Structure):
    """halide_buffer_t."""

    _fields_ = (
        ("device", ctypes.c_uint64),
        ("device_interface", ctypes.c_void_p),
        ("host", ctypes.c_void_p),
        ("flags", ctypes.c_uint64),
        ("type_code", ctypes.c_uint8),
        ("type_bits", ctypes.c_uint8),
        ("type_lanes", ctypes.c_uint16),
        ("dimensions", ctypes.c_int32),
        ("dim", ctypes.c_void_p),
        ("padding", ctypes.c_void_p),
    )


_TYPE_CODES = {"i": 0, "u": 1, "f": 2}
_HOST_DIRTY, _DEVICE_DIRTY = 1, 2


class Buffer:
    """NumPy memory as kernels take it, axes in the opposite order, and what a device has of it.

    It holds the array; who takes memory of a device gives it back. ``first`` is what kernels call its first row, column
    and so on, where that is not 0.
    """

    def __init__(self, array: HostImage, first: Sequence[int] = ()) -> None:
        self.array = array
        self.device = ""
        """Which has memory for it, if any."""
        self.first = tuple(first)
        axes = zip(reversed(array.shape), reversed(array.strides), strict=True)
        self._dimensions = _describe_axes([(extent, stride // array.itemsize) for extent, stride in axes])
        for axis, least in enumerate(first):
            self._dimensions[array.ndim - 1 - axis].min = least
        code, bits = _TYPE_CODES[array.dtype.kind], 8 * array.itemsize
        self._raw = _make_raw(array.ctypes.data, code, bits, self._dimensions)
        self.address = ctypes.addressof(self._raw)

    def take_memory(self, device: str) -> None:
        """Take memory on a device: a multiple of `VULKAN_MULTIPLE` bytes, whatever the array has."""
        padded = -(-self.array.nbytes // VULKAN_MULTIPLE) * VULKAN_MULTIPLE
        self._bytes: NDArray[np.uint8] = np.empty(padded, np.uint8)
        self._whole_dimensions = _describe_axes([(padded, 1)])
        self._whole = _make_raw(self._bytes.ctypes.data, _TYPE_CODES["u"], 8, self._whole_dimensions)
        self.device = device
        self._call("halide_device_malloc", _find_interface(device))
        self._raw.device, self._raw.device_interface = self._whole.device, self._whole.device_interface

    def bring_up(self, device: str) -> None:
        """Take memory on a device and copy the array there, which must be dense."""
        self.take_memory(device)
        self._bytes[: self.array.nbytes] = _order_axes(self.array).reshape(-1).view(np.uint8)
        self._whole.flags = _HOST_DIRTY
        self._call("halide_copy_to_device", _find_interface(device))
        transfers["up"] += 1

    def bring_down(self) -> None:
        """Copy to the array what was written on its device, if it was not yet."""
        if self._raw.flags & _DEVICE_DIRTY:
            if not self.device:
                raise TypeError("an image of a device_scope that has ended is gone: call download() inside it")
            self._raw.flags = 0
            self._whole.flags = _DEVICE_DIRTY
            self._call("halide_copy_to_host")
            self.array[...] = self._bytes[: self.array.nbytes].view(self.array.dtype).reshape(self.array.shape)
            transfers["down"] += 1

    def give_memory(self) -> None:
        """Give the device's memory back."""
        self._call("halide_device_free")
        self.device = ""

    def _call(self, name: str, *more: int) -> None:
        pointers = [None, ctypes.addressof(self._whole), *more]
        get_runtime(self.device).call(_get_function(self.device, name, len(pointers)), *pointers)


def _order_axes(array: HostImage) -> HostImage:
    """Return an array with its axes in the order in which they lie in memory."""
    return array.transpose(sorted(range(array.ndim), key=lambda axis: -array.strides[axis]))


def _describe_axes(axes: Sequence[tuple[int, int]]) -> Any:
    return (_Dimension * len(axes))(*(_Dimension(0, extent, stride, 0) for extent, stride in axes))


def _make_raw(host: int, code: int, bits: int, dimensions: Any) -> _RawBuffer:
    return _RawBuffer(
        host=host,
        type_code=code,
        type_bits=bits,
        type_lanes=1,
        dimensions=len(dimensions),
        dim=ctypes.addressof(dimensions),
    )


@cache
def _find_interface(device: str) -> int:
    return int(get_runtime(device).get("pointer", f"halide_{device}_device_interface")())


@cache
def _get_function(device: str, name: str, pointers: int) -> Callable[..., Any]:
    return get_runtime(device).get("int", name, *[ctypes.c_void_p] * pointers)


class DeviceImage:
    """What a kernel wrote on a device: other kernels read it there, and `download` gives it as an array.

    It is no array itself, so nothing brings it down unseen. When the `device_scope` ends that it was made in, what was
    not downloaded is gone.

    Parameters
    ----------
    host : array
        Where it comes down to.
    buffer : Buffer
        Of that memory and the device's.
    channel : int, optional
        Of ``host``, (height, width, channels), where no more is asked for.
    """

    # Operators with arrays are refused at once, and not tried entry by entry.
    __array_ufunc__ = None

    def __init__(self, host: HostImage, buffer: Buffer, channel: int | None = None) -> None:
        self._host, self._buffer, self._channel = host, buffer, channel
        self.shape = host.shape if channel is None else host.shape[:-1]
        self.dtype, self.ndim = host.dtype, len(self.shape)

    def download(self) -> HostImage:
        """Return it as an array; what several images share is copied once.

        Raises
        ------
        TypeError
            If its scope has ended.
        """
        self._buffer.bring_down()
        return self._host if self._channel is None else self._host[..., self._channel]

    def take_channel(self, channel: int) -> DeviceImage:
        """Return one channel, (height, width), to be downloaded."""
        return DeviceImage(self._host, self._buffer, channel)

    def lend(self, device: str) -> Buffer:
        """Return its buffer for a kernel to read; raise TypeError where that kernel has no such image."""
        if self._buffer.device != device or self._channel is not None:
            raise TypeError(f"a kernel of {device} takes whole images that are there: call download()")
        return self._buffer

    def __array__(self, *_: Any, **__: Any) -> HostImage:
        raise TypeError("an image on a device is no array: call download()")


HostImage = NDArray[Any]
Image = HostImage | DeviceImage


class _Scope:
    """What is on devices until the end of a `device_scope`."""

    def __init__(self) -> None:
        self.lent: dict[Any, Buffer] = {}
        """Buffers of images that went up, by what tells their memory."""
        self.taken: list[tuple[Buffer, HostImage]] = []
        """Every buffer in the order in which it took memory, with what must be held meanwhile."""

    def end(self) -> None:
        """Give all memory back."""
        while self.taken:
            buffer, _ = self.taken.pop()
            buffer.give_memory()


class _Current(threading.local):
    scope: _Scope | None = None


_current = _Current()


@contextmanager
def device_scope() -> Iterator[None]:
    """Keep every image that kernels read or write on their device until the outermost of these ends.

    Nobody may change an image meanwhile that a kernel has read.
    """
    if _current.scope is not None:
        yield
        return
    _current.scope = _Scope()
    try:
        yield
    finally:
        scope, _current.scope = _current.scope, None
        scope.end()


Run = TypeVar("Run", bound=Callable[..., Any])


def returns_host_images(run: Run) -> Run:
    """Let what ``run`` returns be arrays, but inside a `device_scope`, where images stay where they are."""

    @wraps(run)
    def call(*inputs: Any, **options: Any) -> Any:
        if _current.scope is not None:
            return run(*inputs, **options)
        with device_scope():
            return _download_all(run(*inputs, **options))

    return cast(Run, call)


def download(image: Image) -> HostImage:
    """Return an image as an array, brought down if it is on a device and was not yet."""
    return image.download() if isinstance(image, DeviceImage) else image


def _download_all(value: Any) -> Any:
    """Return ``value`` with every image in it, however deep in tuples and lists, as an array."""
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*map(_download_all, value))
    if isinstance(value, (list, tuple)):
        return type(value)(map(_download_all, value))
    return download(value)


def lend(image: Image, device: str) -> Buffer:
    """Return a buffer of an image for a kernel of ``device`` to read.

    Raises
    ------
    TypeError
        If the image is on another device, or a channel of one.
    DeviceError
        If the device has no memory for it.
    """
    if isinstance(image, DeviceImage):
        return image.lend(device)
    if device == "cpu":
        return Buffer(image)
    scope = _get_scope()
    key = (device, image.ctypes.data, image.shape, image.strides, image.dtype.str)
    if key not in scope.lent:
        is_dense = 0 not in image.strides and _order_axes(image).flags.c_contiguous
        buffer = Buffer(image if is_dense else np.ascontiguousarray(image))
        buffer.bring_up(device)
        # The image is held, so that no other one comes to lie where this one does.
        scope.taken.append((buffer, image))
        scope.lent[key] = buffer
    return scope.lent[key]


def _get_scope() -> _Scope:
    assert _current.scope is not None, "kernels of other devices run inside a device_scope"
    return _current.scope


def make_output(
    shape: tuple[int, ...], device: str, memory: FloatArray | None = None, type: str = "float32"
) -> tuple[Buffer, Image]:
    """Return a buffer for a kernel of ``device`` to write, and the image that it then is (`DeviceImage` elsewhere).

    ``memory`` of that shape is where the image lies, or comes down to.
    """
    host = np.empty(shape, dtype=type) if memory is None else memory
    buffer = Buffer(host)
    if device == "cpu":
        return buffer, host
    buffer.take_memory(device)
    _get_scope().taken.append((buffer, host))
    return buffer, DeviceImage(host, buffer)


@overload
def take_image(name: str, image: HostImage, shape: tuple[int, ...]) -> FloatArray: ...
@overload
def take_image(name: str, image: DeviceImage, shape: tuple[int, ...]) -> DeviceImage: ...
def take_image(name: str, image: Image, shape: tuple[int, ...]) -> Image:
    """Return an image as the kernels take it; raise InputError where it is none of this shape."""
    if image.shape != shape or image.dtype.kind not in "fiub":
        raise InputError(
            name,
            expected=f"real numbers of shape {shape}",
            got=f"{image.dtype} of shape {image.shape}",
            action="give one value, or one row of channels, for every pixel",
        )
    return take_dense(image)


@overload
def take_dense(image: HostImage) -> FloatArray: ...
@overload
def take_dense(image: DeviceImage) -> DeviceImage: ...
def take_dense(image: Image) -> Image:
    """Return an image as dense float32; one on a device stays there."""
    return image if isinstance(image, DeviceImage) else np.ascontiguousarray(image, dtype=np.float32)


def take_channel(image: Image, channel: int) -> Image:
    """Return one channel, (height, width), of an image (height, width, channels); it stays where it is."""
    return image.take_channel(channel) if isinstance(image, DeviceImage) else image[..., channel]


def take_mask(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return truth as the kernels take it."""
    return np.ascontiguousarray(mask).view(np.uint8)
