"""Options of farms: what they mean, and one sentence for each mistake."""

import sys
from pathlib import Path

import pytest

from lobewise.cli.options.bounding import parse_memory
from lobewise.errors import InputError
from lobewise.farm import connection
from lobewise.io import write_frame
from lobewise.io.sequence import name_frames
from lobewise.work.limits import GIB
from tests.cli.lines import fail
from tests.mistakes import refuses
from tests.streaming.frames import make_scene


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a folder with a frame, a sequence of one, and make it the current one."""
    monkeypatch.chdir(tmp_path)
    write_frame("in.1.exr", make_scene((16, 16)))
    return tmp_path


def test_without_dask_the_sentence_names_the_command(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    line = ["denoise", "in.#.exr", "-o", "out.#.exr", "--farm", "tcp://127.0.0.1:1"]
    fail(capsys, *line, action="pip install 'lobewise[farm]'")
    assert sorted(path.name for path in folder.iterdir()) == ["in.1.exr"]


@pytest.mark.usefixtures("dask")
def test_a_scheduler_that_does_not_answer(
    folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "CONNECT_SECONDS", 0.5)
    line = ["denoise", "in.#.exr", "-o", "out.#.exr", "--farm", "tcp://127.0.0.1:9"]
    fail(capsys, *line, what="--farm", expected="a Dask scheduler at tcp://127.0.0.1:9")
    assert sorted(path.name for path in folder.iterdir()) == ["in.1.exr"]


@pytest.mark.usefixtures("dask")
def test_an_address_that_is_none(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    line = ["denoise", "in.#.exr", "-o", "out.#.exr", "--farm", "ftp://localhost"]
    fail(capsys, *line, what="--farm", got="'ftp://localhost'")


@pytest.mark.parametrize(
    "address", ["tls://host:8786", "wss://host:1", "tcp://127.0.0.1:8786", "localhost:8786", "tcp://[::1]:1"]
)
def test_tls_and_this_machine_are_secure(address: str) -> None:
    connection.require_secure(address)


@pytest.mark.usefixtures("dask")
def test_insecure_is_tried(folder: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(connection, "CONNECT_SECONDS", 0.5)
    # This address is reserved for documentation: nothing answers.
    words = ["--farm", "tcp://192.0.2.1:8786", "--insecure"]
    line = ["denoise", "in.#.exr", "-o", "out.#.exr", *words]
    fail(capsys, *line, what="--farm", expected="a Dask scheduler at tcp://192.0.2.1:8786")


def test_sizes_of_memory() -> None:
    assert parse_memory("8GiB") == 8.0
    assert parse_memory(" 8gb ") == pytest.approx(8e9 / GIB)
    assert parse_memory("4096MiB") == 4.0
    assert parse_memory("1.5 TB") == pytest.approx(1.5e12 / GIB)
    for text in ("", "8", "GB", "-8GB", "nanGB", "1e9GB"):
        with refuses(InputError, "--max-memory"):
            parse_memory(text)


def test_names_of_frames() -> None:
    assert name_frames([7]) == "Frame 7"
    assert name_frames([1, 2, 3, 7, 9, 10]) == "Frames 1 to 3, 7, 9 to 10"
