"""Images as kernels take and give them: lent to Halide without a copy, and kept on a device between two kernels.

On the processor a kernel reads and writes NumPy's memory. On another device an image that is read goes up, and one that
was written comes down only when NumPy asks for it: what the next kernel reads need not. Inside `stay_on_device` an
image goes up once, however many kernels read it.

Memory of a device is taken in multiples of 256 bytes and given back in the opposite order of its taking, and everything
that a kernel reads or writes is there before it starts: only so does the allocator of Halide 21's Vulkan runtime never
hand out too little memory, or memory that is in use.
"""

from __future__ import annotations

import ctypes
import threading
import weakref
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, is_dataclass, replace
from functools import cache, wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.devices import VULKAN_MULTIPLE
from lobewise.backend.runtime import get_runtime
from lobewise.errors import InputError, describe_problem
from lobewise.frame import FloatArray

transfers: Counter[str] = Counter()
"""How many images went "up" to devices and came "down" in this process."""
Image = NDArray[Any]


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

    def __init__(self, array: Image, first: Sequence[int] = ()) -> None:
        self.array = array
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
        self._call(device, "halide_device_malloc", _find_interface(device))
        self._raw.device, self._raw.device_interface = self._whole.device, self._whole.device_interface

    def bring_up(self, device: str) -> None:
        """Take memory on a device and copy the array there, which must be dense."""
        self.take_memory(device)
        self._bytes[: self.array.nbytes] = _order_axes(self.array).reshape(-1).view(np.uint8)
        self._whole.flags = _HOST_DIRTY
        self._call(device, "halide_copy_to_device", _find_interface(device))
        transfers["up"] += 1

    def bring_down(self, device: str) -> None:
        """Copy to the array what was written on a device, if it was not yet."""
        if self._raw.flags & _DEVICE_DIRTY:
            self._raw.flags = 0
            self._whole.flags = _DEVICE_DIRTY
            self._call(device, "halide_copy_to_host")
            self.array[...] = self._bytes[: self.array.nbytes].view(self.array.dtype).reshape(self.array.shape)
            transfers["down"] += 1

    def give_memory(self, device: str) -> None:
        """Give a device's memory back."""
        self._call(device, "halide_device_free")

    def _call(self, device: str, name: str, *more: int) -> None:
        pointers = [None, ctypes.addressof(self._whole), *more]
        get_runtime(device).call(_get_function(device, name, len(pointers)), *pointers)


def _order_axes(array: Image) -> Image:
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


class DeviceImage(np.lib.mixins.NDArrayOperatorsMixin):
    """What a kernel wrote on a device; an array to everybody who reads it, which brings it down.

    Parameters
    ----------
    host : array
        Where it comes down to.
    buffer : Buffer
        Of that memory and the device's.
    device : str
        A name from `list_devices`.
    part : callable, optional
        What is to be seen of ``host``: a view.
    """

    def __init__(self, host: Image, buffer: Buffer, device: str, part: Callable[[Image], Image] | None = None) -> None:
        self._host, self.buffer, self.device = host, buffer, device
        self._part = part
        self.is_there = True
        """Whether the device still has it."""
        view = host if part is None else part(host)
        self.shape, self.dtype, self.ndim = view.shape, view.dtype, view.ndim

    @property
    def is_whole(self) -> bool:
        """Whether it is all that the kernel wrote."""
        return self._part is None

    def view(self, part: Callable[[Image], Image]) -> DeviceImage:
        """Return a part of it, which stays on the device as well."""
        image = DeviceImage(self._host, self.buffer, self.device, part)
        _get_stay().written.append(weakref.ref(image))
        return image

    def leave(self) -> None:
        """Bring it down for good: its memory on the device is given back."""
        self.fetch()
        self.is_there = False

    def fetch(self) -> Image:
        """Return it as an array, brought down if it is not yet."""
        self.buffer.bring_down(self.device)
        return self._host if self._part is None else self._part(self._host)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> Image:
        array = self.fetch()
        return array.astype(dtype) if dtype is not None and dtype != array.dtype else array.copy() if copy else array

    def __array_ufunc__(self, ufunc: Any, method: str, *inputs: Any, **options: Any) -> Any:
        return getattr(ufunc, method)(*map(to_host, inputs), **{name: to_host(each) for name, each in options.items()})

    def __array_function__(self, function: Any, types: Any, inputs: Any, options: Any) -> Any:
        return function(*map(to_host, inputs), **{name: to_host(each) for name, each in options.items()})

    def __getitem__(self, key: Any) -> Any:
        return self.fetch()[key]

    def __len__(self) -> int:
        return int(self.shape[0])

    def __getattr__(self, name: str) -> Any:
        # Methods of arrays (mean, reshape ...), asked for on the host.
        if name.startswith("_"):
            raise AttributeError(name)
        return getattr(self.fetch(), name)


class _Stay:
    """What is on devices until the end of a `stay_on_device`."""

    def __init__(self) -> None:
        self.lent: dict[Any, Buffer] = {}
        """Buffers of images that went up, by what tells their memory."""
        self.taken: list[tuple[Buffer, str, Image]] = []
        """Every buffer in the order in which it took memory, with its device and what must be held meanwhile."""
        self.written: list[weakref.ref[DeviceImage]] = []

    def end(self) -> None:
        """Bring down what somebody still holds, and give all memory back."""
        for each in self.written:
            image = each()
            if image is not None:
                image.leave()
        while self.taken:
            buffer, device, _ = self.taken.pop()
            buffer.give_memory(device)


class _Current(threading.local):
    stay: _Stay | None = None


_current = _Current()


@contextmanager
def stay_on_device() -> Iterator[None]:
    """Keep every image that kernels read or write on their device until the outermost of these ends.

    Nobody may change an image meanwhile that a kernel has read.
    """
    if _current.stay is not None:
        yield
        return
    _current.stay = _Stay()
    try:
        yield
    finally:
        stay, _current.stay = _current.stay, None
        stay.end()


Run = TypeVar("Run", bound=Callable[..., Any])


def comes_down(run: Run) -> Run:
    """Let what ``run`` returns be arrays, but inside `stay_on_device`, where images stay where they are."""

    @wraps(run)
    def call(*inputs: Any, **options: Any) -> Any:
        if _current.stay is not None:
            return run(*inputs, **options)
        with stay_on_device():
            return to_host(run(*inputs, **options))

    return cast(Run, call)


def to_host(value: Any) -> Any:
    """Return ``value`` with every image in it, however deep in tuples, lists and data classes, as an array."""
    if isinstance(value, DeviceImage):
        return value.fetch()
    if isinstance(value, tuple) and hasattr(value, "_fields"):
        return type(value)(*map(to_host, value))
    if isinstance(value, (list, tuple)):
        brought = list(map(to_host, value))
        same = all(a is b for a, b in zip(brought, value, strict=True))
        return value if same else type(value)(brought)
    if is_dataclass(value) and not isinstance(value, type):
        parts = {each.name: getattr(value, each.name) for each in fields(value)}
        found = {name: to_host(part) for name, part in parts.items()}
        changed = {name: part for name, part in found.items() if part is not parts[name]}
        return replace(value, **changed) if changed else value
    return value


def lend(image: Image, device: str) -> Buffer:
    """Return a buffer of an image for a kernel of ``device`` to read.

    Raises
    ------
    DeviceError
        If the device has no memory for it.
    """
    if isinstance(image, DeviceImage):
        if image.is_there and image.device == device and image.is_whole:
            return image.buffer
        image = np.ascontiguousarray(image.fetch())
    if device == "cpu":
        return Buffer(image)
    stay = _get_stay()
    key = (device, image.ctypes.data, image.shape, image.strides, image.dtype.str)
    if key not in stay.lent:
        is_dense = 0 not in image.strides and _order_axes(image).flags.c_contiguous
        buffer = Buffer(image if is_dense else np.ascontiguousarray(image))
        buffer.bring_up(device)
        # The image is held, so that no other one comes to lie where this one does.
        stay.taken.append((buffer, device, image))
        stay.lent[key] = buffer
    return stay.lent[key]


def _get_stay() -> _Stay:
    assert _current.stay is not None, "kernels of other devices run inside stay_on_device"
    return _current.stay


def make_output(shape: tuple[int, ...], device: str, memory: FloatArray | None = None) -> tuple[Buffer, FloatArray]:
    """Return a buffer for a kernel of ``device`` to write, and the image that it then is (`DeviceImage` elsewhere).

    ``memory`` of that shape is where the image lies, or comes down to.
    """
    host = np.empty(shape, dtype=np.float32) if memory is None else memory
    buffer = Buffer(host)
    if device == "cpu":
        return buffer, host
    stay = _get_stay()
    buffer.take_memory(device)
    stay.taken.append((buffer, device, host))
    image = DeviceImage(host, buffer, device)
    stay.written.append(weakref.ref(image))
    return buffer, cast(FloatArray, image)


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
    return take_dense(image)


def take_dense(image: Image) -> FloatArray:
    """Return an image as dense float32; one on a device stays there."""
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
