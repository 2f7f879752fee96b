"""Two processes write one file at the same time, with and without locks of files: it is always one of theirs, whole."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

BYTES = 300_000
WRITER = """
import errno, sys
from lobewise.io.files import open_atomic

target, letter, locks, size = sys.argv[1], sys.argv[2].encode(), sys.argv[3], int(sys.argv[4])
if locks == "failing":
    import fcntl

    def refuse(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    fcntl.flock = refuse
for line in sys.stdin:
    with open_atomic(target) as stream:
        for _ in range(10):
            stream.write(letter * (size // 10))
    print(line.strip(), flush=True)
"""


def start_writer(target: Path, letter: str, locks: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", WRITER, str(target), letter, locks, str(BYTES)]
    return subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)


@pytest.mark.sampled("failing-100")
@pytest.mark.skipif(os.name != "posix", reason="Windows refuses to replace a file that somebody reads")
@pytest.mark.parametrize("rounds", [100, 500])
@pytest.mark.parametrize("locks", ["working", "failing"])
def test_two_writers_leave_one_whole_file(locks: str, rounds: int, tmp_path: Path) -> None:
    target = tmp_path / "out.exr"
    writers = [start_writer(target, letter, locks) for letter in "ab"]
    mixed = 0
    try:
        for number in range(rounds):
            for writer in writers:
                writer.stdin.write(f"{number}\n")
                writer.stdin.flush()
            for writer in writers:
                assert writer.stdout.readline() == f"{number}\n"
            mixed += target.read_bytes() not in (b"a" * BYTES, b"b" * BYTES)
    finally:
        for writer in writers:
            writer.communicate()
    assert mixed == 0
    assert [path.name for path in tmp_path.iterdir()] == ["out.exr"]
