"""The structure of an OpenEXR file: parts, headers, attributes and where the chunks lie."""

from __future__ import annotations

import struct
from dataclasses import dataclass, replace
from pathlib import Path

MAGIC = b"\x76\x2f\x31\x01"
TILED, LONG_NAMES, DEEP, MULTIPART = 0x200, 0x400, 0x800, 0x1000

# Name and rows in one chunk, by the value of the attribute `compression`.
COMPRESSIONS = {
    0: ("none", 1), 1: ("rle", 1), 2: ("zips", 1), 3: ("zip", 16), 4: ("piz", 32), 5: ("pxr24", 16), 6: ("b44", 32),
    7: ("b44a", 32), 8: ("dwaa", 32), 9: ("dwab", 256), 10: ("htj2k256", 256), 11: ("htj2k32", 32),
    12: ("lj2k", 256), 13: ("zstd", 1),
}  # fmt: skip
PIXEL_TYPES = ("uint", "half", "float")
# Bytes of attributes whose type has a fixed size. Source: "OpenEXR File Layout", predefined attribute types.
ATTRIBUTE_BYTES = {
    "box2f": 16, "box2i": 16, "chromaticities": 32, "compression": 1, "double": 8, "envmap": 1, "float": 4, "int": 4,
    "keycode": 28, "lineOrder": 1, "m33d": 72, "m33f": 36, "m44d": 128, "m44f": 64, "rational": 8, "tiledesc": 9,
    "timecode": 8, "v2d": 16, "v2f": 8, "v2i": 8, "v3d": 24, "v3f": 12, "v3i": 12,
}  # fmt: skip


@dataclass(frozen=True)
class Attribute:
    """One header attribute with its bytes. Names keep undecodable bytes as surrogates."""

    name: str
    type: str
    value: bytes

    def pack(self) -> bytes:
        """Return the attribute as the bytes of a file."""
        return _pack_name(self.name) + _pack_name(self.type) + struct.pack("<i", len(self.value)) + self.value


@dataclass(frozen=True)
class Channel:
    """One channel of a part: ``pixel_type`` is ``uint``, ``half`` or ``float``."""

    name: str
    pixel_type: str
    linear: bool
    x_sampling: int
    y_sampling: int

    @property
    def is_whole(self) -> bool:
        """Whether the channel has a value for every pixel."""
        return self.x_sampling == self.y_sampling == 1


@dataclass(frozen=True)
class Chunk:
    """Offset and size of one chunk in a file, without the part number that multi-part files add."""

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

    @property
    def area(self) -> int:
        """Number of pixels."""
        return self.width * self.height


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
    """Rows of tiles above this part, if it was cut from a taller part."""

    @property
    def rows_per_chunk(self) -> int:
        """Rows of a chunk; the last chunk may have fewer."""
        if self.tiled:
            return self.tile_size[1]
        return next(rows for name, rows in COMPRESSIONS.values() if name == self.compression)

    @property
    def tile_size(self) -> tuple[int, int]:
        """Columns and rows of a tile; only for a part with tiles."""
        columns, rows = struct.unpack_from("<II", self._require("tiles"))
        return columns, rows

    @property
    def tile_mode(self) -> int:
        """Kind of resolution levels and rounding of their sizes: the last byte of the attribute ``tiles``."""
        return self._require("tiles")[8]

    @property
    def line_order(self) -> int:
        """Order of the chunks in the file: from top to bottom (0), from bottom to top (1) or any (2)."""
        return self._require("lineOrder")[0]

    @property
    def name(self) -> str:
        """The part's name, empty if it has none."""
        return self.get_text("name")

    @property
    def view(self) -> str:
        """The part's view, for example ``left``; empty if it has none."""
        return self.get_text("view")

    @property
    def views(self) -> tuple[str, ...]:
        """The views whose channels the part holds, the default one first; empty if the header does not list them."""
        item = self.get("multiView")
        return _unpack_texts(item.value) if item and item.type == "stringvector" else ()

    def describe_obstacle(self, channel: Channel) -> str:
        """Return why no image can be made of a channel, to follow "the channel is"; empty if one can be made."""
        if self.deep:
            return "deep, with any number of samples in each pixel"
        if not channel.is_whole:
            return f"subsampled, with one value for {channel.x_sampling}x{channel.y_sampling} pixels"
        return ""

    def get(self, name: str) -> Attribute | None:
        """Return the attribute ``name``, or None."""
        return next((item for item in self.attributes if item.name == name), None)

    def _require(self, name: str) -> bytes:
        """Return an attribute whose presence and size were checked when the header was read."""
        return next(item.value for item in self.attributes if item.name == name)

    def get_text(self, name: str) -> str:
        """Return the text of a string attribute, empty if it is missing."""
        attribute = self.get(name)
        return attribute.value.decode("utf-8", "replace") if attribute and attribute.type == "string" else ""


@dataclass(frozen=True)
class Container:
    """The structure of a file."""

    path: Path
    version: int
    parts: tuple[Part, ...]
    stamp: tuple[int, ...] | None = None
    """What tells this file from others and from later versions of itself; see `stamp_file`."""

    @property
    def multipart(self) -> bool:
        """Whether the file has the multi-part form, which a file with one part can have too."""
        return bool(self.version & MULTIPART)


def _pack_name(name: str) -> bytes:
    return name.encode("utf-8", "surrogateescape") + b"\0"


def _unpack_texts(data: bytes) -> tuple[str, ...]:
    """Return the texts of an attribute of the type ``stringvector``, each after its size; empty if it is damaged."""
    texts, at = [], 0
    while at + 4 <= len(data):
        (size,) = struct.unpack_from("<i", data, at)
        at += 4
        if not 0 < size <= len(data) - at:
            return ()
        texts.append(data[at : at + size].decode("utf-8", "replace"))
        at += size
    return tuple(texts) if at == len(data) else ()


def crop_part(part: Part, first: int, stop: int) -> Part:
    """Return the rows from ``first`` to before ``stop`` as a part of its own, with one resolution level.

    Rows count from the top of the data window. ``first`` is a multiple of `Part.rows_per_chunk`; ``stop`` is another
    multiple, or the height.
    """
    window, rows = part.data_window, part.rows_per_chunk
    above, below, across = first // rows, -(-stop // rows), 1
    cut = replace(window, y_min=window.y_min + first, y_max=window.y_min + stop - 1)
    changed = {"dataWindow": struct.pack("<4i", cut.x_min, cut.y_min, cut.x_max, cut.y_max)}
    if part.tiled:
        across = -(-window.width // part.tile_size[0])
        # Mode 0 in the last byte: one level. The chunks of the full resolution come first in the table.
        changed["tiles"] = struct.pack("<IIB", *part.tile_size, 0)
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
    """Return a name from a file that is safe to print: control characters become escapes, long names are cut."""
    shown = "".join(letter if letter.isprintable() else ascii(letter)[1:-1] for letter in name)
    return shown if len(shown) <= 80 else shown[:77] + "..."
