"""What `inspect` says is what reading does."""

import dataclasses
import re
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from exr_bytes import EXOTIC, inject_attributes

from lobewise.errors import FileError
from lobewise.interchange import describe_file
from lobewise.io import read_frame, write_frame
from lobewise.io.exr.describe import COSTS
from lobewise.io.exr.schema import CAMERA, DENOISED, LOBES, SCHEMA, SLOTS, SPP
from lobewise.records.camera import Camera
from lobewise.records.frame import Frame, GBuffer, Radiance


def test_a_full_frame(full_frame, tmp_path):
    path = tmp_path / "a.exr"
    write_frame(path, full_frame)
    found = describe_file(path)
    assert found.bytes == path.stat().st_size
    left = ("Left noisy: passes of light 'direct', 'indirect'.",)
    assert (found.image_part, found.spp, found.notes) == (0, 4, left)
    assert found.camera.fov_y == 0.7
    assert found.materials == ("'first': 1 sg lobe for each of 2 views", "'second': 2 sg lobes for each of 2 views")
    assert all(image.found for image in found.images)
    assert found.similarities == ("normal", "sg", "sg_mixture", "ggx")
    (part,) = found.parts
    assert (part.kind, part.compression) == ("scanline", "zip")
    assert (part.data_window.width, part.data_window.height) == (13, 9)
    types = {channel.name: (channel.pixel_type, channel.used_as) for channel in part.channels}
    assert types["half_a.specular.G"] == ("half", "half_a.specular")
    assert types["alpha.U"] == ("float", "gbuffer.alpha_u")
    values = {name: value for name, _, value in part.attributes}
    assert values["lobewise/camera/position"] == "1 2 0.1"
    assert values["lobewise/spp"] == "4"


def test_what_is_missing_is_said(rng, tmp_path):
    path = tmp_path / "a.exr"
    image = Radiance(rng.random((4, 5, 3)))
    write_frame(path, Frame(image))
    found = describe_file(path)
    assert [item.label for item in found.images if item.found] == ["R/G/B"]
    assert found.similarities == ("normal",)
    assert [lack.role for lack in found.lacks] == list(COSTS)
    normals = GBuffer(normal=rng.random((4, 5, 3)), depth=np.ones((4, 5)))
    write_frame(path, Frame(image, normals, spp=1))
    found = describe_file(path)
    assert found.similarities == ("normal",)
    (note,) = found.notes
    assert (
        note
        == "Without alpha.U and the camera (lobewise/camera/...) only normals can be compared, not reflection lobes."
    )


def test_found_images_are_those_that_reading_fills(full_frame, rng, tmp_path):
    for trial in range(12):
        gbuffer = dataclasses.replace(
            full_frame.gbuffer, **{item.name: None for item in dataclasses.fields(GBuffer) if rng.random() < 0.5}
        )
        variance = full_frame.variance if trial % 2 else None
        frame = Frame(full_frame.radiance, gbuffer, variance=variance, lobe_tables=full_frame.lobe_tables)
        write_frame(tmp_path / "a.exr", frame)
        back = read_frame(tmp_path / "a.exr")
        for slot, image in zip(SLOTS, describe_file(tmp_path / "a.exr").images, strict=True):
            owner = getattr(back, slot.owner)
            assert image.found == (owner is not None and getattr(owner, slot.field) is not None), slot.label


def test_a_file_that_reading_refuses(tmp_path):
    channels = {name: np.ones((2, 2), "f") for name in ("R", "G", "B", "normal.X")}
    for name, planes, index, words in (
        ("a.exr", channels, 0, "normal.X/Y/Z"),
        ("b.exr", {"Z": channels["R"]}, None, "expected channels R, G and B"),
        ("c.exr", {name: plane for name, plane in channels.items() if name in "RGB"}, 0, "camera in the header"),
    ):
        header = {SCHEMA: 1} | ({CAMERA + "position": np.ones(3)} if name == "c.exr" else {})
        OpenEXR.File(header, planes).write(str(tmp_path / name))
        found = describe_file(tmp_path / name)
        assert [len(part.channels) for part in found.parts] == [len(planes)]
        assert (found.image_part, found.can_be_denoised) == (index, False)
        assert found.notes == found.refusals
        assert found.notes[0].startswith(f"Denoising will refuse this file: input {str(tmp_path / name)!r}")
        assert words in found.notes[0]


def test_pixels_are_not_read(full_frame, tmp_path):
    path = tmp_path / "a.exr"
    write_frame(path, full_frame)
    whole, data = describe_file(path), bytearray(path.read_bytes())
    data[-200:] = bytes(200)
    path.write_bytes(data)
    with pytest.raises(FileError):
        read_frame(path)
    assert describe_file(path).notes == whole.notes
    assert describe_file(path).images == whole.images


def test_a_camera_that_is_given_is_described(rng, tmp_path):
    path, camera = tmp_path / "a.exr", Camera(position=(0, 0, 0), forward=(0, 0, 1), up=(0, 1, 0), fov_y=0.5)
    guides = GBuffer(normal=rng.random((4, 5, 3)), depth=np.ones((4, 5)), alpha_u=np.ones((4, 5)))
    write_frame(path, Frame(Radiance(rng.random((4, 5, 3))), guides, spp=4))
    assert describe_file(path).similarities == ("normal",)
    found = describe_file(path, camera=camera)
    assert (found.camera.fov_y, found.similarities[-1], found.notes) == (0.5, "ggx", ())


def test_a_part_with_another_window_is_only_copied(tmp_path):
    windows = {name: (np.array([0, 0], np.int32), np.array([3, rows - 1], np.int32))
               for name, rows in (("displayWindow", 3), ("dataWindow", 2))}  # fmt: skip
    image, guides = ({name: np.ones((rows, 4), "f") for name in names} for names, rows in (("RGB", 3), (["Z"], 2)))
    parts = [OpenEXR.Part({SCHEMA: 1, SPP: 1}, image, "image"), OpenEXR.Part(windows, guides, "low")]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    assert describe_file(tmp_path / "a.exr").notes == (
        "Part 'low' has another data window than the image and is only copied.",
    )


def test_any_attribute_can_be_shown(full_frame, tmp_path):
    write_frame(tmp_path / "a.exr", full_frame)
    inject_attributes(tmp_path / "a.exr", [*EXOTIC, (b"\xff\xfe", b"string", b"a\nb\x07" + b"x" * 500)])
    attributes = {name: value for name, _, value in describe_file(tmp_path / "a.exr").parts[0].attributes}
    assert attributes["framesPerSecond"] == "24000 1001"
    assert attributes["exposureTime"] == "1.1"
    assert attributes["ourOwnType"] == "3 bytes"
    assert all(text.isprintable() for item in attributes.items() for text in item)
    assert all(len(text) < 420 for text in attributes.values())


@pytest.mark.real_exr
def test_real_files(exr_folder):
    arnold = describe_file(exr_folder / "arnold_multichannel.exr")
    assert len(arnold.parts[0].channels) == 56
    assert arnold.parts[0].kind == "tiled"
    ball = describe_file(exr_folder / "beachball_multipart.0001.exr")
    assert [part.name for part in ball.parts][:2] == ["rgba_right", "depth_left"]
    assert ball.parts[0].view == "right"


def test_the_documented_channels_are_the_ones_in_use():
    page = (Path(__file__).parents[2] / "docs" / "developers" / "conventions.md").read_text(encoding="utf-8")
    table = page.split("## Channels of an EXR file")[1].split("## Header attributes")[0]
    documented = set()
    for row in re.findall(r"^\| (`.*?) \|", table, re.MULTILINE):
        names = re.findall(r"`([^`]+)`", row)
        # A row gives the first name in full, then suffixes; R, G and B stand for themselves.
        head = names[0].rpartition(".")[0]
        documented |= {head + name if name.startswith(".") else name for name in names}
    used = {name for slot in SLOTS for name in slot.channels}
    copies = ("half_a.", "half_b.", "variance.")
    assert documented >= {name for name in used if not name.startswith(copies)}
    assert documented - used == set()
    camera = [CAMERA + name for name in ("position", "forward", "up", "fov_y", "fov_x")]
    for attribute in (SCHEMA, SPP, DENOISED, LOBES + "1", *camera):
        assert f"`{attribute}`" in page
