"""Files of several view layers: one is denoised by default, with --all-layers all, each with its own passes."""

from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from renderers import WRITERS, make_scene, read_channels

import lobewise
from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.interchange import describe_file
from lobewise.interchange.reading import list_selections
from lobewise.interchange.selections import Selection
from tests.mistakes import refuses

LAYERS = ("Back", "Front", "Front.001")
OWN = "View Layer.001"
LIGHT = ("DiffDir", "DiffInd", "GlossDir", "GlossInd")


def make_layer(number: int) -> dict[str, np.ndarray]:
    """Return the passes of a view layer, from another column of the scene on."""
    channels = WRITERS["cycles"](make_scene()).channels
    width = next(iter(channels.values())).shape[1] - len(LAYERS) + 1
    return {
        name.replace(OWN, LAYERS[number]): np.ascontiguousarray(plane[:, number : number + width])
        for name, plane in channels.items()
    }


def write_layers(path: Path, *, without: tuple[str, ...] = (), views: bool = False) -> None:
    """Write three view layers, without some channels; with ``views`` each twice, as the eyes of a stereo pair."""
    layers = [make_layer(k) for k in range(len(LAYERS))]
    channels = {name: plane for each in layers for name, plane in each.items() if not name.startswith(without)}
    if views:
        heads = {name: name.rpartition(".") for name in channels}
        channels = {f"{heads[name][0]}.{eye}.{heads[name][2]}": channels[name] for name in channels for eye in "ab"}
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File({**header, "cycles.Back.samples": "16"}, channels).write(str(path))


def denoise(*words: str | Path) -> int:
    return run(["denoise", *map(str, words), "--quality", "fast"])


def list_changed(source: Path, output: Path) -> set[str]:
    before, after = read_channels(source), read_channels(output)
    assert before.keys() == after.keys()
    return {name.rpartition(".")[0] for name, plane in before.items() if plane.tobytes() != after[name].tobytes()}


def test_all_layers_are_denoised_each_with_its_own_passes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, output, own = (tmp_path / f"{name}.exr" for name in "abc")
    write_layers(source)
    assert denoise(source, "-o", output, "--all-layers") == 0
    told = capsys.readouterr()
    assert "3 view layers, " in told.out
    assert "Left noisy" not in told.err
    assert told.err.count("The camera was found") == 1
    assert list_changed(source, output) == {f"{layer}.{each}" for layer in LAYERS for each in ("Combined", *LIGHT)}
    for number, layer in enumerate(LAYERS):
        frame = lobewise.read_frame(source, layer=layer)
        surface = frame.gbuffer.depth > 0.0
        expected = make_layer(number)[f"{layer}.Normal.X"]
        np.testing.assert_allclose(frame.gbuffer.normal[surface][:, 0], expected[surface], atol=1e-5)
        result = lobewise.denoise(frame, quality="fast")
        np.testing.assert_array_equal(
            np.stack([read_channels(output)[f"{layer}.Combined.{letter}"] for letter in "RGB"], axis=-1), result.image
        )
        lobewise.write_result(own, result, source=own if number else source, layer=layer)
    assert all(plane.tobytes() == read_channels(own)[name].tobytes() for name, plane in read_channels(output).items())


def test_one_layer_is_denoised_without_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    write_layers(source)
    assert denoise(source, "-o", output) == 0
    assert "Left noisy: view layers 'Front.001', 'Front'." in capsys.readouterr().err
    assert list_changed(source, output) == {f"Back.{each}" for each in ("Combined", *LIGHT)}


def test_inspect_tells_the_option(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_layers(tmp_path / "a.exr")
    told = "This file has 3 view layers: 'Back', 'Front.001', 'Front'; "
    assert describe_file(tmp_path / "a.exr").notes[:2] == (
        f"{told}--all-layers denoises all.",
        "Left noisy: view layers 'Front.001', 'Front'.",
    )
    notes = describe_file(tmp_path / "a.exr", all_layers=True).notes
    assert notes[0] == f"{told}each is denoised with its own guides."
    assert not any("Left noisy" in note for note in notes)
    assert run(["inspect", str(tmp_path / "a.exr"), "--all-layers"]) == 0
    shown = capsys.readouterr().out
    assert "not used" not in shown
    assert "_clean.exr --all-layers" in shown


def test_a_layer_takes_no_guide_of_another(tmp_path: Path) -> None:
    write_layers(tmp_path / "a.exr", without=("Back.Normal", "Back.GlossCol"))
    frame = lobewise.read_frame(tmp_path / "a.exr")
    described = describe_file(tmp_path / "a.exr")
    assert [layer.name for layer in frame.layers] == ["diffuse", "rest"]
    assert "normal" in [lack.role for lack in described.lacks]


def test_an_image_without_passes_takes_those_of_a_layer(tmp_path: Path) -> None:
    # Blender writes the image of its compositor so.
    channels = make_layer(1)
    color = {name.replace("Front", "Composite"): plane for name, plane in channels.items() if "Combined" in name}
    OpenEXR.File({"cycles.Front.samples": "16"}, {**channels, **color}).write(str(tmp_path / "a.exr"))
    frame = lobewise.read_frame(tmp_path / "a.exr")
    assert frame.layers
    assert frame.notes == ("Left noisy: view layer 'Front'.",)


def test_layers_in_views(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    write_layers(source, without=("Front.001",), views=True)
    chosen = [(view, layer) for view in "ab" for layer in LAYERS[:2]]
    assert list_selections(source, all_layers=True) == tuple(Selection(*each) for each in chosen)
    assert denoise(source, "-o", output, "--all-layers", "--confidence") == 0
    assert "2 view layers in 2 views, " in capsys.readouterr().out
    added = read_channels(output).keys() - read_channels(source).keys()
    assert {name for name in added if name.endswith("weight_sum")} == {
        f"{layer}.lobewise.{view}.weight_sum" for view, layer in chosen
    }
    for view, layer in chosen:
        result = lobewise.denoise(lobewise.read_frame(source, view=view, layer=layer), quality="fast")
        np.testing.assert_array_equal(read_channels(output)[f"{layer}.Combined.{view}.G"], result.image[..., 1])


def test_further_passes_that_only_one_layer_has(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    channels = {name: plane for k in (0, 1) for name, plane in make_layer(k).items()}
    channels |= {f"Front.Combined_key.{letter}": 0.5 * channels[f"Front.Combined.{letter}"] for letter in "RGB"}
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    OpenEXR.File({"cycles.Front.samples": "16"}, channels).write(str(source))
    assert denoise(source, "-o", output, "--all-layers", "--also", "Combined_*") == 0
    assert "No pass of view layer 'Back' matches --also Combined_*." in capsys.readouterr().err
    assert "Front.Combined_key" in list_changed(source, output)


def test_mistakes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    write_layers(tmp_path / "a.exr")
    assert denoise(tmp_path / "a.exr", "-o", tmp_path / "b.exr", "--all-layers", "--map", "color=Combined") == 2
    assert "--all-layers: expected no --map color beside it" in capsys.readouterr().err
    many = {f"L{number}.Combined.{letter}": np.ones((2, 2), np.float32) for number in range(300) for letter in "RGB"}
    OpenEXR.File({"cycles.L.samples": "16"}, many).write(str(tmp_path / "many.exr"))
    assert denoise(tmp_path / "many.exr", "-o", tmp_path / "b.exr") == 2
    assert "expected at most 256 views and view layers, got 300; split the file" in capsys.readouterr().err
    with refuses(InputError, "layer", expected="one of Back, Front.001, Front", holder="input 'a.exr'"):
        lobewise.read_frame(tmp_path / "a.exr", layer="Fornt")
