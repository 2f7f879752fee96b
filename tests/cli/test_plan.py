"""``lobewise inspect --plan``: what denoising will do with a file, before it does it."""

from __future__ import annotations

from pathlib import Path

import pytest

from lobewise.cli.main import run
from lobewise.frame import Frame
from lobewise.io import write_frame


@pytest.fixture
def frame_file(full_frame: Frame, tmp_path: Path) -> Path:
    """Return a file that holds a frame."""
    path = tmp_path / "frame.exr"
    write_frame(path, full_frame)
    return path


@pytest.mark.parametrize("quality", ["fast", "balanced", "high"])
def test_it_prints_the_steps_of_the_quality(quality: str, frame_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["inspect", str(frame_file), "--plan", "--quality", quality, "--radius", "4"]) == 0
    printed = capsys.readouterr().out
    assert f"quality {quality}" in printed
    assert printed.splitlines()[1] == "1. filter every layer by its plan"
    steps = {"fast": "full kernel, 9x9 pixels", "balanced": "light 3", "high": "mixture of 13 images"}
    assert {name: step in printed for name, step in steps.items()} == {name: name == quality for name in steps}
    assert "Memory: about" in printed
    assert "Time: about" in printed


@pytest.mark.parametrize(
    ("words", "told"),
    [
        (["--quality", "high"], "--quality: expected --plan beside it"),
        (["--plan", "--json"], "--plan: expected no --json"),
        (["--plan", "--radius", "900"], "radius"),
    ],
)
def test_what_does_not_fit_is_refused(
    words: list[str], told: str, frame_file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(["inspect", str(frame_file), *words]) == 2
    assert told in capsys.readouterr().err
