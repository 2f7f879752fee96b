"""Results go back where they came from; every other channel, part and attribute stays, bit for bit."""

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest
from renderers import REAL, WRITERS, make_scene, write, write_denoised

import lobewise
from lobewise.cli.program import run
from lobewise.interchange import import_file, write_result
from lobewise.interchange.imported import ImageReader
from lobewise.interchange.mapping import map_file
from lobewise.interchange.reading import list_selections
from lobewise.io.exr.container import Part
from lobewise.io.exr.header import DENOISED
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import decode_part

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
CYCLES_PASSES = {("diffuse", "DiffDir"), ("diffuse", "DiffInd"), ("glossy", "GlossDir"), ("glossy", "GlossInd")}
"""Layers of `make_scene` as Cycles writes it, and the passes that make them up."""
RENDERED = ("blender_4.5_seed1.exr", "blender_5.2_multipart.exr", "luxcore/RGB.exr")


def read_all(path: Path) -> list[tuple[dict[str, bytes], dict[str, np.ndarray]]]:
    """Return attributes and channels of every part."""
    container = read_container(path)
    return [
        ({f"{item.type} {item.name}": item.value for item in part.attributes}, decode_part(container, part))
        for part in container.parts
    ]


def require_untouched(source: Path, output: Path) -> int:
    """Compare all that no result went to; return how many channels that is."""
    touched = {
        (one.target.source.part.index, channel)
        for each in list_selections(source)
        for one in import_file(source, light_passes=True, view=each.view or None).outputs.values()
        for channel in one.target.channels
    }
    before, after = read_all(source), read_all(output)
    assert len(before) == len(after)
    count = 0
    for index, ((old_header, old), (new_header, new)) in enumerate(zip(before, after, strict=True)):
        assert {key: value for key, value in new_header.items() if not key.endswith(DENOISED)} == old_header
        assert list(old) == list(new)
        for name, plane in old.items():
            assert new[name].dtype == plane.dtype
            if (index, name) not in touched:
                count += 1
                assert plane.tobytes() == new[name].tobytes(), name
    return count


@pytest.mark.sampled(
    "arnold_multichannel.exr", "bright_rings_nan_inf.exr", "display_window_t03.exr", "special_chars.exr"
)
@pytest.mark.real_exr
@pytest.mark.parametrize("name", REAL)
def test_real_files_without_any_option(name: str, exr_folder: Path, tmp_path: Path) -> None:
    output = tmp_path / "out.exr"
    assert run(["denoise", str(exr_folder / name), "-o", str(output), "--quality", "fast"]) == 0
    require_untouched(exr_folder / name, output)


@pytest.mark.sampled("blender_4.5_seed1.exr")
@pytest.mark.parametrize("name", RENDERED)
def test_rendered_files_without_any_option(name: str, tmp_path: Path) -> None:
    output = tmp_path / "out.exr"
    assert run(["denoise", str(FOREIGN / name), "-o", str(output), "--quality", "fast"]) == 0
    count = require_untouched(FOREIGN / name, output)
    assert count > 40 or name.startswith("luxcore")
    before, after = import_file(FOREIGN / name).frame, import_file(output).frame
    assert not np.array_equal(before.radiance.color, after.radiance.color)


@pytest.mark.parametrize("part_each", [False, True])
def test_layers_still_add_up(part_each: bool, tmp_path: Path) -> None:
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    write(source, WRITERS["cycles"](make_scene()), part_each=part_each)
    assert run(["denoise", str(source), "-o", str(output)]) == 0
    (_, *_), pixels = read_all(output)[0], {}
    for _, channels in read_all(output):
        pixels |= channels
    if part_each:
        found = import_file(output).frame
        total = found.radiance.diffuse + found.radiance.specular
        sky = ~make_scene().surface
        np.testing.assert_allclose(total[~sky], found.radiance.color[~sky], rtol=1e-4, atol=1e-4)
        return

    def get(name: str) -> np.ndarray:
        return np.stack([pixels[f"View Layer.001.{name}.{letter}"] for letter in "RGB"], axis=-1)

    parts = get("DiffCol") * (get("DiffDir") + get("DiffInd")) + get("GlossCol") * (get("GlossDir") + get("GlossInd"))
    np.testing.assert_allclose(parts + get("Env"), get("Combined"), rtol=1e-4, atol=1e-4 * get("Combined").mean())


def test_light_without_an_albedo_goes_to_the_other_layers(tmp_path: Path) -> None:
    """The file cannot hold it in its own pass; the passes still add up to the picture."""
    source, output, scene = tmp_path / "a.exr", tmp_path / "b.exr", make_scene()
    scene.specular_albedo[::2], scene.specular[::2] = 0.0, 0.0
    write(source, WRITERS["cycles"](scene))
    result = lobewise.denoise(lobewise.read_frame(source), quality="fast", with_oidn=False)
    added = np.full_like(result.image, 0.1)
    also = {**result.also, "glossy/GlossDir": result.also["glossy/GlossDir"] + added}
    layers = {**result.layers, "glossy": result.layers["glossy"] + added}
    lobewise.write_result(output, replace(result, image=result.image + added, layers=layers, also=also), source=source)
    found = lobewise.read_frame(output).radiance
    seen = scene.surface & (scene.diffuse_albedo.min(axis=-1) > 0.0)
    np.testing.assert_allclose((found.diffuse + found.specular)[seen], found.color[seen], rtol=1e-4, atol=1e-4)
    assert not found.specular[::2].any()


@pytest.mark.sampled("cycles-settings0")
@pytest.mark.parametrize(
    ("name", "settings"),
    [("cycles", {"radius": 5, "quality": "fast"}), ("cycles", {}), *((name, {}) for name in RENDERED)],
)
def test_three_lines_write_the_file_of_the_command(name: str, settings: dict[str, Any], tmp_path: Path) -> None:
    source, mine, other = FOREIGN / name, tmp_path / "python.exr", tmp_path / "command.exr"
    if name == "cycles":
        source = tmp_path / "a.exr"
        write(source, WRITERS["cycles"](make_scene()))
    options = [word for key, value in settings.items() for word in (f"--{key}", str(value))]
    assert run(["denoise", str(source), "-o", str(other), *options]) == 0
    frame = lobewise.read_frame(source)
    result = lobewise.denoise(frame, **settings)
    lobewise.write_result(mine, result, source=source)
    assert mine.read_bytes() == other.read_bytes()
    if name == "cycles":
        # Exact light is scaled where Open Image Denoise is mixed in.
        exact = {"environment"} if result.settings["with_oidn"] else set()
        assert set(result.also) == {f"{layer}/{each}" for layer, each in CYCLES_PASSES} | exact


def test_light_passes_can_be_left(tmp_path: Path) -> None:
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    write(source, WRITERS["cycles"](make_scene()))
    frame, whole = lobewise.read_frame(source, light_passes=False), lobewise.read_frame(source)
    assert {(layer.name, part) for layer in whole.layers for part in layer.parts} == CYCLES_PASSES
    assert not any(layer.parts for layer in frame.layers)
    result = lobewise.denoise(frame)
    assert result.image.tobytes() == lobewise.denoise(whole).image.tobytes()
    (told,) = lobewise.write_result(output, result, source=source)
    before, after = read_all(source)[0][1], read_all(output)[0][1]
    changed = {name.split(".")[-2] for name, plane in before.items() if plane.tobytes() != after[name].tobytes()}
    assert changed == {"Combined"}
    for _, part in CYCLES_PASSES:
        assert part in told


def test_a_result_finds_the_file_of_its_frame(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The file is taken as it was read, with its options; a file that changed since, or another one, is read anew."""
    source, other = (tmp_path / name for name in ("source.exr", "other.exr"))
    for path in (source, other):
        write(path, WRITERS["cycles"](make_scene()))
    frame = lobewise.read_frame(source, light_passes=False)
    result = lobewise.denoise(frame, quality="fast")
    write_result(tmp_path / "anew.exr", result, source=other)
    reads: list[Path] = []

    def read(path: Path, **options: Any) -> Any:
        reads.append(path)
        return import_file(path, **options)

    monkeypatch.setattr("lobewise.interchange.replacing.import_file", read)
    write_result(tmp_path / "known.exr", result, source=source)
    assert not reads
    assert (tmp_path / "known.exr").read_bytes() == (tmp_path / "anew.exr").read_bytes()
    write_result(tmp_path / "other.exr", result, source=other)
    assert reads == [other]
    os.utime(source, (1.0, 1.0))
    write_result(tmp_path / "changed.exr", result, source=source)
    assert reads == [other, source]


def test_a_part_is_decoded_before_threads_take_chunks_of_it(tmp_path: Path) -> None:
    """Threads that decode would each decode the whole part."""
    source, decoded = tmp_path / "a.exr", []
    write(source, WRITERS["cycles"](make_scene()), part_each=True)
    container = read_container(source)

    def decode(part: Part, names: frozenset[str]) -> Any:
        decoded.append(part.index)
        return decode_part(container, part, names)

    read, found = ImageReader(decode), map_file(container).layers[0].light[0]
    take = read.open(found)
    assert decoded == [found.source.part.index]
    chunk = slice(3, 9), slice(0, 5)
    np.testing.assert_array_equal(take(chunk), read(found)[chunk])
    np.testing.assert_array_equal(read.open(found)(chunk), take(chunk))
    assert len(decoded) == 1


def make_groups(tmp_path: Path) -> Path:
    """Write a file with two light groups of the whole and two of the diffuse layer."""
    scene = make_scene()
    written = WRITERS["arnold"](scene)
    share = np.linspace(0.1, 0.9, scene.color.shape[1], dtype=np.float32)[None, :, None]
    for head, image in (("RGBA", scene.color), ("diffuse", scene.diffuse)):
        for group, light in (("key", share * image), ("fill", image - share * image)):
            written.channels |= {f"{head}_{group}.{letter}": light[..., k] for k, letter in enumerate("RGB")}
    write(tmp_path / "groups.exr", written)
    return tmp_path / "groups.exr"


@pytest.mark.parametrize("quality", ["fast", "balanced", "high"])
def test_light_groups_sum_to_what_they_belong_to(quality: str, tmp_path: Path) -> None:
    found = import_file(make_groups(tmp_path), also=["RGBA_*", "diffuse_key", "diffuse_fill"])
    result = lobewise.denoise(found.frame, quality=quality)
    assert set(result.also) == {"RGBA_key", "RGBA_fill", "diffuse/diffuse_key", "diffuse/diffuse_fill"}
    whole = result.also["RGBA_key"] + result.also["RGBA_fill"]
    np.testing.assert_allclose(whole, result.image, rtol=1e-4, atol=1e-4 * result.image.mean())
    diffuse = result.also["diffuse/diffuse_key"] + result.also["diffuse/diffuse_fill"]
    np.testing.assert_allclose(diffuse, result.layers["diffuse"], rtol=1e-4, atol=1e-4 * result.image.mean())


@pytest.mark.parametrize("part_each", [False, True])
def test_single_channels_go_back_to_their_own_places(
    part_each: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    scene = make_scene()
    written = WRITERS["karma"](scene)
    rng = np.random.default_rng(2)
    value = 0.4 + 0.2 * scene.normal[..., 2]
    light = value * (scene.diffuse_albedo + scene.specular_albedo).mean(axis=-1)
    clean = {f"S0.{wavelength},000000nm": light for wavelength in range(400, 750, 50)} | {"mask.Y": value}
    for name, plane in clean.items():
        written.channels[name] = plane * rng.gamma(4.0, 0.25, plane.shape)
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    write(source, written, half=True, part_each=part_each)
    assert run(["denoise", str(source), "-o", str(output), "--also", "*nm", "--also", "mask"]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "400,000000nm and 6 more single channels are filtered by the weights of the image." in told
    assert "Left noisy" not in told
    before, after = (
        {name: plane for _, part in read_all(path) for name, plane in part.items()} for path in (source, output)
    )
    for name, plane in clean.items():
        own = name.rpartition(".")[2] if part_each else name
        errors = [np.square(image[own] - plane).mean() for image in (after, before)]
        assert errors[0] < 0.3 * errors[1], name
        assert after[own].dtype == np.float16
    assert run(["inspect", str(source)]) == 0
    assert "7 spectral bands (--also '*nm' takes all)" in " ".join(capsys.readouterr().out.split())


def test_beside_alone_and_with_confidence(tmp_path: Path) -> None:
    source = tmp_path / "a.exr"
    write(source, WRITERS["arnold"](make_scene()))
    (_, before), *_ = read_all(source)
    assert run(["denoise", str(source), "-o", str(tmp_path / "b.exr"), "--suffix", "_clean", "--confidence"]) == 0
    (_, beside), *_ = read_all(tmp_path / "b.exr")
    for name, plane in before.items():
        np.testing.assert_array_equal(beside[name], plane)
    more = set(beside) - set(before)
    lights = {f"{name}_clean.{letter}" for name in ("diffuse", "specular") for letter in "RGB"}
    told = {f"lobewise.{name}" for name in ("weight_sum", "effective_samples", "bad_pixel", "rerender")}
    assert more == {"clean.R", "clean.G", "clean.B"} | lights | told
    assert beside["lobewise.effective_samples"].max() > 4.0
    assert run(["denoise", str(source), "-o", str(tmp_path / "c.exr"), "--only"]) == 0
    (_, alone), *_ = read_all(tmp_path / "c.exr")
    assert set(alone) == {"R", "G", "B", *(f"{name}.{letter}" for name in ("diffuse", "specular") for letter in "RGB")}
    np.testing.assert_array_equal(alone["R"], beside["clean.R"])
    # A second time the names are taken.
    assert run(["denoise", str(tmp_path / "b.exr"), "-o", str(tmp_path / "d.exr"), "--suffix", "_clean"]) == 2
    assert not (tmp_path / "d.exr").exists()


@pytest.mark.parametrize("parts", [1, 2])
@pytest.mark.parametrize("compression", ["DWAA", "B44"])
def test_lossy_compression_does_not_touch_the_others(
    compression: str, parts: int, rng: np.random.Generator, tmp_path: Path
) -> None:
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    header = {"compression": getattr(OpenEXR, f"{compression}_COMPRESSION"), "type": OpenEXR.scanlineimage}
    channels = {
        f"{head}{letter}": rng.gamma(1.0, 1.0, (64, 64)).astype(np.float16)
        for head in ("", "other.")
        for letter in "RGB"
    }
    depth = rng.random((64, 64)).astype(np.float16)
    made = [
        OpenEXR.Part({**header, "arnold/x": "1"}, channels, "a"),
        OpenEXR.Part(header, {"Z": depth}, "b"),
    ]
    OpenEXR.File(made[:parts]).write(str(source))
    result = lobewise.denoise(lobewise.read_frame(source), quality="fast", radius=2)
    notes = write_result(output, result, source=source)
    (_, old), (new_header, new) = read_all(source)[0], read_all(output)[0]
    for name in ("other.R", "other.G", "other.B"):
        assert old[name].tobytes() == new[name].tobytes()
    # What B44 gave back it gives back again.
    changed = compression == "DWAA"
    assert read_container(output).parts[0].compression == ("zip" if changed else "b44")
    assert any("compressed with loss" in note for note in notes) == changed
    assert len(OpenEXR.File(str(output)).parts) == parts
    assert new_header["box2i dataWindow"]


@pytest.mark.parametrize("part_each", [False, True])
def test_the_result_goes_where_people_look(part_each: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Blender's denoiser was on: Combined is its image, which viewers show, and Noisy Image is what was rendered."""
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    layer, written = "View Layer.001", write_denoised(source, part_each=part_each)
    assert run(["denoise", str(source), "-o", str(output), "--quality", "fast"]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert "goes into View Layer.001.Combined.R/G/B" in told
    kept = "before" if part_each else f"{layer}.Combined_before"
    assert f"kept as {kept}.R/G/B" in told

    def read(path: Path) -> dict[str, np.ndarray]:
        found = {}
        for part in OpenEXR.File(str(path), separate_channels=True).parts:
            for name, channel in part.channels.items():
                plain = part_each and name in "RGBXYZ"
                found[f"{part.name()}.{name}" if plain else name] = channel.pixels
        return found

    before, after = read(source), read(output)
    result = lobewise.denoise(lobewise.read_frame(source), quality="fast").image
    for k, letter in enumerate("RGB"):
        np.testing.assert_allclose(after[f"{layer}.Combined.{letter}"], result[..., k], rtol=1e-6)
        np.testing.assert_array_equal(after[f"{kept}.{letter}"], written[f"{layer}.Combined.{letter}"])
        np.testing.assert_array_equal(after[f"{layer}.Noisy Image.{letter}"], before[f"{layer}.Noisy Image.{letter}"])
    assert np.array_equal(lobewise.interchange.read_image(output), result)
    # `compare` names the pass that it measures.
    assert run(["compare", str(output), "--reference", str(source)]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert told.count("which viewers show, is measured") == 2
    # A second time the renderer's own image is not replaced by lobewise's.
    again = tmp_path / "c.exr"
    assert run(["denoise", str(output), "-o", str(again), "--quality", "fast"]) == 0
    np.testing.assert_array_equal(read(again)[f"{kept}.R"], written[f"{layer}.Combined.R"])
