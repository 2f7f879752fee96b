"""Parse the structure of an OpenEXR file: headers, attributes and offsets of chunks. No pixel is decoded here.

Parsing the structure first, in Python, has three uses. A damaged or truncated file gives a clear error before a codec
sees it. Attributes are copied as bytes, so that none is lost or changed, whatever its type. Unchanged parts are copied
without decoding.

Source: "OpenEXR File Layout" and "Technical Introduction to OpenEXR", openexr.com.
"""

from __future__ import annotations

import io
import math
import os
import struct
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import BinaryIO

from lobewise.errors import FileError
from lobewise.io.exr.chunk_grid import MAX_EXPANSION, Place, list_levels, list_rows, list_tiles
from lobewise.io.exr.container import (
    ATTRIBUTE_BYTES,
    COMPRESSIONS,
    DEEP,
    LONG_NAMES,
    MAGIC,
    MULTIPART,
    PIXEL_TYPES,
    TILED,
    Attribute,
    Channel,
    Chunk,
    Container,
    Part,
    Window,
    show_name,
)
from lobewise.io.files import PathLike, require_readable

OTHER_FORMATS = {
    b"\x89PNG": "PNG",
    b"\xff\xd8\xff": "JPEG",
    b"GIF8": "GIF",
    b"BM": "BMP",
    b"II*\0": "TIFF",
    b"MM\0*": "TIFF",
    b"#?": "Radiance HDR",
    b"PF": "PFM",
    b"Pf": "PFM",
    b"8BPS": "Photoshop",
    b"DDS ": "DDS",
}
"""Formats of pictures by the first bytes of their files."""
FOR_SCREENS = ("PNG", "JPEG", "GIF", "BMP")
"""Formats that hold colors for screens and no passes."""
MAX_PIXELS = 2**28
"""Most pixels of a data window, 16384 x 16384. A larger window counts as damage."""
MAX_TILE_PIXELS = 2**22
"""Most pixels of a tile, unless the image is large too."""
MAX_ATTRIBUTES = 65536
"""Most attributes of a header. With a damaged length the parser must not read gigabytes."""
MAX_LINE_ORDER = 2
"""Largest value of the attribute ``lineOrder``; see `Part.line_order`."""
MAX_NAME_BYTES = 255
"""Longest name of an attribute, type or channel."""


class _Damaged(Exception):
    """The reason why a file counts as damaged, and what to do. The public functions add the file's name."""

    def __init__(self, reason: str, action: str = "render or copy it again") -> None:
        super().__init__(reason)
        self.action = action


def _require_exr(file: Path) -> None:
    """Raise FileError if a file is a picture of another format."""
    try:
        with file.open("rb") as stream:
            first = stream.read(max(map(len, OTHER_FORMATS)))
    except OSError:
        # Reading the file raises the error.
        return
    for start, name in OTHER_FORMATS.items():
        if first.startswith(start):
            raise FileError(
                f"input {str(file)!r}",
                expected="an OpenEXR file",
                got=f"a {name} picture",
                action="save the render as OpenEXR, with the passes that `lobewise inspect` then names"
                if name in FOR_SCREENS
                else "save it as OpenEXR",
            )


def read_container(path: PathLike) -> Container:
    """Read the structure of an OpenEXR file and check that every chunk lies inside it.

    Raises FileError if the file cannot be opened, is not OpenEXR, or is damaged, truncated or unfinished.
    """
    file = require_readable(path)
    _require_exr(file)
    try:
        with file.open("rb") as stream:
            return replace(_parse(file, stream), stamp=stamp_file(stream.fileno()))
    except _Damaged as problem:
        raise FileError(
            f"input {str(path)!r}",
            expected="a whole OpenEXR file",
            got=str(problem),
            action=problem.action,
        ) from None
    except OSError as problem:
        raise FileError(
            f"input {str(path)!r}", expected="a readable file", got=str(problem), action="check the disk"
        ) from None


def stamp_file(file: Path | int) -> tuple[int, ...]:
    """Return numbers of a file, or of an open one, that are equal only if it is the same file and has not changed."""
    status = os.stat(file)
    return status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns


def parse_bytes(data: bytes) -> Container:
    """Return the structure of a file that is held in memory.

    Raises FileError if it is not a whole OpenEXR file.
    """
    try:
        return _parse(Path("memory"), io.BytesIO(data))
    except _Damaged as problem:
        raise FileError("image", expected="a whole OpenEXR file", got=str(problem), action="write it again") from None


class _Reader:
    """Reads a file from front to back, and tells what is missing if the file ends too soon."""

    def __init__(self, stream: BinaryIO) -> None:
        self.stream = stream
        self.size = stream.seek(0, os.SEEK_END)
        stream.seek(0)

    def take(self, count: int, what: str) -> bytes:
        if not 0 <= count <= self.size - self.stream.tell():
            raise _Damaged(f"a file of {self.size} bytes that ends inside {what}")
        return self.stream.read(count)

    def take_name(self, what: str) -> str:
        name = bytearray()
        while byte := self.take(1, what)[0]:
            name.append(byte)
            if len(name) > MAX_NAME_BYTES:
                raise _Damaged(f"{what} longer than {MAX_NAME_BYTES} bytes")
        return name.decode("utf-8", "surrogateescape")


def _parse(path: Path, stream: BinaryIO) -> Container:
    reader = _Reader(stream)
    if reader.size < 8:
        raise _Damaged(f"a file of {reader.size} bytes, too short to be one")
    if reader.take(4, "the magic number") != MAGIC:
        raise _Damaged("a file that does not begin like one", "name an image that a renderer wrote")
    version = struct.unpack("<I", reader.take(4, "the version"))[0]
    if version & 0xFF != 2 or version & ~(0xFF | TILED | LONG_NAMES | DEEP | MULTIPART):
        raise _Damaged(f"an unknown file version {version:#x}")
    headers = []
    while True:
        header = _parse_header(reader)
        if not header:
            break
        headers.append(header)
        if not version & MULTIPART:
            break
    if not headers:
        raise _Damaged("a file without any part")
    parts = []
    for index, attributes in enumerate(headers):
        parts.append(_interpret_header(index, attributes, version))
    tables = []
    for _, count in parts:
        tables.append(list(struct.unpack(f"<{count}Q", reader.take(8 * count, "the table of chunks"))))
    first = reader.stream.tell()
    multipart = bool(version & MULTIPART)
    if any(0 in table for table in tables):
        tables = _fill_tables(reader, [part for part, _ in parts], tables, multipart=multipart)
    done = tuple(
        replace(part, chunks=_locate_chunks(reader, part, table, multipart=multipart))
        for (part, _), table in zip(parts, tables, strict=True)
    )
    _require_apart(done, first, multipart=multipart)
    return Container(path=path, version=version, parts=done)


def _parse_header(reader: _Reader) -> tuple[Attribute, ...]:
    attributes: dict[str, Attribute] = {}
    while name := reader.take_name("an attribute's name"):
        kind = reader.take_name("an attribute's type")
        size = struct.unpack("<i", reader.take(4, "an attribute's size"))[0]
        if not kind or name in attributes or len(attributes) >= MAX_ATTRIBUTES:
            raise _Damaged("a damaged header")
        if ATTRIBUTE_BYTES.get(kind, size) != size:
            raise _Damaged(
                f"an attribute {_say(name)} of {size} bytes, where its type {kind} has {ATTRIBUTE_BYTES[kind]}"
            )
        attributes[name] = Attribute(name, kind, reader.take(size, f"the attribute {_say(name)}"))
    return tuple(attributes.values())


def _interpret_header(index: int, attributes: tuple[Attribute, ...], version: int) -> tuple[Part, int]:
    """Return the part without its chunks, and the number of its chunks."""
    items = {item.name: item for item in attributes}

    def value(name: str, kind: str, size: int | None) -> bytes:
        item = items.get(name)
        if item is None:
            raise _Damaged(f"a header without the attribute {_say(name)}")
        if item.type != kind or (size is not None and len(item.value) != size):
            raise _Damaged(f"a damaged attribute {_say(name)}")
        return item.value

    data = Window(*struct.unpack("<4i", value("dataWindow", "box2i", 16)))
    display = Window(*struct.unpack("<4i", value("displayWindow", "box2i", 16)))
    for name, window in (("data", data), ("display", display)):
        if window.width < 1 or window.height < 1:
            raise _Damaged(f"an empty {name} window of {window.width}x{window.height} pixels, an image of zero size")
    if data.width * data.height > MAX_PIXELS or max(map(abs, (data.x_min, data.y_min, data.x_max, data.y_max))) > 2**30:
        raise _Damaged(f"a data window of {data.width}x{data.height} pixels, more than {MAX_PIXELS}")
    number = value("compression", "compression", 1)[0]
    if number not in COMPRESSIONS:
        raise _Damaged(f"an unknown compression {number}")
    for name, kind, size in (
        ("pixelAspectRatio", "float", 4), ("screenWindowCenter", "v2f", 8),
        ("screenWindowWidth", "float", 4),
    ):  # fmt: skip
        value(name, kind, size)
    if (order := value("lineOrder", "lineOrder", 1)[0]) > MAX_LINE_ORDER:
        raise _Damaged(f"an unknown order of lines {order}")

    tiled, deep = bool(version & TILED), bool(version & DEEP)
    if version & (MULTIPART | DEEP):
        form = value("type", "string", None).decode("ascii", "replace")
        if form not in ("scanlineimage", "tiledimage", "deepscanline", "deeptile"):
            raise _Damaged(f"a part of the unknown type {_say(form)}")
        tiled, deep = form in ("tiledimage", "deeptile"), form.startswith("deep")

    levels = 1
    if tiled:
        width, height, mode = struct.unpack("<IIB", value("tiles", "tiledesc", 9))
        # The codecs allocate memory for a whole tile before they read its bytes.
        if not (
            0 < width * height <= max(MAX_TILE_PIXELS, 4 * data.width * data.height)
            and mode & 0xF <= 2
            and mode >> 4 <= 1
        ):
            raise _Damaged("a damaged attribute 'tiles'")
        _, grid = list_levels(data, mode)
        levels = len(grid)
        count = sum(-(-x // width) * -(-y // height) for x, y in grid)
    else:
        count = -(-data.height // COMPRESSIONS[number][1])
    if deep or version & MULTIPART:
        stated = struct.unpack("<i", value("chunkCount", "int", 4))[0]
        if stated != count:
            raise _Damaged(f"{stated} chunks in the header where the size of the image asks for {count}")
    channels = _parse_channels(value("channels", "chlist", None), data)
    part = Part(index, attributes, tiled, deep, channels, COMPRESSIONS[number][0], data, display, levels, ())
    return part, count


def _parse_channels(data: bytes, window: Window) -> tuple[Channel, ...]:
    """Return the channels of a part. One value of a subsampled channel must not stand for pixels outside the window."""
    channels = []
    names: set[str] = set()
    position = 0
    while position < len(data) and data[position]:
        end = data.find(b"\0", position)
        if not 0 <= end - position <= MAX_NAME_BYTES or end + 17 > len(data):
            raise _Damaged("a damaged list of channels")
        try:
            name = data[position:end].decode("utf-8")
        except UnicodeDecodeError:
            raise _Damaged("a channel whose name is not UTF-8") from None
        kind, linear, x, y = struct.unpack_from("<iBxxxii", data, end + 1)
        if not 0 <= kind <= 2 or linear > 1 or x < 1 or y < 1 or name in names:
            raise _Damaged(f"a damaged channel {_say(name)}")
        if any((window.x_min % x, window.width % x, window.y_min % y, window.height % y)):
            raise _Damaged(f"a channel {_say(name)} of one value for {x}x{y} pixels, which do not fill the window")
        names.add(name)
        channels.append(Channel(name, PIXEL_TYPES[kind], bool(linear), x, y))
        position = end + 17
    if position != len(data) - 1 or not channels:
        raise _Damaged("a damaged or empty list of channels")
    return tuple(channels)


def _fill_tables(
    reader: _Reader, parts: Sequence[Part], tables: Sequence[Sequence[int]], *, multipart: bool
) -> list[list[int]]:
    """Return the tables of chunks with the offsets that are 0 filled in, as far as their chunks are in the file.

    Some programs never fill in the table, or ended before. The reader is behind the tables, where the chunks begin.
    They follow each other in any order.
    """
    places = [{place.coordinates: number for number, place in enumerate(_list_places(part))} for part in parts]
    filled = [list(table) for table in tables]
    while reader.stream.tell() < reader.size:
        offset = reader.stream.tell()
        index = int.from_bytes(reader.stream.read(4), "little") if multipart else 0
        head = reader.stream.read(_count_leader_bytes(parts[index])) if index < len(parts) else b""
        if index >= len(parts) or len(head) < _count_leader_bytes(parts[index]):
            break
        coordinates, size = _unpack_leader(parts[index], head)
        end = reader.stream.tell() + size
        if coordinates not in places[index] or size < 0 or end > reader.size:
            break
        number = places[index][coordinates]
        filled[index][number] = filled[index][number] or offset
        reader.stream.seek(end)
    return filled


def _count_leader_bytes(part: Part) -> int:
    """Return the size of what precedes the pixels of a chunk, without the number of the part."""
    return (16 if part.tiled else 4) + (24 if part.deep else 4)


def _unpack_leader(part: Part, head: bytes) -> tuple[tuple[int, ...], int]:
    """Return the coordinates of a chunk, and the number of its bytes behind ``head``, which ends with its leader."""
    coordinates = struct.unpack_from("<4i" if part.tiled else "<i", head, len(head) - _count_leader_bytes(part))
    if part.deep:
        return coordinates, sum(struct.unpack_from("<QQ", head, len(head) - 24))
    return coordinates, struct.unpack_from("<i", head, len(head) - 4)[0]


def _locate_chunks(reader: _Reader, part: Part, table: Sequence[int], *, multipart: bool) -> tuple[Chunk, ...]:
    missing = sum(1 for offset in table if offset == 0)
    if missing:
        raise _Damaged(f"an unfinished file: {missing} of {len(table)} chunks of pixels are missing")
    chunks = []
    for place, (index, offset) in zip(_list_places(part), enumerate(table), strict=True):
        start, which = offset + (4 if multipart else 0), f"chunk {index + 1} of {len(table)}"
        leader = _count_leader_bytes(part)
        if offset < 8 or start + leader > reader.size:
            raise _Damaged(f"a truncated file of {reader.size} bytes: {which} is outside")
        reader.stream.seek(offset)
        head = reader.stream.read(start + leader - offset)
        if multipart and struct.unpack_from("<i", head)[0] != part.index:
            raise _Damaged(f"a damaged {which}")
        coordinates, size = _unpack_leader(part, head)
        if size < 0 or start + leader + size > reader.size:
            raise _Damaged(f"a truncated file of {reader.size} bytes: {which} is cut off")
        if coordinates != place.coordinates:
            raise _Damaged(f"a damaged {which}: it is that of another place in the image")
        # The codecs allocate memory for all pixels before they read the bytes.
        least = 0 if part.deep else place.count_bytes(part.channels)
        if least > size * MAX_EXPANSION.get(part.compression, math.inf):
            raise _Damaged(f"a damaged {which}: {size} bytes where its pixels take {least} and compress to more")
        chunks.append(Chunk(index, start, leader + size))
    return tuple(chunks)


def _list_places(part: Part) -> Iterator[Place]:
    """Yield the place of every chunk of a part, in the order of its table."""
    if part.tiled:
        return list_tiles(part.data_window, part.tile_mode, *part.tile_size)
    return list_rows(part.data_window, part.rows_per_chunk)


def _require_apart(parts: tuple[Part, ...], first: int, *, multipart: bool) -> None:
    """Raise `_Damaged` for chunks that overlap each other, or the headers and tables, which end at ``first``."""
    leader = 4 if multipart else 0
    end, before = first, "the header or the table of chunks"
    for offset, size, what in sorted(
        (chunk.offset - leader, chunk.size + leader, f"chunk {chunk.index + 1} of {len(part.chunks)}")
        for part in parts
        for chunk in part.chunks
    ):
        if offset < end:
            raise _Damaged(f"a damaged table of chunks: {what} lies over {before}")
        end, before = offset + size, what


def _say(name: str) -> str:
    return f"'{show_name(name)}'"
