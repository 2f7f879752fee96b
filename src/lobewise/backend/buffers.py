"""Lend images to kernels without a copy, and keep them on a device between two kernels.

On the processor a kernel reads and writes NumPy's memory. On other devices an input is copied up once per
`device_scope`, however many kernels read it. An output is copied down only by `download`.

Device memory is allocated in multiples of 256 bytes and freed in reverse order, and all images of a kernel are
allocated before it starts. Otherwise the allocator of Halide 21's Vulkan runtime may return too little memory, or
memory that is in use.

Large arrays begin at a page, and planes of many image sizes are a whole number of pages. Pixels of one place would then
share a few lines of the nearest cache, whose set is chosen by the place within a page, and a kernel that reads twenty
images would read each line several times. So images begin at different places of a page.

The system clears new memory before it hands it out, which takes as long as a simple kernel. Images of a call therefore
take the memory of earlier images from a `MemoryPool`, which ends with the call. Filters that run frame after frame keep
the memory of the last frame.
"""

from __future__ import annotations

import ctypes
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from functools import cache, wraps
from typing import Any, TypeVar, cast, overload
from weakref import ref

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.devices import VULKAN_MULTIPLE
from lobewise.backend.runtime import get_runtime
from lobewise.errors import InputError
from lobewise.work.arrays import FloatArray

PAGE_BYTES = 4096
"""Addresses that are so far apart share their set of the nearest cache."""
CACHE_STEP_BYTES = 5 * 64
"""Distance of two images within a page: an odd number of cache lines, so that all sets are used."""
MIN_SPREAD_BYTES = 1 << 16
"""Size of an image from which its place within a page matters."""

MAX_EXCESS = 1.25
"""Largest size of a block of memory over that of the array that takes it: results keep their blocks."""


class _Block:
    """Bytes that an array lies in. When the array is gone, they go back to their pool if it is still there."""

    def __init__(self, pool: MemoryPool, memory: NDArray[np.uint8]) -> None:
        self._pool, self._memory = ref(pool), memory
        self.__array_interface__ = memory.__array_interface__

    def __del__(self) -> None:
        pool = self._pool()
        if pool is not None:
            pool._returned.append(self._memory)


class MemoryPool:
    """The memory of arrays that are gone, for new arrays of about the same size.

    In its first use it holds no more than was in use at once: the peak is that of a process without a pool. Later it
    holds what its last two uses needed, so that a use like the one before takes no fresh memory.
    """

    def __init__(self) -> None:
        self._free: list[tuple[int, NDArray[np.uint8]]] = []
        """Free blocks, those that are free for the longest time first, with the use that returned them."""
        self._returned: deque[NDArray[np.uint8]] = deque()
        """Blocks whose arrays are gone. Python may destroy an array at any time, in any thread, so that `_Block` does
        nothing but append."""
        self._lock = threading.Lock()
        self._uses = self._used_bytes = self._most_bytes = self._free_bytes = 0
        self.fresh_bytes = 0
        """Bytes that the pool has taken from the system so far."""

    @property
    def held_bytes(self) -> int:
        """Bytes of all blocks, in use and free."""
        return self._used_bytes + self._free_bytes

    @contextmanager
    def use(self) -> Iterator[None]:
        """Take the memory of all images that kernels write inside the context from this pool."""
        before, _memory.pool = _memory.pool, self
        self._uses += 1
        try:
            yield
        finally:
            _memory.pool = before
            with self._lock:
                self._take_back()
                while self._free and self._free[0][0] < self._uses - 1:
                    self._pop(0)

    def clear(self) -> None:
        """Free all memory that is not in use."""
        with self._lock:
            self._take_back()
            while self._free:
                self._pop(0)

    def take(self, size: int) -> NDArray[np.uint8]:
        """Return an array of ``size`` bytes, uninitialised."""
        with self._lock:
            self._take_back()
            fitting = [
                (block.nbytes, -number)
                for number, (_, block) in enumerate(self._free)
                if size <= block.nbytes <= MAX_EXCESS * size
            ]
            memory = self._pop(-min(fitting)[1]) if fitting else self._allocate(size)
            self._used_bytes += memory.nbytes
            self._most_bytes = max(self._most_bytes, self._used_bytes)
        return np.asarray(_Block(self, memory))[:size]

    def _allocate(self, size: int) -> NDArray[np.uint8]:
        most_bytes = max(self._most_bytes, self._used_bytes + size)
        while self._uses == 1 and self._free and self.held_bytes + size > most_bytes:
            self._pop(0)
        self.fresh_bytes += size
        return np.empty(size, np.uint8)

    def _take_back(self) -> None:
        while self._returned:
            memory = self._returned.popleft()
            self._used_bytes -= memory.nbytes
            self._free_bytes += memory.nbytes
            self._free.append((self._uses, memory))

    def _pop(self, number: int) -> NDArray[np.uint8]:
        _, memory = self._free.pop(number)
        self._free_bytes -= memory.nbytes
        return memory


class _Memory(threading.local):
    pool: MemoryPool | None = None
    offset: int = 0
    """Place of the next image within a page, bytes."""


_memory = _Memory()


def get_pool() -> MemoryPool | None:
    """Return the pool that this thread uses."""
    return _memory.pool


@contextmanager
def share_memory() -> Iterator[None]:
    """Let the images that kernels write inside the context lie in the memory of those that are gone.

    Afterwards nothing is kept but the images that live. Inside a `MemoryPool` that is in use, all memory is its.
    """
    with nullcontext() if _memory.pool is not None else MemoryPool().use():
        yield


def make_plane_stack(shape: tuple[int, ...], type: str = "float32") -> NDArray[Any]:
    """Return an uninitialised array whose entries along the first axis begin in different sets of the cache.

    Each entry is dense; there are gaps between entries.
    """
    count, *rest = shape
    entries = int(np.prod(rest, dtype=np.int64))
    size = np.dtype(type).itemsize
    if entries * size < MIN_SPREAD_BYTES:
        return np.empty(shape, type)
    step = -(-entries * size // PAGE_BYTES) * PAGE_BYTES + CACHE_STEP_BYTES
    total = count * step + 2 * PAGE_BYTES
    memory = np.empty(total, np.uint8) if _memory.pool is None else _memory.pool.take(total)
    # Count from the beginning of a page, wherever the allocator put the memory.
    start = -memory.ctypes.data % PAGE_BYTES + _memory.offset
    _memory.offset = (_memory.offset + count * CACHE_STEP_BYTES) % PAGE_BYTES
    flat = memory[start : start + count * step].reshape(count, step)[:, : entries * size]
    return flat.view(type).reshape(shape)


def make_array(shape: tuple[int, ...], type: str = "float32") -> NDArray[Any]:
    """Return an uninitialised dense array, whose beginning differs from that of the array before."""
    array: NDArray[Any] = make_plane_stack((1, *shape), type)[0]
    return array


transfers: Counter[str] = Counter()
"""Number of images that this process copied "up" to devices and "down" from them."""


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
    """A NumPy array described for Halide, with axes in the opposite order, and its copy on a device.

    The buffer keeps the array alive. Whoever allocates device memory frees it. ``first`` holds the coordinates of the
    first row, column and so on for kernels, if they are not 0.
    """

    def __init__(self, array: HostImage, first: Sequence[int] = ()) -> None:
        self.array = array
        self.device = ""
        """Name of the device that has memory for the array; empty if none."""
        self.first = tuple(first)
        self.layout = array.dtype, array.shape, array.strides, self.first
        """What a kernel examines of the array."""
        axes = zip(reversed(array.shape), reversed(array.strides), strict=True)
        self._dimensions = _describe_axes([(extent, stride // array.itemsize) for extent, stride in axes])
        for axis, least in enumerate(first):
            self._dimensions[array.ndim - 1 - axis].min = least
        code, bits = _TYPE_CODES[array.dtype.kind], 8 * array.itemsize
        self._raw = _make_raw(array.ctypes.data, code, bits, self._dimensions)
        self.address = ctypes.addressof(self._raw)

    def take_memory(self, device: str) -> None:
        """Allocate memory on a device, rounded up to a multiple of `VULKAN_MULTIPLE` bytes."""
        padded = -(-self.array.nbytes // VULKAN_MULTIPLE) * VULKAN_MULTIPLE
        self._bytes: NDArray[np.uint8] = np.empty(padded, np.uint8)
        self._whole_dimensions = _describe_axes([(padded, 1)])
        self._whole = _make_raw(self._bytes.ctypes.data, _TYPE_CODES["u"], 8, self._whole_dimensions)
        self.device = device
        self._call("halide_device_malloc", _look_up_interface(device))
        self._raw.device, self._raw.device_interface = self._whole.device, self._whole.device_interface

    def bring_up(self, device: str) -> None:
        """Allocate memory on a device and copy the array there; it must be dense."""
        self.take_memory(device)
        self._bytes[: self.array.nbytes] = _order_axes(self.array).reshape(-1).view(np.uint8)
        self._whole.flags = _HOST_DIRTY
        self._call("halide_copy_to_device", _look_up_interface(device))
        transfers["up"] += 1

    def bring_down(self) -> None:
        """Copy the device's memory to the array if a kernel has written it since the last copy."""
        if self._raw.flags & _DEVICE_DIRTY:
            if not self.device:
                raise TypeError("the device_scope of an image has ended: call download() inside the scope")
            self._raw.flags = 0
            self._whole.flags = _DEVICE_DIRTY
            self._call("halide_copy_to_host")
            self.array[...] = self._bytes[: self.array.nbytes].view(self.array.dtype).reshape(self.array.shape)
            transfers["down"] += 1

    def give_memory(self) -> None:
        """Free the device's memory."""
        self._call("halide_device_free")
        self.device = ""

    def _call(self, name: str, *more: int) -> None:
        pointers = [None, ctypes.addressof(self._whole), *more]
        get_runtime(self.device).call(_get_function(self.device, name, len(pointers)), *pointers)


def _order_axes(array: HostImage) -> HostImage:
    """Return an array with its axes in the order of decreasing strides."""
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
def _look_up_interface(device: str) -> int:
    return int(get_runtime(device).get("pointer", f"halide_{device}_device_interface")())


@cache
def _get_function(device: str, name: str, pointers: int) -> Callable[..., Any]:
    return get_runtime(device).get("int", name, *[ctypes.c_void_p] * pointers)


class DeviceImage:
    """An output of a kernel in the memory of a device. Other kernels read it there; `download` returns an array.

    It does not act as an array, so that nothing copies it down by accident. When its `device_scope` ends, images that
    were not downloaded are lost.

    Parameters
    ----------
    host : array
        Memory to download to.
    buffer : Buffer
        Describes ``host`` and the device's memory.
    channel : int, optional
        The only channel of ``host``, (height, width, channels), that the image consists of.
    """

    # Make NumPy refuse operators at once instead of trying them entry by entry.
    __array_ufunc__ = None

    def __init__(self, host: HostImage, buffer: Buffer, channel: int | None = None) -> None:
        self._host, self._buffer, self._channel = host, buffer, channel
        self.shape = host.shape if channel is None else host.shape[:-1]
        self.dtype, self.ndim = host.dtype, len(self.shape)

    def download(self) -> HostImage:
        """Return the image as an array; memory that several images share is copied once.

        Raises
        ------
        TypeError
            If the image's scope has ended.
        """
        self._buffer.bring_down()
        return self._host if self._channel is None else self._host[..., self._channel]

    def take_channel(self, channel: int) -> DeviceImage:
        """Return one channel, (height, width), which can only be downloaded."""
        return DeviceImage(self._host, self._buffer, channel)

    def lend(self, device: str) -> Buffer:
        """Return the buffer for a kernel of ``device``; raise TypeError if the image is elsewhere or a channel."""
        if self._buffer.device != device or self._channel is not None:
            raise TypeError(f"a kernel on {device} reads only whole images on that device: call download()")
        return self._buffer

    def __array__(self, *_: Any, **__: Any) -> HostImage:
        raise TypeError("an image on a device is not an array: call download()")


HostImage = NDArray[Any]
Image = HostImage | DeviceImage


class _Scope:
    """The device memory of a `device_scope`."""

    def __init__(self) -> None:
        self.lent: dict[Any, Buffer] = {}
        """Buffers of images that were copied up, by device, address, shape, strides and type."""
        self.buffers: list[tuple[Buffer, HostImage]] = []
        """All buffers in the order of their allocation, each with the array that must stay alive."""

    def end(self) -> None:
        """Free all memory, in reverse order."""
        while self.buffers:
            buffer, _ = self.buffers.pop()
            buffer.give_memory()


class _Current(threading.local):
    scope: _Scope | None = None


_current = _Current()


@contextmanager
def device_scope() -> Iterator[None]:
    """Keep all images that kernels read or write on their device until the outermost scope ends.

    Inside a scope nobody may change an image that a kernel has read.
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
    """Decorate a function to return arrays; inside a `device_scope` its images stay on the device."""

    @wraps(run)
    def call(*inputs: Any, **options: Any) -> Any:
        if _current.scope is not None:
            return run(*inputs, **options)
        with device_scope():
            return _download_all(run(*inputs, **options))

    return cast(Run, call)


def download(image: Image) -> HostImage:
    """Return an image as an array, copied down if it is on a device."""
    return image.download() if isinstance(image, DeviceImage) else image


def _download_all(value: Any) -> Any:
    """Return ``value`` with every image in nested tuples and lists downloaded."""
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
        If the image is on another device, or a single channel of an image on a device.
    DeviceError
        If the device runs out of memory.
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
        # Keep the image alive, so that no other array gets its address.
        scope.buffers.append((buffer, image))
        scope.lent[key] = buffer
    return scope.lent[key]


def _get_scope() -> _Scope:
    assert _current.scope is not None, "kernels of other devices run inside a device_scope"
    return _current.scope


def make_output(
    shape: tuple[int, ...], device: str, memory: FloatArray | None = None, type: str = "float32"
) -> tuple[Buffer, Image]:
    """Return a buffer for a kernel of ``device`` to write, and its image, which is no array on other devices.

    ``memory``, of the same shape, becomes the array, or the array to download to.
    """
    host = make_array(shape, type) if memory is None else memory
    buffer = Buffer(host)
    if device == "cpu":
        return buffer, host
    buffer.take_memory(device)
    _get_scope().buffers.append((buffer, host))
    return buffer, DeviceImage(host, buffer)


@overload
def take_image(name: str, image: HostImage, shape: tuple[int, ...]) -> FloatArray: ...
@overload
def take_image(name: str, image: DeviceImage, shape: tuple[int, ...]) -> DeviceImage: ...
def take_image(name: str, image: Image, shape: tuple[int, ...]) -> Image:
    """Return an image as dense float32; raise InputError if it has another shape or no real numbers."""
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
    """Return an image as dense float32; one on a device, or one that is recorded, stays as it is."""
    return np.ascontiguousarray(image, dtype=np.float32) if isinstance(image, np.ndarray) else image


def take_channel(image: Image, channel: int) -> Image:
    """Return one channel, (height, width), of an image (height, width, channels); it stays where it is."""
    return image.take_channel(channel) if isinstance(image, DeviceImage) else image[..., channel]


def take_mask(mask: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """Return a mask as dense uint8; one that is recorded stays as it is."""
    return np.ascontiguousarray(mask).view(np.uint8) if isinstance(mask, np.ndarray) else mask
