"""Files of several views: each view is denoised with its own guides, and one copy of the file gets all results."""

import shlex
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from renderers import WRITERS, make_scene

import lobewise
from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.interchange import describe_file, import_file
from lobewise.interchange.reading import list_selections
from lobewise.interchange.selections import Selection
from lobewise.io import write_frame
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import decode_part
from lobewise.records.frame import Frame, GBuffer, Radiance
from tests.mistakes import refuses

EYES = ("left", "right")
SHIFT = 4
"""Columns by which the eyes differ."""
KINDS = ("multi_view", "parts", "blender")
Planes = dict[str, np.ndarray]


def make_eyes(renderer: str) -> dict[str, Planes]:
    """Return the scene's channels of both eyes: the right one begins some columns later."""
    channels = WRITERS[renderer](make_scene()).channels
    left = {name: np.ascontiguousarray(plane[:, :-SHIFT]) for name, plane in channels.items()}
    return {"left": left, "right": {name: np.ascontiguousarray(plane[:, SHIFT:]) for name, plane in channels.items()}}


def insert_view(name: str, view: str) -> str:
    head, dot, component = name.rpartition(".")
    return f"{head}{dot}{view}.{component}"


def write_views(path: Path, kind: str) -> dict[str, Planes]:
    """Write both eyes in one of the ways in which renderers do; return their channels by the names in the file."""
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    eyes = make_eyes("cycles" if kind == "blender" else "redshift")
    if kind == "parts":
        parts = [OpenEXR.Part({**header, "view": eye}, planes, f"rgba_{eye}") for eye, planes in eyes.items()]
        OpenEXR.File(parts).write(str(path))
        return eyes
    named = {
        eye: {
            name if kind == "multi_view" and eye == "left" else insert_view(name, eye): plane
            for name, plane in planes.items()
        }
        for eye, planes in eyes.items()
    }
    more = {"multiView": list(EYES)} if kind == "multi_view" else {"cycles.View Layer.001.samples": "16"}
    OpenEXR.File({**header, **more}, {**named["left"], **named["right"]}).write(str(path))
    return named


def read_views(path: Path) -> dict[str, Planes]:
    """Return the channels of a file by the index of the part and their names."""
    container = read_container(path)
    return {str(part.index): decode_part(container, part) for part in container.parts}


def denoise(*words: str | Path) -> int:
    return run(["denoise", *map(str, words), "--quality", "fast"])


def list_written(path: Path, view: str) -> dict[str, tuple[str, ...]]:
    """Return the channels of one view that get results, by the names of the results, after the index of their part."""
    outputs = import_file(path, view=view, light_passes=True).outputs
    return {name: (str(one.target.source.part.index), *one.target.channels) for name, one in outputs.items()}


@pytest.mark.sampled("multi_view", "parts")
@pytest.mark.parametrize("kind", KINDS)
def test_each_view_is_denoised_with_its_own_guides(kind: str, tmp_path: Path) -> None:
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    write_views(source, kind)
    assert denoise(source, "-o", output) == 0
    before, after, touched = read_views(source), read_views(output), set()
    eyes = make_eyes("cycles" if kind == "blender" else "redshift")
    normal = next(name for name in eyes["left"] if "Normal" in name and name.endswith((".X", ".R")))
    for eye in EYES:
        frame = lobewise.read_frame(source, view=eye)
        assert frame.layers
        assert frame.camera is not None
        surface = frame.gbuffer.depth > 0.0
        np.testing.assert_allclose(frame.gbuffer.normal[surface][:, 0], eyes[eye][normal][surface], atol=1e-5)
        result = lobewise.denoise(frame, quality="fast")
        for name, (part, *channels) in list_written(source, eye).items():
            touched |= {(part, channel) for channel in channels}
            if name == "color":
                written = np.stack([after[part][channel] for channel in channels], axis=-1)
                np.testing.assert_array_equal(written, result.image)
                assert not np.array_equal(written, np.stack([before[part][channel] for channel in channels], axis=-1))
    assert len({channel for _, channel in touched}) >= 6
    for part, planes in before.items():
        assert planes.keys() == after[part].keys()
        for channel, plane in planes.items():
            assert (part, channel) in touched or plane.tobytes() == after[part][channel].tobytes(), channel


@pytest.mark.sampled("multi_view")
@pytest.mark.parametrize("kind", KINDS)
def test_the_command_says_what_it_does(kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "a.exr"
    write_views(source, kind)
    assert denoise(source, "-o", tmp_path / "b.exr") == 0
    told = capsys.readouterr()
    assert "2 views, 44x36 pixels" in told.out
    assert "Left noisy" not in told.err
    # What is true of both views is said once.
    for words in ("Read as", "The camera was found", "of the light is in none", "was a mean over all lobes"):
        assert told.err.count(words) <= 1
    assert "View 'right'" not in told.err
    assert lobewise.read_frame(source).notes == ("Left noisy: view 'right'.",)
    assert lobewise.read_frame(source, view="right").notes == ("Left noisy: view 'left'.",)
    described = describe_file(source)
    assert described.notes[0] == "This file has 2 views: 'left', 'right'; each is denoised with its own guides."
    assert run(["inspect", str(source)]) == 0
    assert "not used" not in capsys.readouterr().out


@pytest.mark.sampled("multi_view")
@pytest.mark.parametrize("kind", KINDS)
def test_python_writes_the_same_channels(kind: str, tmp_path: Path) -> None:
    source, output, own = (tmp_path / f"{name}.exr" for name in "abc")
    write_views(source, kind)
    assert denoise(source, "-o", output) == 0
    for eye in EYES:
        result = lobewise.denoise(lobewise.read_frame(source, view=eye), quality="fast")
        lobewise.write_result(own, result, source=source if eye == "left" else own, view=eye)
    for part, planes in read_views(output).items():
        for name, plane in planes.items():
            assert plane.tobytes() == read_views(own)[part][name].tobytes(), name


@pytest.mark.real_exr
def test_a_stereo_file_of_blender(exr_folder: Path, tmp_path: Path) -> None:
    source, output = exr_folder.parent / "field" / "blender_stereo.exr", tmp_path / "out.exr"
    assert run(["denoise", str(source), "-o", str(output)]) == 0
    ((_, before),), ((_, after),) = read_views(source).items(), read_views(output).items()
    for eye in EYES:
        names = [f"ViewLayer.Combined.{eye}.{letter}" for letter in "RGB"]
        noisy, clean = (np.stack([planes[name] for name in names], -1).astype("f4") for planes in (before, after))
        assert measure_grain(clean) < 0.6 * measure_grain(noisy)
        result = lobewise.denoise(lobewise.read_frame(source, view=eye))
        np.testing.assert_array_equal(clean.astype("f2"), result.image.astype("f2"))
    for name in (name for name in before if ".Combined." not in name or name.endswith("A")):
        is_light = ".DiffDir." in name or ".DiffInd." in name
        assert is_light or before[name].tobytes() == after[name].tobytes(), name


def measure_grain(image: np.ndarray) -> float:
    """Return the median difference of a pixel from the mean of its neighbours."""
    around = 0.25 * (image[:-2, 1:-1] + image[2:, 1:-1] + image[1:-1, :-2] + image[1:-1, 2:])
    return float(np.median(np.abs(image[1:-1, 1:-1] - around)))


@pytest.mark.real_exr
@pytest.mark.parametrize("name", ["beachball_multipart.0001.exr", "beachball_singlepart.0001.exr"])
def test_stereo_samples_of_openexr(name: str, exr_folder: Path) -> None:
    # The right eye is the first.
    assert list_selections(exr_folder / name) == (Selection("right"), Selection("left"))


@pytest.mark.parametrize("kind", ["multi_view", "blender"])
def test_names_of_added_channels_hold_the_view(kind: str, tmp_path: Path) -> None:
    source, output = tmp_path / "a.exr", tmp_path / "b.exr"
    before = write_views(source, kind)
    assert denoise(source, "-o", output, "--suffix", "_clean", "--confidence") == 0
    added = read_views(output)["0"].keys() - {name for planes in before.values() for name in planes}
    picture = "View Layer.001.Combined_clean" if kind == "blender" else "clean"
    assert f"{picture}.right.R" in added
    assert {"lobewise.left.weight_sum", "lobewise.right.weight_sum"} <= added


def test_channels_of_one_view_select_it(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source = tmp_path / "a.exr"
    write_views(source, "blender")
    assert len(list_selections(source, mapping={"normal": "Normal"})) == 2
    word = shlex.quote("color=View Layer.001.Combined.right")
    assert denoise(source, "-o", tmp_path / "b.exr", *shlex.split(f"--map {word}")) == 0
    assert "Left noisy: view 'left'." in capsys.readouterr().err
    before, after = (read_views(tmp_path / name)["0"] for name in ("a.exr", "b.exr"))
    changed = {name.split(".")[-2] for name, plane in before.items() if plane.tobytes() != after[name].tobytes()}
    assert changed == {"right"}


def test_a_view_without_an_image_is_no_view_to_denoise(tmp_path: Path) -> None:
    left, right = make_eyes("redshift").values()
    channels = {**left, **{insert_view(name, "right"): plane for name, plane in right.items() if name.startswith("P")}}
    OpenEXR.File({"multiView": list(EYES)}, channels).write(str(tmp_path / "a.exr"))
    assert list_selections(tmp_path / "a.exr") == (Selection("left"),)
    assert lobewise.read_frame(tmp_path / "a.exr").notes == ()


def test_views_of_parts_beside_listed_views(tmp_path: Path) -> None:
    left, right = make_eyes("redshift").values()
    header = {"type": OpenEXR.scanlineimage}
    parts = [
        OpenEXR.Part({**header, "multiView": ["left", "other"]}, left, "a"),
        OpenEXR.Part({**header, "view": "right"}, right, "b"),
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    assert list_selections(tmp_path / "a.exr") == (Selection("left"), Selection("right"))


def test_unknown_views_are_refused(tmp_path: Path) -> None:
    write_views(tmp_path / "a.exr", "blender")
    with refuses(InputError, "view", holder="input 'a.exr'"):
        lobewise.read_frame(tmp_path / "a.exr", view="rigth")
    normal = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (8, 8, 3))
    write_frame(tmp_path / "own.exr", Frame(Radiance(np.ones((8, 8, 3), np.float32)), GBuffer(normal=normal)))
    with refuses(InputError, "view", holder="input 'own.exr'"):
        lobewise.read_frame(tmp_path / "own.exr", view="left")


@pytest.mark.nightly
@pytest.mark.parametrize("more", [["--temporal"], ["--window", "1"]])
def test_sequences_of_views(more: list[str], tmp_path: Path) -> None:
    for number in range(3):
        write_views(tmp_path / f"in.{number}.exr", "blender")
    source, output = str(tmp_path / "in.#.exr"), str(tmp_path / "out.#.exr")
    assert run(["denoise", source, "-o", output, *more, "--quality", "fast"]) == 0
    for eye in EYES:
        frames = [lobewise.read_frame(tmp_path / f"in.{k}.exr", view=eye) for k in range(3)]
        past_only = "--temporal" in more
        window = lobewise.WindowFilter(2 if past_only else 1, quality="fast", past_only=past_only)
        images = [window.denoise(frames[: k + 1] if past_only else frames, k).image for k in range(3)]
        for number, image in enumerate(images):
            written = lobewise.read_frame(tmp_path / f"out.{number}.exr", view=eye).radiance.color
            np.testing.assert_allclose(written, image, rtol=1e-6)
