"""Decode and encode the pixels of one part. No other module calls the OpenEXR library.

Where memory runs out, the library ends the process, crashes, or leaves channels out as if the file were damaged. So
the memory for a call is asked for first. The library reads and writes bytes in memory and needs no temporary file.
"""

from __future__ import annotations

import io
import mmap
import threading
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from typing import Any
from weakref import finalize

import numpy as np
from numpy.typing import NDArray

from lobewise.display.hushing import hide_lines
from lobewise.errors import FileError
from lobewise.io.exr.container import COMPRESSIONS, Container, Part, Window, crop_part, show_name
from lobewise.io.exr.parsing import parse_bytes
from lobewise.io.exr.splice import pack_part
from lobewise.io.files import say_reason
from lobewise.work.chunks import ForkGate, count_cores
from lobewise.work.limits import check_limits

Pixels = NDArray[Any]

DTYPES: dict[str, np.dtype[Any]] = {
    "uint": np.dtype(np.uint32),
    "half": np.dtype(np.float16),
    "float": np.dtype(np.float32),
}


MAX_SLAB_BYTES = 3 * 2**28
"""Most bytes of pixels that are decoded or encoded at once, unless a single row of chunks has more."""

FIXED_BYTES = 2**26
"""Memory that a call of the library needs beside its pixels, bytes."""
THREAD_BYTES = 2**26 + 2**23
"""Address space of a thread: a heap of glibc, and a stack."""
KEPT_BYTES = 2**24
"""Most bytes of the pixels of a file whose parts stay decoded as long as the `Container` that they were decoded for."""
_kept: dict[tuple[int, int], dict[str, Pixels]] = {}
"""Such pixels, by the identity of the container and the index of the part."""
SCRATCH_COPIES = 3
"""Most copies of the pixels that the library holds at once beside the decoded ones: packed, unpacked, reordered."""


def count_fitting_rows(part: Part) -> int:
    """Return how many rows of a part fit into `MAX_SLAB_BYTES`: whole rows of chunks, at least one."""
    rows = part.rows_per_chunk
    return rows * max(MAX_SLAB_BYTES // (_count_row_bytes(part) * rows), 1)


def _count_row_bytes(part: Part) -> int:
    return part.data_window.width * sum(DTYPES[channel.pixel_type].itemsize for channel in part.channels)


def decode_part(container: Container, part: Part, names: Collection[str] | None = None) -> dict[str, Pixels]:
    """Return channels of a part, each (height, width) in its own type: uint32, float16 or float32.

    ``names`` are the wanted channels, by default all. Other channels take memory only for some rows at a time, unless
    the part has subsampled channels. A small file is decoded once for a container, and its channels are read-only.

    Raises FileError if the pixels are damaged, the part holds deep samples, or the system refuses memory or files.
    """
    if part.deep:
        raise FileError(
            f"input {str(container.path)!r}",
            expected="an image with one value per pixel",
            got="deep samples",
            action="flatten it first",
        )
    chosen = [channel for channel in part.channels if names is None or channel.name in names]
    window, step = part.data_window, count_fitting_rows(part)
    plain = all(channel.x_sampling == channel.y_sampling == 1 for channel in part.channels)
    if (kept := _kept.get((id(container), part.index))) is not None:
        top = window.y_min - container.parts[part.index].data_window.y_min
        return {channel.name: kept[channel.name][top : top + window.height] for channel in chosen}
    if step >= window.height or not plain:
        pixels = _decode_rows(container, part)
        if plain and window == container.parts[part.index].data_window:
            _keep(container, part, pixels)
        return {channel.name: pixels[channel.name] for channel in chosen}
    try:
        whole = {each.name: np.empty((window.height, window.width), DTYPES[each.pixel_type]) for each in chosen}
    except MemoryError as problem:
        raise refuse_system(f"input {str(container.path)!r}", problem) from problem
    for first in range(0, window.height, step):
        stop = min(first + step, window.height)
        pixels = _decode_rows(container, crop_part(part, first, stop))
        for name, plane in whole.items():
            plane[first:stop] = pixels[name]
    return whole


def _keep(container: Container, part: Part, pixels: dict[str, Pixels]) -> None:
    """Keep the pixels of a part of a small file: it is read thrice, and the library decodes all channels for a few."""
    if sum(_count_row_bytes(each) * each.data_window.height for each in container.parts) > KEPT_BYTES:
        return
    for plane in pixels.values():
        plane.flags.writeable = False
    _kept[id(container), part.index] = pixels
    finalize(container, _kept.pop, (id(container), part.index), None).atexit = False


def refuse_system(name: str, problem: MemoryError | OSError | ImportError) -> FileError:
    """Return the error for a file whose pixels the system does not let us decode or encode; the file may be good."""
    if isinstance(problem, MemoryError):
        got, action = "not enough memory", "free some, or raise the limit of this process (ulimit -v)"
    else:
        got = say_reason(problem) if isinstance(problem, OSError) else f"a library that cannot be loaded ({problem})"
        action = "check the disk, and the limits of this process (ulimit -a)"
    return FileError(name, expected="memory and files to work with", got=got, action=action)


def _decode_rows(container: Container, part: Part) -> dict[str, Pixels]:
    """Return every channel of a part, decoded at once."""
    name = f"input {str(container.path)!r}"
    try:
        with container.path.open("rb") as stream:
            data = pack_part(container, part, stream)
        pixels = decode_bytes(data, _count_row_bytes(part) * part.data_window.height)
    except (OSError, MemoryError, ImportError) as problem:
        raise refuse_system(name, problem) from problem
    except (RuntimeError, ValueError, TypeError, KeyError) as problem:
        raise FileError(
            name, expected="pixels that can be decoded", got="damaged pixels", action="render or copy it again"
        ) from problem
    for channel in part.channels:
        shape = (part.data_window.height // channel.y_sampling, part.data_window.width // channel.x_sampling)
        plane = pixels.get(channel.name)
        plain = channel.x_sampling == channel.y_sampling == 1
        if plane is None or plane.dtype != DTYPES[channel.pixel_type] or (plain and plane.shape != shape):
            raise FileError(
                name,
                expected=f"the channel '{show_name(channel.name)}' of {shape[1]}x{shape[0]} pixels",
                got="damaged pixels",
                action="render or copy it again",
            )
    return pixels


def decode_bytes(data: bytes, pixel_bytes: int) -> dict[str, Pixels]:
    """Return every channel of a file with one part, whose decoded pixels have ``pixel_bytes``.

    A damaged channel is left out, or raises RuntimeError, ValueError, TypeError or KeyError. Raises MemoryError,
    OSError or ImportError if the system refuses memory, files or the library.
    """
    import OpenEXR

    with _enter_library(len(data) + pixel_bytes, pixel_bytes):
        channels = OpenEXR.File(io.BytesIO(data), separate_channels=True).channels()
        # The library leaves out pixels that it cannot decode.
        return {key: np.asarray(channel.pixels) for key, channel in channels.items()}


def encode_part(container: Container, part: Part, pixels: Mapping[str, Pixels]) -> list[tuple[int, bytes]]:
    """Return the chunks of ``part`` with new pixels, as (index in the chunk table, bytes without the part number).

    Raises FileError as `require_encodable`.
    """
    require_encodable(container, part)
    data = encode_whole(part, pixels)
    return list_chunks(parse_bytes(data).parts[0], data)


def encode_whole(part: Part, pixels: Mapping[str, Pixels]) -> bytes:
    """Return a file that holds only ``part`` with new pixels, without attributes of users."""
    header: dict[str, Any] = {"dataWindow": _pair(part.data_window), "displayWindow": _pair(part.display_window)}
    header["lineOrder"] = part.line_order
    return encode_file(header, pixels, part=part)


def list_chunks(part: Part, data: bytes) -> list[tuple[int, bytes]]:
    """Return the chunks of the only part of a file, in the order of the file."""
    ordered = sorted(part.chunks, key=lambda chunk: chunk.offset)
    return [(chunk.index, data[chunk.offset : chunk.offset + chunk.size]) for chunk in ordered]


def require_encodable(container: Container, part: Part) -> None:
    """Raise FileError if a part has resolution levels or subsampled channels, which cannot be written."""
    odd = [show_name(channel.name) for channel in part.channels if (channel.x_sampling, channel.y_sampling) != (1, 1)]
    if part.levels > 1 or odd:
        raise FileError(
            f"input {str(container.path)!r}",
            expected="an image whose beauty can be written again",
            got=f"a part with subsampled channels ({', '.join(odd)})" if odd else "a part with resolution levels",
            action="convert it to a plain scanline file first",
        )


def encode_file(
    header: Mapping[str, Any], pixels: Mapping[str, Pixels], *, compression: str = "zip", part: Part | None = None
) -> bytes:
    """Return a single-part file, with the types, tiles and compression of ``part`` if it is given.

    Raises FileError if the library cannot encode the pixels, or the system refuses memory.
    """
    import OpenEXR

    numbers = {name: number for number, (name, _) in COMPRESSIONS.items()}
    full: dict[str, Any] = dict(header)
    full["compression"] = OpenEXR.Compression(numbers[part.compression if part else compression])
    full["type"] = OpenEXR.tiledimage if part and part.tiled else OpenEXR.scanlineimage
    if "lineOrder" in full:
        full["lineOrder"] = OpenEXR.LineOrder(full["lineOrder"])
    if "envmap" in full:
        full["envmap"] = OpenEXR.Envmap(full["envmap"])
    if part and part.tiled:
        full["tiles"] = OpenEXR.TileDescription()
        full["tiles"].xSize, full["tiles"].ySize = part.tile_size
    linear = {channel.name: channel.linear for channel in part.channels} if part else {}
    channels = {
        # The library ignores strides: an array that is not contiguous would be scrambled.
        name: OpenEXR.Channel(name, np.ascontiguousarray(values), 1, 1, linear.get(name, False))
        for name, values in pixels.items()
    }
    out = io.BytesIO()
    pixel_bytes = sum(values.nbytes for values in pixels.values())
    try:
        with _enter_library(2 * pixel_bytes, pixel_bytes):
            OpenEXR.File(full, channels).write(out)
    except (MemoryError, OSError) as problem:
        raise refuse_system("output", problem) from problem
    except (RuntimeError, ValueError, TypeError) as problem:
        raise FileError(
            "output", expected="pixels that can be encoded", got=str(problem), action="report it"
        ) from problem
    return out.getvalue()


class _Threads:
    """The library's threads, one for every core. Without this the library uses a single thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._has_started = False

    def start(self) -> None:
        """Start a thread for every core, if there is more than one and none was started.

        Their number stays, as other calls may be using them. Where the system has no room for the threads, or refuses
        them, none is started: the library then works in the thread that calls it.
        """
        with self._lock:
            if not self._has_started and count_cores() > 1 and _has_memory(count_cores() * THREAD_BYTES + FIXED_BYTES):
                try:
                    self._set(count_cores())
                    self._has_started = True
                except RuntimeError:
                    self._set(0)

    def end(self) -> None:
        """End all threads; then the library works in the thread that calls it. No call may be under way."""
        if self._has_started:
            self._set(0)
            self._has_started = False

    def _set(self, count: int) -> None:
        import OpenEXR

        if hasattr(OpenEXR, "set_global_thread_count"):
            OpenEXR.set_global_thread_count(count)


_threads = _Threads()
_gate = ForkGate(_threads.end)


def _pair(window: Window) -> tuple[Pixels, Pixels]:
    return np.array([window.x_min, window.y_min], np.int32), np.array([window.x_max, window.y_max], np.int32)


def _has_memory(size: int) -> bool:
    """Return whether the system would hand out ``size`` bytes now. They are not touched, so none is used."""
    try:
        mmap.mmap(-1, size).close()
    except OSError:
        return False
    return True


@contextmanager
def _enter_library(kept_bytes: int, pixel_bytes: int) -> Iterator[None]:
    """Start the library's threads for a call. Any number of threads may call it at once.

    The call keeps ``kept_bytes`` in memory and works on ``pixel_bytes`` of pixels. Raises MemoryError without the call
    if the system would not hand out its memory, and after a call that failed while memory was short.

    On damaged pixels the library prints, by Python's print and from C, and cannot be told to be silent. These lines are
    hidden.
    """
    check_limits()
    needed = kept_bytes + SCRATCH_COPIES * pixel_bytes + FIXED_BYTES
    with _gate.enter(), hide_lines("EXR_ERR", "ojph", "Warning: Exception raised reading pixel data"):
        _threads.start()
        if not _has_memory(needed):
            raise MemoryError
        try:
            yield
        except (RuntimeError, ValueError, TypeError, KeyError) as problem:
            # Another thread may have taken the memory since.
            if not _has_memory(needed):
                raise MemoryError from problem
            raise
