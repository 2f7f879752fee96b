"""`lobewise.denoise_files` does from Python what the command does: the same bytes, remarks and refusals."""

import shutil
from pathlib import Path
from typing import Any

import pytest

import lobewise
from lobewise.cli.program import run
from lobewise.errors import CancelledError, FileError, InputError
from tests.mistakes import refuses
from tests.streaming.frames import make_scene

FOREIGN = Path(__file__).parents[1] / "data" / "foreign" / "blender_4.5_seed1.exr"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return the current folder, with three frames and a file of Blender."""
    monkeypatch.chdir(tmp_path)
    for number in (1, 2, 3):
        lobewise.write_frame(f"in.{number}.exr", make_scene((24, 32), seed=number))
        lobewise.write_frame(f"half.{number}.exr", make_scene((24, 32), seed=10 + number))
    shutil.copy(FOREIGN, "shot.exr")
    return tmp_path


@pytest.mark.parametrize(
    ("source", "words", "changes"),
    [
        ("in.#.exr", ["--window", "1"], {"window": 1}),
        ("in.#.exr", ["--temporal", "--half", "half.#.exr"], {"window": 2, "past_only": True, "half": "half.#.exr"}),
        ("in.1.exr", ["--bands", "8"], {"bands": 8}),
        ("shot.exr", ["--suffix", "_clean", "--confidence"], {"suffix": "_clean", "confidence": True}),
    ],
)
def test_the_files_are_those_of_the_command(
    source: str, words: list[str], changes: dict[str, Any], folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    output = "c" + source
    assert run(["denoise", source, "-o", output, "--quality", "fast", *words, "--progress", "off"]) == 0
    notes = "".join(capsys.readouterr().err.split())
    remarks: list[str] = []
    report = lobewise.denoise_files(source, "p" + source, quality="fast", **changes, remark=remarks.append)
    files = sorted(path.name for path in folder.glob("c*.exr"))
    assert len(files) == report.frames == report.written
    for name in files:
        assert (folder / name).read_bytes() == (folder / f"p{name[1:]}").read_bytes()
    # The terminal breaks lines.
    assert notes == "".join("".join(each.split()) for each in remarks)
    assert report.last is not None
    assert report.last.settings["quality"] == "fast"


def test_a_sequence_that_was_cancelled_goes_on(folder: Path) -> None:
    Path("in.4.exr").write_bytes(Path("in.3.exr").read_bytes())
    Path("in.3.exr").unlink()
    remarks: list[str] = []
    request = lobewise.FileRequest(settings=lobewise.DenoiseSettings(quality="fast"))
    with pytest.raises(CancelledError):
        lobewise.denoise_files("in.#.exr", "out.#.exr", request, progress=lambda record: record.done < 2)
    report = lobewise.denoise_files("in.#.exr", "out.#.exr", request, remark=remarks.append)
    assert remarks[0] == "Frame 3 of 1 to 4 is missing."
    assert remarks[1].startswith("Going on: 2 of 3 frames are done")
    assert (report.frames, report.written) == (3, 1)
    assert report.last is not None
    assert report.last.describe()["width"] == 32


MISTAKES: list[tuple[str, str, dict[str, Any], tuple[str, ...]]] = [
    ("in.1.exr", "in.1.exr", {}, ("output 'in.1.exr'",)),
    ("in.1.exr", "out.#.exr", {}, ("source and output",)),
    ("in.1.exr", "out.exr", {"window": 1}, ("window", "'in.1.exr'")),
    ("in.1.exr", "out.exr", {"numbers": [1]}, ("numbers",)),
    ("in.#.exr", "out.#.exr", {"window": 99}, ("window", "99")),
    ("in.1.exr", "out.exr", {"qualitee": "fast"}, ("setting", "'qualitee'")),
    ("in.1.exr", "out.exr", {"lightgroups": False}, ("setting", "'lightgroups'")),
    ("in.1.exr", "out.exr", {"also": "AO"}, ("also",)),
    ("in.1.exr", "out.exr", {"bands": 8, "only": True}, ("bands",)),
    ("in.1.exr", "out.exr", {"half": "in.#.exr"}, ("half",)),
    ("in.1.exr", "out.jpg", {}, ("output",)),
]


@pytest.mark.parametrize(("source", "output", "changes", "refused"), MISTAKES)
def test_mistakes(source: str, output: str, changes: dict[str, Any], refused: tuple[str, ...], folder: Path) -> None:
    before = sorted(folder.iterdir())
    with refuses((InputError, FileError), *refused):
        lobewise.denoise_files(source, output, **changes)
    assert sorted(folder.iterdir()) == before


def test_images_that_no_setting_would_use_are_not_named(folder: Path) -> None:
    told: dict[str, str] = {}
    for similarity in ("ggx", "normal"):
        remarks: list[str] = []
        changes = {"quality": "fast", "similarity": similarity}
        report = lobewise.denoise_files("shot.exr", f"{similarity}.exr", remark=remarks.append, **changes)
        assert "motion" in report.last.results[0].unused
        told[similarity] = " ".join(note for note in remarks if note.startswith("Not used"))
    assert "alpha_u" in told["normal"]
    assert "alpha_u" not in told["ggx"]
    assert "motion" not in told["normal"]
