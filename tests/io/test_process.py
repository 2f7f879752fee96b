"""Reading and writing files leaves the process to others: lines of threads and children, modes of files, the mask."""

import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from lobewise.exporting.folder import MARK, open_folder
from lobewise.interchange import read_image
from lobewise.io import write_image
from lobewise.io.files import write_text

LINES = 10_000
BESIDE = """
import os, subprocess, sys, threading, time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
import numpy as np
from lobewise.interchange import read_image
from lobewise.io import write_image

folder, lines = Path(sys.argv[1]), int(sys.argv[2])
image = np.random.default_rng(1).random((200, 200, 3)).astype(np.float32)
write_image(folder / "source.exr", image)
over, wide, found = threading.Event(), set(), []

def print_lines(stream):
    for number in range(lines // 4):
        getattr(sys, stream).write(f"stream {number}\\n")
        if number % 50 == 0:
            getattr(sys, stream).flush()
            time.sleep(0.001)

def write_lines(descriptor):
    for number in range(lines // 8):
        os.write(descriptor, f"descriptor {number}\\n".encode())
        if number % 50 == 0:
            time.sleep(0.001)

def start_children():
    for start in range(0, lines // 8, lines // 80):
        script = f"for n in $(seq {start} {start + lines // 80 - 1}); do echo child $n; echo child $n >&2; done"
        subprocess.run(["sh", "-c", script], check=True)

def make_files():
    number = 0
    while not over.is_set():
        path = folder / f"made.{number}"
        path.touch()
        found.append(path.stat().st_mode & 0o777)
        path.unlink()
        number += 1

def copy_images(number):
    while not over.is_set():
        write_image(folder / f"{number}.exr", read_image(folder / "source.exr"))
        found.append((folder / f"{number}.exr").stat().st_mode & 0o777)

with ThreadPoolExecutor(8) as threads:
    busy = [threads.submit(copy_images, number) for number in range(2)] + [threads.submit(make_files)]
    work = [threads.submit(print_lines, stream) for stream in ("stdout", "stderr")]
    work += [threads.submit(write_lines, descriptor) for descriptor in (1, 2)]
    work += [threads.submit(start_children)]
    try:
        for each in work:
            each.result()
    finally:
        over.set()
    for each in busy:
        each.result()
print("modes", *sorted(set(found)))
"""


@pytest.mark.skipif(os.name != "posix", reason="starts a shell, and sets a mask of modes")
def test_lines_and_modes_of_other_threads_stay_their_own(tmp_path: Path) -> None:
    mask = os.umask(0o027)
    try:
        done = subprocess.run(
            [sys.executable, "-c", BESIDE, str(tmp_path), str(LINES)], capture_output=True, text=True, check=True
        )
    finally:
        os.umask(mask)
    counts = {"stream": LINES // 4, "descriptor": LINES // 8, "child": LINES // 8}
    expected = sorted(f"{name} {number}" for name, count in counts.items() for number in range(count))
    told = done.stdout.splitlines()
    assert sorted(told[:-1]) == expected
    assert sorted(done.stderr.splitlines()) == expected
    assert told[-1] == f"modes {0o640}"


@pytest.mark.skipif(os.name != "posix", reason="sets a mask of modes")
def test_the_mask_is_applied_and_never_set(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(mask: int) -> int:
        raise AssertionError(f"the mask of all threads is set to {mask}")

    before = os.umask(0o027)
    try:
        with monkeypatch.context() as patch:
            patch.setattr(os, "umask", refuse)
            write_text(tmp_path / "file", "content")
            for _ in range(2):
                with open_folder(tmp_path / "folder", force=True) as name:
                    name(MARK).write_text("content")
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.rglob("*")}
    assert modes == {"file": 0o640, "folder": 0o750, MARK: 0o640}


THREADS = 8
COMPRESSIONS = ("none", "rle", "zips", "zip", "piz", "zstd", "zip", "piz")


@pytest.mark.sampled("2")
@pytest.mark.parametrize("rounds", [2, 6])
def test_threads_read_and_write_what_a_loop_does(rounds: int, rng: np.random.Generator, tmp_path: Path) -> None:
    images = [rng.random((150 + 10 * number, 170, 3)).astype(np.float32) for number in range(THREADS)]

    def copy(number: int) -> tuple[bytes, bytes]:
        """Write, read and replace a file; return its bytes and its pixels."""
        path, compression = tmp_path / f"{number}.exr", COMPRESSIONS[number]
        write_image(path, images[number], compression=compression)
        read = read_image(path)
        write_image(path, read, compression=compression)
        return path.read_bytes(), read.tobytes()

    expected = [copy(number) for number in range(THREADS)]
    with ThreadPoolExecutor(THREADS) as threads:
        for _ in range(rounds):
            assert list(threads.map(copy, range(THREADS))) == expected
