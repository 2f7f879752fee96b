"""``lobewise inspect --plan``: what denoising will do with a file, before it does it."""

from pathlib import Path

import pytest

from lobewise.cli.program import run
from lobewise.io import write_frame
from lobewise.recipes.streaming import plan
from lobewise.records.frame import Frame


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
    assert printed.splitlines()[1].startswith("1. filter ")
    assert ("full kernel, 9x9 pixels" in printed) == (quality == "fast")
    assert ("7x7 taps, lobes to the power 1" in printed) == (quality != "fast")
    assert ("refine the image" in printed) == (quality == "high")
    assert "Memory: about" in printed
    assert "Time: about" in printed
    assert "In a sequence: about" in printed


def test_a_file_in_bands_is_planned_without_open_image_denoise(
    frame_file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    assert run(["inspect", str(frame_file), "--plan"]) == 0
    whole = capsys.readouterr().out.splitlines()
    monkeypatch.setattr(plan, "MAX_WHOLE_GIB", 1e-9)
    assert run(["inspect", str(frame_file), "--plan"]) == 0
    banded = capsys.readouterr().out.splitlines()
    assert whole[0].split(",")[0] == banded[0].split(",")[0]
    assert "this one is denoised in bands" in banded[0]
    assert not any("mix in the image of Open Image Denoise" in line for line in banded)
    assert "Bands of rows take less." in banded[-2]
    assert "Bands" not in whole[-2]


def test_a_result_is_refused_as_denoise_refuses_it(
    frame_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    result = str(tmp_path / "clean.exr")
    assert run(["denoise", str(frame_file), "-o", result, "--quality", "fast"]) == 0
    capsys.readouterr()
    assert run(["denoise", result, "-o", str(tmp_path / "again.exr")]) == 2
    told = capsys.readouterr().err
    assert run(["inspect", result, "--plan"]) == 2
    assert capsys.readouterr().err == told
