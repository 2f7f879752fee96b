"""Exported upsampling: C++ agrees with Python for sparse frames, alone and over time."""

from typing import Any

import pytest

from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.exporting.pipeline.sample import FRAMES, get_place, make_sparse, prepare_frame
from lobewise.exporting.pipeline.scene import make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from tests.mistakes import refuses


def test_every_frame_shades_another_pixel() -> None:
    settings = PipelineSettings(upsample=3)
    frames = [make_sparse(settings, prepare_frame(settings, make_frame(k)), k) for k in range(FRAMES)]
    assert len({get_place(frame) for frame in frames}) >= 3


def test_radius_counts_samples(capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["export", "pipeline", "--upsample", "4", "--list"]) == 0
    assert "upsampling kernel, 11x11 samples, 4 pixels apart" in capsys.readouterr().out


@pytest.mark.parametrize("changes", [{"layers": "color"}, {"form": "separable"}])
def test_what_upsampling_lacks_is_refused(changes: dict[str, Any]) -> None:
    with refuses(InputError, next(iter(changes))):
        PipelineSettings(upsample=2, **changes)
