"""A file that lobewise denoised is not denoised again in silence; its noisy image, where it is still there, serves."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from renderers import WRITERS, make_scene, write, write_denoised

from lobewise.cli.program import run
from lobewise.denoising import denoise
from lobewise.interchange import describe_file, import_file, read_frame, write_result
from lobewise.interchange.checks import MARKED
from lobewise.io import write_frame
from lobewise.io.exr.header import REPLACED, read_replaced
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.schema import DENOISED
from lobewise.recipes.streaming.recipe import denoise_file
from lobewise.records.frame import Frame, GBuffer, Radiance
from tests.cli.lines import fail

REFUSED = {"expected": "a noisy render", "got": "a result of lobewise, as its attribute 'lobewise/denoised' says"}


@pytest.fixture
def own(rng: np.random.Generator, tmp_path: Path) -> Path:
    """Return a result in lobewise's own names."""
    normal = np.broadcast_to([0.0, 0.0, 1.0], (12, 16, 3))
    write_frame(
        tmp_path / "noisy.exr", Frame(Radiance(rng.gamma(1.0, 1.0, (12, 16, 3))), GBuffer(normal=normal), spp=4)
    )
    assert run(["denoise", str(tmp_path / "noisy.exr"), "-o", str(tmp_path / "clean.exr"), "--quality", "fast"]) == 0
    return tmp_path / "clean.exr"


def test_a_result_is_refused(own: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "again.exr"
    for more in ([], ["--bands", "4"], ["--bands", "off"], ["--suffix", "_x"]):
        fail(capsys, "denoise", own, "-o", output, *more, **REFUSED)
    fail(capsys, "denoise", tmp_path / "noisy.exr", "--half", own, "-o", output, **REFUSED)
    assert not output.exists()
    # Whoever names the image means it.
    named = ["--map", "color=R,G,B", "--map", "normal=normal.X,normal.Y,normal.Z"]
    assert run(["denoise", str(own), "-o", str(output), *named]) == 0
    (told,) = (note for note in describe_file(own).notes if "Lobewise has denoised this file" in note)
    assert told.endswith("give the noisy render, or say by --map color=... which image is noisy.")
    assert told in denoise_file(own, output).notes
    assert not any("denoised this" in note for note in describe_file(tmp_path / "noisy.exr").notes)


@pytest.mark.parametrize("part_each", [False, True])
def test_a_result_of_another_renderers_file_is_refused(
    part_each: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, clean = tmp_path / "a.exr", tmp_path / "b.exr"
    write(source, WRITERS["cycles"](make_scene()), part_each=part_each)
    assert run(["denoise", str(source), "-o", str(clean)]) == 0
    fail(capsys, "denoise", clean, "-o", tmp_path / "c.exr", **REFUSED)
    (found,) = (one for one in import_file(clean).findings if one.what == MARKED)
    assert not found.mended
    assert found.sentence in describe_file(clean).notes
    # What it is read as stays: a result has layers, too.
    assert import_file(clean).frame.layers


@pytest.mark.parametrize("part_each", [False, True])
def test_a_noisy_image_that_is_still_there_is_filtered(
    part_each: bool, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    source, clean = tmp_path / "a.exr", tmp_path / "b.exr"
    write_denoised(source, part_each=part_each)
    first = import_file(source).frame
    assert run(["denoise", str(source), "-o", str(clean)]) == 0
    capsys.readouterr()
    assert run(["denoise", str(clean), "-o", str(tmp_path / "c.exr")]) == 0
    told = "the image is filtered as a whole, because its passes of light are denoised already"
    assert capsys.readouterr().err.count(told) == 1
    again = import_file(clean).frame
    np.testing.assert_array_equal(again.radiance.color, first.radiance.color)
    assert first.layers
    assert not again.layers
    # It stays marked, with all that either run replaced.
    lists = [read_replaced(read_container(tmp_path / name)) for name in ("b.exr", "c.exr")]
    assert lists[0] == lists[1]
    assert sum(map(len, (lists[0] or {}).values())) > 3


def test_results_beside_the_noisy_image_leave_it_noisy(own: Path, tmp_path: Path) -> None:
    noisy, beside = tmp_path / "noisy.exr", tmp_path / "beside.exr"
    assert run(["denoise", str(noisy), "-o", str(beside), "--suffix", "_clean"]) == 0
    assert read_replaced(read_container(beside)) == {0: {"clean.R", "clean.G", "clean.B"}}
    assert run(["denoise", str(beside), "-o", str(tmp_path / "again.exr")]) == 0


def test_only_the_result_is_named_as_well(tmp_path: Path) -> None:
    source, clean = tmp_path / "a.exr", tmp_path / "b.exr"
    write(source, WRITERS["cycles"](make_scene()), part_each=True)
    assert run(["denoise", str(source), "-o", str(clean), "--only"]) == 0
    container = read_container(clean)
    assert read_replaced(container) == {part.index: {one.name for one in part.channels} for part in container.parts}


@pytest.mark.parametrize(
    "mark", ["{}", '{"radius": 8}', "no JSON", '{"replaced": [1]}', '{"replaced": {"": 3}, "replaced": {}}']
)
def test_a_mark_without_a_list_stands_for_every_channel(own: Path, mark: str) -> None:
    container = read_container(own)
    (part,) = container.parts
    others = tuple(item for item in part.attributes if item.name != DENOISED)
    (item,) = set(part.attributes) - set(others)
    listed = {channel for names in json.loads(item.value)[REPLACED].values() for channel in names}
    assert listed == set("RGB")
    assert read_replaced(container) == {0: listed}
    old = replace(container, parts=(replace(part, attributes=(*others, replace(item, value=mark.encode()))),))
    assert read_replaced(old) == {0: {channel.name for channel in part.channels}}
    assert read_replaced(replace(container, parts=(replace(part, attributes=others),))) is None


def test_names_that_are_not_there_are_no_channels(own: Path) -> None:
    """Whoever takes the channels apart leaves the mark: it says nothing of channels with other names."""
    container = read_container(own)
    (part,) = container.parts
    values = json.dumps({REPLACED: {"": ["beauty.R", 3, "G"], "other": ["B"]}}).encode()
    changed = tuple(replace(item, value=values) if item.name == DENOISED else item for item in part.attributes)
    assert read_replaced(replace(container, parts=(replace(part, attributes=changed),))) == {0: {"G"}}


def test_python_writes_the_same_mark(own: Path, tmp_path: Path) -> None:
    noisy = tmp_path / "noisy.exr"
    write_result(tmp_path / "python.exr", denoise(read_frame(noisy), quality="fast"), source=noisy)
    assert (tmp_path / "python.exr").read_bytes() == own.read_bytes()
