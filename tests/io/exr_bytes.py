"""A second, minimal reader and writer of EXR headers, independent of the one under test: single-part files only."""

import struct
from pathlib import Path

Attributes = list[tuple[bytes, bytes, bytes]]


def read_attributes(data: bytes) -> tuple[Attributes, int]:
    """Return (name, type, value) of every attribute, and where the chunk table begins."""
    position, out = 8, []
    while data[position]:
        fields = []
        for _ in range(2):
            end = data.index(0, position)
            fields.append(data[position:end])
            position = end + 1
        (size,) = struct.unpack_from("<i", data, position)
        position += 4
        out.append((fields[0], fields[1], data[position : position + size]))
        position += size
    return out, position + 1


def inject_attributes(path: Path, extra: Attributes) -> None:
    """Add raw attributes to a file and move its chunk table along."""
    data = path.read_bytes()
    attributes, start = read_attributes(data)
    # The table ends where the first chunk begins; with falling line order that is the last one in the table.
    offsets: list[int] = []
    while not offsets or start + 8 * len(offsets) < min(offsets):
        offsets += struct.unpack_from("<Q", data, start + 8 * len(offsets))
    header = data[:8] + b"".join(
        name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value for name, kind, value in attributes + extra
    )
    header += b"\0"
    moved = [offset + len(header) - start for offset in offsets]
    path.write_bytes(header + struct.pack(f"<{len(moved)}Q", *moved) + data[min(offsets) :])


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
