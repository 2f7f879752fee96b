"""Locks and replaced files as Windows has them, stood in for by rules that hold there."""

import os
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lobewise.exporting.folder import open_folder
from lobewise.io import locks, replacing
from lobewise.io.replacing import Replacement, name_temporary, remove_leftovers

posix = pytest.mark.skipif(not Path("/proc/self/fd").is_dir(), reason="asks Linux which files are open")


class WindowsLocks:
    """Locks of bytes: one holder for each byte of a file, until its descriptor is closed."""

    LK_NBLCK = 2

    def __init__(self) -> None:
        self.held: dict[tuple[int, int], int] = {}

    def locking(self, descriptor: int, mode: int, count: int) -> None:
        assert (mode, count) == (self.LK_NBLCK, 1)
        byte = os.fstat(descriptor).st_ino, os.lseek(descriptor, 0, os.SEEK_CUR)
        holder = self.held.get(byte, descriptor)
        # A descriptor of the same number is a later one: the former is closed.
        if holder != descriptor and self.is_open(holder, byte[0]):
            raise PermissionError(13, "locked")
        self.held[byte] = descriptor

    def is_open(self, descriptor: int, number: int) -> bool:
        """Return whether a descriptor is still that of a file."""
        try:
            return os.fstat(descriptor).st_ino == number
        except OSError:
            return False


@pytest.fixture(params=["own", "windows"])
def system(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> str:
    """Run a test with the locks of this system, and with those of Windows."""
    if request.param == "windows":
        monkeypatch.setattr(locks, "fcntl", None)
        monkeypatch.setattr(locks, "msvcrt", WindowsLocks())
    return str(request.param)


@pytest.fixture
def closed_only(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse, as Windows does, to remove or replace files that are open."""

    def require_closed(*paths: object) -> None:
        for each in Path("/proc/self/fd").iterdir():
            with suppress(FileNotFoundError):
                if os.readlink(each) in {str(path) for path in paths}:
                    raise PermissionError(13, "open", os.readlink(each))

    unlink, replace = os.unlink, os.replace

    def unlink_closed(path: object, **options: Any) -> None:
        require_closed(path)
        unlink(str(path), **options)

    def replace_closed(source: object, target: object) -> None:
        require_closed(source, target)
        if Path(str(source)).is_dir() and Path(str(target)).exists():
            raise PermissionError(13, "exists", str(target))
        replace(str(source), str(target))

    monkeypatch.setattr(os, "unlink", unlink_closed)
    monkeypatch.setattr(os, "replace", replace_closed)
    monkeypatch.setattr(replacing, "_is_posix", False)


def test_one_holder_at_a_time(system: str, tmp_path: Path) -> None:
    path = tmp_path / "file"
    with path.open("wb") as first, path.open("rb+") as second:
        first.write(b"begun")
        first.flush()
        assert locks.try_lock(first.fileno()), system
        assert not locks.try_lock(second.fileno())
        first.write(b" and ended")
    assert path.read_bytes() == b"begun and ended"
    with path.open("rb+") as third:
        assert locks.try_lock(third.fileno())


@pytest.mark.parametrize("has_lock", [True, False])
def test_file_systems_without_locks(has_lock: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object) -> None:
        raise OSError(95, "not supported")

    calls = SimpleNamespace(flock=refuse, LOCK_EX=2, LOCK_NB=4)
    monkeypatch.setattr(locks, "fcntl", calls if has_lock else None)
    monkeypatch.setattr(locks, "msvcrt", SimpleNamespace(locking=refuse, LK_NBLCK=2))
    with (tmp_path / "file").open("wb") as stream:
        assert locks.try_lock(stream.fileno())


@posix
@pytest.mark.usefixtures("closed_only")
def test_files_that_are_open_are_neither_removed_nor_replaced(tmp_path: Path) -> None:
    target = tmp_path / "out.exr"
    with Replacement(target) as new:
        new.stream.write(b"first")
        new.finish()
    assert target.read_bytes() == b"first"
    with Replacement(target) as new:
        new.stream.write(b"half")
    assert [path.name for path in tmp_path.iterdir()] == ["out.exr"]
    assert target.read_bytes() == b"first"


@posix
@pytest.mark.usefixtures("closed_only")
def test_what_is_written_now_is_no_leftover(tmp_path: Path) -> None:
    """A file is removed a minute after its last change, and only while nobody has it open."""
    target = tmp_path / "out.exr"
    left, closed, opened = (name_temporary(target) for _ in range(3))
    for path in (left, closed, opened):
        path.write_bytes(b"half")
    for path in (left, opened):
        os.utime(path, (1.0, 1.0))
    with opened.open("rb"):
        remove_leftovers(target)
    assert set(tmp_path.iterdir()) == {closed, opened}


@posix
@pytest.mark.usefixtures("closed_only")
def test_a_folder_takes_a_name_that_is_free(tmp_path: Path) -> None:
    target = tmp_path / "export"
    target.mkdir()
    for content in ("one", "two"):
        with open_folder(target, force=True) as name:
            name("lobewise-export.json").write_text(content)
            name("README.md").write_text(content)
        assert (target / "README.md").read_text() == content
    assert [path.name for path in tmp_path.iterdir()] == ["export"]
