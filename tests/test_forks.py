"""Processes that were forked or started anew, and threads, read and filter after their parent did, to the same bits."""

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

import lobewise
from tests.streaming.frames import make_scene

TIMES = 20
SECONDS = 120
"""Far more than the children need; a child that waits for ever is killed then."""


def read_and_filter(path: str) -> bytes:
    """Return what the quality "fast" makes of a file, as bytes."""
    return lobewise.denoise(lobewise.read_frame(path), quality="fast").image.tobytes()


def run_children(path: str, method: str) -> list[bytes]:
    """Return what children give that are started while nothing else runs."""
    if method == "fork":
        return [fork_child(path) for _ in range(TIMES)]
    with multiprocessing.get_context(method).Pool(2) as pool:
        return pool.map(read_and_filter, [path] * TIMES, chunksize=1)


def fork_child(path: str) -> bytes:
    """Return what one forked child gives, and nothing if it fails."""
    receive, send = os.pipe()
    child = os.fork()
    if child == 0:
        try:
            with os.fdopen(send, "wb") as stream:
                stream.write(read_and_filter(path))
        finally:
            os._exit(0)
    os.close(send)
    with os.fdopen(receive, "rb") as stream:
        given = stream.read()
    os.waitpid(child, 0)
    return given


def fork_beside_threads(path: str) -> list[bytes]:
    """Return what children give that are forked while other threads read and filter, and what these threads give."""
    over = threading.Event()

    def work() -> list[bytes]:
        found = [read_and_filter(path)]
        while not over.is_set():
            found.append(read_and_filter(path))
        return found

    with ThreadPoolExecutor(2) as threads:
        busy = [threads.submit(work) for _ in range(2)]
        try:
            given = [fork_child(path) for _ in range(TIMES)]
        finally:
            over.set()
        return given + [image for each in busy for image in each.result()]


def main(path: str, method: str) -> None:
    """Work in this process, in its children, and in this process again; print how many images agree, of how many."""
    want = read_and_filter(path)
    given = fork_beside_threads(path) if method == "threads" else run_children(path, method)
    given.append(read_and_filter(path))
    print(sum(image == want for image in given), "of", len(given), "of at least", TIMES + 1)


@pytest.mark.nightly
@pytest.mark.skipif(not hasattr(os, "fork"), reason="this system has no fork")
@pytest.mark.parametrize("method", ["fork", "spawn", "forkserver", "threads"])
def test_children_read_and_filter_as_their_parent_did(method, tmp_path):
    path = tmp_path / "a.exr"
    lobewise.write_frame(path, make_scene((160, 96)))
    root = str(Path(__file__).parents[1])
    command = [sys.executable, "-m", "tests.test_forks", str(path), method]
    with subprocess.Popen(command, stdout=subprocess.PIPE, cwd=root, start_new_session=True, text=True) as process:
        try:
            told, _ = process.communicate(timeout=SECONDS)
        except subprocess.TimeoutExpired:
            told = "hanging"
        finally:
            # Children that hang outlive their parent.
            kill_group(process.pid)
    words = told.split()
    assert words[1:2] == ["of"], told
    assert words[0] == words[2], told
    assert int(words[2]) > TIMES


def kill_group(number: int) -> None:
    """End every process of a group that is left."""
    try:
        os.killpg(number, signal.SIGKILL)
    except ProcessLookupError:
        return


if __name__ == "__main__":
    main(*sys.argv[1:])
