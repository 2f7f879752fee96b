"""The option `--frames`: which frames of a sequence are filtered, and what runs of other frames leave alone."""

from pathlib import Path

import pytest

from lobewise.cli.options.frames import parse_frames
from lobewise.cli.program import run
from lobewise.errors import InputError
from lobewise.io import write_frame
from lobewise.recipes.ledger import name_ledger
from tests.mistakes import refuses
from tests.streaming.frames import make_scene

CHEAP = ("--quality", "fast", "--similarity", "normal")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with the frames 1 to 4 and 6 of a sequence, and make it the current one."""
    monkeypatch.chdir(tmp_path)
    for number in (1, 2, 3, 4, 6):
        write_frame(f"in.{number}.exr", make_scene((16, 16), seed=number))
    return tmp_path


def denoise(*options: str) -> int:
    return run(["denoise", "in.#.exr", "-o", "out.#.exr", *CHEAP, *options])


def list_written(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir() if not path.name.startswith("in."))


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("7", [7]),
        ("0", [0]),
        ("1001-1004", [1001, 1002, 1003, 1004]),
        ("1-9x4", [1, 5, 9]),
        ("1-8x4", [1, 5]),
        ("5-5", [5]),
        ("10-12, 1,5,11-13", [1, 5, 10, 11, 12, 13]),
        ("0001-0003", [1, 2, 3]),
        ("3-", [4, 6]),
        ("2-x2", [2, 4, 6]),
        ("1,5-", [1, 6]),
    ],
)
def test_texts_that_name_frames(text: str, numbers: list[int]) -> None:
    assert parse_frames(text, lambda: [1, 2, 4, 6]) == numbers


@pytest.mark.parametrize(
    "text",
    [
        *("", " ", "#", "1,", "7-", "-1", "-5-5", "10-1", "1-10x0", "1-10x-2", "1.5", "1-5x0.5"),
        *("1-9y2", "1-9:2", "1 2", "٤", "1-1000001", "1-600000,1-600000", "9999999999"),
    ],
)
def test_texts_that_name_none(text: str) -> None:
    with refuses(InputError, "--frames", repr(text)):
        parse_frames(text, lambda: [1, 2])


def test_only_the_frames_that_are_asked_for_are_written(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert denoise("--frames", "1-3x2,6", "--png", "--exposure", "0") == 0
    assert list_written(folder) == [f"out.{number}.{ending}" for number in (1, 3, 6) for ending in ("exr", "png")]
    told = capsys.readouterr()
    assert "3 of 3 frames" in told.out
    assert "missing" not in told.err


def test_files_of_other_frames_do_not_matter(folder: Path) -> None:
    (folder / "out.1.png").mkdir()
    assert denoise("--frames", "2", "--png", "--exposure", "0") == 0


def test_records_of_other_runs_are_kept(folder: Path) -> None:
    others = [name_ledger(folder / "out.#.exr", numbers) for numbers in (None, [3, 4])]
    own = name_ledger(folder / "out.#.exr", [1, 2])
    for records in (*others, own):
        records.mkdir()
        (records / "1.json").write_text("{}")
    assert denoise("--frames", "1-2") == 0
    assert [(records / "1.json").exists() for records in others] == [True, True]
    assert not own.exists()
    # Records of another program are none of this one.
    assert denoise() == 0
    assert [records.exists() for records in others] == [False, True]
