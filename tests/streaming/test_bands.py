"""Rows read from files and put back into them: the same pixels and bytes as of whole files."""

import os
import struct
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from lobewise.errors import FileError, InputError, LobewiseError, MissingChannelError
from lobewise.interchange import write_result
from lobewise.io import read_frame, write_frame
from lobewise.io.exr.bands import BandReader, BandWriter
from lobewise.io.exr.schema import SCHEMA
from lobewise.io.files import open_spool
from lobewise.recipes.streaming.plan import cut_bands, widen_band
from lobewise.records.frame import Frame, Result
from tests.mistakes import refuses
from tests.streaming.frames import assert_same_images

SHAPE = (75, 21)
COMPRESSIONS = sorted(name for name in vars(OpenEXR) if name.endswith("_COMPRESSION"))
"""Blocks of 1, 16, 32 and 256 rows."""
HEIGHTS = (1, 7, 16, 50, 75)


def make_result(shape: tuple[int, int], *, apart: bool = True) -> Result:
    """Return random images, some beyond what a half can hold."""
    rng = np.random.default_rng(5)
    image, diffuse, specular = (rng.gamma(0.2, 1e4, (*shape, 3)).astype(np.float32) for _ in range(3))
    ones = np.ones(shape, np.float32)
    parts = {"diffuse": diffuse, "specular": specular} if apart else {}
    return Result(image, ones, ones, np.zeros(shape, bool), {"radius": 8, "beta": 0.5}, 0.1, **parts)


def write_rows(source: Path, target: Path, result: Result, heights: list[int] | int) -> None:
    """Write a result some rows at a time."""
    reader = BandReader(source)
    given = {"color": result.image, "diffuse": result.diffuse, "specular": result.specular}
    images = {field: image for field, image in given.items() if image is not None}
    with open_spool(target) as spool:
        writer = BandWriter(reader, images, spool)
        height = reader.shape[0]
        for top, bottom in cut_bands(height, heights) if isinstance(heights, int) else heights:
            writer.add({field: image[top:bottom] for field, image in images.items()})
            reader.forget(min(writer.row, bottom))
        writer.finish(target, result.settings)


def make_channels(shape: tuple[int, int]) -> dict[str, np.ndarray[Any, Any]]:
    """Return channels of every type, the image among them."""
    rng = np.random.default_rng(2)
    names = ("R", "G", "B", "diffuse.R", "diffuse.G", "diffuse.B", "specular.R", "specular.G", "specular.B", "extra.X")
    channels = {name: rng.gamma(0.5, 1.0, shape).astype(np.float16) for name in names}
    channels["depth.Z"] = rng.random(shape).astype(np.float32)
    channels["id"] = rng.integers(0, 2**32, shape, dtype=np.uint32)
    return channels


def make_window(shape: tuple[int, int], corner: tuple[int, int]) -> dict[str, Any]:
    """Return header entries of a data window that begins anywhere."""
    low, size = np.array(corner, np.int32), np.array([shape[1] - 1, shape[0] - 1], np.int32)
    return {"dataWindow": (low, low + size), "displayWindow": (np.array([0, 0], np.int32), size)}


def write_file(path: Path, corner: tuple[int, int] = (-3, 5), **header: Any) -> None:
    """Write a file with one part."""
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, SCHEMA: 1, **header}
    OpenEXR.File({**header, **make_window(SHAPE, corner)}, make_channels(SHAPE)).write(str(path))


def write_parts(path: Path) -> None:
    """Write a file whose image, parts of it and guides are in parts of different kinds."""
    channels = make_channels(SHAPE)
    window = make_window(SHAPE, (2, -7))

    def part(name: str, prefix: str, **header: Any) -> OpenEXR.Part:
        chosen = {key: value for key, value in channels.items() if key.rpartition(".")[0] == prefix}
        return OpenEXR.Part({"type": OpenEXR.scanlineimage, **header, **window}, chosen, name)

    other = {"compression": OpenEXR.PIZ_COMPRESSION}
    OpenEXR.File(
        [
            part("guides", "depth", compression=OpenEXR.ZIPS_COMPRESSION),
            part("image", "", compression=OpenEXR.ZIP_COMPRESSION, **{SCHEMA: 1}),
            part("one", "diffuse", **make_tiles(8, 10), **other),
            part("two", "specular", lineOrder=OpenEXR.DECREASING_Y, **other),
            part("extra", "extra", **other),
        ]
    ).write(str(path))


def make_tiles(columns: int, rows: int) -> dict[str, Any]:
    """Return header entries of a tiled file."""
    tiles = OpenEXR.TileDescription()
    tiles.xSize, tiles.ySize = columns, rows
    return {"type": OpenEXR.tiledimage, "tiles": tiles}


KINDS: dict[str, dict[str, Any]] = {
    **{name.removesuffix("_COMPRESSION").lower(): {"compression": getattr(OpenEXR, name)} for name in COMPRESSIONS},
    "falling": {"lineOrder": OpenEXR.DECREASING_Y},
    "falling rows": {"lineOrder": OpenEXR.DECREASING_Y, "compression": OpenEXR.ZIPS_COMPRESSION},
    "tiles": make_tiles(8, 10),
    "falling tiles": {**make_tiles(16, 16), "lineOrder": OpenEXR.DECREASING_Y},
    "one tile": make_tiles(128, 128),
    "origin": {"corner": (0, 0)},
}


@pytest.fixture(params=[*KINDS, "parts"])
def file(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    """Return a file of every kind."""
    path = tmp_path / "in.exr"
    write_parts(path) if request.param == "parts" else write_file(path, **KINDS[request.param])
    return path


def test_rows_are_those_of_the_whole_file(file: Path) -> None:
    whole = read_frame(file)
    reader = BandReader(file)
    assert reader.shape == SHAPE
    for first, stop in ((0, 1), (13, 40), (40, 75), (3, 74), (0, 75)):
        assert_same_images(reader.read_frame(first, stop), whole, slice(first, stop))
    # What was let go is read again.
    reader.forget(75)
    assert_same_images(reader.read_frame(0, 75), whole)


def test_a_copy_has_the_bytes_of_one_written_at_once(file: Path, tmp_path: Path) -> None:
    result = make_result(SHAPE)
    write_result(tmp_path / "whole.exr", result, source=file)
    expected = (tmp_path / "whole.exr").read_bytes()
    for height in HEIGHTS:
        write_rows(file, tmp_path / "rows.exr", result, height)
        assert (tmp_path / "rows.exr").read_bytes() == expected
    assert sorted(os.listdir(tmp_path)) == ["in.exr", "rows.exr", "whole.exr"]


def test_bands_need_not_be_alike(tmp_path: Path) -> None:
    source, result = tmp_path / "in.exr", make_result(SHAPE, apart=False)
    write_file(source)
    write_result(tmp_path / "whole.exr", result, source=source)
    write_rows(source, source, result, [(0, 33), (33, 34), (34, 64), (64, 75)])
    assert source.read_bytes() == (tmp_path / "whole.exr").read_bytes()


def test_cameras_tables_and_counts_come_along(full_frame: Frame, tmp_path: Path) -> None:
    path = tmp_path / "frame.exr"
    write_frame(path, full_frame, half=False)
    whole, reader = read_frame(path), BandReader(path)
    band = reader.read_frame(2, 7)
    assert_same_images(band, whole, slice(2, 7))
    assert band.spp == whole.spp == 4
    assert [table.name for table in band.lobe_tables] == [table.name for table in whole.lobe_tables]
    np.testing.assert_array_equal(band.camera.make_ray_directions(13, 5), whole.camera.make_ray_directions(13, 9)[2:7])
    only = BandReader(path, wanted={("radiance", "color"), ("gbuffer", "depth"), ("gbuffer", "tangents")}).read_frame(
        0, 9
    )
    assert only.gbuffer.depth is not None
    assert only.gbuffer.normal is None
    assert only.half_a is None


def test_bytes_of_a_pixel_are_those_of_its_channels(tmp_path: Path) -> None:
    write_file(tmp_path / "in.exr")
    # Nine halves that frames have, and a float; id and extra are nobody's.
    reader = BandReader(tmp_path / "in.exr")
    assert reader.count_bytes() == (9 * 2 + 4, 10 * 4)
    with open_spool(tmp_path / "out.exr") as spool:
        BandWriter(reader, ["color"], spool)
    assert reader.count_bytes() == (10 * 2 + 4 + 4, 10 * 4)


def test_rows_are_kept_until_they_are_forgotten(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_file(tmp_path / "in.exr")
    decoded: list[tuple[int, int]] = []
    from lobewise.io.exr import bands

    def decode(container: Any, part: Any, names: Any) -> Any:
        decoded.append((part.data_window.y_min - 5, part.data_window.height))
        return original(container, part, names)

    original = bands.decode_part
    monkeypatch.setattr(bands, "decode_part", decode)
    reader = BandReader(tmp_path / "in.exr")
    reader.read_frame(0, 10)
    reader.read_frame(5, 70)
    assert decoded == [(0, 64), (64, 11)]
    reader.forget(63)
    reader.read_frame(60, 64)
    assert len(decoded) == 2
    reader.forget(64)
    reader.read_frame(70, 75)
    assert len(decoded) == 2
    reader.read_frame(0, 1)
    assert decoded[2:] == [(0, 64)]


def test_what_cannot_be_read_in_bands_says_so(tmp_path: Path) -> None:
    path = tmp_path / "in.exr"
    write_file(path)
    # In the list of channels: type, linear, and every how many columns and rows there is a value.
    entry = b"id\0" + struct.pack("<iBxxx", 0, 0)
    data = path.read_bytes()
    assert data.count(entry + struct.pack("<ii", 1, 1)) == 1
    path.write_bytes(data.replace(entry + struct.pack("<ii", 1, 1), entry + struct.pack("<ii", 3, 1)))
    with refuses(FileError, "input 'in.exr'", "the subsampled channel 'id'"):
        BandReader(path)
    with refuses(FileError, "input 'none.exr'"):
        BandReader(tmp_path / "none.exr")


def test_damage_is_told_as_for_whole_files(tmp_path: Path) -> None:
    path = tmp_path / "in.exr"
    write_file(path)
    data = bytearray(path.read_bytes())
    data[-40:] = bytes(40)
    path.write_bytes(data)
    reader = BandReader(path)
    reader.read_frame(0, 10)
    with refuses(FileError, "input 'in.exr'", "damaged pixels") as found:
        reader.read_frame(0, 75)
    with pytest.raises(FileError) as expected:
        read_frame(path)
    assert str(found.value) == str(expected.value)


def read_both(path: Path) -> None:
    """Raise AssertionError unless whole files and bands are refused, or read, alike."""
    errors = []
    for read in (read_frame, lambda name: BandReader(name).read_frame(0, 1)):
        try:
            read(path)
            errors.append("")
        except LobewiseError as problem:
            errors.append(f"{type(problem).__name__}: {problem}")
    assert errors[0] == errors[1]


@pytest.mark.parametrize("missing", ["R", "diffuse.G", "half_a.R"])
def test_missing_channels_are_told_alike(missing: str, full_frame: Frame, tmp_path: Path) -> None:
    path = tmp_path / "in.exr"
    write_frame(path, full_frame)
    channels = {
        name: channel.pixels
        for name, channel in OpenEXR.File(str(path), separate_channels=True).channels().items()
        if name != missing
    }
    OpenEXR.File({"type": OpenEXR.scanlineimage, "lobewise/schema": 1}, channels).write(str(path))
    read_both(path)
    with pytest.raises(MissingChannelError):
        BandReader(path)


def test_a_material_without_table_is_told_alike(full_frame: Frame, tmp_path: Path) -> None:
    path = tmp_path / "in.exr"
    write_frame(path, full_frame)
    with refuses(InputError, "material", holder="input 'in.exr'") as found:
        BandReader(path, lobe_tables=[]).read_frame(0, 9)
    with pytest.raises(InputError) as expected:
        read_frame(path, lobe_tables=[])
    assert str(found.value) == str(expected.value)


def test_cuts_are_whole_and_even() -> None:
    for height in (1, 2, 31, 100):
        for rows in (1, 7, 30, 100, 1000):
            bands = cut_bands(height, rows)
            assert bands[0][0] == 0
            assert bands[-1][1] == height
            sizes = [bottom - top for top, bottom in bands]
            assert 1 <= min(sizes) <= max(sizes) <= min(rows, min(sizes) + 1)
            assert all(one[1] == other[0] for one, other in pairwise(bands))
    assert widen_band((30, 40), 7, 100) == (16, 47)
    assert widen_band((5, 40), 7, 44) == (0, 44)


def test_many_channels_that_are_only_copied_are_decoded_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    write_file(tmp_path / "in.exr")
    from lobewise.io.exr import bands

    def copy(name: str) -> tuple[bytes, int]:
        reader = BandReader(tmp_path / "in.exr", wanted={("radiance", "color")})
        height = reader.shape[0]
        with (tmp_path / "spool").open("w+b") as spool:
            writer = bands.BandWriter(reader, ["color"], spool)
            stored, _ = reader.count_bytes()
            for first in range(0, height, 10):
                color = reader.read_frame(first, min(first + 10, height)).radiance.color
                writer.add({"color": 0.5 * color})
            writer.finish(tmp_path / name, {})
        return (tmp_path / name).read_bytes(), stored

    kept, stored = copy("kept.exr")
    monkeypatch.setattr(bands, "MAX_KEPT_BYTES", 0)
    again, least = copy("again.exr")
    assert kept == again
    assert least < stored
