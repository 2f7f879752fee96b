"""Several inputs, folders, names of our own, standard input and output, and tev."""

import io
import os
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from lobewise.cli.options.naming import expand_names, name_clean
from lobewise.cli.program import run
from lobewise.interchange import read_image
from lobewise.io import write_frame
from lobewise.recipes.files.denoiser import FileDenoiser, OpenedFile
from lobewise.recipes.files.result import FileResult
from tests.streaming.frames import make_scene

CHEAP = ("--quality", "fast", "--similarity", "normal")


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with two frames in ``in``, and make it the current one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "in").mkdir()
    for number, name in enumerate("ab"):
        write_frame(f"in/{name}.exr", make_scene((83, 19), seed=number))
    return tmp_path


def list_files(folder: Path) -> list[str]:
    return sorted(path.relative_to(folder).as_posix() for path in folder.rglob("*.exr"))


@pytest.mark.parametrize(
    ("words", "made"),
    [
        (["in/a.exr"], ["in/a_clean.exr"]),
        (["in/a.exr", "in/b.exr"], ["in/a_clean.exr", "in/b_clean.exr"]),
        (["in"], ["in_clean/a.exr", "in_clean/b.exr"]),
        (["in", "-o", "out"], ["out/a.exr", "out/b.exr"]),
        (["in/a.exr", "-o", "out/"], ["out/a.exr"]),
        (["in/a.exr", "in/b.exr", "-o", "out"], ["out/a.exr", "out/b.exr"]),
        # Some shells replace no stars.
        (["in/*.exr", "-o", "out"], ["out/a.exr", "out/b.exr"]),
        (["in/?.EXR"], ["in/a_clean.exr", "in/b_clean.exr"]),
    ],
)
def test_where_results_go(folder: Path, words: list[str], made: list[str]) -> None:
    assert run(["denoise", *words, *CHEAP]) == 0
    assert list_files(folder) == sorted(["in/a.exr", "in/b.exr", *made])
    assert run(["denoise", "in/a.exr", "-o", "alone.exr", *CHEAP]) == 0
    np.testing.assert_array_equal(read_image(made[0]), read_image("alone.exr"))


def test_the_current_folder_and_the_one_above_it(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(folder / "in")
    assert run(["denoise", ".", *CHEAP]) == 0
    (folder / "in" / "below").mkdir()
    monkeypatch.chdir(folder / "in" / "below")
    (folder / "in_clean" / "a.exr").unlink()
    assert run(["denoise", "..", *CHEAP]) == 0
    assert list_files(folder) == ["in/a.exr", "in/b.exr", "in_clean/a.exr", "in_clean/b.exr"]


def test_names_of_sequences() -> None:
    assert name_clean(Path("x/shot.####.exr")) == Path("x/shot_clean.####.exr")
    assert name_clean(Path("shot-%04d.exr")) == Path("shot_clean-%04d.exr")
    assert name_clean(Path("####.exr")) == Path("clean.####.exr")


def test_names_with_stars_are_those_of_files_of_any_letters(folder: Path) -> None:
    (folder / "B.EXR").touch()
    (folder / "c.exr").mkdir()
    assert expand_names(["*.exr", "in/a.exr", "*.png"]) == ["B.EXR", "in/a.exr", "*.png"]
    assert expand_names(["gone/*.exr"]) == ["gone/*.exr"]


def test_a_folder_of_an_animation_is_named_once_with_the_option_for_it(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    for number in (1, 2, 3):
        write_frame(f"anim_{number:04d}.exr", make_scene((83, 19), seed=number))
    assert run(["denoise", "anim_*.exr", "-o", "out/", *CHEAP]) == 0
    told = " ".join(capsys.readouterr().err.split())
    assert told.count("If they are an animation, 'anim_####.exr' with --window 2 has less flicker.") == 1
    # What is the same for every file is told for the first.
    assert told.count("Used: ") == told.count("anim_0001.exr: Used: ") == 1
    assert run(["denoise", "in", "-o", "out/", *CHEAP]) == 0
    assert "animation" not in capsys.readouterr().err
    assert run(["denoise", ".", "-o", "out/", *CHEAP, "--window", "2"]) == 2
    told = " ".join(capsys.readouterr().err.split())
    assert "got 'anim_0001.exr'; name the sequence 'anim_####.exr', in quotes" in told


def test_the_folder_of_a_sequences_results_is_made(folder: Path) -> None:
    write_frame("anim_0001.exr", make_scene((83, 19), seed=1))
    for more in ((), ("--workers", "1"), ("--png",)):
        output = f"new{len(more)}{more[:1]}"
        assert run(["denoise", "anim_####.exr", "-o", f"{output}/below/clean_####.exr", *CHEAP, *more]) == 0
        assert (folder / output / "below" / "clean_0001.exr").exists()


def test_a_file_that_fails_does_not_stop_the_others(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    Path("in/a.exr").write_bytes(b"nothing")
    assert run(["denoise", "in", "-o", "out", *CHEAP]) == 2
    told = capsys.readouterr().err.splitlines()
    assert [line for line in told if line.startswith("in/a.exr: ")]
    assert told[-1] == ("lobewise: 1 of 2 files could not be denoised (in/a.exr); mend what is said above.")
    assert list_files(folder / "out") == ["b.exr"]


def test_the_next_file_is_read_while_one_is_filtered(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    write_frame("in/c.exr", make_scene((83, 19), seed=2))
    begun = {name: threading.Event() for name in ("a.exr", "b.exr", "c.exr")}
    read, denoise = FileDenoiser.read, FileDenoiser._filter

    def note_read(own: FileDenoiser, path: Path) -> OpenedFile:
        begun[path.name].set()
        return read(own, path)

    def wait_and_filter(own: FileDenoiser, file: OpenedFile) -> FileResult:
        following = {"a.exr": "b.exr", "b.exr": "c.exr"}.get(file.path.name)
        assert following is None or begun[following].wait(60.0)
        return denoise(own, file)

    monkeypatch.setattr(FileDenoiser, "read", note_read)
    monkeypatch.setattr(FileDenoiser, "_filter", wait_and_filter)
    assert run(["denoise", "in", "-o", "out", *CHEAP, "--verbose"]) == 0
    assert list_files(folder / "out") == ["a.exr", "b.exr", "c.exr"]
    told = capsys.readouterr().err
    assert told.count("Seconds: reading ") == 3


def test_standard_input_and_output_carry_the_bytes_of_files(folder: Path) -> None:
    program = [sys.executable, "-c", "from lobewise.cli import main; main()", "denoise", *CHEAP]
    done = subprocess.run([*program, "-", "-o", "-"], input=Path("in/a.exr").read_bytes(), capture_output=True)
    assert done.returncode == 0, done.stderr
    assert run(["denoise", "in/a.exr", "-o", "alone.exr", *CHEAP]) == 0
    assert done.stdout == Path("alone.exr").read_bytes()
    assert b"Wrote " in done.stderr


def test_an_input_that_is_no_image_is_named_as_standard_input(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(b"nothing")))
    assert run(["denoise", "-", "-o", "out.exr"]) == 2
    assert "standard_input.exr" in capsys.readouterr().err


@pytest.mark.skipif(os.name == "nt", reason="the stand-in for tev is a script of a shell")
def test_tev_is_started_with_results_and_inputs(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    tev = folder / "tev"
    tev.write_text('#!/bin/sh\necho "$@" > shown.part && mv shown.part shown\n')
    tev.chmod(0o755)
    monkeypatch.setenv("PATH", f"{folder}{os.pathsep}{os.environ['PATH']}")
    started: list[subprocess.Popen[bytes]] = []
    popen = subprocess.Popen

    def start(*words: object, **options: object) -> subprocess.Popen[bytes]:
        started.append(popen(*words, **options))  # type: ignore[call-overload]
        return started[-1]

    monkeypatch.setattr("lobewise.cli.options.naming.subprocess.Popen", start)
    assert run(["denoise", "in/a.exr", "-o", "out.exr", "--tev", *CHEAP]) == 0
    assert started[0].wait(timeout=20.0) == 0
    assert Path("shown").read_text() == "out.exr in/a.exr\n"
