"""Damage is told in one sentence: no traceback, no crash, no hang."""

import errno
import io
import struct

import numpy as np
import OpenEXR
import pytest
from exr_bytes import inject_attributes, read_attributes

from lobewise.errors import FileError, LobewiseError, MissingChannelError
from lobewise.interchange import describe_file, import_file, read_image
from lobewise.io import read_frame, write_frame
from lobewise.io.exr.describe import describe_part
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import decode_part
from tests.mistakes import refuses


def assert_one_sentence(problem: LobewiseError) -> None:
    assert (problem.holder or problem.what).startswith("input '")
    assert all((problem.expected, problem.got, problem.action))
    assert str(problem).isprintable()


@pytest.fixture
def whole(full_frame, tmp_path):
    """Return the bytes of a file of several chunks, and a path to write changed ones to."""
    path = tmp_path / "a.exr"
    write_frame(path, full_frame, compression="zips")
    return path.read_bytes(), path


def test_a_file_cut_anywhere_is_refused(whole):
    data, path = whole
    lengths = {*range(64), *np.linspace(64, len(data) - 1, 200).astype(int)}
    for length in sorted(lengths):
        path.write_bytes(data[:length])
        for read in (read_frame, read_image, describe_file):
            with pytest.raises(FileError) as caught:
                read(path)
            assert_one_sentence(caught.value)


def test_truncation_is_named(whole):
    data, path = whole
    path.write_bytes(data[:-1])
    with refuses(FileError, "input 'a.exr'", f"a truncated file of {len(data) - 1} bytes: chunk 9 of 9 is cut off"):
        read_frame(path)


def test_an_unfinished_file_is_named(whole):
    data, path = whole
    start, table = locate_table(data, 9)
    # A renderer that was ended has written seven rows and no table.
    path.write_bytes(data[:start] + bytes(72) + data[start + 72 : table[7]])
    with refuses(FileError, "input 'a.exr'", "an unfinished file: 2 of 9 chunks of pixels are missing"):
        read_frame(path)
    path.write_bytes(data[:start] + bytes(72) + data[start + 72 : table[7] + 20])
    with refuses(FileError, "input 'a.exr'", "an unfinished file: 2 of 9 chunks of pixels are missing"):
        read_frame(path)


@pytest.mark.parametrize(
    ("data", "got"),
    [
        (b"", "an empty file of 0 bytes"),
        (b"\x89PNG\r\n\x1a\n" + bytes(100), "a PNG picture"),
        (b"II*\0" + bytes(100), "a TIFF picture"),
        (b"PF\n8 8\n-1.0\n" + bytes(768), "a PFM picture"),
        (b"# text" + bytes(100), "a file that does not begin like one"),
        (b"v/1", "a file of 3 bytes, too short to be one"),
        (b"v/1\x01\x09\0\0\0" + bytes(100), "an unknown file version 0x9"),
        (b"v/1\x01\x02\0\0\0\0" + bytes(100), "a file without any part"),
    ],
)
def test_other_files_are_told(data, got, tmp_path):
    (tmp_path / "a.exr").write_bytes(data)
    with refuses(FileError, "input 'a.exr'", got):
        read_frame(tmp_path / "a.exr")


@pytest.mark.parametrize(
    ("window", "got"),
    [
        ((0, 0, -1, -1), "an empty data window of 0x0 pixels, an image of zero size"),
        ((0, 0, -1, 8), "an empty data window of 0x9 pixels, an image of zero size"),
        ((0, 0, 2**30, 8), "a data window of 1073741825x9 pixels, more than 268435456"),
        ((-(2**31), 0, -(2**31), 8), "a data window of 1x9 pixels, more than 268435456"),
    ],
)
def test_impossible_sizes_are_told(whole, window, got):
    data, path = whole
    at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
    path.write_bytes(data[:at] + struct.pack("<4i", *window) + data[at + 16 :])
    with refuses(FileError, "input 'a.exr'", got):
        read_frame(path)


def test_an_attribute_twice_is_damage(whole):
    data, path = whole
    path.write_bytes(data)
    inject_attributes(path, [(b"compression", b"compression", b"\0")])
    with refuses(FileError, "input 'a.exr'", "a damaged header"):
        read_frame(path)


@pytest.mark.parametrize(
    ("at", "numbers", "got"),
    [
        *((4, bytes([flag]), "a damaged channel 'G'") for flag in (2, 255)),
        *(
            (
                8,
                struct.pack("<ii", x, y),
                f"a channel 'G' of one value for {x}x{y} pixels, which do not fill the window",
            )
            for x, y in ((2, 1), (1, 2), (2**19, 1), (1, 2**30))
        ),
    ],
)
def test_flags_and_sampling_of_channels_are_checked(at, numbers, got, tmp_path):
    path = tmp_path / "a.exr"
    OpenEXR.File({}, {name: np.zeros((5, 5), "f") for name in "RGB"}).write(str(path))
    data = path.read_bytes()
    at += data.index(b"\0G\0") + 3
    path.write_bytes(data[:at] + numbers + data[at + len(numbers) :])
    with refuses(FileError, "input 'a.exr'", got):
        read_container(path)


def test_tiles_far_larger_than_the_image_are_damage(rng, tmp_path):
    path = tmp_path / "a.exr"
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
    header["tiles"].xSize = header["tiles"].ySize = 16
    OpenEXR.File(header, {name: rng.random((16, 16)).astype("f") for name in "RGB"}).write(str(path))
    data = path.read_bytes()
    at = data.index(b"tiles\0tiledesc\0") + len(b"tiles\0tiledesc\0") + 4
    path.write_bytes(data[:at] + struct.pack("<II", 2**15, 2**15) + data[at + 8 :])
    with refuses(FileError, "input 'a.exr'", "a damaged attribute 'tiles'"):
        read_frame(path)
    path.write_bytes(data[:at] + struct.pack("<II", 2**11, 2**11) + data[at + 8 :])
    assert read_image(path).shape == (16, 16, 3)


def test_damaged_pixels_are_told(whole):
    data, path = whole
    path.write_bytes(data[:-200] + bytes(200))
    with refuses(FileError, "input 'a.exr'", "damaged pixels"):
        read_frame(path)


def test_a_file_that_cannot_be_opened_is_not_called_damaged(whole, monkeypatch):
    _, path = whole
    container = read_container(path)

    def refuse(*_):
        raise OSError(errno.EMFILE, "Too many open files")

    monkeypatch.setattr(type(path), "open", refuse)
    with refuses(FileError, "input 'a.exr'", "too many open files"):
        decode_part(container, container.parts[0])


def test_deep_images_are_told(whole, tmp_path):
    samples = np.empty((2, 2), dtype=object)
    for at in np.ndindex(2, 2):
        samples[at] = np.ones(1, np.float32)
    path = tmp_path / "deep.exr"
    try:
        channels = dict.fromkeys("RGB", samples)
        OpenEXR.File({"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}, channels).write(str(path))
    except (RuntimeError, TypeError, ValueError) as problem:
        pytest.skip(f"this version of OpenEXR cannot write deep images from Python: {problem}")
    for read in (read_frame, describe_file, import_file):
        with refuses(MissingChannelError, "input 'deep.exr'"):
            read(path)
    assert describe_part(read_container(path).parts[0], {}).kind == "deep scanline"


def test_random_damage_never_escapes(rng, tmp_path):
    """Bytes changed at random: the file is read or refused, and nothing else."""
    bases = []
    for index, name in enumerate(("ZIP", "PIZ", "RLE", "PXR24", "B44", "DWAA", "HTJ2K32", "ZSTD")):
        header = {"compression": getattr(OpenEXR, f"{name}_COMPRESSION")}
        if index % 2:
            header |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
            header["tiles"].xSize = header["tiles"].ySize = 16
        channels = {name: rng.random((33, 20)).astype(np.float16) for name in "RGB"}
        OpenEXR.File(header, channels).write(str(tmp_path / "base.exr"))
        bases.append((tmp_path / "base.exr").read_bytes())
    refused = 0
    for trial in range(400):
        data = bytearray(bases[trial % len(bases)])
        for _ in range(rng.integers(1, 5)):
            at = rng.integers(500) if rng.random() < 0.5 else rng.integers(len(data))
            data[at] = rng.choice([0, 127, 128, 255, rng.integers(256)])
        (tmp_path / "a.exr").write_bytes(data)
        try:
            read_image(tmp_path / "a.exr")
        except LobewiseError as problem:
            refused += 1
            assert_one_sentence(problem)
    assert 100 < refused < 400


@pytest.mark.real_exr
def test_the_damaged_files_of_the_openexr_project(exr_folder, capfd):
    files = sorted((exr_folder / "damaged").glob("*.exr"))
    assert len(files) == 23
    for path in files:
        for read in (read_frame, read_image, describe_file):
            with pytest.raises(FileError) as caught:
                read(path)
            assert_one_sentence(caught.value)
    assert capfd.readouterr() == ("", "")


def locate_table(data: bytes, count: int) -> tuple[int, list[int]]:
    """Return where the chunk table of a single-part file begins, and the places of its chunks."""
    start = read_attributes(data)[1]
    return start, list(struct.unpack_from(f"<{count}Q", data, start))


@pytest.mark.parametrize(
    ("change", "got"),
    [
        (lambda table: table[:1] * 9, "a damaged chunk 2 of 9: it is that of another place in the image"),
        (
            lambda table: [table[1], table[0], *table[2:]],
            "a damaged chunk 1 of 9: it is that of another place in the image",
        ),
    ],
)
def test_chunks_must_be_where_the_table_says(whole, change, got):
    data, path = whole
    start, table = locate_table(data, 9)
    path.write_bytes(data[:start] + struct.pack("<9Q", *change(table)) + data[start + 72 :])
    with refuses(FileError, "input 'a.exr'", got) as caught:
        read_frame(path)
    assert_one_sentence(caught.value)


@pytest.mark.parametrize("kept", [0, 1])
@pytest.mark.parametrize("form", ["rows", "tiles", "parts", "deep"])
def test_missing_tables_of_chunks_are_filled_in(form, kept, rng, tmp_path):
    whole, holed = tmp_path / "a.exr", tmp_path / "b.exr"
    planes = {name: rng.random((40, 70)).astype("f4") for name in "RGB"}
    header = {"compression": OpenEXR.ZIPS_COMPRESSION, "type": OpenEXR.scanlineimage}
    if form == "rows":
        header["lineOrder"] = OpenEXR.DECREASING_Y
    if form == "tiles":
        header |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
        header["tiles"].xSize = header["tiles"].ySize = 16
    if form == "deep":
        samples = np.empty((40, 70), object)
        for place in np.ndindex(samples.shape):
            samples[place] = rng.random(1 + sum(place) % 3).astype("f4")
        header["type"], planes = OpenEXR.deepscanline, {"Z": samples}
    parts = [OpenEXR.Part(dict(header), dict(planes), name) for name in ("one", "two")[: 1 + (form == "parts")]]
    (OpenEXR.File(parts) if form == "parts" else OpenEXR.File(header, dict(planes))).write(str(whole))
    data, before = whole.read_bytes(), read_container(whole).parts
    table = b"".join(struct.pack("<Q", each.offset - 4 * (form == "parts")) for part in before for each in part.chunks)
    assert data.count(table) == 1
    holed.write_bytes(data.replace(table, table[: 8 * kept] + bytes(len(table) - 8 * kept)))
    assert read_container(holed).parts == before
    if form != "deep":
        for name, plane in decode_part(read_container(holed), before[-1]).items():
            np.testing.assert_array_equal(plane, planes[name])


def test_an_unknown_order_of_lines_is_damage(whole):
    data, path = whole
    at = data.index(b"lineOrder\0lineOrder\0") + len(b"lineOrder\0lineOrder\0") + 4
    path.write_bytes(data[:at] + bytes([3]) + data[at + 1 :])
    with pytest.raises(FileError, match="a whole OpenEXR file, got an unknown order of lines 3; render or copy it"):
        read_frame(path)


def test_chunks_lie_apart(whole):
    data, path = whole
    at = locate_table(data, 9)[1][0]
    # The first chunk says that it is long, and so holds the second.
    (size,) = struct.unpack_from("<i", data, at + 4)
    path.write_bytes(data[: at + 4] + struct.pack("<i", size + 1) + data[at + 8 :])
    with refuses(FileError, "input 'a.exr'", "a damaged table of chunks: chunk 2 of 9 lies over chunk 1 of 9"):
        read_frame(path)
    # A chunk of one byte less than there is has a gap behind it, which is no damage to the table.
    path.write_bytes(data[: at + 4] + struct.pack("<i", size - 1) + data[at + 8 :])
    with refuses(FileError, "input 'a.exr'", "damaged pixels"):
        read_frame(path)


def test_chunks_lie_behind_the_table(whole):
    data, path = whole
    fake = struct.pack("<ii", 0, 400) + bytes(400)
    inject_attributes(path, [(b"fake", b"blob", fake)])
    data = path.read_bytes()
    start = read_attributes(data)[1]
    path.write_bytes(data[:start] + struct.pack("<Q", data.index(fake)) + data[start + 8 :])
    with refuses(FileError, "input 'a.exr'"):
        read_frame(path)


def test_chunks_of_several_parts_lie_apart(rng, tmp_path):
    path = tmp_path / "a.exr"
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.NO_COMPRESSION}
    image = rng.random((2, 4)).astype("f")
    parts = [OpenEXR.Part(dict(header), dict.fromkeys(names, image), names) for names in ("RGB", "XYZ")]
    OpenEXR.File(parts).write(str(path))
    data = bytearray(path.read_bytes())
    first = struct.pack("<iii", 0, 0, 48)
    at = data.index(first)
    assert read_image(path).shape == (2, 4, 3)
    struct.pack_into("<i", data, at + 8, 49 + 60)
    path.write_bytes(data)
    with refuses(FileError, "input 'a.exr'", "a damaged table of chunks: chunk 2 of 2 lies over chunk 1 of 2"):
        read_image(path)


def make_constant(compression: str, *, tiled: bool, width: int) -> bytes:
    """Return a file of one value: nothing compresses better."""
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    if tiled:
        header |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
        header["tiles"].xSize = header["tiles"].ySize = 512
    out = io.BytesIO()
    OpenEXR.File(header, {name: np.zeros((300, width), np.float32) for name in "RGB"}).write(out)
    return out.getvalue()


@pytest.mark.parametrize("tiled", [False, True])
@pytest.mark.parametrize("compression", ["NO", "RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44", "B44A", "DWAA", "DWAB"])
def test_no_chunk_claims_more_than_its_bytes_can_hold(compression, tiled, tmp_path):
    data = make_constant(compression, tiled=tiled, width=1500)
    path = tmp_path / "a.exr"
    path.write_bytes(data)
    assert not read_image(path).any()
    at = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 12
    far = bytearray(data)
    struct.pack_into("<i", far, at, 2**19 - 1)
    if tiled:
        at = data.index(b"tiles\0tiledesc\0") + len(b"tiles\0tiledesc\0") + 4
        # As many tiles as before.
        struct.pack_into("<I", far, at, -(-(2**19) // 3))
    path.write_bytes(far)
    with refuses(FileError, "input 'a.exr'") as caught:
        read_image(path)
    assert_one_sentence(caught.value)
