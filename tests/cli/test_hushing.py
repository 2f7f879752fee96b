"""The command prints one sentence about damaged pixels, and nothing of what OpenEXR prints about them."""

import subprocess
import sys
from pathlib import Path

import pytest

from lobewise.io import write_frame


@pytest.fixture
def damaged(full_frame, tmp_path) -> Path:
    """Return a file whose last chunk cannot be decoded."""
    path = tmp_path / "in.1.exr"
    write_frame(path, full_frame, compression="zips")
    path.write_bytes(path.read_bytes()[:-200] + bytes(200))
    return path


def run_program(folder: Path, *words: str) -> tuple[int, str, str]:
    command = [sys.executable, "-m", "lobewise", *words]
    done = subprocess.run(command, capture_output=True, text=True, cwd=folder, check=False)
    return done.returncode, done.stdout, done.stderr


def assert_one_sentence(code: int, out: str, err: str) -> None:
    assert (code, out) == (2, "")
    assert err.startswith("lobewise: input 'in.1.exr': expected pixels that can be decoded, got damaged pixels; ")
    assert err.count("\n") == 1


@pytest.mark.sampled("off")
@pytest.mark.parametrize("bands", ["off", "16"])
def test_damaged_pixels_take_one_sentence(bands: str, damaged: Path) -> None:
    found = run_program(damaged.parent, "denoise", "in.1.exr", "-o", "out.exr", "--bands", bands)
    assert_one_sentence(*found)


@pytest.mark.nightly
def test_the_worker_of_a_page_is_silent_too(damaged: Path) -> None:
    pytest.importorskip("viser", reason="pip install 'lobewise[viewer]'")
    assert_one_sentence(*run_program(damaged.parent, "view", "in.1.exr", "--port", "0"))


@pytest.mark.nightly
def test_workers_of_a_farm_are_silent_too(damaged: Path) -> None:
    pytest.importorskip("distributed", reason="pip install 'lobewise[farm]'")
    (damaged.parent / "in.2.exr").write_bytes(damaged.read_bytes())
    code, out, err = run_program(damaged.parent, "denoise", "in.#.exr", "-o", "out.#.exr", "--workers", "1")
    assert (code, out) == (2, "Wrote out.#.exr: 0 of 2 frames.\n")
    assert "damaged pixels" in err
    assert "EXR_ERR" not in err


PROGRAM = """
import os, sys
from lobewise.display.hushing import hide_lines, hush_libraries
if sys.argv[1] == "hushed":
    hush_libraries()
with hide_lines("noise"):
    print("noise out")
    print("other out")
    os.write(2, b"noise err\\nother err\\n")
    print("seen err", file=sys.stderr)
"""


@pytest.mark.parametrize(("word", "lines"), [("hushed", 0), ("not", 1)])
def test_lines_without_a_mark_are_printed(word: str, lines: int) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM, word], capture_output=True, text=True, check=True)
    assert done.stdout == "noise out\n" * lines + "other out\n"
    assert sorted(done.stderr.splitlines()) == ["noise err"] * lines + ["other err", "seen err"]
