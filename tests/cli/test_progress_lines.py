"""``--progress json``: every line on standard error is an object that programs read."""

import json
import shutil
from pathlib import Path
from typing import Any

import pytest

import lobewise
from lobewise.cli.program import run
from tests.streaming.frames import make_scene

FOREIGN = Path(__file__).parents[1] / "data" / "foreign" / "blender_4.5_seed1.exr"
CHEAP = ["--quality", "fast", "--progress", "json"]


def read_lines(text: str) -> list[dict[str, Any]]:
    """Return the objects of all lines; fail if one is not an object, or a share falls."""
    lines = [json.loads(line) for line in text.splitlines()]
    shares = [line["share"] for line in lines if "share" in line]
    assert shares == sorted(shares)
    return lines


def test_a_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    output = tmp_path / "out.exr"
    assert run(["denoise", str(FOREIGN), "-o", str(output), *CHEAP]) == 0
    streams = capsys.readouterr()
    lines = read_lines(streams.err)
    assert streams.out.startswith(f"Wrote {output}")
    told, notes, last = lines[:-1], [line["note"] for line in lines if "note" in line], lines[-1]
    assert list(dict.fromkeys(line["stage"] for line in told if "stage" in line)) == ["reading", "filtering", "writing"]
    assert {line["frame"] for line in told if "stage" in line} == {FOREIGN.name}
    assert any(note.startswith("Read as Blender Cycles") for note in notes)
    result = lobewise.denoise(lobewise.read_frame(FOREIGN), quality="fast")
    facts = json.loads(json.dumps(result.describe()))
    assert last == {
        "stage": "done",
        "share": 1.0,
        "output": str(output),
        "frames": 1,
        "written": 1,
        **facts,
        "seconds": last["seconds"],
        "notes": last["notes"],
        "stage_seconds": last["stage_seconds"],
    }
    assert list(last["stage_seconds"]) == ["reading", "filtering", "writing"]
    assert min(last["stage_seconds"].values()) > 0.0
    assert (facts["width"], facts["height"], facts["settings"]["quality"]) == (64, 48, "fast")


def test_bands_and_upsampling(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    lobewise.write_frame(tmp_path / "in.exr", make_scene((83, 19)))
    for words, source in ((["denoise", "--bands", "40"], tmp_path / "in.exr"), (["upsample", "--scale", "2"], FOREIGN)):
        command = [*words, str(source), "-o", str(tmp_path / "out.exr"), "--overwrite", "--progress", "json"]
        assert run(command) == 0
        lines = read_lines(capsys.readouterr().err)
        assert lines[-1]["stage"] == "done"
        assert (lines[-1]["width"], lines[-1]["height"]) == ((19, 83) if source != FOREIGN else (64, 48))


@pytest.mark.parametrize("more", [[], ["--workers", "1"]], ids=["here", "farm"])
def test_a_sequence(more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for number in (1, 2, 3):
        shutil.copy(FOREIGN, tmp_path / f"in.{number}.exr")
    names = [str(tmp_path / "in.#.exr"), "-o", str(tmp_path / "out.#.exr")]
    assert run(["denoise", *names, *CHEAP, *more]) == 0
    lines = read_lines(capsys.readouterr().err)
    assert {line["frames"] for line in lines if "share" in line} == {3}
    assert {line["done"] for line in lines if "done" in line} >= {0, 1, 2}
    if not more:
        assert {line.get("detail") for line in lines} >= {"reading", "writing", "filter every layer by its guides"}
    assert (lines[-1]["stage"], lines[-1]["written"]) == ("done", 3)


def test_mistakes_are_lines_as_well(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run(["denoise", str(tmp_path / "none.exr"), "-o", str(tmp_path / "out.exr"), *CHEAP]) == 2
    *_, line = read_lines(capsys.readouterr().err)
    assert "none.exr" in line["error"]
    # The next command line writes sentences again.
    assert run(["denoise", str(FOREIGN), "-o", str(tmp_path / "out.exr"), "--progress", "jsno"]) == 2
    told = "lobewise: --progress: expected one of auto, json, off, got 'jsno'; did you mean 'json'?"
    assert capsys.readouterr().err.startswith(told)
