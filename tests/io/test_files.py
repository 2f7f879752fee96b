"""Paths that cannot be used, and writes that leave no trace when they fail."""

import os
import re
import stat

import numpy as np
import pytest

from lobewise.errors import FileError
from lobewise.interchange import read_image
from lobewise.io import read_frame, write_frame, write_image
from lobewise.io.files import open_atomic, require_readable, require_writable, write_text
from lobewise.records.frame import Frame, Radiance
from tests.mistakes import refuses

FRAME = Frame(Radiance(np.ones((2, 3, 3))))


def list_names(folder):
    return sorted(entry.name for entry in folder.iterdir())


@pytest.mark.parametrize("read", [read_frame, read_image])
class TestInputs:
    @pytest.mark.parametrize(
        "path", ["other.exr", "farme.exr", "", "frame.exr/b.exr", "pipe", "/dev/zero", "a\0b.exr", "x" * 5000]
    )
    def test_unreadable(self, read, path, tmp_path):
        write_image(tmp_path / "frame.exr", np.ones((2, 2, 3)))
        os.mkfifo(tmp_path / "pipe")
        with refuses(FileError, f"input {str(tmp_path / path)!r}") as caught:
            read(tmp_path / path)
        assert ("frame.exr" in caught.value.action) == (path == "farme.exr")

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may read everything")
    def test_forbidden(self, read, tmp_path):
        write_frame(tmp_path / "a.exr", FRAME)
        (tmp_path / "a.exr").chmod(0)
        with pytest.raises(FileError, match="permission denied"):
            read(tmp_path / "a.exr")


class TestOutputs:
    @pytest.mark.parametrize(
        ("path", "got"),
        [
            ("", "a directory"),
            ("missing/a.exr", "no folder '.*missing'"),
            ("file/a.exr", "'.*file', which is not a folder"),
            ("pipe", "a device or pipe"),
            ("/proc/a.exr", "no such file or directory|permission denied"),
            ("a\0b.exr", "(lstat: )?embedded null"),
        ],
    )
    def test_unwritable(self, path, got, tmp_path):
        (tmp_path / "file").write_text("")
        # A pipe and not a device: a mistake of ours must not cost the machine its /dev/null.
        os.mkfifo(tmp_path / "pipe")
        with pytest.raises(FileError) as caught:
            write_frame(tmp_path / path, FRAME)
        assert caught.value.what.startswith("output '")
        assert re.match(got, caught.value.got)
        assert list_names(tmp_path) == ["file", "pipe"]
        assert (tmp_path / "pipe").is_fifo()

    @pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
    def test_forbidden(self, tmp_path):
        tmp_path.chmod(0o500)
        with pytest.raises(FileError, match="read-only"):
            write_frame(tmp_path / "a.exr", FRAME)

    def test_checking_changes_nothing(self, tmp_path):
        assert require_writable(tmp_path / "a.exr") == (tmp_path / "a.exr").resolve()
        assert list_names(tmp_path) == []


class TestAtomic:
    def fail_inside(self, path, error):
        with pytest.raises(error), open_atomic(path) as stream:  # noqa: PT012 - the block is what fails
            stream.write(b"half of it")
            raise error

    @pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
    def test_failure_leaves_the_old_file_and_nothing_else(self, error, tmp_path):
        (tmp_path / "a.exr").write_text("old")
        self.fail_inside(tmp_path / "a.exr", error)
        assert (tmp_path / "a.exr").read_text() == "old"
        assert list_names(tmp_path) == ["a.exr"]

    def test_failure_leaves_no_new_file(self, tmp_path):
        self.fail_inside(tmp_path / "a.exr", RuntimeError)
        assert list_names(tmp_path) == []

    def test_a_full_disk_is_told(self, tmp_path):
        with refuses(FileError, "output 'a.exr'", "no space left on device"), open_atomic(tmp_path / "a.exr"):
            raise OSError(28, "No space left on device")
        assert list_names(tmp_path) == []

    def test_the_old_file_stays_until_the_end(self, tmp_path):
        path = tmp_path / "a.exr"
        path.write_text("old")
        with open_atomic(path) as stream:
            stream.write(b"new")
            stream.flush()
            assert path.read_text() == "old"
        assert path.read_text() == "new"
        assert list_names(tmp_path) == ["a.exr"]

    def test_permissions(self, tmp_path):
        old = os.umask(0o027)
        try:
            write_text(tmp_path / "new.txt", "x")
        finally:
            os.umask(old)
        assert stat.S_IMODE((tmp_path / "new.txt").stat().st_mode) == 0o640
        (tmp_path / "new.txt").chmod(0o604)
        write_text(tmp_path / "new.txt", "y")
        assert stat.S_IMODE((tmp_path / "new.txt").stat().st_mode) == 0o604

    def test_links_are_followed(self, tmp_path):
        (tmp_path / "real.txt").write_text("old")
        (tmp_path / "link.txt").symlink_to("real.txt")
        write_text(tmp_path / "link.txt", "new")
        assert (tmp_path / "link.txt").is_symlink()
        assert (tmp_path / "real.txt").read_text() == "new"

    def test_long_names(self, tmp_path):
        write_text(tmp_path / ("n" * 250), "x")
        assert list_names(tmp_path) == ["n" * 250]


def test_an_empty_file_is_missed_by_what_it_should_hold(tmp_path):
    (tmp_path / "a").touch()
    for options, expected in (({}, "an image"), ({"what": "scene"}, "a scene"), ({"holds": "a lobe"}, "a lobe")):
        with refuses(FileError, got="an empty file of 0 bytes", expected=expected):
            require_readable(tmp_path / "a", **options)
