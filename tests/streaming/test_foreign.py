"""Files of other renderers in bands: the bytes of the whole frame, or a sentence on why it must be read as a whole."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

import lobewise
from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.interchange import import_file
from lobewise.interchange.importing import bands
from lobewise.recipes.streaming import plan
from lobewise.recipes.streaming.recipe import denoise_file
from tests.cli.lines import fail
from tests.interchange import renderers
from tests.mistakes import refuses
from tests.streaming.frames import compare_bands

LIGHT = ("diffuse.", "specular.")
CHEAP = ["--quality", "fast", "--similarity", "normal"]


@pytest.fixture
def arnold(monkeypatch: pytest.MonkeyPatch) -> renderers.Written:
    """Return the passes of a frame of 136x130 pixels: the image and its guides, with a lamp and pixels that are NaN."""
    monkeypatch.setattr(renderers, "HEIGHT", 136)
    monkeypatch.setattr(renderers, "WIDTH", 130)
    written = renderers.write_arnold(renderers.make_scene())
    channels = {name: plane.copy() for name, plane in written.channels.items() if not name.startswith(LIGHT)}
    for name in "RGB":
        channels[name][30:44, 20:40] = 60.0
    channels["diffuse_albedo.G"][64, 5] = channels["R"][90, 8] = np.nan
    return renderers.Written("arnold", channels, written.attributes)


def write(path: Path, channels: Mapping[str, Any], attributes: Mapping[str, Any]) -> Path:
    """Write channels as a file."""
    header = {"type": OpenEXR.scanlineimage, "compression": OpenEXR.ZIP_COMPRESSION, **attributes}
    OpenEXR.File(header, dict(channels)).write(str(path))
    return path


def compare(source: Path, **settings: Any) -> lobewise.Result:
    """Raise AssertionError unless bands give the file that the whole frame does; return that frame's result."""
    return compare_bands(source, (27, 136), with_oidn=False, **settings)[0]


@pytest.mark.sampled("fast-all pixels", "balanced-some pixels")
@pytest.mark.parametrize("most", [1 << 20, 2000], ids=["all pixels", "some pixels"])
@pytest.mark.parametrize("quality", ["fast", "balanced"])
def test_a_file_of_arnold_in_bands(
    quality: str, most: int, arnold: renderers.Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bands, "MAX_JUDGED_PIXELS", most)
    source = write(tmp_path / "in.exr", arnold.channels, arnold.attributes)
    result = compare(source, quality=quality)
    # The lamp is found, and the similarity has the camera of the header.
    assert np.array_equal(result.image[36, 30], [60.0, 60.0, 60.0])
    assert result.settings["similarity"] != "normal"


def test_noise_that_pixels_share_is_told_by_all_of_them(
    arnold: renderers.Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    noise = np.random.default_rng(1).gamma(2.0, 0.5, (136, 130)).astype(np.float32)
    spread = sum(np.roll(noise, shift, (0, 1)) for shift in np.ndindex(3, 3)) / np.float32(9.0)
    arnold.channels.update(dict.fromkeys("RGB", spread))
    source = write(tmp_path / "in.exr", arnold.channels, arnold.attributes)
    monkeypatch.setattr(bands, "MAX_JUDGED_PIXELS", 2000)
    assert import_file(source).frame.noise_is_shared
    compare(source, quality="balanced")


def test_encoded_normals_and_a_left_handed_world(arnold: renderers.Written, tmp_path: Path) -> None:
    turn = np.array([-1.0, 1.0, 1.0])
    for letter, sign in zip("XYZ", turn, strict=True):
        arnold.channels[f"P.{letter}"] *= np.float32(sign)
        arnold.channels[f"N.{letter}"] *= np.float32(sign)
    arnold.attributes.update(renderers.make_matrices(left_handed=True))
    compare(write(tmp_path / "in.exr", arnold.channels, arnold.attributes), quality="fast")


@pytest.mark.sampled("fast-all pixels", "high-some pixels")
@pytest.mark.parametrize("most", [1 << 20, 2000], ids=["all pixels", "some pixels"])
@pytest.mark.parametrize("quality", ["fast", "balanced", "high"])
def test_layers_of_light_in_bands(
    quality: str, most: int, arnold: renderers.Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bands, "MAX_JUDGED_PIXELS", most)
    scene = renderers.make_scene()
    light = {"": scene.color, "diffuse": scene.diffuse, "specular": scene.specular, "emission": scene.emission}
    for name, image in light.items():
        arnold.channels.update(renderers.name(name, image))
    arnold.channels["R"][90, 8] = arnold.channels["diffuse.R"][90, 8] = np.nan
    # Pixel filters ring, so that light is below 0.
    for name in ("R", "specular.R"):
        arnold.channels[name][70, 60:70] -= 9.0
    for name, share in (("specular_direct", 0.3), ("specular_indirect", 0.7)):
        parts = {f"{name}.{letter}": np.float32(share) * arnold.channels[f"specular.{letter}"] for letter in "RGB"}
        arnold.channels.update(parts)
    for letter in "RGB":
        del arnold.channels[f"specular.{letter}"]
    if quality == "fast":
        arnold.channels["A"] = np.ones((136, 130), np.float32)
        arnold.channels["A"][[1, 40, 100], [1, 64, 31]] = 0.5
    else:
        ids = np.where(scene.normal[..., 2] == 1.0, np.float32(1.5), np.float32(2.5))
        share = np.random.default_rng(2).choice(np.array([1.0, 0.7], np.float32), ids.shape, p=[0.9, 0.1])
        matte = np.stack([ids, share, np.float32(4.0) - ids, np.float32(1.0) - share], axis=-1)
        arnold.channels.update(renderers.name("crypto_object00", matte, "RGBA"))
    source = write(tmp_path / "in.exr", arnold.channels, arnold.attributes)
    assert lobewise.read_frame(source).gbuffer.coverage is not None
    result = compare(source, quality=quality)
    assert [*result.layers] == ["diffuse", "specular"]
    assert {"specular/specular_direct", "specular/specular_indirect"} <= {*result.also}


@pytest.mark.nightly
def test_a_real_file_of_vray_in_bands(exr_folder: Path, tmp_path: Path) -> None:
    source = tmp_path / "in.exr"
    source.write_bytes((exr_folder / "vray_cornellBox_CryptoWildcard.0001.exr").read_bytes())
    compare(source, quality="fast")


def refuse(path: Path) -> str:
    """Return the sentence that refuses a file in bands."""
    with refuses(InputError, "input 'in.exr'") as caught:
        denoise_file(path, path.with_name("out.exr"), quality="fast")
    assert not path.with_name("out.exr").exists()
    return str(caught.value)


def test_what_needs_the_whole_image_is_refused(arnold: renderers.Written, tmp_path: Path) -> None:
    source, channels, attributes = tmp_path / "in.exr", arnold.channels, arnold.attributes
    scene = renderers.make_scene()
    light = renderers.name("diffuse", scene.diffuse)
    image = {name: np.nan_to_num(plane) for name, plane in renderers.name("", scene.color).items()}
    assert "noisy light that is in no layer" in refuse(write(source, {**channels, **image, **light}, attributes))
    no_camera = {name: value for name, value in attributes.items() if name.startswith("arnold/")}
    assert "camera is found from all of its positions" in refuse(write(source, channels, no_camera))
    turned = {name: -plane if name.startswith("N.") else plane for name, plane in channels.items()}
    assert "The normals of N.X/Y/Z look away from the camera" in refuse(write(source, turned, attributes))
    noisy = {f"RGBA_noisy.{name}": channels[name] for name in "RGB"}
    assert "the renderer denoised" in refuse(write(source, {**channels, **noisy}, attributes))
    eyes = {f"{eye}.{name}": channels[name] for eye in ("left", "right") for name in "RGB"}
    assert "several views" in refuse(write(source, {**channels, **eyes}, attributes))


def test_a_lens_that_blurs_is_found_at_pixels_that_were_not_judged(
    arnold: renderers.Written, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bands, "MAX_JUDGED_PIXELS", 2000)
    arnold.channels["P.X"][101, 60] += 0.5
    assert "a lens blurs" in refuse(write(tmp_path / "in.exr", arnold.channels, arnold.attributes))


def test_the_command_takes_bands_by_itself_where_it_can(
    arnold: renderers.Written, tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    source, command = write(tmp_path / "in.exr", arnold.channels, arnold.attributes), ["denoise", "-o"]
    whole, out = str(tmp_path / "whole.exr"), str(tmp_path / "out.exr")
    assert run([*command, whole, str(source), "--bands", "off", *CHEAP]) == 0
    monkeypatch.setattr(plan, "MAX_WHOLE_GIB", 1e-6)
    for options, told in ((["--bands", "30"], "in 5 bands"), ([], "in 1 band,")):
        capsys.readouterr()
        assert run([*command, out, str(source), *options, *CHEAP]) == 0
        printed = capsys.readouterr()
        assert told in printed.out
        assert "Read as Arnold" in printed.err
        assert Path(out).read_bytes() == Path(whole).read_bytes()
    arnold.attributes.pop("worldToCamera")
    write(source, arnold.channels, arnold.attributes)
    assert run([*command, out, str(source), *CHEAP]) == 0
    assert " band" not in capsys.readouterr().out
    assert run([*command, out, str(source), "--bands", "30", *CHEAP]) == 2


def test_a_result_is_not_denoised_again(
    arnold: renderers.Written, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source = write(tmp_path / "in.exr", arnold.channels, arnold.attributes)
    assert run(["denoise", str(source), "-o", str(tmp_path / "a.exr"), "--bands", "30", *CHEAP]) == 0
    line = ["denoise", tmp_path / "a.exr", "-o", tmp_path / "b.exr", "--bands", "30", *CHEAP]
    fail(capsys, *line, what="input 'a.exr'", expected="a noisy render")
