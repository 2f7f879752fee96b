"""Copy files with new values in some channels, or with new channels. Everything else keeps its bits."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, BinaryIO

import numpy as np

from lobewise.errors import InputError
from lobewise.io.exr.container import LONG_NAMES, Attribute, Channel, Container, Part, crop_part, show_name
from lobewise.io.exr.header import make_headers
from lobewise.io.exr.layout import convert_plane
from lobewise.io.exr.pixels import DTYPES, Pixels, count_fitting_rows, decode_bytes, decode_part
from lobewise.io.exr.splice import write_container
from lobewise.io.exr.spool import ChunkSpool
from lobewise.io.files import PathLike, open_atomic, open_spool, require_writable
from lobewise.records.frame import FloatArray

LOSSLESS = ("none", "rle", "zips", "zip", "piz", "zstd", "htj2k256", "htj2k32")
"""Compressions that lose nothing, for every pixel type."""
MAX_SHORT_NAME_BYTES = 31
"""Longest name of a channel in a file without the flag `LONG_NAMES`."""

Planes = Mapping[str, FloatArray]


def write_copy(
    path: PathLike,
    container: Container,
    changed: Mapping[int, Planes],
    settings: Mapping[str, Any],
    beauty: Part,
    *,
    added: Mapping[int, Planes] | None = None,
    only: bool = False,
) -> tuple[str, ...]:
    """Write a copy of a file with other values in some channels; return sentences about what had to change otherwise.

    Parameters
    ----------
    path : path
        The copy. It is written whole or not at all.
    container : Container
        The file.
    changed, added : mapping of int to mapping of str to array, shape (height, width)
        By the index of a part and the name of a channel: new values for channels of the file, stored in the channel's
        type, and new channels, stored as 32-bit floats.
    settings : mapping
        Written into the header of ``beauty`` with the names of the ``changed`` and ``added`` channels.
    only : bool
        Whether the copy has only the changed and added channels, and only the parts that have any.

    Raises
    ------
    FileError
        If the file cannot be read or the copy cannot be written.
    InputError
        If an added channel exists already, or a plane has another size than its part.
    """
    require_writable(path)
    added_planes = added or {}
    written = {index: [*changed.get(index, ()), *added_planes.get(index, ())] for index in {*changed, *added_planes}}
    headers = make_headers(container, beauty, settings, written)
    spools: dict[int, ChunkSpool] = {}
    notes: list[str] = []
    version, parts = container.version, list(container.parts)
    with open_spool(path) as stream:
        for index in sorted(written):
            part = container.parts[index]
            planes = _Planes(part, changed.get(index, {}), added_planes.get(index, {}), only=only)
            planes.check(container)
            spools[index], note = _encode(container, planes, stream)
            notes += [note] if note else []
            headers[index] = [_take_over(item, spools[index]) for item in headers[index]]
            parts[index] = replace(part, chunks=spools[index].chunks)
            names = [channel.name for channel in planes.part.channels]
            version |= LONG_NAMES if any(len(name.encode()) > MAX_SHORT_NAME_BYTES for name in names) else 0
        whole = replace(container, version=version, parts=tuple(parts))
        chunks = {index: spool.read() for index, spool in spools.items()}
        if only:
            part_numbers = sorted(chunks)
            whole = replace(whole, parts=tuple(replace(parts[index], index=k) for k, index in enumerate(part_numbers)))
            headers = [headers[index] for index in part_numbers]
            chunks = {k: chunks[index] for k, index in enumerate(part_numbers)}
        with container.path.open("rb") as source, open_atomic(path) as out:
            write_container(out, whole, source, headers, chunks)
    return tuple(notes)


class _Planes:
    """The channels of a part of the copy.

    ``changed`` replaces channels of the part, ``added`` are new channels, and ``only`` leaves out all others. ``part``
    has the channels of the copy; ``unchanged`` names those that are copied.
    """

    def __init__(self, part: Part, changed: Planes, added: Planes, *, only: bool) -> None:
        self._before, self._changed, self._added = part, changed, added
        old_channels = [channel for channel in part.channels if not only or channel.name in changed]
        new_channels = [Channel(name, "float", False, 1, 1) for name in added]
        self.part = replace(part, channels=(*old_channels, *new_channels))
        self.unchanged = [channel.name for channel in old_channels if channel.name not in changed]

    def check(self, container: Container) -> None:
        """Raise InputError if a plane has another size than the part, or an added channel exists already."""
        _check_planes(container, self._before, self._changed, self._added)

    def read(self, container: Container, first: int, stop: int) -> dict[str, Pixels]:
        """Return the rows from ``first`` to before ``stop``, in the types of the channels."""
        pixels = decode_part(container, crop_part(self._before, first, stop), self.unchanged) if self.unchanged else {}
        types = {channel.name: DTYPES[channel.pixel_type] for channel in self._before.channels}
        for name, plane in self._changed.items():
            pixels[name] = convert_plane(plane[first:stop], types[name])
        for name, plane in self._added.items():
            pixels[name] = np.asarray(plane[first:stop], np.float32)
        return pixels


def _check_planes(container: Container, part: Part, changed: Planes, added: Planes) -> None:
    size = part.data_window.height, part.data_window.width
    for name, plane in {**changed, **added}.items():
        if plane.shape != size:
            raise InputError(
                f"channel {show_name(name)!r}",
                expected=f"the size of {str(container.path)!r}, {size[1]}x{size[0]} pixels",
                got=f"an array of shape {plane.shape}",
                action="denoise that file",
            )
    there = {channel.name for channel in part.channels}
    for name in added:
        if name in there:
            raise InputError(
                f"channel {show_name(name)!r}",
                expected="a name that the file does not have",
                got="one that it has",
                action="choose another suffix",
            )


def _encode(container: Container, planes: _Planes, stream: BinaryIO) -> tuple[ChunkSpool, str]:
    """Return the chunks and a sentence about a changed compression. Untouched channels keep their values."""
    part = planes.part
    lossy = part.compression not in LOSSLESS and bool(planes.unchanged)
    spool = ChunkSpool(container, part, stream)
    if _fill(spool, container, planes, checked=lossy):
        return spool, ""
    spool = ChunkSpool(container, replace(part, compression="zip"), stream)
    _fill(spool, container, planes, checked=False)
    return spool, (
        f"Part {show_name(part.name) or part.index!r} is compressed with loss ({part.compression}); so that "
        "channels which are not touched stay as they are, the copy is compressed without (zip)."
    )


def _fill(spool: ChunkSpool, container: Container, planes: _Planes, *, checked: bool) -> bool:
    """Encode all rows; return whether untouched channels kept their values, which is tested only if ``checked``."""
    height, step, first = planes.part.data_window.height, count_fitting_rows(planes.part), 0
    while first < height:
        # Where a compression loses, the first rows show it.
        stop = min(first + (planes.part.rows_per_chunk if checked and not first else step), height)
        pixels = planes.read(container, first, stop)
        data = spool.add(first, stop, pixels)
        if checked and not _keeps(data, pixels, planes.unchanged):
            return False
        first = stop
    return True


def _keeps(data: bytes, pixels: Mapping[str, Pixels], names: list[str]) -> bool:
    made = decode_bytes(data, sum(plane.nbytes for plane in pixels.values()))
    return all(np.array_equal(made[name], pixels[name], equal_nan=True) for name in names)


def _take_over(item: Attribute, spool: ChunkSpool) -> Attribute:
    """Return an attribute for the copy: channels, compression and chunk count are new, all others stay."""
    if item.name == "chunkCount":
        return replace(item, value=struct.pack("<i", len(spool.chunks)))
    written = spool.look_up_made(item.name) if item.name in ("channels", "compression") else None
    return item if written is None else written
