"""Cut parts out of OpenEXR files, and assemble files from old and new chunks without decoding old ones."""

from __future__ import annotations

import struct
from collections.abc import Iterable, Mapping
from typing import BinaryIO

from lobewise.errors import FileError
from lobewise.io.exr.container import LONG_NAMES, MAGIC, TILED, Attribute, Chunk, Container, Part


def pack_part(container: Container, part: Part, stream: BinaryIO) -> bytes:
    """Return one part as a file of its own, with only the attributes that decoding needs.

    ``stream`` is the open file. The codec never sees other parts or attributes of users.
    """
    needed = {
        "channels", "compression", "dataWindow", "displayWindow", "lineOrder", "pixelAspectRatio",
        "screenWindowCenter", "screenWindowWidth",
    }  # fmt: skip
    if part.tiled:
        needed.add("tiles")
    needed_items = [item for item in part.attributes if item.name in needed]
    version = 2 | (TILED if part.tiled else 0) | (container.version & LONG_NAMES)
    header = MAGIC + struct.pack("<I", version) + b"".join(item.pack() for item in needed_items) + b"\0"
    chunks = [
        (chunk.index, shift_tiles(read_chunk(stream, chunk), -part.tiles_above))
        for chunk in sorted(part.chunks, key=lambda one: one.offset)
    ]
    table, position = [0] * len(chunks), len(header) + 8 * len(chunks)
    for index, data in chunks:
        table[index] = position
        position += len(data)
    # Join once: every copy of a large file takes as long as reading it.
    return b"".join([header, struct.pack(f"<{len(table)}Q", *table), *(data for _, data in chunks)])


def read_chunk(stream: BinaryIO, chunk: Chunk) -> bytes:
    """Return the bytes of one chunk, leader included, part number excluded."""
    stream.seek(chunk.offset)
    data = stream.read(chunk.size)
    if len(data) != chunk.size:
        raise FileError(
            "input",
            expected="a file that stays as it is",
            got="one that shrank while being read",
            action="try again",
        )
    return data


def shift_tiles(chunk: bytes, rows: int) -> bytes:
    """Return the chunk of a tile, moved down by ``rows`` rows of tiles. With 0 rows any chunk is returned as it is."""
    return (
        chunk if rows == 0 else chunk[:4] + struct.pack("<i", struct.unpack_from("<i", chunk, 4)[0] + rows) + chunk[8:]
    )


def write_container(
    out: BinaryIO,
    container: Container,
    source: BinaryIO,
    headers: list[list[Attribute]],
    new: Mapping[int, Iterable[tuple[int, bytes]]],
) -> None:
    """Write a file with the given headers, new chunks for the parts in ``new``, and unchanged chunks for the others.

    ``new`` maps a part's index to pairs of (index in the chunk table, bytes without the part number). Unchanged chunks
    are copied one by one, so that memory does not grow with their number.
    """
    packed = [b"".join(item.pack() for item in header) + b"\0" for header in headers]
    head = MAGIC + struct.pack("<I", container.version) + b"".join(packed) + (b"\0" if container.multipart else b"")
    tables = {part.index: [0] * len(part.chunks) for part in container.parts}
    position = len(head) + 8 * sum(len(table) for table in tables.values())
    out.write(head)
    out.write(b"\0" * (position - len(head)))
    for part in container.parts:
        prefix = struct.pack("<i", part.index) if container.multipart else b""
        pending: Iterable[Chunk] | Iterable[tuple[int, bytes]]
        in_order = sorted(part.chunks, key=lambda one: one.offset)
        pending = new.get(part.index, in_order)
        for item in pending:
            index, data = (item.index, read_chunk(source, item)) if isinstance(item, Chunk) else item
            tables[part.index][index] = position
            out.write(prefix)
            out.write(data)
            position += len(prefix) + len(data)
    out.seek(len(head))
    for part in container.parts:
        out.write(struct.pack(f"<{len(tables[part.index])}Q", *tables[part.index]))
