"""Sequences to filter on farms, and the processes of a farm."""

import importlib.util
import os
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from lobewise.cli.program import run
from lobewise.io import write_frame
from tests.farm.processes import Farm, make_command, run_program
from tests.streaming.frames import make_scene

NUMBERS = (*range(1, 13), *range(21, 33))
"""Two shots: the numbers between them are missing."""
SHAPE = (64, 96)


@pytest.fixture(scope="session")
def dask() -> None:
    """Skip without Dask and say how to get it; where CI is set that is a failure."""
    if importlib.util.find_spec("distributed") is None:
        told = "Dask is not installed: pip install 'lobewise[farm]'"
        if os.environ.get("CI"):
            pytest.fail(told)
        pytest.skip(told)


@pytest.fixture(scope="session")
def sources(dask: None, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return the folder of a noisy sequence ``in.####.exr``."""
    folder = tmp_path_factory.mktemp("sources")
    for number in NUMBERS:
        write_frame(folder / f"in.{number:04d}.exr", make_scene(SHAPE, seed=number))
    return folder


@pytest.fixture(scope="session")
def expected(sources: Path, tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """Return the files that one process writes for the sequence, by name."""
    folder = tmp_path_factory.mktemp("expected")
    # The program itself, without a start of Python.
    words = make_command(sources, folder)
    assert run(words[words.index("denoise") :]) == 0
    return read_outputs(folder)


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """Return an empty folder for outputs."""
    made = tmp_path / "outputs"
    made.mkdir()
    return made


@pytest.fixture
def farm(tmp_path: Path) -> Iterator[Farm]:
    """Return a scheduler and two workers, each a process of its own."""
    with Farm(tmp_path) as found:
        yield found


def read_outputs(folder: Path) -> dict[str, bytes]:
    """Return the content of every file in a folder, hidden ones included."""
    return {path.name: path.read_bytes() for path in sorted(folder.iterdir()) if path.is_file()}


def require_frame_3_failed(done: subprocess.CompletedProcess[str], folder: Path, expected: dict[str, bytes]) -> None:
    """Raise AssertionError unless a program wrote all frames but the third, and told that one."""
    assert done.returncode == 2, done.stderr
    assert f"lobewise: 1 of {len(NUMBERS)} frames could not be filtered (frame 3); " in done.stderr
    assert read_outputs(folder) == {name: data for name, data in expected.items() if name != "out.0003.exr"}


def require_only_frame_3_is_filtered(sources: Path, folder: Path, expected: dict[str, bytes]) -> None:
    """Give the same command again, and raise AssertionError unless it filters only what failed."""
    others = {path: path.stat().st_mtime_ns for path in folder.glob("out.*.exr")}
    done = run_program(sources, folder, "--workers", "1")
    assert done.returncode == 0, done.stderr
    assert f"Going on: {len(NUMBERS) - 1} of {len(NUMBERS)} frames are done" in done.stderr
    assert f"1 of {len(NUMBERS)} frames" in done.stdout
    assert {path: path.stat().st_mtime_ns for path in others} == others
    assert read_outputs(folder) == expected
