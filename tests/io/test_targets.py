"""What becomes of the file that an output replaces, and of what a killed process left."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from pathlib import Path

import pytest

from lobewise.cli.main import run
from lobewise.errors import FileError
from lobewise.io import replacing
from lobewise.io.files import open_atomic, require_writable, write_text
from lobewise.io.replacing import TargetWarning, name_temporary, remove_temporary

pytestmark = pytest.mark.skipif(os.name != "posix", reason="modes, owners and links of POSIX")


def list_names(folder: Path) -> list[str]:
    return sorted(entry.name for entry in folder.iterdir())


class TestTarget:
    def test_a_read_only_file_is_refused(self, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
        target = tmp_path / "a.exr"
        target.write_text("old")
        target.chmod(0o444)
        with pytest.raises(FileError, match=r"read-only file \(mode 0444\); make it writable"):
            require_writable(target)
        assert run(["render", "showroom", "-o", str(target)]) == 2
        assert "read-only file" in capsys.readouterr().err
        assert target.read_text() == "old"
        assert list_names(tmp_path) == ["a.exr"]

    @pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away")
    def test_owner_group_and_mode_stay(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        target.write_text("old")
        os.chown(target, 12345, 23456)
        target.chmod(0o2664)
        write_text(target, "new")
        found = target.stat()
        assert (found.st_uid, found.st_gid, found.st_mode & 0o7777) == (12345, 23456, 0o2664)
        assert target.read_text() == "new"

    def test_an_owner_that_cannot_be_kept_is_told(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        target = tmp_path / "a.txt"
        target.write_text("old")
        if os.geteuid() == 0:
            os.chown(target, 12345, -1)
        else:
            pytest.skip("only root can make a file of another user")

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

    def test_attributes_stay(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        target.write_text("old")
        try:
            os.setxattr(target, "user.shot", b"42")
        except OSError:
            pytest.skip("this file system has no attributes")
        write_text(target, "new")
        assert os.getxattr(target, "user.shot") == b"42"


class TestTemporary:
    def test_one_name_however_long_the_targets_is(self, tmp_path: Path) -> None:
        for name in ("a.exr", "x" * 251 + ".exr", "é" * 125 + ".exr", os.fsdecode(b"\xff.exr")):
            assert len(os.fsencode(name_temporary(tmp_path / name).name)) <= 255
            with open_atomic(tmp_path / name) as stream:
                assert name_temporary(tmp_path / name).exists()
                stream.write(b"new")
            assert (tmp_path / name).read_bytes() == b"new"
        assert len(list_names(tmp_path)) == 4

    def test_what_a_killed_process_left_is_taken_over(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        program = (
            "import os, sys; from lobewise.io.files import open_atomic\n"
            "with open_atomic(sys.argv[1]) as stream: stream.write(b'half' * 9999); stream.flush(); os.kill(0, 9)"
        )
        subprocess.run([sys.executable, "-c", program, str(target)], start_new_session=True, check=False)
        assert list_names(tmp_path) == [".a.txt.part"]
        write_text(target, "new")
        assert target.read_text() == "new"
        assert list_names(tmp_path) == ["a.txt"]

    def test_what_a_killed_process_left_can_be_removed_but_not_what_is_being_written(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        name_temporary(target).write_text("half")
        remove_temporary(target)
        assert list_names(tmp_path) == []
        # Without a temporary file nothing happens.
        remove_temporary(target)
        with open_atomic(target) as stream:
            stream.write(b"new")
            remove_temporary(target)
        assert target.read_text() == "new"

    def test_two_writers(self, tmp_path: Path) -> None:
        target = tmp_path / "a.txt"
        with open_atomic(target) as stream:
            stream.write(b"first")
            with pytest.raises(FileError, match="another process that is writing it"):
                write_text(target, "second")
        assert target.read_text() == "first"
        assert list_names(tmp_path) == ["a.txt"]

    def test_many_writers(self, tmp_path: Path) -> None:
        """Whoever is not refused leaves a whole file."""
        target, refused = tmp_path / "a.txt", []

        def write(letter: str) -> None:
            for _ in range(20):
                try:
                    write_text(target, letter * 100_000)
                except FileError as problem:
                    refused.append(problem)
                text = target.read_text() if target.exists() else "-"
                assert len(set(text)) == 1

        threads = [threading.Thread(target=write, args=(letter,)) for letter in "abcd"]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
        assert len(refused) < 80
        assert len(target.read_text()) == 100_000
        assert list_names(tmp_path) == ["a.txt"]

    def test_links_and_pipes_in_its_place_are_refused(self, tmp_path: Path) -> None:
        target, precious = tmp_path / "a.txt", tmp_path / "precious"
        precious.write_text("old")
        name_temporary(target).symlink_to(precious)
        with pytest.raises(FileError, match="which is a link"):
            write_text(target, "new")
        name_temporary(target).unlink()
        os.mkfifo(name_temporary(target))
        with pytest.raises(FileError, match="no regular file"):
            write_text(target, "new")
        assert precious.read_text() == "old"

    def test_a_file_with_other_links_is_not_written_into(self, tmp_path: Path) -> None:
        target, precious = tmp_path / "a.txt", tmp_path / "precious"
        precious.write_text("old")
        os.link(precious, name_temporary(target))
        write_text(target, "new")
        assert (precious.read_text(), target.read_text()) == ("old", "new")

    def test_leftovers_of_the_first_version(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(replacing, "_swept", set())
        old, young = tmp_path / ".a.txt.ab12cd_4.part", tmp_path / ".b.txt.ab12cd_4.part"
        for path in (old, young):
            path.write_text("half")
        os.utime(old, (1.0, 1.0))
        write_text(tmp_path / "c.txt", "new")
        assert list_names(tmp_path) == [young.name, "c.txt"]


NAMES = (b"fr\xff.exr", b"a\nb.exr", b"[red]x[bold].exr", b"\x1b[31mx.exr", "größe….exr".encode())


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
def test_any_name_is_read_written_and_shown(name: bytes, encoding: str, tmp_path: Path) -> None:
    source = Path(__file__).parents[1] / "data" / "foreign" / "blender_4.5_seed1.exr"
    path = tmp_path / os.fsdecode(name)
    path.write_bytes(source.read_bytes())
    program = (
        "import sys; from lobewise.cli.main import run\n"
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


@pytest.mark.parametrize(
    "words",
    [
        ["inspect", "{long}"],
        ["denoise", "{long}", "-o", "a.exr"],
        ["denoise", "in.####{long}", "-o", "out.####.exr"],
        ["upsample", "{long}", "-o", "a.exr"],
        ["fit", "{long}", "-o", "a.lobes"],
        ["export", "-o", "{long}"],
        ["render", "showroom", "-o", "{long}"],
        ["view", "{long}"],
    ],
)
def test_names_that_are_too_long_are_told(words: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    assert run([word.format(long="x" * 300 + ".exr") for word in words]) == 2
    told = capsys.readouterr().err
    assert told.startswith("lobewise: ")
    assert "expected" in told
