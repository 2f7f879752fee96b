"""The extension for Blender: its process, and in Blender's module for Python the extension as users install it."""

import importlib.util
import io
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import OpenEXR
import pytest

import lobewise
from lobewise.cli.program import run
from lobewise.interchange import import_file
from releasing.blender import RELEASES, build_extension, list_systems
from tests.pythons import choose_python, run_without_paths

ROOT = Path(__file__).parents[2]
EXTENSIONS = ROOT / "extensions"
FOREIGN = ROOT / "tests" / "data" / "foreign" / "blender_4.5_seed1.exr"
SAME = {"rtol": 1e-4, "atol": 1e-5}
"""Blender and this environment have other versions of NumPy."""


@pytest.fixture(scope="module")
def process() -> Any:
    """Return the module of the extension that imports nothing of Blender."""
    spec = importlib.util.spec_from_file_location("process", EXTENSIONS / "blender" / "process.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def read_channels(path: Path) -> dict[str, np.ndarray]:
    """Return every channel of a file of Blender, in which names tell parts apart."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return {name: channel.pixels for part in file.parts for name, channel in part.channels.items()}


def require_same(ours: Path, theirs: Path) -> None:
    """Fail unless two files have the same channels and nearly the same pixels."""
    one, other = read_channels(ours), read_channels(theirs)
    assert one.keys() == other.keys()
    for name, pixels in one.items():
        np.testing.assert_allclose(pixels, other[name], **SAME, err_msg=name)


@pytest.mark.parametrize(
    ("first", "far", "pattern"),
    [
        ("/out/0001.exr", "/out/999999.exr", "/out/####.exr"),
        ("/out/take100_0001_v2.exr", "/out/take100_999999_v2.exr", "/out/take100_####_v2.exr"),
        ("/out/shot100001.exr", "/out/shot10999999.exr", "/out/shot10####.exr"),
        ("/out/1.exr", "/out/999999.exr", "/out/#.exr"),
        ("/out/00000001.exr", "/out/00999999.exr", "/out/00######.exr"),
    ],
)
def test_the_pattern_of_an_animation(first: str, far: str, pattern: str, process: Any) -> None:
    assert process.name_pattern(first, far) == pattern


@pytest.mark.parametrize("passes", ["REPLACE", "BESIDE", "ONLY"])
def test_settings_are_options_of_the_command(passes: str, process: Any, tmp_path: Path) -> None:
    options = process.list_options(quality="FAST", passes=passes, window=0, light_groups=True, all_layers=True)
    assert run(["denoise", str(FOREIGN), "-o", str(tmp_path / "clean.exr"), *options]) == 0
    before, after = read_channels(FOREIGN), read_channels(tmp_path / "clean.exr")
    kept = {name for name, pixels in before.items() if np.array_equal(after.get(name), pixels)}
    assert ("ViewLayer.Combined.R" in kept) == (passes == "BESIDE")
    assert ("ViewLayer.Normal.X" in kept) == (passes != "ONLY")


def test_options_of_sequences_and_light_groups(process: Any) -> None:
    options = process.list_options(quality="AUTO", passes="REPLACE", window=2, light_groups=False, all_layers=False)
    assert options == ["--quality", "auto", "--no-light-groups", "--window", "2"]


def test_a_file_is_denoised_by_the_command(process: Any, tmp_path: Path) -> None:
    source = tmp_path / "take[1]" / "shot.exr"
    source.parent.mkdir()
    source.write_bytes(FOREIGN.read_bytes())
    work = process.Denoising(source, process.name_output(source), ["--quality", "fast"])
    work.wait()
    is_done, messages = work.take_messages()
    assert is_done, messages
    assert messages
    assert run(["denoise", str(source), "-o", str(tmp_path / "ours.exr"), "--quality", "fast"]) == 0
    require_same(tmp_path / "ours.exr", source.parent / "clean" / "shot.exr")


def test_a_refused_file_is_told_in_the_words_of_the_command(process: Any, tmp_path: Path) -> None:
    work = process.Denoising(tmp_path / "none.exr", tmp_path / "clean" / "none.exr", [])
    work.wait()
    is_done, messages = work.take_messages()
    assert not is_done
    assert messages[-1].startswith("input ")
    assert "none.exr" in messages[-1]


@pytest.fixture
def sequence(tmp_path: Path, full_frame: lobewise.Frame) -> Path:
    """Return the pattern of a sequence of many frames."""
    lobewise.write_frame(tmp_path / "in.0001.exr", full_frame)
    for number in range(2, 400):
        os.link(tmp_path / "in.0001.exr", tmp_path / f"in.{number:04}.exr")
    return tmp_path / "in.####.exr"


def test_progress_and_cancelling(process: Any, sequence: Path) -> None:
    output = process.name_output(sequence)
    # A shell that runs tests in the background ignores interrupts, and children inherit this.
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    work = process.Denoising(sequence, output, ["--quality", "fast", "--offline"])
    signal.signal(signal.SIGINT, before)
    end = time.monotonic() + 60.0
    while work.describe()[1] == 0.0:
        assert not work.is_done(), work.take_messages()
        assert time.monotonic() < end
        time.sleep(0.02)
    words, share = work.describe()
    done = int(words.split()[0])
    assert words.startswith(f"{done} of 399 frames, filtering, ")
    assert share == pytest.approx(done / 399, abs=0.05)
    work.cancel()
    assert work.is_cancelled
    assert work.is_done()
    written = process.list_frames(output)
    assert done <= len(written) < 399
    assert not [path for path in output.parent.iterdir() if path.suffix == ".part"]
    is_done, messages = work.take_messages()
    assert not is_done
    assert messages[-1].startswith("interrupted")


def test_a_file_tells_its_share_and_whatever_python_says_is_a_message(
    process: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    lines = (
        b'{"stage": "filtering", "share": 0.25, "frames": 1, "done": 0, "seconds_left": 7.2}\n{"note": "Hm."}\nbad\n1\n'
    )
    made = SimpleNamespace(returncode=1, stderr=io.BytesIO(lines))
    monkeypatch.setattr(process.subprocess, "Popen", lambda *_, **__: made)
    work = process.Denoising(FOREIGN, tmp_path / "clean.exr", [])
    assert work.take_messages() == (False, ["Hm.", "bad", "1"])
    assert work.describe() == ("filtering, 25 %, 7 s left", 0.25)


def test_a_missing_package_is_named(process: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(process.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(FileNotFoundError, match="lobewise is missing: install the extension's file for this system"):
        process.locate_package()


SMALL_SCENE = """
import json
import shutil
import sys
from pathlib import Path

import bpy

bpy.ops.wm.read_factory_settings()
scene, layer = bpy.context.scene, bpy.context.view_layer
output = scene.render.image_settings
scene.render.engine = "CYCLES"
scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
scene.cycles.use_animated_seed = True
scene.cycles.samples = 4
scene.render.resolution_x, scene.render.resolution_y = 48, 27
scene.render.resolution_percentage = 100
bpy.ops.mesh.primitive_plane_add(size=20, location=(0, 0, -1))
bpy.data.objects["Light"].data.shadow_soft_size = 3


def choose_multilayer():
    if hasattr(output, "media_type"):
        output.media_type = "MULTI_LAYER_IMAGE"
    output.file_format, output.color_depth, output.exr_codec = "OPEN_EXR_MULTILAYER", "32", "ZIP"
"""
SWITCH_ON = (
    SMALL_SCENE
    + """
sys.path.insert(0, sys.argv[1])
import blender

blender.register()
scene.render.film_transparent = sys.argv[3] == "transparent"
for _ in range(2):
    bpy.ops.lobewise.switch_on_passes(roughness=True)
choose_multilayer()
scene.render.filepath = sys.argv[2]
bpy.ops.render.render(write_still=True)
assert layer.cycles.denoising_store_passes
assert len(layer.aovs) == (bpy.app.version < (5, 2, 0))
blender.unregister()
assert not hasattr(bpy.types.Scene, "lobewise")
"""
)
USE_INSTALLED = (
    SMALL_SCENE
    + """
bpy.ops.extensions.package_install_files(repo="user_default", filepath=sys.argv[1], enable_on_install=True)
folder = Path(sys.argv[2])
told = {"module": sys.modules[bpy.types.Scene.lobewise.keywords["type"].__module__].__file__}


def describe_output():
    return [output.file_format, output.color_depth, output.color_mode, output.exr_codec]


def denoise(**changes):
    # An operator that reports an error raises it.
    try:
        return sorted(bpy.ops.lobewise.denoise(**changes))
    except RuntimeError as problem:
        return str(problem)


told["without render"] = denoise()
layer.lightgroups.add().name = "lamp"
bpy.data.objects["Light"].lightgroup = "lamp"
bpy.ops.lobewise.switch_on_passes(roughness=True)
bpy.ops.render.render()
told["output before"] = describe_output()
told["render"] = denoise()
told["output after"] = describe_output()
(clean,) = (image for image in bpy.data.images if image.filepath)
shutil.copy(clean.filepath, folder / "clean_render.exr")
clean_folder = Path(clean.filepath).parent
told["left of the render"] = [path.name for path in Path(clean.filepath).parents[1].iterdir()]
told["without multilayer"] = denoise(animation=True)
choose_multilayer()
bpy.data.images["Render Result"].save_render(str(folder / "noisy.exr"))
told["file"] = denoise(filepath=str(folder / "noisy.exr"))
told["no file"] = denoise(filepath=str(folder / "none.exr"))
scene.render.filepath = str(folder / "shot_")
scene.frame_start, scene.frame_end = 1, 2
told["without frames"] = denoise(animation=True)
scene.lobewise.window, scene.lobewise.passes = 1, "BESIDE"
scene.view_layers.new("Second")
for each in scene.view_layers:
    with bpy.context.temp_override(view_layer=each):
        bpy.ops.lobewise.switch_on_passes()
told["vector"] = layer.use_pass_vector
bpy.ops.render.render(animation=True)
told["animation"] = denoise(animation=True)
scene.render.use_multiview = True
told["eyes"] = [output.views_format, denoise(animation=True)]
bpy.ops.render.render()
told["stereo"] = denoise()
told["views after"] = output.views_format
(stereo,) = (image for image in bpy.data.images if image.filepath and Path(image.filepath).parent == clean_folder)
shutil.copy(stereo.filepath, folder / "clean_stereo.exr")
told["left of the eyes"] = [path.name for path in clean_folder.parent.iterdir()]
told["images"] = {Path(image.filepath).name: image.source for image in bpy.data.images if image.filepath}
(folder / "told.json").write_text(json.dumps(told))
"""
)


@pytest.mark.parametrize("film", ["opaque", "transparent"])
def test_the_button_switches_on_what_lobewise_reads(film: str, tmp_path: Path) -> None:
    path = tmp_path / "shot.exr"
    run_without_paths([choose_python("bpy"), "-c", SWITCH_ON, str(EXTENSIONS), str(path), film])
    found = import_file(path, light_passes=True)
    assert found.preset == "cycles"
    assert [note for note in found.notes if note.startswith("No ") or "more light than the image" in note] == []
    assert found.frame.camera is not None
    assert found.frame.gbuffer.alpha_u is not None
    assert {layer.name for layer in found.frame.layers} >= {"diffuse", "glossy"}
    assert all(layer.parts for layer in found.frame.layers)


@pytest.fixture(scope="module")
def used(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Return the folder in which an installed extension worked, and what its operators said."""
    python, folder = choose_python("bpy"), tmp_path_factory.mktemp("used")
    asked = subprocess.run([python, "-c", "import sys; print(sys.version_info.minor)"], capture_output=True, check=True)
    command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation", "-w", str(folder)]
    subprocess.run([*command, str(ROOT)], check=True)
    (wheel,) = folder.glob("*.whl")
    (system,) = list_systems(wheel)
    (release,) = (each for each in RELEASES if each.minor == int(asked.stdout))
    extension = build_extension(wheel, system, release, folder)
    names = {"BLENDER_USER_RESOURCES": str(folder / "user"), "TMPDIR": str(folder)}
    run_without_paths([python, "-c", USE_INSTALLED, str(extension), str(folder)], **names)
    return folder, json.loads((folder / "told.json").read_text())


def test_the_extension_is_installed(used: tuple[Path, dict[str, Any]]) -> None:
    folder, told = used
    assert Path(told["module"]).is_relative_to(folder / "user")


def test_the_render_result_is_denoised_as_by_the_command(used: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    folder, told = used
    assert told["render"] == told["file"] == ["FINISHED"]
    assert told["output before"] == told["output after"]
    assert told["output before"][0] == "PNG"
    assert told["left of the render"] == ["clean"]
    ours = tmp_path / "ours.exr"
    assert run(["denoise", str(folder / "noisy.exr"), "-o", str(ours), "--also", "Combined_*"]) == 0
    require_same(ours, folder / "clean" / "noisy.exr")
    require_same(ours, folder / "clean_render.exr")
    noisy = read_channels(folder / "noisy.exr")
    changed = {name for name, pixels in read_channels(ours).items() if not np.array_equal(pixels, noisy[name])}
    assert changed >= {"ViewLayer.Combined.R", "ViewLayer.Combined_lamp.R"}
    assert changed & {"ViewLayer.DiffDir.R", "ViewLayer.Diffuse Direct.R"}


def test_an_animation_is_denoised_as_by_the_command(used: tuple[Path, dict[str, Any]], tmp_path: Path) -> None:
    folder, told = used
    assert told["vector"] is True
    assert told["animation"] == ["FINISHED"]
    assert told["images"]["shot_0001.exr"] == "SEQUENCE"
    options = ["--window", "1", "--suffix", "_clean", "--also", "Combined_*", "--all-layers"]
    assert run(["denoise", str(folder / "shot_####.exr"), "-o", str(tmp_path / "ours_####.exr"), *options]) == 0
    for number in (1, 2):
        require_same(tmp_path / f"ours_{number:04}.exr", folder / "clean" / f"shot_{number:04}.exr")
    assert {"ViewLayer.Combined_clean.R", "Second.Combined_clean.R"} <= read_channels(tmp_path / "ours_0001.exr").keys()


def test_both_eyes_of_a_stereo_render_are_denoised(used: tuple[Path, dict[str, Any]]) -> None:
    folder, told = used
    assert told["eyes"][0] == told["views after"] == "INDIVIDUAL"
    assert "a file for each eye: choose Multi-View as Views Format" in told["eyes"][1]
    assert told["stereo"] == ["FINISHED"]
    assert told["left of the eyes"] == ["clean"]
    names = {name.replace("right", "left") for name in read_channels(folder / "clean_stereo.exr") if "right" in name}
    assert names
    assert names <= read_channels(folder / "clean_stereo.exr").keys()


def test_operators_say_what_is_missing(used: tuple[Path, dict[str, Any]]) -> None:
    _, told = used
    for what, words in {
        "without render": "render an image first.",
        "without multilayer": "The output is no multilayer EXR: choose that in the tab Output",
        "without frames": "shot_####.exr: render the animation first.",
        "no file": "none.exr",
    }.items():
        assert words in told[what], what
