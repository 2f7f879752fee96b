"""Exported upsampling: C++ agrees with Python for sparse frames, alone and over time."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.cli.main import run
from lobewise.errors import InputError
from lobewise.exporting.pipeline.sample import FRAMES, get_place, make_sparse, prepare_frame
from lobewise.exporting.pipeline.scene import HEIGHT, WIDTH, make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from tests.exporting.pipelines import export, run_example


@pytest.mark.nightly
@pytest.mark.parametrize(
    "settings",
    [{"upsample": 2}, {"upsample": 3, "history": True, "hit_distance": True}],
    ids=["alone", "over time"],
)
def test_cpp_agrees_with_python(settings: dict[str, Any], compiler: str, cpp: str, tmp_path: Path) -> None:
    folder = export(tmp_path / "out", radius=2, **settings)
    assert max(run_example(folder, cpp)) <= 1e-5
    images = np.fromfile(folder / "output.raw", np.float32).reshape(FRAMES, HEIGHT, WIDTH, 3)
    assert (images.std(axis=(1, 2, 3)) > 0.05).all()
    told = json.loads((folder / "lobewise-export.json").read_text())
    shapes = {each["name"]: each["shape"] for each in told["inputs"]}
    assert shapes["diffuse"] == ["rows", "columns", 3]
    assert shapes["normal"] == ["height", "width", 3]


def test_every_frame_shades_another_pixel() -> None:
    settings = PipelineSettings(upsample=3)
    frames = [make_sparse(settings, prepare_frame(settings, make_frame(k)), k) for k in range(FRAMES)]
    assert len({get_place(frame) for frame in frames}) >= 3


def test_radius_counts_samples(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", "pipeline", "--upsample", "4", "--list"]) == 0
    assert "upsampling kernel, 11x11 samples, 4 pixels apart" in capsys.readouterr().out


@pytest.mark.parametrize("changes", [{"layers": "color"}, {"form": "separable"}])
def test_what_upsampling_lacks_is_refused(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="what a pipeline can contain"):
        PipelineSettings(upsample=2, **changes)
