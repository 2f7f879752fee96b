"""Frames of other renderers: errors without the reference's noise, passes of files, live renders."""

from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.metrics import rel_mse
from tests.pythons import choose_python, run_without_paths

files: Any = None
judging: Any = None

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
    globals().update({name: import_module(f"benchmarks.foreign.{name}") for name in ("files", "judging")})


def get_renderer(name: str) -> Any:
    return next(renderer for renderer in files.RENDERERS if renderer.name == name)


def render_luxcore(folder: Path, scene: str, *more: str) -> None:
    script = ROOT / "benchmarks" / "foreign" / "render_luxcore.py"
    options = ["--spp", "8", "--seeds", "1", "--reference", "0", "--size", "48x36", *more]
    run_without_paths([choose_python("pyluxcore"), str(script), str(folder), "--scenes", scene, *options])


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
def test_guides_come_from_every_layout(name: str) -> None:
    renderer, path = get_renderer(name), FILES[name]
    albedo, normal = (renderer.read_guide(path, index) for index in (0, 1))
    assert albedo.shape == normal.shape
    assert 0.05 < albedo.mean() < 1.0
    lengths = np.linalg.norm(normal, axis=-1)
    assert 0.9 < np.median(lengths) < 1.01
    with pytest.raises(KeyError):
        files.read_pass(path, "Nothing", "XYZ")


def test_luxcore_still_writes_what_is_kept(tmp_path: Path) -> None:
    render_luxcore(tmp_path, "room")
    fresh, kept = tmp_path / "room_8_1", FILES["luxcore"].parent
    assert {path.name for path in fresh.iterdir()} == {path.name for path in kept.iterdir()}
    for name in ("RGB", "POSITION", "SHADING_NORMAL", "ALBEDO"):
        np.testing.assert_allclose(
            np.median(files.read_pass(fresh / f"{name}.exr", "", "RGB"), axis=(0, 1)),
            np.median(files.read_pass(kept / f"{name}.exr", "", "RGB"), axis=(0, 1)),
            rtol=0.1,
            atol=0.02,
        )


def test_luxcore_leaves_out_what_is_not_asked_for(tmp_path: Path) -> None:
    render_luxcore(tmp_path, "sparks", "--without", "SHADING_NORMAL,ALPHA")
    written = {path.stem for path in (tmp_path / "sparks_8_1").iterdir()}
    assert "AVG_SHADING_NORMAL" in written
    assert not written & {"SHADING_NORMAL", "ALPHA"}
    image = files.read_pass(tmp_path / "sparks_8_1" / "RGB.exr", "", "RGB").mean(axis=-1)
    # Light of small lamps through glass is found by chance alone.
    assert image.max() > 300.0 * np.median(image)
