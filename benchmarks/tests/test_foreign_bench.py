"""The bench of other renderers' frames: errors without the reference's noise, passes of files, ratios, live renders."""

from __future__ import annotations

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.metrics import rel_mse
from tests.pythons import choose_python, run_without_paths

files: Any = None
judging: Any = None
foreign: Any = None

ROOT = Path(__file__).parents[2]
SMALL = ROOT / "tests" / "data" / "foreign"
FILES = {
    "blender": SMALL / "blender_4.5_seed1.exr",
    "blender-5.2": SMALL / "blender_5.2_multipart.exr",
    "luxcore": SMALL / "luxcore" / "RGB.exr",
}
NOISE = JUDGED = 0.04
# What noise of the denominator leaves: an error of 0.04 + 0.04^2, which squared is 8 % more.
RELATIVE = 0.1
# 40,000 products of two normal deviations of 0.04 have a mean of 0 with a deviation of 8e-6.
NOTHING = 4e-5


@pytest.fixture(scope="module", autouse=True)
def bench() -> None:
    """Import the bench, which needs Mitsuba, when a test runs and not when it is collected."""
    pytest.importorskip("mitsuba", reason="it shares the tuning of the bench of quality, which renders its frames")
    parts = {"files": "files", "judging": "judging", "foreign": "__main__"}
    globals().update({name: import_module(f"benchmarks.foreign.{part}") for name, part in parts.items()})


def get_renderer(name: str) -> Any:
    return next(renderer for renderer in files.RENDERERS if renderer.name == name)


def render(module: str, script: str, folder: Path, size: str, *more: str, scene: str = "room") -> None:
    command = [choose_python(module), str(ROOT / "benchmarks" / "foreign" / script), str(folder), "--scenes", scene]
    options = ["--spp", "8", "--seeds", "1", "--reference", "0", "--size", size, *more]
    run_without_paths([*command, *options])


def test_noise_of_the_reference_leaves_no_error() -> None:
    random = np.random.default_rng(5)
    truth = random.uniform(0.5, 2.0, (100, 133, 3))
    first, second = (truth * random.normal(1.0, NOISE, truth.shape) for _ in range(2))
    judge = judging.make_judge(first, second)
    image = truth * (1.0 + JUDGED)
    exact = rel_mse(image, truth)
    assert judge.measure(image)[0] == pytest.approx(exact, rel=RELATIVE)
    assert judge.measure(truth)[0] == pytest.approx(0.0, abs=NOTHING)
    assert judge.measure_noise() == pytest.approx(0.5 * NOISE**2, rel=0.05)
    # The plain metric counts the noise of the mean.
    assert rel_mse(image, 0.5 * (first + second)) > 1.4 * exact


def test_a_bright_dot_is_in_the_first_figure_alone() -> None:
    truth = np.ones((50, 50, 3))
    image = truth * 1.1
    image[20, 30] = 50.0
    every, trimmed = judging.make_judge(truth, truth).measure(image)
    assert trimmed == pytest.approx(rel_mse(truth * 1.1, truth), rel=2e-3)
    assert every > 10.0 * trimmed


def test_frames_are_found_where_their_reference_is(tmp_path: Path) -> None:
    for name in ("a_8_1", "a_8_2", "a_128_1", "a_reference_1", "a_reference_2", "b_8_1", "b_reference_1"):
        (tmp_path / f"{name}.exr").touch()
        (tmp_path / "apart" / name).mkdir(parents=True)
        (tmp_path / "apart" / name / "RGB.exr").touch()
    found = files.list_frames(get_renderer("blender"), tmp_path)
    assert found == {
        "a": {8: {seed: tmp_path / f"a_8_{seed}.exr" for seed in (1, 2)}, 128: {1: tmp_path / "a_128_1.exr"}}
    }
    apart = files.list_frames(get_renderer("luxcore"), tmp_path / "apart")
    assert apart["a"][8][2] == tmp_path / "apart" / "a_8_2" / "RGB.exr"
    assert set(apart) == {"a"}


@pytest.mark.parametrize("name", FILES)
def test_guides_and_lone_passes_come_from_every_layout(name: str, tmp_path: Path) -> None:
    renderer, path = get_renderer(name), FILES[name]
    albedo, normal = (renderer.read_guide(path, index) for index in (0, 1))
    assert albedo.shape == normal.shape
    assert 0.05 < albedo.mean() < 1.0
    lengths = np.linalg.norm(normal, axis=-1)
    assert 0.9 < np.median(lengths) < 1.01
    kept = renderer.keep_alone(path, tmp_path)
    written = kept.parent.glob("*.exr") if renderer.apart else [kept]
    for each in renderer.alone:
        components = "XYZ" if each == "Normal" else "RGB"
        file, owner = (kept.with_name(f"{each}.exr"), "") if renderer.apart else (kept, each)
        origin = path.with_name(f"{each}.exr") if renderer.apart else path
        np.testing.assert_array_equal(
            files.read_pass(file, owner, components), files.read_pass(origin, owner, components)
        )
    assert sum(file.stat().st_size for file in written) < 0.4 * sum(
        file.stat().st_size for file in (path.parent.glob("*.exr") if renderer.apart else [path])
    )
    with pytest.raises(KeyError):
        files.read_pass(kept, "Position", "XYZ")


def test_ratios_are_geometric_means() -> None:
    def make_row(**errors: float) -> dict[str, object]:
        names = {**dict.fromkeys((*foreign.METHODS, foreign.TUNED), 1.0), **errors}
        return {name: {kind: [value, value] for kind in foreign.KINDS} for name, value in names.items()}

    scenes = {"a": {"samples": {"8": make_row(balanced=0.5)}}, "b": {"samples": {"8": make_row(balanced=2.0)}}}
    scenes["b"]["samples"]["32"] = make_row(balanced=8.0, oidn=2.0)
    row = foreign.summarise(scenes)["rel_mse"]["balanced / oidn"]
    assert row == {"8": 1.0, "32": 4.0, "all": pytest.approx(4.0 ** (1.0 / 3.0), rel=1e-3)}


def test_blender_still_writes_what_is_kept(tmp_path: Path) -> None:
    render("bpy", "render_blender.py", tmp_path, "64x48")
    fresh, kept = tmp_path / "room_8_1.exr", FILES["blender"]
    for name, components in (("Combined", "RGBA"), ("Position", "XYZ"), ("CryptoObject00", "rgba"), ("Roughness", "X")):
        # The same seed: what differs is the version of Blender.
        np.testing.assert_allclose(
            np.median(files.read_pass(fresh, name, components), axis=(0, 1)),
            np.median(files.read_pass(kept, name, components), axis=(0, 1)),
            rtol=0.05,
            atol=0.01,
        )


def test_luxcore_still_writes_what_is_kept(tmp_path: Path) -> None:
    render("pyluxcore", "render_luxcore.py", tmp_path, "48x36")
    fresh, kept = tmp_path / "room_8_1", FILES["luxcore"].parent
    assert {path.name for path in fresh.iterdir()} == {path.name for path in kept.iterdir()}
    for name in ("RGB", "POSITION", "SHADING_NORMAL", "ALBEDO"):
        np.testing.assert_allclose(
            np.median(files.read_pass(fresh / f"{name}.exr", "", "RGB"), axis=(0, 1)),
            np.median(files.read_pass(kept / f"{name}.exr", "", "RGB"), axis=(0, 1)),
            rtol=0.1,
            atol=0.02,
        )


def test_an_artist_has_the_noisy_image_beside_the_picture_of_blender(tmp_path: Path) -> None:
    render("bpy", "render_blender.py", tmp_path, "64x36", "--passes", "artist", "--denoise", scene="product")
    path = tmp_path / "product_8_1.exr"
    clean, noisy = (files.read_pass(path, name, "RGB") for name in ("Combined", "Noisy Image"))
    rough = [np.median(np.abs(np.diff(image, n=2, axis=1))) for image in (clean, noisy)]
    assert rough[0] < 0.7 * rough[1]
    assert files.read_pass(path, "CryptoMaterial00", "rgba").shape == (36, 64, 4)
    with pytest.raises(KeyError):
        files.read_pass(path, "Roughness", "X")


def test_frames_of_a_sequence_know_their_motion(tmp_path: Path) -> None:
    render("bpy", "render_blender.py", tmp_path, "64x36", "--frames", "2", scene="moving")
    assert sorted(path.name for path in tmp_path.iterdir()) == ["moving_8_1.0001.exr", "moving_8_1.0002.exr"]
    first, second = (files.read_pass(path, "Combined", "RGB") for path in sorted(tmp_path.iterdir()))
    assert np.abs(first - second).mean() > 0.01
    # The ball flies several pixels a frame, the floor only as the camera moves.
    motion = np.abs(files.read_pass(tmp_path / "moving_8_1.0002.exr", "Vector", "XY"))
    assert motion.max() > 2.0
    assert np.median(motion) < 1.0


def test_luxcore_leaves_out_what_is_not_asked_for(tmp_path: Path) -> None:
    render("pyluxcore", "render_luxcore.py", tmp_path, "48x36", "--without", "SHADING_NORMAL,ALPHA", scene="sparks")
    written = {path.stem for path in (tmp_path / "sparks_8_1").iterdir()}
    assert "AVG_SHADING_NORMAL" in written
    assert not written & {"SHADING_NORMAL", "ALPHA"}
    image = files.read_pass(tmp_path / "sparks_8_1" / "RGB.exr", "", "RGB").mean(axis=-1)
    # Light of small lamps through glass is found by chance alone.
    assert image.max() > 300.0 * np.median(image)


def test_mitsuba_s_files_hold_what_a_person_writes(tmp_path: Path) -> None:
    render("mitsuba", "render_mitsuba.py", tmp_path, "64x36", scene="principled")
    path = tmp_path / "principled_8_1.exr"
    assert files.read_pass(path, "", "RGB").shape == (36, 64, 3)
    lengths = np.linalg.norm(files.read_pass(path, "normals", "XYZ"), axis=-1)
    assert 0.9 < np.median(lengths) < 1.01


@pytest.mark.nightly
def test_the_command_and_its_steps_are_timed_in_turn(tmp_path: Path) -> None:
    speed = import_module("benchmarks.foreign.speed")
    figures = speed.measure_file(FILES["blender"], "fast", 1)
    assert set(figures) == {"command", "filter", "read", "write", "command over filter"}
    assert all(value > 0.0 for value in figures.values())
    # A process of its own starts besides.
    assert figures["command"] > figures["filter"]
