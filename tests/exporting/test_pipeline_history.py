"""Exported histories: C++ follows Python from frame to frame, over a cut, and after a reset."""

import platform
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.exporting.pipeline.sample import FRAMES, make_settings, prepare_frame, run_recipe
from lobewise.exporting.pipeline.scene import CUT, HEIGHT, WIDTH, make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.pipeline.writing import export_pipeline
from lobewise.recipes.temporal import TemporalFilter
from tests.exporting.pipelines import LIBRARIES, STRICT, build, export, run_example

SETTINGS: dict[str, Any] = {"radius": 2, "history": True, "hit_distance": True}


@pytest.fixture(scope="module")
def history(compiler: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a pipeline with a history that follows reflections."""
    return export(tmp_path_factory.mktemp("history") / "out", **SETTINGS)


def read_images(folder: Path, name: str) -> Any:
    """Return the images of a file of an export, (frames, height, width, 3)."""
    return np.fromfile(folder / name, np.float32).reshape(-1, HEIGHT, WIDTH, 3)


def test_example_has_a_history_and_a_cut() -> None:
    settings = PipelineSettings(**SETTINGS)
    over_time = TemporalFilter(make_settings(settings))
    frames = [prepare_frame(settings, make_frame(number)) for number in range(FRAMES)]
    shares = [over_time.add(frame).settings["history_share"] for frame in frames]
    assert shares[0] == 0.0
    assert min(shares[1:CUT]) > 0.8
    assert shares[CUT] == 0.0


@pytest.mark.nightly
def test_cpp_follows_python(history: Path, cpp: str) -> None:
    assert max(run_example(history, cpp)) <= 1e-5
    made = read_images(history, "output.raw")
    settings = PipelineSettings(**SETTINGS)
    frames = [prepare_frame(settings, make_frame(number)) for number in range(FRAMES)]
    alone = [run_recipe(settings, [frame])[0] for frame in frames]
    changed = [float(np.abs(image - other).max()) for image, other in zip(made, alone, strict=True)]
    assert max(changed[0], changed[CUT]) < 1e-4
    assert min(changed[1:CUT]) > 0.05


CANCELLED = """
            int left = 3;
            pipeline.on_progress([&left](int, int) { return left-- > 0; });
            try {
                pipeline.run(camera, frame);
                return 2;
            } catch (const lobewise::Error &problem) {
                if (problem.status() != lobewise_cancelled) throw;
            }
            pipeline.on_progress(nullptr);
            pipeline.run(camera, frame);
"""


@pytest.mark.nightly
def test_a_cancelled_frame_leaves_the_history_as_it_was(history: Path, cpp: str) -> None:
    text = (history / "example.cpp").read_text()
    (history / "cancelled.cpp").write_text(text.replace("            pipeline.run(camera, frame);\n", CANCELLED))
    build(history, cpp, "-std=c++11", *STRICT, "cancelled.cpp", "liblobewise.a", "-o", "cancelled", *LIBRARIES)
    build(history, "./cancelled")


@pytest.mark.nightly
def test_a_reset_forgets_everything(history: Path, cpp: str) -> None:
    """The example with a reset before each frame gives what each frame gives alone."""
    program = (history / "example.cpp").read_text()
    assert "pipeline.run(camera, frame);" in program
    changed = program.replace("pipeline.run(camera, frame);", "pipeline.reset(); pipeline.run(camera, frame);")
    (history / "reset.cpp").write_text(changed.replace("output.raw", "reset.raw"))
    build(history, cpp, "-std=c++11", "reset.cpp", "liblobewise.a", "-o", "reset", *LIBRARIES)
    subprocess.run(["./reset"], cwd=history, capture_output=True)
    settings = PipelineSettings(**SETTINGS)
    found = read_images(history, "reset.raw")
    for number, image in enumerate(found):
        (alone,) = run_recipe(settings, [prepare_frame(settings, make_frame(number))])
        np.testing.assert_allclose(image, alone, rtol=1e-5)


@pytest.mark.nightly
@pytest.mark.skipif(platform.machine() != "x86_64" or sys.platform != "linux", reason="runs code for x86-64 Linux")
@pytest.mark.parametrize("target", ["x86-64-linux", "x86-64-linux-avx2-fma"])
def test_narrower_vectors_follow_python(target: str, compiler: str, cpp: str, tmp_path: Path) -> None:
    """Each vector width has code of its own: places that are NaN must not be found with any."""
    export_pipeline(tmp_path / "out", PipelineSettings(**SETTINGS, similarity="sg"), target=target)
    bound = 1e-5 if "fma" in target else 5e-5
    assert max(run_example(tmp_path / "out", cpp)) <= bound
