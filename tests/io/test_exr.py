"""Frames survive files; files survive denoising."""

import dataclasses
import json
import struct

import numpy as np
import OpenEXR
import pytest
from exr_bytes import EXOTIC, inject_attributes, read_attributes

from lobewise.errors import FileError, InputError, MissingChannelError
from lobewise.interchange import describe_file, read_image, write_result
from lobewise.io import read_frame, write_frame, write_image
from lobewise.records.frame import Frame, GBuffer, Radiance, Result
from tests.mistakes import refuses
from tests.streaming.frames import assert_same_images

COMPRESSIONS = sorted(name for name in vars(OpenEXR) if name.endswith("_COMPRESSION"))
LOSSLESS = {"NO_COMPRESSION", "RLE_COMPRESSION", "ZIPS_COMPRESSION", "ZIP_COMPRESSION", "PIZ_COMPRESSION",
            "ZSTD_COMPRESSION"}  # fmt: skip


def make_result(rng, height, width, **parts):
    image = rng.gamma(0.5, 1.0, (height, width, 3)).astype(np.float32)
    ones = np.ones((height, width), np.float32)
    return Result(
        image=image,
        weight_sum=ones,
        effective_samples=ones,
        bad_pixels=np.zeros((height, width), bool),
        settings={"similarity": "sg", "beta": 8.0},
        seconds=0.1,
        **parts,
    )


def read_channels(path, part=0):
    return {name: item.pixels for name, item in OpenEXR.File(str(path), separate_channels=True).channels(part).items()}


def make_windows(height, width, full_height, full_width):
    """Return header entries of a data window at the origin and a larger display window."""
    return {
        "dataWindow": (np.zeros(2, np.int32), np.array([width - 1, height - 1], np.int32)),
        "displayWindow": (np.zeros(2, np.int32), np.array([full_width - 1, full_height - 1], np.int32)),
    }


class TestRoundTrip:
    def test_every_image_and_the_header(self, full_frame, tmp_path):
        write_frame(tmp_path / "a.exr", full_frame, half=False)
        back = read_frame(tmp_path / "a.exr")
        assert_same_images(back, full_frame)
        for owner in ("radiance", "gbuffer", "half_a", "half_b", "variance"):
            assert all(image is not None for image in vars(getattr(back, owner)).values())
        assert back.spp == 4
        for name in ("position", "forward", "up"):
            np.testing.assert_allclose(getattr(back.camera, name), getattr(full_frame.camera, name), rtol=1e-15)
        assert (back.camera.fov_y, back.camera.fov_x) == (0.7, 0.9)
        assert len(back.lobe_tables) == 2
        for ours, theirs in zip(full_frame.lobe_tables, back.lobe_tables, strict=True):
            for item in dataclasses.fields(ours):
                np.testing.assert_array_equal(getattr(theirs, item.name), getattr(ours, item.name))

    def test_names_are_the_documented_ones(self, full_frame, tmp_path):
        write_frame(tmp_path / "a.exr", full_frame, half=False)
        channels = read_channels(tmp_path / "a.exr")
        colors = ["", "diffuse.", "specular.", "direct.", "indirect."]
        expected = [
            copy + layer + c for copy in ("", "variance.", "half_a.", "half_b.") for layer in colors for c in "RGB"
        ]
        expected += ["depth.Z", "alpha.U", "alpha.V", "lobe_kind.I", "hit_distance.Z", "motion.X", "motion.Y"]
        expected += ["material.I", *(f"reflected_motion.{c}" for c in "XYZ")]
        expected += [f"{n}.{c}" for n in ("position", "normal", "tangent") for c in "XYZ"]
        expected += [f"{n}.{c}" for n in ("hit_position", "mean_normal", "denoiser_normal") for c in "XYZ"]
        expected += [f"{n}_albedo.{c}" for n in ("diffuse", "specular", "denoiser") for c in "RGB"]
        expected += [f"mean_{n}_albedo.{c}" for n in ("diffuse", "specular") for c in "RGB"]
        expected += [f"mean_emission.{c}" for c in "RGB"]
        expected += [*(f"coverage.{k}" for k in range(9)), "blur_radius.R"]
        assert sorted(channels) == sorted(expected)
        np.testing.assert_array_equal(channels["half_b.specular.G"], full_frame.half_b.specular[..., 1])
        np.testing.assert_array_equal(channels["alpha.V"], full_frame.gbuffer.alpha_v)
        np.testing.assert_array_equal(channels["motion.Y"], full_frame.gbuffer.motion[..., 1])

    @pytest.mark.parametrize("size", [(1, 1), (1, 7), (17, 3)])
    def test_small_and_odd_sizes(self, make_frame, size, tmp_path):
        frame = make_frame(height=size[0], width=size[1])
        write_frame(tmp_path / "a.exr", frame, half=False)
        assert_same_images(read_frame(tmp_path / "a.exr"), frame)

    def test_only_an_image(self, rng, tmp_path):
        frame = Frame(Radiance(rng.random((4, 6, 3))))
        write_frame(tmp_path / "a.exr", frame, half=False)
        back = read_frame(tmp_path / "a.exr")
        assert_same_images(back, frame)
        assert (back.camera, back.spp, back.half_a) == (None, None, None)
        np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), frame.radiance.color)

    @pytest.mark.parametrize("compression", ["none", "rle", "zips", "zip", "piz", "zstd"])
    def test_compressions_lose_nothing(self, full_frame, compression, tmp_path):
        write_frame(tmp_path / "a.exr", full_frame, half=False, compression=compression)
        assert_same_images(read_frame(tmp_path / "a.exr"), full_frame)
        stated = OpenEXR.File(str(tmp_path / "a.exr")).header()["compression"]
        assert stated == getattr(
            OpenEXR, "NO_COMPRESSION" if compression == "none" else f"{compression.upper()}_COMPRESSION"
        )

    def test_unknown_compression(self, full_frame, tmp_path):
        with refuses(InputError, "compression"):
            write_frame(tmp_path / "a.exr", full_frame, compression="zipp")

    def test_bad_pixels_come_through(self, rng, tmp_path):
        color = rng.random((3, 4, 3)).astype(np.float32)
        color[0, 0], color[1, 1, 1], color[2, 2, 2], color[2, 3] = np.nan, np.inf, -np.inf, -1.0
        for half in (False, True):
            write_frame(tmp_path / "a.exr", Frame(Radiance(color)), half=half)
            back = read_frame(tmp_path / "a.exr").radiance.color
            np.testing.assert_allclose(back, color, rtol=2.0**-11)

    def test_custom_attributes(self, full_frame, tmp_path):
        write_frame(tmp_path / "a.exr", full_frame, attributes={"scene": "showroom"})
        assert OpenEXR.File(str(tmp_path / "a.exr")).header()["scene"] == "showroom"


class TestHalf:
    def read_types(self, frame, path):
        write_frame(path, frame)
        return {name: pixels.dtype for name, pixels in read_channels(path).items()}

    def test_color_is_half_and_geometry_is_not(self, full_frame, tmp_path):
        types = self.read_types(full_frame, tmp_path / "a.exr")
        for name in ("R", "specular.B", "half_a.diffuse.R", "specular_albedo.G", "mean_diffuse_albedo.B", "coverage.8"):
            assert types[name] == np.float16
        for name in ("depth.Z", "position.X", "normal.Y", "alpha.U", "motion.X", "hit_distance.Z"):
            assert types[name] == np.float32

    def test_coverage_is_exact_in_half(self, full_frame, tmp_path):
        write_frame(tmp_path / "a.exr", full_frame)
        np.testing.assert_array_equal(read_frame(tmp_path / "a.exr").gbuffer.coverage, full_frame.gbuffer.coverage)

    def test_values_beyond_half_stay_exact(self, tmp_path):
        color = np.full((2, 2, 3), 70000.0, np.float32)
        variance = np.full((2, 2, 3), 1e-6, np.float32)
        frame = Frame(Radiance(color), variance=Radiance(variance))
        types = self.read_types(frame, tmp_path / "a.exr")
        assert types["R"] == types["variance.R"] == np.float32
        assert_same_images(read_frame(tmp_path / "a.exr"), frame)

    def test_the_largest_half_is_still_half(self, tmp_path):
        types = self.read_types(Frame(Radiance(np.full((2, 2, 3), 65504.0))), tmp_path / "a.exr")
        assert types["R"] == np.float16


class TestReading:
    """Files that other programs could have made with our names."""

    def write(self, path, channels, header=None):
        OpenEXR.File(header or {}, {name: np.ascontiguousarray(pixels) for name, pixels in channels.items()}).write(
            str(path)
        )

    def test_missing_beauty(self, tmp_path):
        self.write(tmp_path / "a.exr", {"R": np.ones((2, 2), "f"), "G": np.ones((2, 2), "f")})
        for read in (read_frame, read_image):
            with refuses(MissingChannelError, "input 'a.exr'", "only G, R"):
                read(tmp_path / "a.exr")

    def test_missing_beauty_among_many_channels_is_still_one_line(self, tmp_path):
        self.write(tmp_path / "a.exr", {f"crypto{i:02}": np.ones((2, 2), "f") for i in range(40)})
        with refuses(MissingChannelError, "input 'a.exr'"):
            read_image(tmp_path / "a.exr")

    @pytest.mark.parametrize(
        ("extra", "label"),
        [(("normal.X", "normal.Y"), "normal.X/Y/Z"), (("half_a.diffuse.R",), "half_a.diffuse.R/G/B")],
    )
    def test_an_image_in_part_is_refused(self, extra, label, tmp_path):
        self.write(tmp_path / "a.exr", {name: np.ones((2, 2), "f") for name in ("R", "G", "B", *extra)})
        with refuses(MissingChannelError, "input 'a.exr'", f"only {', '.join(extra)}", f"all of {label}, or none"):
            read_frame(tmp_path / "a.exr")

    def test_a_half_without_its_total_is_refused(self, tmp_path):
        names = ("R", "G", "B", "half_a.diffuse.R", "half_a.diffuse.G", "half_a.diffuse.B")
        self.write(tmp_path / "a.exr", {name: np.ones((2, 2), "f") for name in names})
        with refuses(MissingChannelError, "input 'a.exr'", "none of them beside its other images"):
            read_frame(tmp_path / "a.exr")

    def test_integer_and_half_channels_become_floats(self, tmp_path):
        channels = {name: np.full((2, 3), 0.5, np.float16) for name in "RGB"}
        channels["lobe_kind.I"] = np.arange(6, dtype=np.uint32).reshape(2, 3)
        self.write(tmp_path / "a.exr", channels)
        kind = read_frame(tmp_path / "a.exr").gbuffer.lobe_kind
        np.testing.assert_array_equal(kind, np.arange(6).reshape(2, 3))
        assert kind.dtype == np.float32

    def test_images_in_other_parts_of_the_same_window_are_found(self, tmp_path):
        ones = np.ones((4, 5), "f")
        parts = [
            OpenEXR.Part({}, {"Z": ones}, "first"),
            OpenEXR.Part({}, {name: ones * index for index, name in enumerate("BGR")}, "beauty"),
            OpenEXR.Part({}, {"depth.Z": ones * 7}, "depth"),
            OpenEXR.Part(make_windows(3, 5, 4, 5), {"alpha.U": np.ones((3, 5), "f")}, "elsewhere"),
            OpenEXR.Part({"view": "right"}, {"alpha.V": ones}, "stereo"),
        ]
        OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
        frame = read_frame(tmp_path / "a.exr")
        np.testing.assert_array_equal(frame.radiance.color, np.broadcast_to([2.0, 1.0, 0.0], (4, 5, 3)))
        np.testing.assert_array_equal(frame.gbuffer.depth, ones * 7)
        assert frame.gbuffer.alpha_u is None
        assert frame.gbuffer.alpha_v is None

    def test_a_camera_in_part_or_senseless_is_refused(self, rng, tmp_path):
        path = tmp_path / "a.exr"
        rgb = {name: np.ones((2, 2), "f") for name in "RGB"}
        values = {"position": [0.0, 0.0, 0.0], "forward": [0.0, 0.0, 1.0], "up": [0.0, 1.0, 0.0], "fov_y": [0.5]}
        header = {f"lobewise/camera/{name}": np.array(value) for name, value in values.items()}
        self.write(path, rgb, header)
        assert read_frame(path).camera.fov_y == 0.5
        self.write(path, rgb, {key: value for key, value in header.items() if not key.endswith("up")})
        with refuses(InputError, "camera in the header", "none", holder="input 'a.exr'"):
            read_frame(path)
        self.write(path, rgb, header | {"lobewise/camera/up": np.array([0.0, 0, 2])})
        with refuses(InputError, "camera up", holder="input 'a.exr'"):
            read_frame(path)
        self.write(path, rgb, header | {"lobewise/camera/fov_y": "wide"})
        with refuses(InputError, "camera in the header", "another type", holder="input 'a.exr'"):
            read_frame(path)

    @pytest.mark.parametrize(
        ("change", "refused"),
        [
            (lambda text: text[:-40], ("attribute lobewise/lobes/2", None, "JSON")),
            (lambda text: text.replace("0.99", "1.99"), ("lobe table: cosine_l2",)),
            (lambda text: text.replace('"version": 1', '"version": 7'), ("attribute lobewise/lobes/2", "version 7")),
            (lambda text: np.ones(3), ("attribute lobewise/lobes/2", None, "JSON")),
            (None, ("lobe tables in the header",)),
        ],
    )
    def test_damaged_lobe_tables_are_one_error(self, full_frame, change, refused, tmp_path):
        path = tmp_path / "a.exr"
        write_frame(path, full_frame)
        opened = OpenEXR.File(str(path), separate_channels=True)
        header, channels = dict(opened.header()), {name: item.pixels for name, item in opened.channels().items()}
        good = header.pop("lobewise/lobes/2")
        header["lobewise/lobes/2" if change else "lobewise/lobes/3"] = change(good) if change else good
        self.write(path, channels, {name: value for name, value in header.items() if name != "channels"})
        with refuses(FileError, *refused) as caught:
            read_frame(path)
        assert caught.value.holder.startswith(f"input {str(path)!r}")
        assert any(refused[0] in note for note in describe_file(path).notes)

    def test_a_pixel_without_its_lobe_table_is_refused(self, tmp_path):
        channels = {name: np.ones((2, 2), "f") for name in ("R", "G", "B", "material.I")}
        self.write(tmp_path / "a.exr", channels)
        with refuses(
            InputError, "material", expected="numbers from 0 to 0, the count of lobe tables", holder="input 'a.exr'"
        ):
            read_frame(tmp_path / "a.exr")

    def test_single_precision_cameras_are_read(self, tmp_path):
        values = {"position": [1, 2, 3], "forward": [0, 0, 1], "up": [0, 1, 0]}
        header = {f"lobewise/camera/{name}": np.array(value, "f") for name, value in values.items()}
        header["lobewise/camera/fov_y"] = 0.5
        self.write(tmp_path / "a.exr", {name: np.ones((2, 2), "f") for name in "RGB"}, header)
        camera = read_frame(tmp_path / "a.exr").camera
        assert camera.position.tolist() == [1.0, 2.0, 3.0]
        assert camera.fov_y == 0.5


class TestResult:
    def make_source(self, path, rng, kind="ZIP_COMPRESSION", tiled=False):
        """Write a file with mixed types, offset windows and strangers; return its channels."""
        height, width = 37, 50
        channels = {
            "R": rng.random((height, width)).astype(np.float16),
            "G": rng.random((height, width)).astype(np.float16),
            "B": rng.random((height, width)).astype("f"),
            "A": rng.random((height, width)).astype(np.float16),
            "a.very.long.channel.name.beyond.thirty.one.bytes": rng.random((height, width)).astype("f"),
            "id": rng.integers(0, 2**32, (height, width), dtype=np.uint32),
        }
        header = {
            "compression": getattr(OpenEXR, kind),
            "dataWindow": (np.array([-3, 7], np.int32), np.array([width - 4, height + 6], np.int32)),
            "displayWindow": (np.array([0, 0], np.int32), np.array([99, 98], np.int32)),
            "pixelAspectRatio": 1.5,
            "type": OpenEXR.tiledimage if tiled else OpenEXR.scanlineimage,
            "lineOrder": OpenEXR.RANDOM_Y if tiled else OpenEXR.DECREASING_Y,
        }
        if tiled:
            header["tiles"] = OpenEXR.TileDescription()
            header["tiles"].xSize = header["tiles"].ySize = 16
        full = {name: OpenEXR.Channel(name, np.ascontiguousarray(p), 1, 1, name == "A") for name, p in channels.items()}
        OpenEXR.File(header, full).write(str(path))
        inject_attributes(path, EXOTIC)
        return channels

    @pytest.mark.parametrize("tiled", [False, True])
    @pytest.mark.parametrize("kind", COMPRESSIONS)
    def test_everything_else_survives(self, rng, kind, tiled, tmp_path):
        source, out = tmp_path / "in.exr", tmp_path / "out.exr"
        channels = self.make_source(source, rng, kind, tiled)
        result = make_result(rng, 37, 50)
        write_result(out, result, source=source)

        before, after = read_attributes(source.read_bytes())[0], read_attributes(out.read_bytes())[0]
        assert after[:-1] == before
        assert set(EXOTIC) <= set(after)
        assert after[-1][:2] == (b"lobewise/denoised", b"string")
        assert json.loads(after[-1][2]) == {"similarity": "sg", "beta": 8.0, "replaced": {"": ["B", "G", "R"]}}

        # The latin-1 attribute keeps OpenEXR's own reader from opening the file; ours reads both.
        from lobewise.io.exr.parsing import read_container
        from lobewise.io.exr.pixels import decode_part

        opened = read_container(out)
        pixels = decode_part(opened, opened.parts[0])
        for index, name in enumerate("RGB"):
            assert pixels[name].dtype == channels[name].dtype
            if kind in LOSSLESS:
                np.testing.assert_array_equal(pixels[name], result.image[..., index].astype(channels[name].dtype))
        np.testing.assert_array_equal(pixels["id"], channels["id"])
        # Lossy codecs treat channels that are perceptually linear in another way, and must be told which.
        assert np.abs(pixels["A"].astype("f") - channels["A"]).mean() < 0.05
        rises = np.diff([chunk.offset for chunk in opened.parts[0].chunks]) > 0
        assert not rises.any() or tiled
        if kind in LOSSLESS:
            for name in channels.keys() - set("RGB"):
                np.testing.assert_array_equal(pixels[name], channels[name], err_msg=name)

    def test_the_library_reads_what_we_wrote(self, rng, tmp_path):
        source, out = tmp_path / "in.exr", tmp_path / "out.exr"
        channels = {name: rng.random((40, 30)).astype("f") for name in ("R", "G", "B", "mask")}
        kept = {name: pixels.copy() for name, pixels in channels.items()}
        OpenEXR.File({"owner": "somebody"}, channels).write(str(source))
        result = make_result(rng, 40, 30)
        write_result(out, result, source=source)
        opened = OpenEXR.File(str(out), separate_channels=True)
        assert opened.header()["owner"] == "somebody"
        np.testing.assert_array_equal(opened.channels()["mask"].pixels, kept["mask"])
        np.testing.assert_array_equal(opened.channels()["G"].pixels, result.image[..., 1])

    def test_other_parts_survive_byte_for_byte(self, rng, tmp_path):
        source, out = tmp_path / "in.exr", tmp_path / "out.exr"
        plane = rng.random((20, 10)).astype("f")
        parts = [
            OpenEXR.Part({"compression": OpenEXR.PIZ_COMPRESSION, "mark": 3}, {"Z": plane}, "depth"),
            OpenEXR.Part({"view": "left"}, {name: plane * index for index, name in enumerate("RGBA")}, "beauty"),
            OpenEXR.Part({"compression": OpenEXR.B44_COMPRESSION}, {"h": plane.astype(np.float16)}, "lossy"),
            OpenEXR.Part(make_windows(5, 10, 20, 10), {name: plane[:5].copy() for name in "RGB"}, "other size"),
        ]
        OpenEXR.File(parts).write(str(source))
        result = make_result(rng, 20, 10)
        write_result(out, result, source=source)
        before, after = (OpenEXR.File(str(p), separate_channels=True) for p in (source, out))
        assert [part.name() for part in after.parts] == ["depth", "beauty", "lossy", "other size"]
        for index in (0, 2, 3):
            assert after.header(index).keys() == before.header(index).keys()
            for name, item in before.channels(index).items():
                np.testing.assert_array_equal(after.channels(index)[name].pixels, item.pixels)
        assert after.header(0)["mark"] == 3
        assert after.header(1)["view"] == "left"
        np.testing.assert_array_equal(after.channels(1)["A"].pixels, plane * 3)
        np.testing.assert_array_equal(after.channels(1)["R"].pixels, result.image[..., 0])

    def test_diffuse_and_specular_are_replaced_where_both_have_them(self, full_frame, rng, tmp_path):
        source, out = tmp_path / "in.exr", tmp_path / "out.exr"
        write_frame(source, full_frame, half=False)
        diffuse = rng.random((9, 13, 3)).astype(np.float32)
        result = make_result(rng, 9, 13, diffuse=diffuse)
        write_result(out, result, source=source)
        back = read_frame(out)
        np.testing.assert_array_equal(back.radiance.color, result.image)
        np.testing.assert_array_equal(back.radiance.diffuse, diffuse)
        expected = full_frame.with_changes(
            radiance=dataclasses.replace(full_frame.radiance, color=result.image, diffuse=diffuse)
        )
        assert_same_images(back, expected)
        assert back.spp == 4

    def test_values_beyond_half_are_clamped_where_the_file_is_half(self, rng, tmp_path):
        source, out = tmp_path / "in.exr", tmp_path / "out.exr"
        write_image(source, rng.random((3, 3, 3)), half=True)
        result = make_result(rng, 3, 3)
        result.image[1, 1] = 1e6
        write_result(out, result, source=source)
        assert read_image(out)[1, 1].tolist() == [65504.0] * 3

    def test_in_place_and_twice(self, rng, tmp_path):
        path = tmp_path / "a.exr"
        write_image(path, rng.random((3, 3, 3)))
        for _ in range(2):
            result = make_result(rng, 3, 3)
            write_result(path, result, source=path)
            np.testing.assert_array_equal(read_image(path), result.image)
        names = [name for name, _, _ in read_attributes(path.read_bytes())[0]]
        assert names.count(b"lobewise/denoised") == 1

    def test_sizes_must_match(self, rng, tmp_path):
        write_image(tmp_path / "a.exr", rng.random((3, 4, 3)))
        with refuses(InputError, "channel 'R'", "an array of shape (4, 4)", "the size of 'a.exr', 4x3 pixels"):
            write_result(tmp_path / "b.exr", make_result(rng, 4, 4), source=tmp_path / "a.exr")
        assert not (tmp_path / "b.exr").exists()

    def test_resolution_levels_are_refused(self, rng, tmp_path):
        header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()}
        header["tiles"].xSize = header["tiles"].ySize = 16
        path = tmp_path / "a.exr"
        OpenEXR.File(header, {name: rng.random((16, 16)).astype("f") for name in "RGB"}).write(str(path))
        data = path.read_bytes()
        start = read_attributes(data)[1]
        # A 16x16 image has five levels: change the mode, and put the others' tiles behind, uncompressed.
        at = data.index(b"tiledesc\0") + len(b"tiledesc\0") + 4 + 8
        data = data[:at] + b"\1" + data[at + 1 :]
        (first,) = struct.unpack_from("<Q", data, start)
        sizes = {level: 3 * 4 * (16 >> level) ** 2 for level in (1, 2, 3, 4)}
        tiles = [struct.pack("<5i", 0, 0, level, level, size) + bytes(size) for level, size in sizes.items()]
        offsets = np.cumsum([first + 32, len(data) - first, *map(len, tiles[:-1])])
        path.write_bytes(data[:start] + struct.pack("<5Q", *offsets) + data[first:] + b"".join(tiles))
        with refuses(FileError, "input 'a.exr'"):
            write_result(tmp_path / "b.exr", make_result(rng, 16, 16), source=path)


@pytest.mark.real_exr
class TestRealFiles:
    NAMES = (
        "mitsuba_multi_channels", "arnold_multichannel", "beachball_multipart.0001", "beachball_singlepart.0001",
        "bright_rings_nan_inf", "display_window_t03", "special_chars",
    )  # fmt: skip

    @pytest.mark.parametrize("name", NAMES)
    def test_pixels_agree_with_the_library(self, exr_folder, name):
        path = exr_folder / f"{name}.exr"
        image = read_image(path)
        opened = OpenEXR.File(str(path), separate_channels=True)
        for index, channel in enumerate("RGB"):
            np.testing.assert_array_equal(image[..., index], opened.channels()[channel].pixels.astype("f"))
        assert read_frame(path).shape == image.shape[:2]

    @pytest.mark.sampled("mitsuba_multi_channels", "beachball_multipart.0001", "bright_rings_nan_inf")
    @pytest.mark.parametrize("name", NAMES)
    def test_denoising_changes_only_the_image(self, exr_folder, name, rng, tmp_path):
        path, out = exr_folder / f"{name}.exr", tmp_path / "out.exr"
        result = make_result(rng, *read_image(path).shape[:2])
        write_result(out, result, source=path)
        before, after = (OpenEXR.File(str(p), separate_channels=True) for p in (path, out))
        assert len(after.parts) == len(before.parts)
        for part in range(len(before.parts)):
            one, two = before.header(part), after.header(part)
            assert two.keys() - one.keys() == ({"lobewise/denoised"} if part == 0 else set())
            assert {k: repr(v) for k, v in two.items() if k in one} == {k: repr(v) for k, v in one.items()}
            for channel, item in before.channels(part).items():
                found = after.channels(part)[channel]
                assert (found.pixels.dtype, found.xSampling, found.ySampling, found.pLinear) == (
                    item.pixels.dtype, item.xSampling, item.ySampling, item.pLinear,
                )  # fmt: skip
                if part == 0 and channel in "RGB":
                    new = result.image[..., "RGB".index(channel)].astype(item.pixels.dtype)
                    np.testing.assert_array_equal(found.pixels, new)
                else:
                    np.testing.assert_array_equal(found.pixels, item.pixels, err_msg=channel)

    def test_real_bad_pixels_come_through(self, exr_folder):
        assert not np.isfinite(read_frame(exr_folder / "bright_rings_nan_inf.exr").radiance.color).all()

    def test_mitsuba_positions_are_read(self, exr_folder):
        gbuffer = read_frame(exr_folder / "mitsuba_multi_channels.exr").gbuffer
        assert isinstance(gbuffer, GBuffer)
        assert gbuffer.position is not None
        assert gbuffer.normal is None
