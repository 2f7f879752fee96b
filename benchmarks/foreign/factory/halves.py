"""Files all of half floats, as many a pipeline writes them. Needs neither Blender nor a library of EXR files."""

from __future__ import annotations

import struct
import zlib
from pathlib import Path

import numpy as np

FLOAT, HALF = 2, 1
"""Types of channels in EXR files."""
MAX_HALF = 65504.0
LINES = {2: 1, 3: 16}
"""Lines of a block, by number of the compression: ZIPS and ZIP."""


def unpack(block: bytes, size: int) -> np.ndarray:
    """Return the bytes of a block, `size` of them, as they were before its compression."""
    if len(block) == size:
        return np.frombuffer(block, np.uint8)
    steps = np.frombuffer(zlib.decompress(block), np.uint8).astype(np.int64)
    apart = (np.cumsum(steps) - 128 * np.arange(size)).astype(np.uint8)
    joined = np.empty(size, np.uint8)
    joined[::2], joined[1::2] = apart[: (size + 1) // 2], apart[(size + 1) // 2 :]
    return joined


def pack(data: np.ndarray) -> bytes:
    """Return bytes compressed; as they are where that makes them no smaller."""
    apart = np.concatenate([data[::2], data[1::2]]).astype(np.int64)
    steps = apart.copy()
    steps[1:] += 128 - apart[:-1]
    packed = zlib.compress(steps.astype(np.uint8).tobytes())
    return packed if len(packed) < len(data) else data.tobytes()


def read_header(data: bytes) -> tuple[dict[str, tuple[int, int]], int]:
    """Return where the values of a file's attributes begin and end, by name, and where the header ends."""
    found, at = {}, 8
    while data[at]:
        name, _, rest = data[at : at + 600].split(b"\0", 2)
        at += len(data[at : at + 600]) - len(rest)
        found[name.decode()] = at + 4, at + 4 + struct.unpack_from("<i", data, at)[0]
        at = found[name.decode()][1]
    return found, at + 1


def halve_file(path: Path) -> None:
    """Turn floats of a file of one part into half floats, but those of Cryptomatte, whose bits are names of things.

    What is larger than a half float can be becomes the largest one.
    """
    data = path.read_bytes()
    header, end = read_header(data)
    channels, before, after, at = bytearray(data[: header["channels"][1]]), [], [], header["channels"][0]
    while data[at]:
        name_end = data.index(b"\0", at)
        (kind,) = struct.unpack_from("<i", data, name_end + 1)
        is_name = b"Crypto" in data[at:name_end]
        before.append("<f2" if kind == HALF else "<f4")
        after.append("<f4" if is_name else "<f2")
        struct.pack_into("<i", channels, name_end + 1, FLOAT if is_name else HALF)
        at = name_end + 17
    left, top, right, bottom = struct.unpack_from("<4i", data, header["dataWindow"][0])
    lines, width = LINES[data[header["compression"][0]]], right - left + 1
    rows = [np.dtype([(str(number), each, width) for number, each in enumerate(types)]) for types in (before, after)]
    offsets, blocks = [], []
    count = -(-(bottom - top + 1) // lines)
    place = end + 8 * count
    for start in struct.unpack_from(f"<{count}Q", data, end):
        line, size = struct.unpack_from("<2i", data, start)
        high = min(lines, bottom + 1 - line)
        old = unpack(data[start + 8 : start + 8 + size], high * rows[0].itemsize).view(rows[0])
        new = np.empty(high, rows[1])
        for name in old.dtype.names:
            values = old[name]
            new[name] = values if new.dtype[name].base.itemsize == 4 else values.clip(-MAX_HALF, MAX_HALF)
        block = pack(new.view(np.uint8))
        offsets.append(place)
        blocks.append(struct.pack("<2i", line, len(block)) + block)
        place += len(blocks[-1])
    temporary = path.with_name(f".{path.name}")
    temporary.write_bytes(
        channels + data[header["channels"][1] : end] + struct.pack(f"<{count}Q", *offsets) + b"".join(blocks)
    )
    temporary.rename(path)
