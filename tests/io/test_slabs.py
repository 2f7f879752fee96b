"""Parts are read and written some rows at a time: the same bits, and memory that does not grow with other channels."""

import tracemalloc

import numpy as np
import OpenEXR
import pytest

from lobewise.io.exr import pixels
from lobewise.io.exr.container import crop_part
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import decode_part
from lobewise.io.exr.replacing import write_copy

EXTRA = 40
FORMS = ("ZIPS", "ZIP", "PIZ", "RLE", "DWAB", "B44", "HTJ2K32", "ZSTD", "tiles", "falling")


def write_file(path, rng, form, size=(300, 70)):
    """Write R, G and B and many channels beside them."""
    header = {"compression": getattr(OpenEXR, f"{form}_COMPRESSION", OpenEXR.ZIP_COMPRESSION)}
    header["type"] = OpenEXR.scanlineimage
    if form == "tiles":
        header |= {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
        header["tiles"].xSize, header["tiles"].ySize = 32, 16
    if form == "falling":
        header["lineOrder"] = OpenEXR.DECREASING_Y
    names = ["R", "G", "B", *(f"extra{number}.Z" for number in range(EXTRA))]
    OpenEXR.File(header, {name: rng.random(size).astype(np.float16) for name in names}).write(str(path))
    return read_container(path)


@pytest.mark.sampled("ZIP", "PIZ", "DWAB", "B44", "HTJ2K32", "tiles")
@pytest.mark.parametrize("form", FORMS)
def test_rows_at_a_time_are_the_same_bits(rng, tmp_path, monkeypatch, form):
    monkeypatch.setattr(pixels, "KEPT_BYTES", 0)
    container = write_file(tmp_path / "a.exr", rng, form)
    (part,) = container.parts
    planes = {0: {name: rng.random((300, 70), np.float32) for name in "RGB"}}
    added = {0: {"R.noisy": rng.random((300, 70), np.float32)}}

    def work(name):
        told = write_copy(tmp_path / name, container, planes, {}, part, added=added)
        return decode_part(container, part), told, (tmp_path / name).read_bytes()

    whole = work("whole.exr")
    monkeypatch.setattr(pixels, "MAX_SLAB_BYTES", 1)
    assert pixels.count_fitting_rows(part) == part.rows_per_chunk
    some = work("some.exr")
    assert whole[1:] == some[1:]
    assert list(whole[0]) == list(some[0])
    for name, plane in whole[0].items():
        np.testing.assert_array_equal(plane, some[0][name])


def test_a_small_file_is_decoded_once_for_a_container(rng, tmp_path, monkeypatch):
    container = write_file(tmp_path / "a.exr", rng, "tiles")
    (part,) = container.parts
    whole, known = decode_part(container, part), (id(container), 0)
    monkeypatch.setattr(pixels, "decode_bytes", None)
    rows = decode_part(container, crop_part(part, 16, 48), "RG")
    assert sorted(rows) == ["G", "R"]
    np.testing.assert_array_equal(rows["R"], whole["R"][16:48])
    assert not rows["R"].flags.writeable
    assert known in pixels._kept
    del container
    assert known not in pixels._kept


def test_channels_that_nobody_asked_for_take_no_memory(rng, tmp_path, monkeypatch):
    container = write_file(tmp_path / "a.exr", rng, "ZIPS", (256, 256))
    (part,) = container.parts
    monkeypatch.setattr(pixels, "MAX_SLAB_BYTES", 1 << 17)
    peaks = {}
    for names in (None, "RGB"):
        tracemalloc.start()
        found = decode_part(container, part, names)
        peaks[names] = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        assert sorted(found) == sorted(names or [channel.name for channel in part.channels])
    whole = 2 * 256 * 256 * (EXTRA + 3)
    assert peaks[None] > whole
    assert peaks["RGB"] < whole / 4
    planes = {0: {name: np.zeros((256, 256), np.float32) for name in "RGB"}}
    tracemalloc.start()
    write_copy(tmp_path / "b.exr", container, planes, {}, part)
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < whole / 4
