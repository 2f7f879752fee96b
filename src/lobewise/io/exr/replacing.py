"""Copies of files in which some channels have other values, or further ones: all else is kept bit for bit."""

from __future__ import annotations

import struct
from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from lobewise.errors import InputError
from lobewise.frame import FloatArray
from lobewise.io.exr.container import LONG_NAMES, Attribute, Channel, Container, Part, show_name
from lobewise.io.exr.header import make_headers
from lobewise.io.exr.layout import convert_plane
from lobewise.io.exr.parsing import parse_bytes
from lobewise.io.exr.pixels import Pixels, decode_bytes, decode_part, encode_whole, list_chunks, require_encodable
from lobewise.io.exr.splice import write_container
from lobewise.io.files import PathLike, open_atomic, require_writable

LOSSLESS = ("none", "rle", "zips", "zip", "piz", "zstd", "htj2k256", "htj2k32")
"""Compressions that give back what they took, of every type."""
SHORT_NAME = 31

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
    """Write a copy of a file with other values in some channels; return what could not stay as it was, in sentences.

    Parameters
    ----------
    path : path
        The copy, which appears whole or not at all.
    container : Container
        The file.
    changed, added : mapping of int to mapping of str to array, shape (height, width)
        By the index of a part and the name of a channel: values that replace those of the file, in the type that the
        channel is stored in; and channels that it does not have, of 32 bits.
    settings : mapping
        Goes into the header of ``beauty``.
    only : bool
        Whether the copy shall have these channels alone, and no part without any.

    Raises
    ------
    FileError
        If the file cannot be read or the copy cannot be written.
    InputError
        If a channel that is added is there already, or a plane has another size.
    """
    require_writable(path)
    more = added or {}
    headers = make_headers(container, beauty, settings)
    chunks: dict[int, list[tuple[int, bytes]]] = {}
    told: list[str] = []
    version, parts = container.version, list(container.parts)
    for index in sorted({*changed, *more}):
        part = container.parts[index]
        _check_planes(container, part, changed.get(index, {}), more.get(index, {}))
        pixels, part = _change_pixels(container, part, changed.get(index, {}), more.get(index, {}), only=only)
        chunks[index], made, note = _encode(container, part, pixels, set(changed.get(index, {})))
        told += [note] if note else []
        headers[index] = [_take_over(item, made) for item in headers[index]]
        parts[index] = replace(container.parts[index], chunks=made.chunks)
        version |= LONG_NAMES if any(len(name.encode()) > SHORT_NAME for name in pixels) else 0
    whole = replace(container, version=version, parts=tuple(parts))
    if only:
        kept = sorted(chunks)
        whole = replace(whole, parts=tuple(replace(parts[index], index=k) for k, index in enumerate(kept)))
        headers = [headers[index] for index in kept]
        chunks = {k: chunks[index] for k, index in enumerate(kept)}
    with container.path.open("rb") as stream, open_atomic(path) as out:
        write_container(out, whole, stream, headers, chunks)
    return tuple(told)


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


def _change_pixels(
    container: Container, part: Part, changed: Planes, added: Planes, *, only: bool
) -> tuple[dict[str, Pixels], Part]:
    """Return the channels of a part as they shall be, and the part with the channels that are more."""
    before = decode_part(container, part)
    pixels = {name: plane for name, plane in before.items() if not only or name in changed}
    pixels |= {name: convert_plane(plane, before[name].dtype) for name, plane in changed.items()}
    pixels |= {name: np.asarray(plane, np.float32) for name, plane in added.items()}
    channels = (*part.channels, *(Channel(name, "float", False, 1, 1) for name in added))
    return pixels, replace(part, channels=tuple(channel for channel in channels if channel.name in pixels))


def _encode(
    container: Container, part: Part, pixels: Mapping[str, Pixels], changed: set[str]
) -> tuple[list[tuple[int, bytes]], Part, str]:
    """Return chunks, how the part was written, and what had to change: never the values of an untouched channel."""
    require_encodable(container, part)
    data = encode_whole(part, pixels)
    made, told = parse_bytes(data).parts[0], ""
    kept = [name for name in pixels if name not in changed]
    if part.compression not in LOSSLESS and kept and not _keeps(data, pixels, kept):
        told = (
            f"Part {show_name(part.name) or part.index!r} is compressed with loss ({part.compression}); so that "
            "channels which are not touched stay as they are, the copy is compressed without (zip)."
        )
        data = encode_whole(replace(part, compression="zip"), pixels)
        made = parse_bytes(data).parts[0]
    return list_chunks(made, data), made, told


def _keeps(data: bytes, pixels: Mapping[str, Pixels], names: list[str]) -> bool:
    made = decode_bytes(data)
    return all(np.array_equal(made[name], pixels[name], equal_nan=True) for name in names)


def _take_over(item: Attribute, made: Part) -> Attribute:
    """Return an attribute as it was, but channels, compression and the count of chunks as they were written."""
    if item.name == "chunkCount":
        return replace(item, value=struct.pack("<i", len(made.chunks)))
    written = made.get(item.name) if item.name in ("channels", "compression") else None
    return item if written is None else written
