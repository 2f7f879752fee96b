"""The structure of an OpenEXR file: headers, attributes and where the chunks lie; no pixel is decoded here.

Reading the structure first, in Python, has three uses. A damaged or truncated file is told in one sentence before a
codec sees it. Attributes travel as the bytes they are, so that none is lost or changed, whatever its type. Parts that
nobody touches are copied without being decoded.

Source: "OpenEXR File Layout" and "Technical Introduction to OpenEXR", openexr.com.
"""

from __future__ import annotations

import io
import os
import struct
from dataclasses import dataclass, replace
from pathlib import Path
from typing import BinaryIO

from lobewise.errors import FileError
from lobewise.io.files import PathLike, require_readable

MAGIC = b"\x76\x2f\x31\x01"
TILED, LONG_NAMES, DEEP, MULTIPART = 0x200, 0x400, 0x800, 0x1000

# Rows in one chunk, by the value of the attribute `compression`.
COMPRESSIONS = {
    0: ("none", 1), 1: ("rle", 1), 2: ("zips", 1), 3: ("zip", 16), 4: ("piz", 32), 5: ("pxr24", 16), 6: ("b44", 32),
    7: ("b44a", 32), 8: ("dwaa", 32), 9: ("dwab", 256), 10: ("htj2k256", 256), 11: ("htj2k32", 32),
    12: ("lj2k", 256), 13: ("zstd", 1),
}  # fmt: skip
PIXEL_TYPES = ("uint", "half", "float")

# A window beyond this is taken for damage: 2^28 pixels are 16384 x 16384.
MAX_PIXELS = 2**28
# Larger tiles are believed only where the image is large too.
MAX_TILE = 2**22
# No renderer comes near; a damaged length must not make the reader walk through gigabytes.
MAX_ATTRIBUTES = 65536
MAX_NAME = 255


@dataclass(frozen=True)
class Attribute:
    """One header attribute as its bytes; names keep undecodable bytes as surrogates."""

    name: str
    type: str
    value: bytes

    def pack(self) -> bytes:
        """Return the attribute as it stands in a file."""
        return _pack_name(self.name) + _pack_name(self.type) + struct.pack("<i", len(self.value)) + self.value


@dataclass(frozen=True)
class Channel:
    """One channel of a part: ``pixel_type`` is ``uint``, ``half`` or ``float``."""

    name: str
    pixel_type: str
    linear: bool
    x_sampling: int
    y_sampling: int


@dataclass(frozen=True)
class Chunk:
    """Where one chunk lies in the file: ``offset`` and ``size`` without the part number that multi-part files add."""

    index: int
    offset: int
    size: int


@dataclass(frozen=True)
class Window:
    """Inclusive pixel bounds."""

    x_min: int
    y_min: int
    x_max: int
    y_max: int

    @property
    def width(self) -> int:
        """Columns."""
        return self.x_max - self.x_min + 1

    @property
    def height(self) -> int:
        """Rows."""
        return self.y_max - self.y_min + 1


@dataclass(frozen=True)
class Part:
    """One part of a file."""

    index: int
    attributes: tuple[Attribute, ...]
    tiled: bool
    deep: bool
    channels: tuple[Channel, ...]
    compression: str
    data_window: Window
    display_window: Window
    levels: int
    chunks: tuple[Chunk, ...]
    tiles_above: int = 0
    """Rows of tiles that lie above, where this is cut from a taller part."""

    @property
    def rows_per_chunk(self) -> int:
        """Rows that a chunk has, the last ones perhaps less."""
        if not self.tiled:
            return next(rows for name, rows in COMPRESSIONS.values() if name == self.compression)
        tiles = self.get("tiles")
        assert tiles is not None  # checked when the header was read
        return int.from_bytes(tiles.value[4:8], "little")

    @property
    def name(self) -> str:
        """The part's name, empty where it has none."""
        return self.get_text("name")

    @property
    def view(self) -> str:
        """The part's view, for example ``left``; empty where it has none."""
        return self.get_text("view")

    def get(self, name: str) -> Attribute | None:
        """Return the attribute ``name``, or None."""
        return next((item for item in self.attributes if item.name == name), None)

    def get_text(self, name: str) -> str:
        """Return the text of a string attribute, empty where it is missing."""
        attribute = self.get(name)
        return attribute.value.decode("utf-8", "replace") if attribute and attribute.type == "string" else ""


@dataclass(frozen=True)
class Container:
    """The structure of a file."""

    path: Path
    version: int
    parts: tuple[Part, ...]

    @property
    def multipart(self) -> bool:
        """Whether the file is written in the multi-part form, even with one part."""
        return bool(self.version & MULTIPART)


class _Damaged(Exception):
    """Inner, short: what is wrong. The public edge adds the file's name."""


def read_container(path: PathLike) -> Container:
    """Read the structure of an OpenEXR file and check that every chunk lies inside it.

    Raises
    ------
    FileError
        If the file cannot be opened, is not OpenEXR, or is damaged, truncated or unfinished.
    """
    file = require_readable(path)
    try:
        with file.open("rb") as stream:
            return _parse(file, stream)
    except _Damaged as problem:
        raise FileError(
            f"input {str(path)!r}",
            expected="a whole OpenEXR file",
            got=str(problem),
            action="render or copy it again",
        ) from None
    except OSError as problem:
        raise FileError(
            f"input {str(path)!r}", expected="a readable file", got=str(problem), action="check the disk"
        ) from None


def parse_bytes(data: bytes) -> Container:
    """Return the structure of a file that is held in memory.

    Raises
    ------
    FileError
        If it is not a whole OpenEXR file.
    """
    try:
        return _parse(Path("memory"), io.BytesIO(data))
    except _Damaged as problem:
        raise FileError("image", expected="a whole OpenEXR file", got=str(problem), action="write it again") from None


def _pack_name(name: str) -> bytes:
    return name.encode("utf-8", "surrogateescape") + b"\0"


class _Reader:
    """A file that is read front to back and says where it ends too soon."""

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
            if len(name) > MAX_NAME:
                raise _Damaged(f"{what} longer than {MAX_NAME} bytes")
        return name.decode("utf-8", "surrogateescape")


def _parse(path: Path, stream: BinaryIO) -> Container:
    reader = _Reader(stream)
    if reader.size < 8:
        raise _Damaged(f"a file of {reader.size} bytes, too short to be one")
    if reader.take(4, "the magic number") != MAGIC:
        raise _Damaged("a file of another format")
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
        tables.append(struct.unpack(f"<{count}Q", reader.take(8 * count, "the table of chunks")))
    done = tuple(
        _with_chunks(part, _locate_chunks(reader, part, table, multipart=bool(version & MULTIPART)))
        for (part, _), table in zip(parts, tables, strict=True)
    )
    return Container(path=path, version=version, parts=done)


def _parse_header(reader: _Reader) -> tuple[Attribute, ...]:
    attributes: dict[str, Attribute] = {}
    while name := reader.take_name("an attribute's name"):
        kind = reader.take_name("an attribute's type")
        size = struct.unpack("<i", reader.take(4, "an attribute's size"))[0]
        if not kind or name in attributes or len(attributes) >= MAX_ATTRIBUTES:
            raise _Damaged("a damaged header")
        attributes[name] = Attribute(name, kind, reader.take(size, f"the attribute {_say(name)}"))
    return tuple(attributes.values())


def _interpret_header(index: int, attributes: tuple[Attribute, ...], version: int) -> tuple[Part, int]:
    """Return the part without chunks, and how many chunks it has."""
    found = {item.name: item for item in attributes}

    def value(name: str, kind: str, size: int | None) -> bytes:
        item = found.get(name)
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
        ("lineOrder", "lineOrder", 1), ("pixelAspectRatio", "float", 4), ("screenWindowCenter", "v2f", 8),
        ("screenWindowWidth", "float", 4),
    ):  # fmt: skip
        value(name, kind, size)

    tiled, deep = bool(version & TILED), bool(version & DEEP)
    if version & (MULTIPART | DEEP):
        form = value("type", "string", None).decode("ascii", "replace")
        if form not in ("scanlineimage", "tiledimage", "deepscanline", "deeptile"):
            raise _Damaged(f"a part of the unknown type {_say(form)}")
        tiled, deep = form in ("tiledimage", "deeptile"), form.startswith("deep")

    levels = 1
    if tiled:
        width, height, mode = struct.unpack("<IIB", value("tiles", "tiledesc", 9))
        # The codecs set aside memory for a whole tile before they look at its bytes.
        if not (
            0 < width * height <= max(MAX_TILE, 4 * data.width * data.height) and mode & 0xF <= 2 and mode >> 4 <= 1
        ):
            raise _Damaged("a damaged attribute 'tiles'")
        grid = _list_levels(data, mode)
        levels = len(grid)
        count = sum(-(-x // width) * -(-y // height) for x, y in grid)
    else:
        count = -(-data.height // COMPRESSIONS[number][1])
    if deep or version & MULTIPART:
        stated = struct.unpack("<i", value("chunkCount", "int", 4))[0]
        if stated != count:
            raise _Damaged(f"{stated} chunks in the header where the size of the image asks for {count}")
    channels = _parse_channels(value("channels", "chlist", None))
    part = Part(index, attributes, tiled, deep, channels, COMPRESSIONS[number][0], data, display, levels, ())
    return part, count


def _list_levels(data: Window, mode: int) -> list[tuple[int, int]]:
    """Return the size of every resolution level."""

    def sizes(full: int) -> list[int]:
        out = [full]
        while out[-1] > 1:
            out.append((out[-1] + 1) // 2 if mode >> 4 else out[-1] // 2)
        if mode >> 4:
            # Rounding up goes by the original size, not by the level before; both agree for halving.
            out = [max(1, -(-full // 2**level)) for level in range(len(out))]
        return out

    if mode & 0xF == 0:
        return [(data.width, data.height)]
    across, down = sizes(data.width), sizes(data.height)
    if mode & 0xF == 1:
        count = max(len(across), len(down))
        across += [1] * (count - len(across))
        down += [1] * (count - len(down))
        return list(zip(across, down, strict=True))
    return [(x, y) for y in down for x in across]


def _parse_channels(data: bytes) -> tuple[Channel, ...]:
    channels = []
    names: set[str] = set()
    position = 0
    while position < len(data) and data[position]:
        end = data.find(b"\0", position)
        if not 0 <= end - position <= MAX_NAME or end + 17 > len(data):
            raise _Damaged("a damaged list of channels")
        try:
            name = data[position:end].decode("utf-8")
        except UnicodeDecodeError:
            raise _Damaged("a channel whose name is not UTF-8") from None
        kind, linear, x, y = struct.unpack_from("<iBxxxii", data, end + 1)
        if not 0 <= kind <= 2 or x < 1 or y < 1 or name in names:
            raise _Damaged(f"a damaged channel {_say(name)}")
        names.add(name)
        channels.append(Channel(name, PIXEL_TYPES[kind], bool(linear), x, y))
        position = end + 17
    if position != len(data) - 1 or not channels:
        raise _Damaged("a damaged or empty list of channels")
    return tuple(channels)


def _locate_chunks(reader: _Reader, part: Part, table: tuple[int, ...], *, multipart: bool) -> tuple[Chunk, ...]:
    missing = sum(1 for offset in table if offset == 0)
    if missing:
        raise _Damaged(f"an unfinished file: {missing} of {len(table)} chunks of pixels are missing")
    chunks = []
    coordinates = 16 if part.tiled else 4
    for index, offset in enumerate(table):
        start = offset + (4 if multipart else 0)
        leader = coordinates + (24 if part.deep else 4)
        if offset < 8 or start + leader > reader.size:
            raise _Damaged(f"a truncated file of {reader.size} bytes: chunk {index + 1} of {len(table)} is outside")
        reader.stream.seek(offset)
        head = reader.stream.read(start + leader - offset)
        if multipart and struct.unpack_from("<i", head)[0] != part.index:
            raise _Damaged(f"a damaged chunk {index + 1} of {len(table)}")
        if part.deep:
            size = sum(struct.unpack_from("<QQ", head, start - offset + coordinates))
        else:
            size = struct.unpack_from("<i", head, start - offset + coordinates)[0]
        if size < 0 or start + leader + size > reader.size:
            raise _Damaged(f"a truncated file of {reader.size} bytes: chunk {index + 1} of {len(table)} is cut off")
        chunks.append(Chunk(index, start, leader + size))
    return tuple(chunks)


def _with_chunks(part: Part, chunks: tuple[Chunk, ...]) -> Part:
    return replace(part, chunks=chunks)


def crop_part(part: Part, first: int, stop: int) -> Part:
    """Return the rows from ``first`` to before ``stop`` as a part of its own, of one resolution.

    ``first`` counts from the top of the data window and is a multiple of `Part.rows_per_chunk`; so is ``stop``, or it
    is the height.
    """
    window, rows, tiles = part.data_window, part.rows_per_chunk, part.get("tiles")
    above, below, across = first // rows, -(-stop // rows), 1
    cut = replace(window, y_min=window.y_min + first, y_max=window.y_min + stop - 1)
    changed = {"dataWindow": struct.pack("<4i", cut.x_min, cut.y_min, cut.x_max, cut.y_max)}
    if part.tiled and tiles is not None:
        across = -(-window.width // int.from_bytes(tiles.value[:4], "little"))
        # The mode in the last byte: one level. That of the whole image comes first in the table.
        changed["tiles"] = tiles.value[:8] + b"\0"
    return replace(
        part,
        attributes=tuple(replace(item, value=changed.get(item.name, item.value)) for item in part.attributes),
        data_window=cut,
        levels=1,
        chunks=tuple(
            replace(chunk, index=chunk.index - above * across) for chunk in part.chunks[above * across : below * across]
        ),
        tiles_above=above if part.tiled else 0,
    )


def show_name(name: str) -> str:
    """Return a name from a file so that any terminal can show it, and none obeys it."""
    shown = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in name)
    return shown if len(shown) <= 80 else shown[:77] + "..."


def _say(name: str) -> str:
    return f"'{show_name(name)}'"
