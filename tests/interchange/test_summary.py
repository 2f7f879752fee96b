"""What `inspect` tells a person: a summary without contradictions, and commands that work."""

import json
import shlex
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from renderers import WRITERS, make_scene, write, write_denoised

from lobewise.cli.program import run
from lobewise.cli.terminal.summary import describe_quality
from lobewise.denoising import denoise
from lobewise.errors import InputError
from lobewise.interchange import describe_file, import_file, read_frame, write_result
from lobewise.interchange.preset import load_presets
from lobewise.io import write_frame, write_sparse_frame
from lobewise.io.exr.describe import COSTS
from lobewise.recipes.streaming import plan
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.sparse_frame import make_sparse
from tests.mistakes import refuses

FOREIGN = Path(__file__).parents[1] / "data" / "foreign"
BLENDER = FOREIGN / "blender_5.2_multipart.exr"
WIDTHS = [80, 100, 120]


def ask(capsys: pytest.CaptureFixture[str], *words: str | Path, code: int = 0) -> str:
    """Return what a command prints as its result."""
    assert run([str(word) for word in words]) == code
    return capsys.readouterr().out


@pytest.mark.parametrize("width", WIDTHS)
def test_the_summary_of_a_blender_file_fits_a_screen(
    width: int, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", str(width))
    lines = ask(capsys, "inspect", BLENDER).splitlines()
    assert len(lines) <= 25
    told = " ".join(" ".join(lines).split())
    assert "Blender Cycles (Blender 5.2.3 LTS), 64x48 pixels, 8 samples per pixel" in told
    assert "Expected quality: best." in told
    assert "diffuse and glossy are each filtered by itself" in told
    assert "into Combined and 4 more passes of light" in told
    assert "Missing" not in told
    assert "┃" not in told


@pytest.mark.sampled("cycles")
@pytest.mark.parametrize("renderer", ["cycles", "mitsuba", "lobewise", "alone"])
def test_the_method_is_that_of_the_result(renderer: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    if renderer == "alone":
        OpenEXR.File({}, {name: np.ones((8, 8), "f4") for name in "RGB"}).write(str(path))
    elif renderer == "lobewise":
        frame = read_frame(BLENDER)
        # Every normal is the same: it tells Open Image Denoise nothing.
        flat = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), (*frame.shape, 3))
        guides = replace(frame.gbuffer, normal=flat, denoiser_normal=None)
        write_frame(path, frame.with_changes(gbuffer=guides))
    else:
        write(path, WRITERS[renderer](make_scene()))
    method = denoise(read_frame(path)).method
    assert json.loads(ask(capsys, "inspect", "--json", path))["method"] == method
    assert method in " ".join(ask(capsys, "inspect", path).split())


def test_a_file_in_bands_is_foretold_without_open_image_denoise(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    write_frame(tmp_path / "a.exr", read_frame(BLENDER))
    monkeypatch.setattr(plan, "MAX_WHOLE_GIB", 1e-9)
    assert "this one is denoised in bands" in " ".join(ask(capsys, "inspect", tmp_path / "a.exr").split())


def test_tables_and_attributes_are_asked_for(capsys: pytest.CaptureFixture[str]) -> None:
    everything = ask(capsys, "inspect", "--all", BLENDER)
    assert everything.startswith(ask(capsys, "inspect", BLENDER))
    assert "what a frame can have" in everything
    assert "lin_rec709_scene" not in everything
    assert "lin_rec709_scene" in ask(capsys, "inspect", "-a", BLENDER)


def test_the_command_to_type_next_works(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "my frame.exr"
    shutil.copy(BLENDER, path)
    out = ask(capsys, "inspect", path, "--preset", "cycles", "--map", "alpha=ViewLayer.Combined.A")
    commands = [line.partition(":")[2] for line in out.splitlines() if ": " in line and "lobewise" in line]
    denoise, inspect = [shlex.split(command) for command in commands if command.split()[:1] == ["lobewise"]]
    assert denoise[-4:] == inspect[-5:-1] == ["--preset", "cycles", "--map", "alpha=ViewLayer.Combined.A"]
    assert run(denoise[1:]) == 0
    assert (tmp_path / "my frame_clean.exr").is_file()
    assert run(inspect[1:]) == 0


def test_light_of_layers_is_found_light() -> None:
    found = describe_file(BLENDER)
    told = {image.label: image.found for image in found.images}
    assert told["diffuse (of the layers)"]
    assert told["specular (of the layers)"]
    assert "diffuse" not in told
    (albedo,) = [image for image in found.images if image.meaning.startswith("albedo of all lobes")]
    assert "for Open Image Denoise, as layers have their own" in albedo.meaning


@pytest.mark.parametrize("renderer", WRITERS)
def test_what_is_missing_comes_with_the_renderers_own_words(renderer: str, tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    written = WRITERS[renderer](make_scene())
    write(path, written)
    found = describe_file(path)
    assert {lack.role for lack in found.lacks} | set(found.uses) >= set(COSTS)
    advice = " ".join(load_presets()[written.preset].advice.values())
    for lack in found.lacks:
        assert lack.told in found.notes
        assert lack.role not in found.uses
        assert not lack.remedy.startswith("none")
        assert lack.remedy in advice


@pytest.mark.parametrize(
    ("without", "quality", "missing"),
    [
        ((), "best", ""),
        (("Roughness", "Denoising"), "good", "Roughness in every material"),
        (("DiffDir", "GlossDir"), "fair", "Diffuse, Glossy and Transmission: Direct, Indirect, Color"),
        (("Normal",), "fair", "View Layer > Passes > Data > Normal"),
        (("Position", "Depth"), "good", "View Layer > Passes > Data > Position"),
        (
            ("Normal", "Position", "Depth", "Diff", "Gloss", "Roughness", "Denoising"),
            "weak",
            "View Layer > Passes > Data > Normal",
        ),
    ],
)
def test_quality_is_told_from_what_is_there(
    without: tuple[str, ...], quality: str, missing: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.exr"
    write(path, WRITERS["cycles"](make_scene()).leave_out(*without))
    told = " ".join(ask(capsys, "inspect", path).split())
    assert f"Expected quality: {quality}." in told
    assert missing in told
    assert describe_quality(describe_file(path)).startswith(quality)


def test_an_albedo_that_nothing_takes_is_not_called_missing(tmp_path: Path) -> None:
    folder = tmp_path / "frame"
    shutil.copytree(FOREIGN / "luxcore", folder)
    for name in ("DIRECT_DIFFUSE", "INDIRECT_DIFFUSE"):
        (folder / f"{name}.exr").unlink()
    (lack,) = [lack for lack in describe_file(folder / "RGB.exr").lacks if lack.role == "albedo"]
    assert (lack.remedy, lack.reason) == ("", "ALBEDO.R/G/B is there, but no layer of light takes it")


def test_an_image_in_another_file_is_described(capsys: pytest.CaptureFixture[str]) -> None:
    told = ask(capsys, "inspect", FOREIGN / "luxcore" / "RGB.exr", "--map", "color=DIRECT_GLOSSY", code=2)
    assert "LuxCoreRender, 48x36 pixels, samples unknown" in told
    assert "Expected quality: none. The file is refused: see below." in told
    assert "image DIRECT_GLOSSY.R/G/B: expected one in 'RGB.exr'" in " ".join(told.split())
    assert "lobewise denoise" not in told


def test_no_result_goes_into_another_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    source, clean = FOREIGN / "luxcore" / "RGB.exr", tmp_path / "a.exr"
    assert run(["denoise", str(source), "--map", "color=DIRECT_GLOSSY", "-o", str(clean)]) == 2
    assert capsys.readouterr().err == (
        "lobewise: image DIRECT_GLOSSY.R/G/B: expected one in 'RGB.exr', of which a copy is written, got one in "
        "another file beside it; give that file, or put all passes into one file.\n"
    )
    found = import_file(source, mapping={"color": "DIRECT_GLOSSY"})
    with refuses(InputError, "image DIRECT_GLOSSY.R/G/B"):
        write_result(clean, denoise(found.frame, quality="fast"), source=found)
    assert not clean.exists()


@pytest.mark.parametrize("renderer", ["cycles", "lobewise"])
def test_a_result_gets_no_command(renderer: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    noisy, clean = tmp_path / "a.exr", tmp_path / "b.exr"
    if renderer == "lobewise":
        write_frame(noisy, read_frame(FOREIGN / "blender_5.2_multipart.exr"))
    else:
        write(noisy, WRITERS[renderer](make_scene()))
    assert run(["denoise", str(noisy), "-o", str(clean), "--quality", "fast"]) == 0
    capsys.readouterr()
    told = ask(capsys, "inspect", clean, code=2)
    assert "Expected quality: none. The file is refused: see below." in told
    assert told.count("Lobewise has denoised this file") == 1
    assert "lobewise denoise" not in told
    assert run(["denoise", str(clean), "-o", str(tmp_path / "c.exr")]) == 2
    assert "lobewise denoise" in ask(capsys, "inspect", noisy)


def test_whoever_names_the_noisy_image_is_believed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    noisy, clean = tmp_path / "a.exr", tmp_path / "b.exr"
    write(noisy, WRITERS["cycles"](make_scene()))
    assert run(["denoise", str(noisy), "-o", str(clean), "--quality", "fast"]) == 0
    capsys.readouterr()
    told = ask(capsys, "inspect", clean, "--map", "color=Combined")
    assert "Expected quality: best." in told
    assert "lobewise denoise" in told


def test_denoised_passes_of_light_are_not_called_switched_off(tmp_path: Path) -> None:
    path, clean = tmp_path / "a.exr", tmp_path / "b.exr"
    write_denoised(path)
    assert run(["denoise", str(path), "-o", str(clean), "--quality", "fast"]) == 0
    found = describe_file(clean)
    assert not found.refusals
    (lack,) = [lack for lack in found.lacks if lack.role == "layers"]
    assert (lack.remedy, lack.reason) == ("", "the passes of light are denoised by lobewise already")


def test_a_pass_that_cannot_be_used_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    write(path, WRITERS["cycles"](make_scene()).leave_out("Normal.Z", "Denoising Normal"))
    told = " ".join(ask(capsys, "inspect", path).split())
    assert "Unusable View Layer.001.Normal.X/Y is not used as normal: X, Y and Z are needed." in told
    assert told.count("is not used as normal") == 1
    assert "into Combined and 4 more passes of light" in told
    assert any(note.startswith("No normal that can be used: ") for note in describe_file(path).notes)


def test_an_image_alone_is_called_weak_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    OpenEXR.File({}, {name: np.ones((8, 8), "f4") for name in "RGB"}).write(str(path))
    told = " ".join(ask(capsys, "inspect", path).split())
    assert "Expected quality: weak. Of a color image alone lobewise's own filters make a weak result" in told
    assert told.count("a pass named normal, in world space") == 1
    assert "lobewise denoise" in told
    found = describe_file(path)
    assert found.alone in found.notes
    assert {lack.told for lack in found.lacks} == {""}


def test_a_known_camera_is_not_called_missing(tmp_path: Path) -> None:
    path = tmp_path / "a.exr"
    write(path, WRITERS["arnold"](make_scene()).leave_out("P", "Z"))
    (lack,) = [lack for lack in describe_file(path).lacks if lack.role == "camera"]
    assert lack.told.startswith("No positions:")
    assert lack.remedy == "the AOV P"


def test_json_holds_what_the_summary_says(capsys: pytest.CaptureFixture[str], exr_folder: Path) -> None:
    found = json.loads(ask(capsys, "inspect", "--json", exr_folder / "arnold_multichannel.exr"))
    assert found["version"] == "Arnold 5.1.0.0"
    assert [lack["role"] for lack in found["lacks"]] == list(COSTS)
    assert found["outputs"] == ["R/G/B"]
    assert found["parts"][0]["channels"]


def test_a_file_that_denoise_refuses(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    channels = ("R", "G", "B", "normal.X")
    OpenEXR.File({"lobewise/schema": 1}, {name: np.ones((4, 4), "f4") for name in channels}).write(str(path))
    out = ask(capsys, "inspect", path, code=2)
    assert "Expected quality: none. The file is refused: see below." in out
    assert "lobewise denoise" not in out
    assert run(["denoise", str(path), "-o", str(tmp_path / "b.exr")]) == 2


def write_sparsely(path: Path) -> None:
    light = Radiance(np.ones((8, 8, 3)))
    write_sparse_frame(path, make_sparse(Frame(light, GBuffer(normal=np.ones((8, 8, 3)))), 2))


def write_damaged(path: Path) -> None:
    write_frame(path, Frame(Radiance(np.full((8, 8, 3), np.nan))))


def write_damaged_by_another(path: Path) -> None:
    OpenEXR.File({}, {name: np.full((8, 8), np.nan, "f4") for name in "RGB"}).write(str(path))


@pytest.mark.parametrize("make", [write_sparsely, write_damaged, write_damaged_by_another])
def test_inspect_ends_as_denoise_does(
    make: Callable[[Path], None], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "a.exr"
    make(path)
    assert run(["denoise", str(path), "-o", str(tmp_path / "b.exr")]) == 2
    reason = capsys.readouterr().err.partition("expected ")[2].partition(";")[0]
    assert reason in " ".join(ask(capsys, "inspect", path, code=2).split())
    found = json.loads(ask(capsys, "inspect", path, "--json", code=2))
    assert reason in found["refusals"][0]


def test_a_file_of_ours_needs_no_normals(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    write_frame(path, Frame(Radiance(np.ones((8, 8, 3)))))
    told = " ".join(ask(capsys, "inspect", path).split())
    assert "Expected quality: weak." in told
    assert "Noted" in told
    assert "Nothing tells surfaces apart but the image itself" in told
    assert run(["denoise", str(path), "-o", str(tmp_path / "b.exr"), "--quality", "fast"]) == 0


def test_a_file_without_an_image(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "a.exr"
    zeros = np.zeros((2, 2), "f4")
    OpenEXR.File({"lobewise/schema": 1}, dict.fromkeys(("normal.X", "normal.Y", "normal.Z"), zeros)).write(str(path))
    told = ask(capsys, "inspect", path, code=2)
    assert "Expected quality: none." in told
    assert "lobewise denoise" not in told
