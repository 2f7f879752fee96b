"""What becomes of the file that an output replaces, and of what a killed process left."""

import os
import stat
import subprocess
import sys
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from lobewise.cli.program import run
from lobewise.errors import FileError
from lobewise.exporting.folder import open_folder
from lobewise.io import write_frame
from lobewise.io.files import open_atomic, require_writable, write_text
from lobewise.io.replacing import TargetWarning, begin_temporary, name_temporary, remove_leftovers
from lobewise.recipes.ledger import Ledger
from lobewise.records.frame import Frame, Radiance
from tests.mistakes import refuses

pytestmark = pytest.mark.skipif(os.name != "posix", reason="modes, owners and links of POSIX")

needs_root = pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root gives files away")


def write_folder(target: Path, text: str) -> None:
    with open_folder(target, force=True) as name:
        name("a.txt").write_text(text)


def write_record(target: Path, text: str) -> None:
    Ledger(folder=target.parent, identity="").record(int(target.stem), text, [])


def list_names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


class TestTarget:
    def test_content_is_on_the_disk_before_it_has_the_name(
        self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        done: list[str] = []
        sync, replace = os.fsync, os.replace

        def record_sync(descriptor: int) -> None:
            seen = os.fstat(descriptor)
            done.append("folder" if stat.S_ISDIR(seen.st_mode) else f"{seen.st_size} bytes")
            sync(descriptor)

        def record_replace(source: Path, target: Path) -> None:
            done.append("name")
            replace(source, target)

        monkeypatch.setattr(os, "fsync", record_sync)
        monkeypatch.setattr(os, "replace", record_replace)
        with open_atomic(tmp_path / "a.txt") as stream:
            stream.write(b"content")
        assert done == ["7 bytes", "name", "folder"]

    def test_a_read_only_file_is_refused(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        target = tmp_path / "a.exr"
        target.write_text("old")
        target.chmod(0o444)
        with refuses(FileError, "output 'a.exr'", "a read-only file (mode 0444)"):
            require_writable(target)
        assert run(["render", "showroom", "-o", str(target)]) == 2
        assert "read-only file" in capsys.readouterr().err
        assert target.read_text() == "old"
        assert list_names(tmp_path) == ["a.exr"]

    @needs_root
    def test_owner_group_and_mode_stay(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        target.write_text("old")
        os.chown(target, 12345, 23456)
        target.chmod(0o2664)
        write_text(target, "new")
        found = target.stat()
        assert (found.st_uid, found.st_gid, found.st_mode & 0o7777) == (12345, 23456, 0o2664)
        assert target.read_text() == "new"

    @needs_root
    def test_an_owner_that_cannot_be_kept_is_told(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        target = tmp_path / "a.txt"
        target.write_text("old")
        os.chown(target, 12345, -1)

        def refuse(*_: object) -> None:
            raise PermissionError(1, "Operation not permitted")

        monkeypatch.setattr(os, "fchown", refuse)
        with pytest.warns(TargetWarning, match="its owner is now 0 instead of 12345"):
            write_text(target, "new")
        assert target.read_text() == "new"

    def test_hard_links_keep_the_old_content_and_that_is_told(self, tmp_path: Path) -> None:
        target, other = tmp_path / "a.txt", tmp_path / "b.txt"
        target.write_text("old")
        os.link(target, other)
        with pytest.warns(TargetWarning, match=r"a\.txt' was replaced: 1 hard link"):
            write_text(target, "new")
        assert (target.read_text(), other.read_text()) == ("new", "old")

    @pytest.mark.parametrize("write", [write_text, write_folder])
    def test_a_loop_of_links_is_refused(self, write: Callable[[Path, str], None], tmp_path: Path) -> None:
        (tmp_path / "a").symlink_to("b")
        (tmp_path / "b").symlink_to("a")
        with refuses(FileError, "output 'a'"):
            write(tmp_path / "a", "new")
        assert list_names(tmp_path) == ["a", "b"]
        assert (tmp_path / "a").is_symlink()

    def test_an_open_file_that_was_deleted_is_refused(self, tmp_path: Path) -> None:
        path = tmp_path / "a.txt"
        with path.open("w") as stream:
            link = Path(f"/proc/self/fd/{stream.fileno()}")
            if not link.exists():
                pytest.skip("this system shows no open files")
            assert require_writable(link) == path.resolve()
            path.unlink()
            for name in ("other.txt", "a.txt (deleted)"):
                with refuses(FileError, got="an open file that was deleted, which has no name"):
                    write_text(link, "new")
                (tmp_path / name).write_text("another file")
        assert list_names(tmp_path) == ["a.txt (deleted)", "other.txt"]
        assert (tmp_path / "a.txt (deleted)").read_text() == "another file"

    def test_a_name_with_a_slash_at_its_end_is_refused(self, tmp_path: Path) -> None:
        target = tmp_path / "a.exr"
        target.write_text("old")
        with refuses(FileError, "output 'a.exr/'"):
            write_frame(f"{target}/", Frame(Radiance(np.ones((4, 4, 3)))))
        assert target.read_text() == "old"

    def test_attributes_stay(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        target.write_text("old")
        try:
            os.setxattr(target, "user.shot", b"42")
        except OSError:
            pytest.skip("this file system has no attributes")
        write_text(target, "new")
        assert os.getxattr(target, "user.shot") == b"42"


def make_leftover(target: Path) -> Path:
    """Return a file that a process left for a target when it was killed."""
    program = (
        "import os, sys; from lobewise.io.files import open_atomic\n"
        "with open_atomic(sys.argv[1]) as stream: stream.write(b'half' * 9999); stream.flush(); os.kill(0, 9)"
    )
    before = set(target.parent.iterdir())
    subprocess.run([sys.executable, "-c", program, str(target)], start_new_session=True, check=False)
    (left,) = set(target.parent.iterdir()) - before
    return left


class TestTemporary:
    def test_names_are_short_enough_however_long_the_targets_is(self, tmp_path: Path) -> None:
        for name in ("a.exr", "x" * 251 + ".exr", "é" * 125 + ".exr", os.fsdecode(b"\xff.exr")):
            target = tmp_path / name
            names = [name_temporary(target) for _ in range(2)]
            assert names[0] != names[1]
            assert all(len(os.fsencode(path.name)) <= 255 for path in names)
            with open_atomic(target) as stream:
                stream.write(b"new")
            assert target.read_bytes() == b"new"
        assert len(list_names(tmp_path)) == 4

    @pytest.mark.parametrize("name", ["a.txt", "x" * 251 + ".txt"])
    def test_the_next_write_removes_what_a_killed_process_left(self, name: str, tmp_path: Path) -> None:
        target, other = tmp_path / name, tmp_path / "b.txt"
        left = make_leftover(target)
        assert left.name.endswith(".part")
        write_text(other, "new")
        assert left.exists()
        write_text(target, "new")
        assert target.read_text() == "new"
        assert list_names(tmp_path) == sorted([name, "b.txt"])

    def test_the_next_export_removes_the_folder_that_a_killed_one_left(self, tmp_path: Path) -> None:
        target = tmp_path / "export"
        left = make_leftover(target)
        left.unlink()
        left.mkdir()
        (left / "half.c").write_text("half")
        write_folder(target, "new")
        assert list_names(tmp_path) == ["export"]

    def test_what_somebody_may_be_writing_stays(self, tmp_path: Path) -> None:
        """A process that runs here, and one on another machine that wrote in the last day."""
        target = tmp_path / "a.txt"
        left = make_leftover(target)
        machine, process, _ = left.name.removeprefix(".a.txt.").split("-")
        far = left.rename(left.with_name(left.name.replace(machine, "0" * 8)))
        near = left.with_name(left.name.replace(f"-{process}-", f"-{os.getppid()}-"))
        near.write_text("half")
        foreign = [left.with_name(name) for name in (".a.txt.part", ".a.txt.b.part", "a.txt.bak")]
        for path in foreign:
            path.write_text("of somebody else")
        folder = near.with_name(f"{near.name[: -len('12345678.part')]}12345678.part")
        folder.mkdir()
        write_text(target, "new")
        assert set(tmp_path.iterdir()) == {target, far, near, folder, *foreign}
        os.utime(far, (time.time() - 82800.0,) * 2)
        remove_leftovers(target)
        assert far.exists()
        os.utime(far, (time.time() - 90000.0,) * 2)
        remove_leftovers(target)
        assert set(tmp_path.iterdir()) == {target, near, folder, *foreign}

    def test_files_of_others_stay(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        target = tmp_path / "a.txt"
        left = make_leftover(target)
        monkeypatch.setattr(os, "geteuid", lambda: left.stat().st_uid + 1)
        remove_leftovers(target)
        assert left.exists()

    def test_what_is_being_written_stays(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        with open_atomic(target) as stream:
            stream.write(b"first")
            remove_leftovers(target)
            write_text(target, "second")
            assert target.read_text() == "second"
        assert target.read_text() == "first"
        assert list_names(tmp_path) == ["a.txt"]

    @pytest.mark.parametrize("write", [write_text, write_record])
    def test_what_lies_in_the_place_of_a_temporary_file_is_not_written_to(
        self, write: Callable[[Path, str], None], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
    ) -> None:
        target, other = tmp_path / "7.json", tmp_path / "other"
        monkeypatch.setattr("lobewise.io.replacing.secrets.token_hex", lambda _: "00000000")
        place = name_temporary(target)
        for put in (os.mkfifo, partial(os.symlink, other), partial(os.symlink, "nowhere"), partial(os.link, other)):
            other.write_text("old")
            put(place)
            # A pipe that somebody reads can be opened for writing.
            reader = os.open(place, os.O_RDONLY | os.O_NONBLOCK) if put is os.mkfifo else None
            with refuses(FileError, got="file exists"):
                write(target, "new")
            if reader is not None:
                assert os.read(reader, 1) == b""
                os.close(reader)
            place.unlink(missing_ok=True)
            assert other.read_text() == "old"
            assert list_names(tmp_path) == ["other"]

    def test_threads_write_one_target(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"

        def write(letter: str) -> None:
            for _ in range(20):
                write_text(target, letter * 100_000)
                assert len(set(target.read_text())) == 1

        with ThreadPoolExecutor(4) as threads:
            list(threads.map(write, "abcd"))
        assert len(target.read_text()) == 100_000
        assert list_names(tmp_path) == ["a.txt"]

    def test_two_machines_of_one_name_are_told_apart(self, monkeypatch: pytest.MonkeyPatch) -> None:
        target = Path("a.txt")
        first = begin_temporary(target)
        monkeypatch.setattr(os, "readlink", lambda _: "pid:[1]")
        assert begin_temporary(target) != first


NAMES = (b"fr\xff.exr", b"a\nb.exr", b"[red]x[bold].exr", b"\x1b[31mx.exr", "größe….exr".encode())


@pytest.mark.nightly
@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_any_name_is_read_written_and_shown(name: bytes, encoding: str, tmp_path: Path) -> None:
    source = Path(__file__).parents[1] / "data" / "foreign" / "blender_4.5_seed1.exr"
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(source.read_bytes())
    program = (
        "import sys; from lobewise.cli.program import run\n"
        "path, folder = sys.argv[1:]\n"
        "code = run(['inspect', path])\n"
        "code = code or run(['compare', path, '--reference', path, '--json', folder + '/a.json'])\n"
        "sys.exit(code or run(['view', path + 'x']) - 2)"
    )
    environment = {**os.environ, "PYTHONIOENCODING": encoding}
    command = [sys.executable, "-c", program, str(path), str(tmp_path)]
    done = subprocess.run(command, capture_output=True, env=environment)
    assert done.returncode == 0, done.stderr
    assert b"Traceback" not in done.stderr
    assert b"\x1b" not in done.stdout + done.stderr
