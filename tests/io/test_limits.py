"""What the system refuses is named: a good file is never called damaged. Decoding needs no temporary file."""

import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from lobewise.interchange import read_image
from lobewise.io import write_image
from lobewise.io.exr import pixels
from lobewise.work.chunks import run_chunks

LIMITED = """
import os, resource, sys
import OpenEXR
import lobewise.io.exr.frames
from lobewise.interchange import read_image

def read(limit):
    resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
    try:
        print("read", *read_image(sys.argv[1]).shape)
    except Exception as problem:
        print(type(problem).__name__, problem)

for extra in map(int, sys.argv[2:]):
    used = int(open("/proc/self/statm").read().split()[0]) * resource.getpagesize()
    child = os.fork()
    if child == 0:
        read(used + extra)
        sys.stdout.flush()
        os._exit(0)
    if os.waitpid(child, 0)[1]:
        print("crashed")
"""
ON_FULL_MACHINE = """
import resource, sys
from lobewise.interchange import read_image
resource.setrlimit(resource.RLIMIT_NOFILE, (int(sys.argv[2]), int(sys.argv[2])))
try:
    print("read", *read_image(sys.argv[1]).shape)
except Exception as problem:
    print(type(problem).__name__, problem)
"""
MEBI = 2**20
needs_linux = pytest.mark.skipif(sys.platform != "linux", reason="sets limits of Linux")


@pytest.fixture(scope="module")
def good_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a file of several chunks, compressed by the method that needs most memory."""
    path = tmp_path_factory.mktemp("good") / "good.exr"
    write_image(path, np.random.default_rng(20150915).random((500, 700, 3)).astype(np.float32), compression="piz")
    return path


def run(program: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run a program of Python in a process of its own."""
    command = [sys.executable, "-c", program, *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, env={**os.environ, **environment}, check=False)


@needs_linux
def test_little_memory_is_no_damage(good_file: Path) -> None:
    extras = [*range(0, 100 * MEBI, 4 * MEBI), 400 * MEBI]
    told = run(LIMITED, good_file, *extras).stdout.splitlines()
    assert len(told) == len(extras)
    for line in told[:-1]:
        assert line.startswith("read 500 700 3") or "got not enough memory; free some, or raise the limit" in line
    assert "not enough memory" in told[0]
    assert told[-1] == "read 500 700 3"


@pytest.mark.sampled("3", "6")
@needs_linux
@pytest.mark.parametrize("files", [3, 4, 5, 6])
def test_few_open_files_are_no_damage(good_file: Path, files: int) -> None:
    done = run(ON_FULL_MACHINE, good_file, files)
    assert done.stdout.startswith("read 500 700 3") or "got too many open files" in done.stdout, done.stderr


@pytest.mark.parametrize("folder", ["missing", "good.exr/below"])
def test_decoding_needs_no_temporary_file(good_file: Path, folder: str) -> None:
    program = (
        "import sys, tempfile\n"
        "def refuse(*_, **__): raise AssertionError('a temporary file')\n"
        "tempfile._get_default_tempdir = tempfile.TemporaryFile = refuse\n"
        "from lobewise.display.hushing import hush_libraries\n"
        "from lobewise.interchange import read_image\n"
        "hush_libraries()\n"
        "print(read_image(sys.argv[1]).shape)\n"
    )
    if sys.platform != "linux":
        program = program.replace("hush_libraries()\n", "")
    done = run(program, good_file, TMPDIR=str(good_file.parent / folder))
    assert done.stdout == "(500, 700, 3)\n", done.stderr


def test_work_goes_on_without_other_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise RuntimeError("can't start new thread")

    monkeypatch.setenv("HL_NUM_THREADS", "4")
    monkeypatch.setattr("threading.Thread.start", refuse)
    done = np.zeros((300, 400), int)

    def count(chunk: tuple[slice, slice]) -> None:
        done[chunk] += 1

    run_chunks(count, *done.shape)
    assert (done == 1).all()


@pytest.mark.parametrize(("room", "asked"), [(2 * pixels.THREAD_BYTES, []), (2**40, [4, 0])])
def test_one_thread_decodes_where_there_is_no_room_for_more(
    good_file: Path, room: int, asked: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    counts = []

    def refuse(count: int) -> None:
        counts.append(count)
        if count > 0:
            raise RuntimeError("can't start new thread")

    monkeypatch.setattr("OpenEXR.set_global_thread_count", refuse)
    monkeypatch.setattr(pixels, "_threads", pixels._Threads())
    monkeypatch.setattr(pixels, "count_cores", lambda: 4)
    monkeypatch.setattr(pixels, "_has_memory", lambda size: size <= room)
    assert read_image(good_file).shape == (500, 700, 3)
    assert counts == asked


@pytest.mark.parametrize(
    ("problem", "told"),
    [("MemoryError", "got not enough memory; free some"), ("OSError(24, 'Too many open files')", "got too many open")],
)
def test_the_program_names_limits(good_file: Path, problem: str, told: str) -> None:
    program = (
        "import sys\nfrom lobewise.cli import main\n"
        f"def refuse(*_, **__): raise {problem}\n"
        "import lobewise.cli.running as running\nrunning.run_files = refuse\n"
        "main(['denoise', sys.argv[1], '-o', sys.argv[1] + '.out.exr', '--quality', 'fast'])\n"
    )
    done = run(program, good_file)
    assert done.returncode == 2, done.stderr
    assert told in done.stderr
    assert "went wrong inside" not in done.stderr
