"""EXR files with a sound structure and mad contents: headers, chunk tables and chunks, taken apart and put together."""

import struct
from dataclasses import dataclass, field

import numpy as np
from hypothesis import strategies as st
from hypothesis.strategies import DrawFn

NUMBERS = (0, 1, 2, 7, 255, 256, 65535, 65536, 2**24, 2**28, 2**30, 2**31 - 1, -1, -2, -(2**31))
OFFSETS = (0, 1, 8, 4096, 2**31 - 1, 2**32, 2**63, 2**64 - 1)
SPECIAL = (0.0, -0.0, 1.0, 1e-45, 1e-38, 3.4e38, float("inf"), float("-inf"), float("nan"), -1.0, 0.5)


@dataclass
class Header:
    """The attributes of a part: name, type, value."""

    attributes: list[tuple[bytes, bytes, bytes]]
    table: list[int] = field(default_factory=list)


@dataclass
class File:
    """A file in its pieces; offsets of chunks count from the end of the tables."""

    version: int
    headers: list[Header]
    chunks: bytes

    def pack(self) -> bytes:
        """Return the file, its chunk tables moved to where the chunks now are."""
        out = struct.pack("<II", 20000630, self.version)
        for header in self.headers:
            for name, kind, value in header.attributes:
                out += name + b"\0" + kind + b"\0" + struct.pack("<i", len(value)) + value
            out += b"\0"
        if self.version & 0x1000:
            out += b"\0"
        start = len(out) + 8 * sum(len(header.table) for header in self.headers)
        for header in self.headers:
            out += b"".join(struct.pack("<Q", (start + offset) % 2**64) for offset in header.table)
        return out + self.chunks


def unpack(data: bytes) -> File:
    """Take a sound file apart."""
    version = struct.unpack_from("<I", data, 4)[0]
    position, headers = 8, []
    while True:
        attributes: list[tuple[bytes, bytes, bytes]] = []
        while data[position]:
            words = []
            for _ in range(2):
                end = data.index(0, position)
                words.append(data[position:end])
                position = end + 1
            (size,) = struct.unpack_from("<i", data, position)
            attributes.append((words[0], words[1], data[position + 4 : position + 4 + size]))
            position += 4 + size
        position += 1
        headers.append(Header(attributes))
        if not version & 0x1000:
            break
        if not data[position]:
            position += 1
            break
    # The tables end where the first chunk begins.
    offsets: list[int] = []
    while not offsets or position + 8 * len(offsets) < min(offsets):
        offsets += struct.unpack_from("<Q", data, position + 8 * len(offsets))
    start = min(offsets)
    place = 0
    for header in headers:
        named = {name: value for name, _, value in header.attributes}
        count = struct.unpack("<i", named[b"chunkCount"])[0] if b"chunkCount" in named else len(offsets)
        header.table = [offset - start for offset in offsets[place : place + count]]
        place += count
    return File(version, headers, data[start:])


def _replace_numbers(draw: DrawFn, value: bytes, code: str, numbers: tuple[float, ...]) -> bytes:
    size = struct.calcsize(code)
    if len(value) < size:
        return value
    at = size * draw(st.integers(0, len(value) // size - 1))
    return value[:at] + struct.pack(f"<{code}", draw(st.sampled_from(numbers))) + value[at + size :]


def change_value(draw: DrawFn, value: bytes, kind: bytes) -> bytes:
    """Return the value of an attribute with something in it changed."""
    how = draw(st.sampled_from(("number", "number", "byte", "cut", "longer", "any", "text")))
    if how == "number" and kind in (b"box2i", b"int", b"v2i", b"v3i", b"tiledesc", b"chlist", b"rational"):
        return _replace_numbers(draw, value, "i", NUMBERS)
    if how == "number" and kind in (b"double", b"v2d", b"v3d", b"m44d", b"m33d"):
        return _replace_numbers(draw, value, "d", (*SPECIAL, 1e300, 1e-300))
    if how == "number":
        return _replace_numbers(draw, value, "f", SPECIAL)
    if how == "cut":
        return value[: draw(st.integers(0, max(len(value) - 1, 0)))]
    if how == "longer":
        return value + draw(st.binary(min_size=1, max_size=20))
    if how == "any":
        return draw(st.binary(max_size=32))
    if how == "text":
        texts = ("9" * 5000, "-1", "0 0 0", "4 1 9999999999999999999999", "[" * 1000, "é\0\x1b[31m\n", "NaN", "")
        return draw(st.sampled_from(texts)).encode()
    return _change_byte(draw, value)


def _change_byte(draw: DrawFn, data: bytes) -> bytes:
    if not data:
        return data
    at = draw(st.integers(0, len(data) - 1))
    return data[:at] + bytes([draw(st.sampled_from((0, 1, 127, 128, 255)) | st.integers(0, 255))]) + data[at + 1 :]


def change_header(draw: DrawFn, file: File) -> None:
    """Change attributes: their values, types and names, how many there are and in which order."""
    header = draw(st.sampled_from(file.headers))
    at = draw(st.integers(0, len(header.attributes) - 1))
    name, kind, value = header.attributes[at]
    how = draw(st.sampled_from(("value",) * 6 + ("kind", "name", "drop", "twice", "move", "lobewise")))
    if how == "value":
        header.attributes[at] = name, kind, change_value(draw, value, kind)
    elif how == "kind":
        kinds = (b"int", b"float", b"string", b"box2i", b"v2f", b"m44f", b"chlist", b"", b"\xff", b"k" * 300)
        header.attributes[at] = name, draw(st.sampled_from(kinds)), value
    elif how == "name":
        named = (b"", b"\xff", b"n" * 300, b"cryptomatte/x/manifest", b"lobewise/spp", b"lobewise/lobes/9")
        header.attributes[at] = draw(st.sampled_from(named)), kind, value
    elif how == "drop":
        del header.attributes[at]
        if not header.attributes:
            header.attributes.append((name, kind, value))
    elif how == "twice":
        header.attributes.insert(draw(st.integers(0, len(header.attributes))), (name, kind, value))
    elif how == "move":
        header.attributes.insert(0, header.attributes.pop(at))
    else:
        header.attributes.append(draw(st.sampled_from(OWN)))


OWN = (
    (b"lobewise/camera/position", b"v3d", struct.pack("<3d", 1e300, 0.0, float("nan"))),
    (b"lobewise/camera/fov_y", b"double", struct.pack("<d", float("inf"))),
    (b"lobewise/lobes/1", b"string", b'{"format": "lobewise lobes", "version": 1, "kind": 5}'),
    (b"lobewise/lobes/2", b"string", b"[" * 5000),
    (b"lobewise/sparse", b"string", b"2 0 " + b"9" * 5000),
    (b"cycles.V.samples", b"string", b"9" * 5000),
    (b"samplesPerPixel", b"float", struct.pack("<f", float("inf"))),
    (b"worldToCamera", b"m44f", struct.pack("<16f", *[0.0] * 16)),
    (b"worldToNDC", b"m44f", struct.pack("<16f", *[3e38] * 16)),
    (b"pixelAspectRatio", b"float", struct.pack("<f", 0.0)),
    (b"cameraFov", b"float", struct.pack("<f", float("nan"))),
    (b"dwaCompressionLevel", b"float", struct.pack("<f", float("nan"))),
    (b"preview", b"preview", struct.pack("<II", 2**16, 2**16)),
    (b"multiView", b"stringvector", struct.pack("<i", 2**31 - 1)),
)
"""Attributes that lobewise or OpenEXR looks at, with contents that nobody writes."""


def change_table(draw: DrawFn, file: File) -> None:
    """Change the chunk tables: offsets that repeat, overlap, lie outside or in another order; more or fewer of them."""
    header = draw(st.sampled_from(file.headers))
    table = header.table
    how = draw(st.sampled_from(("same", "near", "far", "shuffle", "more", "fewer")))
    at = draw(st.integers(0, len(table) - 1)) if table else 0
    if how == "same" and table:
        header.table = [table[at]] * len(table)
    elif how == "near" and table:
        table[at] += draw(st.integers(-40, 40))
    elif how == "far" and table:
        table[at] = draw(st.sampled_from(OFFSETS))
    elif how == "shuffle":
        table.reverse()
    elif how == "more":
        header.table = table + [table[at] if table else 0] * draw(st.sampled_from((1, 8, 500)))
    elif how == "fewer" and table:
        del table[at]


def change_chunks(draw: DrawFn, file: File) -> None:
    """Change the chunks: bytes, numbers in front of them, pieces that are cut out, repeated or swapped."""
    data = file.chunks
    how = draw(st.sampled_from(("byte", "byte", "number", "cut", "repeat", "swap", "noise", "zero")))
    at = draw(st.integers(0, max(len(data) - 1, 0)))
    size = draw(st.integers(1, 64))
    if how == "byte":
        file.chunks = _change_byte(draw, data)
    elif how == "number":
        # A chunk begins with its row and its size, or the part before them.
        offsets = [offset for header in file.headers for offset in header.table if 0 <= offset < len(data) - 16]
        start = draw(st.sampled_from(offsets)) if offsets else 0
        start += 4 * draw(st.integers(0, 4))
        file.chunks = data[:start] + struct.pack("<i", draw(st.sampled_from(NUMBERS))) + data[start + 4 :]
    elif how == "cut":
        file.chunks = data[:at]
    elif how == "repeat":
        file.chunks = data[:at] + data[at : at + size] * draw(st.sampled_from((2, 3, 50))) + data[at + size :]
    elif how == "swap":
        file.chunks = data[at:] + data[:at]
    elif how == "noise":
        file.chunks = data[:at] + draw(st.binary(min_size=size, max_size=size)) + data[at + size :]
    else:
        file.chunks = data[:at] + bytes(size) + data[at + size :]


@st.composite
def make_structured(draw: DrawFn, seeds: list[bytes]) -> bytes:
    """Return a file that was taken apart, changed once to four times, and put together."""
    file = unpack(draw(st.sampled_from(seeds)))
    for _ in range(draw(st.sampled_from((1, 1, 1, 2, 3)))):
        draw(st.sampled_from((change_header, change_header, change_table, change_chunks)))(draw, file)
    if draw(st.integers(0, 9)) == 0:
        file.version ^= draw(st.sampled_from((0x200, 0x400, 0x800, 0x1000, 1, 0x80000000)))
    return file.pack()


PIXEL = struct.Struct("<iBxxxii")


@st.composite
def make_sound(draw: DrawFn) -> bytes:
    """Return a file in order whose pixels are noise: any channels, half of them not finite or far too large."""
    width, height = draw(st.integers(1, 9)), draw(st.integers(1, 9))
    names = sorted({*draw(st.sampled_from(GROUPS)), *draw(st.sampled_from(GROUPS)), *draw(st.sampled_from(GROUPS))})
    kinds = [draw(st.sampled_from((1, 2, 2, 2) if name != b"material.I" else (0, 2))) for name in names]
    window = struct.pack("<4i", 0, 0, width - 1, height - 1)
    compression = draw(st.sampled_from((0, 1, 2, 3)))
    channels = b"".join(name + b"\0" + PIXEL.pack(kind, 0, 1, 1) for name, kind in zip(names, kinds, strict=True))
    rows = 16 if compression == 3 else 1
    odd = draw(st.sampled_from((0.0, 0.02, 0.5)))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    chunks, table = b"", []
    for first in range(0, height, rows):
        data = b""
        for _ in range(first, min(first + rows, height)):
            for kind in kinds:
                values = rng.random(width).astype(np.float32)
                values[rng.random(width) < odd] = rng.choice(np.array(SPECIAL, np.float64)).astype(np.float32)
                with np.errstate(all="ignore"):
                    data += values.astype((np.uint32, np.float16, np.float32)[kind]).tobytes()
        table.append(len(chunks))
        # Data as long as it is when it is not packed is taken for not packed.
        chunks += struct.pack("<2i", first, len(data)) + data
    attributes = [
        (b"channels", b"chlist", channels + b"\0"), (b"compression", b"compression", bytes([compression])),
        (b"dataWindow", b"box2i", window), (b"displayWindow", b"box2i", window), (b"lineOrder", b"lineOrder", b"\0"),
        (b"pixelAspectRatio", b"float", struct.pack("<f", draw(st.sampled_from((1.0, *SPECIAL))))),
        (b"screenWindowCenter", b"v2f", bytes(8)), (b"screenWindowWidth", b"float", struct.pack("<f", 1.0)),
    ]  # fmt: skip
    attributes += draw(st.lists(st.sampled_from(OWN), max_size=2, unique=True))
    return File(2, [Header(attributes, table)], chunks).pack()


@st.composite
def make_from_grammar(draw: DrawFn) -> bytes:
    """Return a file of a header that was made up: channels, windows, compression, tiles, with chunks of noise."""
    width, height = (draw(st.sampled_from((1, 2, 16, 33, 4096, 16384)) | st.integers(1, 64)) for _ in range(2))
    low = draw(st.sampled_from((0, -1, 1, -(2**30), 2**30 - 40000)))
    window = struct.pack("<4i", low, low, low + width - 1, low + height - 1)
    names = draw(st.lists(st.sampled_from(CHANNELS), min_size=1, max_size=40, unique=True))
    channels = b"".join(
        name + b"\0" + PIXEL.pack(draw(st.integers(0, 2)), 0, *draw(st.sampled_from(((1, 1), (1, 1), (2, 2), (1, 4)))))
        for name in sorted(names)
    )
    compression = draw(st.integers(0, 14))
    attributes = [
        (b"channels", b"chlist", channels + b"\0"), (b"compression", b"compression", bytes([compression])),
        (b"dataWindow", b"box2i", window), (b"displayWindow", b"box2i", window),
        (b"lineOrder", b"lineOrder", bytes([draw(st.integers(0, 3))])),
        (b"pixelAspectRatio", b"float", struct.pack("<f", draw(st.sampled_from(SPECIAL)))),
        (b"screenWindowCenter", b"v2f", bytes(8)), (b"screenWindowWidth", b"float", struct.pack("<f", 1.0)),
    ]  # fmt: skip
    attributes += draw(st.lists(st.sampled_from(OWN), max_size=3, unique=True))
    tiled = draw(st.booleans())
    rows = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256, 256, 32, 256, 1, 1)[compression]
    count = -(-height // rows)
    if tiled:
        side, mode = draw(st.sampled_from((1, 8, 64, 4096))), draw(st.sampled_from((0, 0, 1, 2, 16, 17, 3)))
        attributes.append((b"tiles", b"tiledesc", struct.pack("<IIB", side, side, mode)))
        count = min(-(-width // side) * -(-height // side), 5000)
    size = draw(st.sampled_from((0, 4, 64, 1000)))
    noise = bytes(size) if draw(st.booleans()) else draw(st.binary(min_size=size, max_size=size))
    leader = [0, 0, 0, 0, size] if tiled else [low, size]
    chunk = struct.pack(f"<{len(leader)}i", *leader) + noise
    apart = draw(st.booleans())
    table = [k * len(chunk) if apart else 0 for k in range(count)]
    return File(2 | 0x200 * tiled, [Header(attributes, table)], chunk * (count if apart else 1)).pack()


GROUPS = (
    *((b"R", b"G", b"B"), (b"R", b"G", b"B"), (b"R", b"G", b"B"), (b"normal.X", b"normal.Y", b"normal.Z"), (b"Z",)),
    *(
        (b"depth.Z",),
        (b"alpha.U",),
        (b"alpha.U", b"alpha.V"),
        (b"material.I",),
        (b"position.X", b"position.Y", b"position.Z"),
    ),
    *((b"variance.R", b"variance.G", b"variance.B"), (b"half_a.R", b"half_a.G", b"half_a.B"), (b"N.X", b"N.Y", b"N.Z")),
    *(
        tuple(b"V.%s.%s" % (name, letter) for letter in (b"R", b"G", b"B"))
        for name in (b"Combined", b"DiffCol", b"DiffDir")
    ),
    *(
        (b"V.Normal.X", b"V.Normal.Y", b"V.Normal.Z"),
        (b"V.Depth.Z",),
        (b"P.X", b"P.Y", b"P.Z"),
        (b"V.Vector.X", b"V.Vector.Y"),
    ),
    tuple(b"V.CryptoObject00.%s" % letter for letter in (b"r", b"g", b"b", b"a")),
)
"""Channels that belong together, in lobewise's names and others'."""
CHANNELS = (
    *(b"R", b"G", b"B", b"A", b"Z", b"Y", b"RY", b"BY", b"normal.X", b"normal.Y", b"normal.Z", b"depth.Z", b"alpha.U"),
    *(b"material.I", b"N.X", b"N.Y", b"N.Z", b"V.Combined.R", b"V.Combined.G", b"V.Combined.B", b"V.DiffCol.R"),
    *(b"V.CryptoObject00.r", b"V.CryptoObject00.g", b"V.CryptoObject00.b", b"V.CryptoObject00.a", b"variance.R"),
    *(b"half_a.R", b"half_a.G", b"half_a.B", b"half_b.R", b"\xc3\xa9", b".", b"..R", b"a" * 255, b"[!]", b"*"),
)
