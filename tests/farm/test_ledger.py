"""A frame is done only while its record, its sources and its files agree."""

import errno
import json
import os
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from lobewise.errors import FileError
from lobewise.recipes.ledger import MAX_RECORD_BYTES, Ledger
from tests.mistakes import refuses

FRAMES = (1, 2, 3)


class Sequence:
    """Three sources, three outputs that are recorded, and the ledger."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.frames = [(number, folder / f"in.{number}") for number in FRAMES]
        for number, path in self.frames:
            path.write_text("noisy" * number)
        self.ledger = self.make_ledger()
        with self.ledger.lock():
            self.ledger.put_token("a token")
        for number, proof in self.prove().items():
            self.name_output(number).write_text("clean" * number)
            self.ledger.record(number, proof, [self.name_output(number)])

    def make_ledger(self, identity: str = "beta 1") -> Ledger:
        return Ledger(folder=self.folder / "out.lobewise-done", identity=identity)

    def name_output(self, number: int) -> Path:
        return self.folder / f"out.{number}"

    def prove(self, ledger: Ledger | None = None) -> dict[int, str]:
        return (ledger or self.ledger).prove(self.frames, lambda _, path: [path])

    def list_done(self, ledger: Ledger | None = None) -> list[int]:
        proofs = self.prove(ledger)
        return [
            number
            for number in FRAMES
            if (ledger or self.ledger).is_done(number, proofs[number], [self.name_output(number)])
        ]


@pytest.fixture
def sequence(tmp_path: Path) -> Sequence:
    return Sequence(tmp_path)


def age(path: Path) -> None:
    """Move the time of a file by 10 ms."""
    state = path.stat()
    os.utime(path, ns=(state.st_atime_ns, state.st_mtime_ns + 10_000_000))


def append_spaces(path: Path, count: int) -> None:
    path.write_text(path.read_text() + " " * count)


def test_what_is_recorded_is_done(sequence: Sequence) -> None:
    assert sequence.list_done() == [1, 2, 3]
    assert sequence.ledger.list_recorded() == {1, 2, 3}


def test_file_servers_may_round_times(sequence: Sequence) -> None:
    state = sequence.name_output(2).stat()
    os.utime(sequence.name_output(2), ns=(state.st_atime_ns, state.st_mtime_ns // 1000 * 1000))
    assert sequence.list_done() == [1, 2, 3]


CHANGES: dict[str, Callable[[Sequence], object]] = {
    "source changed": lambda each: age(each.folder / "in.2"),
    "last source removed": lambda each: (each.folder / "in.3").unlink(),
    "output removed": lambda each: each.name_output(2).unlink(),
    "output truncated": lambda each: os.truncate(each.name_output(2), 3),
    "output written again": lambda each: age(each.name_output(2)),
    "record removed": lambda each: (each.ledger.folder / "2.json").unlink(),
    "record truncated": lambda each: os.truncate(each.ledger.folder / "2.json", 20),
    "record too large": lambda each: append_spaces(each.ledger.folder / "2.json", MAX_RECORD_BYTES),
    "record of another kind": lambda each: (each.ledger.folder / "2.json").write_text("[1, 2]"),
    "record without files": lambda each: (each.ledger.folder / "2.json").write_text(
        json.dumps({"proof": each.prove()[2], "files": [None]})
    ),
}


@pytest.mark.parametrize("change", CHANGES)
def test_what_changed_is_not_done(change: str, sequence: Sequence) -> None:
    CHANGES[change](sequence)
    # Frames after a changed source are made again.
    assert sequence.list_done() == {"source changed": [1], "last source removed": [1, 2]}.get(change, [1, 3])


def test_other_settings_void_everything(sequence: Sequence) -> None:
    assert sequence.list_done(sequence.make_ledger("beta 2")) == []


def test_a_full_disk_leaves_no_half_record(sequence: Sequence, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    before = sorted(sequence.ledger.folder.iterdir())
    monkeypatch.setattr(os, "replace", refuse)
    with refuses(FileError, "record '2.json'"):
        sequence.ledger.record(2, "proof", [])
    assert sorted(sequence.ledger.folder.iterdir()) == before


def test_removing_leaves_files_of_others(sequence: Sequence) -> None:
    other = sequence.ledger.folder / "notes.txt"
    other.write_text("mine")
    sequence.ledger.remove()
    assert list(sequence.ledger.folder.iterdir()) == [other]
    other.unlink()
    sequence.ledger.remove()
    assert not sequence.ledger.folder.exists()


@pytest.mark.parametrize("name", ["token", "lock", "2.json"])
def test_links_in_the_folder_change_no_other_file(name: str, sequence: Sequence) -> None:
    victim, link = sequence.folder / "victim", sequence.ledger.folder / name
    victim.write_text("mine")
    link.unlink()
    link.symlink_to(victim)
    with suppress(FileError), sequence.ledger.lock():
        sequence.ledger.put_token("other")
        sequence.ledger.record(2, "proof", [])
    assert victim.read_text() == "mine"
    # The lock of a run that cannot begin is the only file that stays a link.
    assert link.is_symlink() == (name == "lock")


def test_a_folder_that_is_a_link_is_refused(sequence: Sequence) -> None:
    link = sequence.folder / "other.lobewise-done"
    link.symlink_to(sequence.ledger.folder)
    with pytest.raises(FileError, match="expected a folder, got a link"), Ledger(folder=link, identity="").lock():
        pass


HOLD = """
import sys
from pathlib import Path
from lobewise.recipes.ledger import Ledger
with Ledger(folder=Path(sys.argv[1]), identity="").lock():
    print("locked", flush=True)
    sys.stdin.read()
"""


def test_two_runs_do_not_write_one_sequence(sequence: Sequence) -> None:
    command = [sys.executable, "-c", HOLD, str(sequence.ledger.folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as other:
        assert other.stdout.readline() == "locked\n"
        with refuses(FileError, "records 'out.lobewise-done'"), sequence.ledger.lock():
            pass
        other.communicate()
    with sequence.ledger.lock():
        pass
