"""Of damaged pixels the command prints one sentence, and nothing of what OpenEXR prints; the library prints nothing."""

import platform
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


LIBRARY = """
import sys, lobewise
try:
    lobewise.read_frame(sys.argv[1])
except lobewise.LobewiseError as problem:
    sys.exit("damaged pixels" in str(problem) and 7)
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only the C library of Linux lets its stderr be replaced")
def test_the_library_prints_nothing(damaged: Path) -> None:
    done = subprocess.run([sys.executable, "-c", LIBRARY, str(damaged)], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stdout, done.stderr) == (7, "", "")


PROGRAM = """
import ctypes, os, subprocess, sys, threading
from lobewise.display import hushing
if sys.argv[1] == "redirected":
    hushing.hush_libraries()
    hushing._open_c_stderr = lambda: None
library = ctypes.CDLL(None)
own = sys.stdout

def print_from_c(text):
    library.fputs(text, ctypes.c_void_p.in_dll(library, "stderr"))
    library.fflush(None)

def print_beside():
    print("noise of another thread")
    own.flush()
    os.write(1, b"at once\\n")
    if sys.argv[1] == "caught":
        os.write(2, b"noise of a descriptor\\n")
        subprocess.run(["sh", "-c", "echo noise of a child >&2"], check=True)

with hushing.hide_lines("noise"):
    print("noise out")
    print("other out")
    print_from_c(b"noise err\\nother err\\n")
    print("seen err", file=sys.stderr, flush=True)
    thread = threading.Thread(target=print_beside)
    thread.start()
    thread.join()
assert sys.stdout is own
print("noise after")
print_from_c(b"noise after err\\n")
"""


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="only the C library of Linux has a variable stderr")
@pytest.mark.parametrize("way", ["caught", "redirected"])
def test_lines_of_others_are_printed(way: str) -> None:
    done = subprocess.run([sys.executable, "-c", PROGRAM, way], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines() == ["noise of another thread", "at once", "other out", "noise after"]
    others = ["noise of a child", "noise of a descriptor"] if way == "caught" else []
    assert sorted(done.stderr.splitlines()) == sorted(["noise after err", *others, "other err", "seen err"])
