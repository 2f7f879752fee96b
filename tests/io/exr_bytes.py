"""Attributes of EXR files, read and added without the reader and the writer under test: single-part files only."""

import struct
from pathlib import Path

from tests.fuzz.exr_files import unpack

Attributes = list[tuple[bytes, bytes, bytes]]


def read_attributes(data: bytes) -> tuple[Attributes, int]:
    """Return (name, type, value) of every attribute, and where the chunk table begins."""
    file = unpack(data)
    (header,) = file.headers
    return header.attributes, len(data) - len(file.chunks) - 8 * len(header.table)


def inject_attributes(path: Path, extra: Attributes) -> None:
    """Add raw attributes to a file and move its chunk table along."""
    file = unpack(path.read_bytes())
    file.headers[0].attributes += extra
    path.write_bytes(file.pack())


EXOTIC: Attributes = [
    (b"framesPerSecond", b"rational", struct.pack("<iI", 24000, 1001)),
    (b"exposureTime", b"double", struct.pack("<d", 1.1)),
    (b"timeCode", b"timecode", struct.pack("<II", 1, 2)),
    (b"preview", b"preview", struct.pack("<II", 2, 2) + bytes(range(16))),
    (b"owner", b"string", "Jos\xe9".encode("latin-1")),
    (b"notes", b"string", "日本 \0 tail".encode()),
    (b"names", b"stringvector", struct.pack("<i", 3) + b"abc" + struct.pack("<i", 0)),
    (b"ourOwnType", b"studioThing", b"\x00\xff\x01"),
    (b"matrix", b"m44f", struct.pack("<16f", *range(16))),
    (b"an_attribute_name_longer_than_31_bytes", b"int", struct.pack("<i", -7)),
    (b"empty", b"string", b""),
]
