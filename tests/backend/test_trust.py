"""Machine code is read only from files of this user, and only whole object files reach the loader."""

import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
import warnings
from pathlib import Path
from typing import Any

import pytest

from lobewise.backend import disk, sources, trust
from lobewise.backend.disk import CacheWarning, fetch_object, locate_cache_folder, write_whole
from lobewise.backend.objects import compile_object, is_object
from lobewise.backend.trust import describe_folder_problem, describe_problem
from lobewise.errors import FileError
from tests.backend.test_jit import PROGRAM, make_elf, run_program
from tests.mistakes import refuses
from tests.pythons import run_python

pytestmark = [pytest.mark.processor, pytest.mark.skipif(os.name != "posix", reason="Windows has no modes of files")]


@pytest.fixture(autouse=True)
def forget(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let every test see its warnings."""
    monkeypatch.setattr(disk, "_told", set())


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Return a cache that holds one object file."""
    path = tmp_path / "cache"
    monkeypatch.setenv("LOBEWISE_CACHE", str(path))
    fetch_object("something", make)
    return path


@pytest.fixture(scope="session")
def code() -> bytes:
    """Return an object file of two functions."""
    import halide as hl

    x, func = hl.Var("x"), hl.Func("f")
    func[x] = 2 * x
    target = hl.get_host_target().with_feature(hl.TargetFeature.NoRuntime)
    return compile_object(lambda path: hl.Pipeline(func).compile_to_object(path, [], "twice", target))


_made: list[int] = []


def make() -> tuple[bytes, dict[str, Any]]:
    """Return the smallest whole ELF file, and count how often it was asked for."""
    _made.append(1)
    return make_elf(), {"parameters": []}


def count_made() -> int:
    """Fetch the object file, and return how often this call made it."""
    before = len(_made)
    assert fetch_object("something", make)[0] == make_elf()
    return len(_made) - before


class TestModes:
    def test_only_this_user_can_read_what_is_written(self, folder: Path) -> None:
        (path,) = folder.iterdir()
        assert folder.stat().st_mode & 0o777 == 0o700
        assert path.stat().st_mode & 0o777 == 0o600
        assert count_made() == 0

    @pytest.mark.parametrize("mode", [0o777, 0o1777, 0o707])
    def test_a_folder_that_others_can_write_to_is_refused(self, folder: Path, mode: int) -> None:
        folder.chmod(mode)
        with pytest.warns(CacheWarning, match=f"{folder.name}.*every user.*LOBEWISE_CACHE"):
            assert count_made() == 1
        # Told once.
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            assert count_made() == 1

    def test_so_is_one_below_it(self, folder: Path) -> None:
        folder.parent.chmod(0o777)
        assert "every user" in describe_folder_problem(folder)
        folder.parent.chmod(0o1777)
        assert describe_folder_problem(folder) == ""

    @pytest.mark.parametrize("mode", [0o666, 0o602])
    def test_a_file_that_others_can_write_to_is_compiled_anew(self, folder: Path, mode: int) -> None:
        (path,) = folder.iterdir()
        path.chmod(mode)
        with pytest.warns(CacheWarning, match=f"{path.name}.*every user"):
            assert count_made() == 1
        assert path.stat().st_mode & 0o777 == 0o600
        assert count_made() == 0

    @pytest.mark.skipif(not hasattr(os, "geteuid") or os.geteuid() != 0, reason="only root can give files away")
    def test_files_and_folders_of_another_user(self, folder: Path) -> None:
        (path,) = folder.iterdir()
        os.chown(path, 12345, 12345)
        with pytest.warns(CacheWarning, match="another user"):
            assert count_made() == 1
        os.chown(folder, 12345, 12345)
        with pytest.warns(CacheWarning, match="another user"):
            assert count_made() == 1

    def test_groups(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        tmp_path.chmod(0o770)
        monkeypatch.setattr(trust, "_is_private_group", lambda group: False)
        assert "group" in describe_problem(tmp_path.stat())
        monkeypatch.setattr(trust, "_is_private_group", lambda group: True)
        assert describe_problem(tmp_path.stat()) == ""

    def test_links_are_not_followed(self, folder: Path, tmp_path: Path) -> None:
        (path,) = folder.iterdir()
        path.rename(tmp_path / "elsewhere")
        path.symlink_to(tmp_path / "elsewhere")
        assert count_made() == 1
        assert not path.is_symlink()

    def test_a_file_with_the_name_of_another_does_not_count(self, folder: Path) -> None:
        (path,) = folder.iterdir()
        fetch_object("other", make)
        other = next(each for each in folder.iterdir() if each != path)
        other.replace(path)
        assert count_made() == 1

    @pytest.mark.parametrize(
        ("old", "new"), [(b'"parameters": []', b'"parameters": [1]'), (b"\x7fELF\x02\x01\0", b"\x7fELF\x02\x01\3")]
    )
    def test_a_file_of_another_description_or_code_does_not_count(self, folder: Path, old: bytes, new: bytes) -> None:
        (path,) = folder.iterdir()
        content = path.read_bytes()
        assert content.count(old) == 1
        path.write_bytes(content.replace(old, new))
        assert count_made() == 1

    def test_digests_of_sources_that_others_can_write_to_do_not_count(self, folder: Path) -> None:
        def describe() -> str:
            sources._open_kept.cache_clear()
            return sources.describe_definitions(["lobewise.records.frame"])

        told = describe()
        path = folder / "sources.json"
        known = json.loads(path.read_text())
        path.write_text(json.dumps({key: [{"Frame": [["0", []]]}, imports] for key, (_, imports) in known.items()}))
        assert describe() != told
        path.chmod(0o666)
        assert describe() == told


class TestObjects:
    def test_whole_ones_pass(self, code: bytes) -> None:
        assert is_object(code, "twice")
        assert is_object(make_elf())
        assert not is_object(code, "thrice")

    def test_no_other_reaches_the_loader(self, code: bytes) -> None:
        for damaged in (b"", b"twice\0" * 50, code[:64], code[: len(code) // 2], code[:-1], code[::-1]):
            assert not is_object(damaged, "twice")

    @pytest.mark.nightly
    def test_an_empty_one_with_a_valid_checksum_is_compiled_anew(self, tmp_path: Path) -> None:
        # The digest of a file without code is right, as a compiler on a full disk would have left it.
        poison = (
            "from lobewise.backend import disk\n"
            "write = disk.write_whole\n"
            "digest = disk._digest\n"
            "disk._digest = lambda known, told, content: digest(known, told, b'')\n"
            "disk.write_whole = lambda path, content: write(path, content.split(b'\\n', 1)[0] + b'\\n')\n"
        )
        run_program(tmp_path, before=poison)
        assert all(path.read_bytes().endswith(b"\n") for path in tmp_path.glob("*.kernel"))
        assert run_program(tmp_path) == "2 True\n"

    def test_a_disk_that_is_full(self, folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        def refuse(*_: object) -> None:
            raise OSError(28, "No space left on device")

        monkeypatch.setattr(os, "replace", refuse)
        with pytest.warns(CacheWarning, match="no space left"):
            fetch_object("other", make)
        assert [path.suffix for path in folder.iterdir()] == [".kernel"]

    def test_what_killed_processes_left_is_removed(self, folder: Path) -> None:
        for name in ("tmpab12cd34", ".lobewise-1-00"):
            (folder / name).write_text("")
            os.utime(folder / name, (1.0, 1.0))
        young, other = folder / ".lobewise-2-00", folder / "notes.txt"
        young.write_text("")
        other.write_text("")
        os.utime(other, (1.0, 1.0))
        fetch_object("other", make)
        assert {path.name for path in folder.iterdir() if path.suffix != ".kernel"} == {young.name, other.name}
        assert time.time() - young.stat().st_mtime < disk.MAX_TEMPORARY_SECONDS


class TestHomes:
    @pytest.mark.parametrize("home", [None, ""])
    def test_a_user_without_a_home(self, home: str | None, monkeypatch: pytest.MonkeyPatch) -> None:
        import pwd

        monkeypatch.delenv("LOBEWISE_CACHE", raising=False)
        monkeypatch.delenv("XDG_CACHE_HOME", raising=False)
        if home is None:
            monkeypatch.delenv("HOME", raising=False)
        else:
            monkeypatch.setenv("HOME", home)
        own = Path(pwd.getpwuid(os.getuid()).pw_dir)
        found = locate_cache_folder()
        assert own in found.parents

        def know_nobody(number: int) -> None:
            raise KeyError(number)

        monkeypatch.setattr(pwd, "getpwuid", know_nobody)
        assert locate_cache_folder() is None
        assert fetch_object("something", make)[0] == make_elf()

    @pytest.mark.parametrize("name", ["file/folder", "file", "x" * 300])
    def test_folders_that_cannot_be(self, name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path / name))
        with pytest.warns(CacheWarning, match=r"not kept.*LOBEWISE_CACHE"):
            assert count_made() == 1

    def test_names_that_are_not_utf8(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setenv("LOBEWISE_CACHE", os.fsdecode(os.fsencode(tmp_path) + b"/\xff"))
        assert count_made() == 1
        assert count_made() == 0

    def test_relative_ones(self, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.chdir(tmp_path)
        monkeypatch.setenv("LOBEWISE_CACHE", "here")
        assert write_whole(tmp_path / "here" / "a", b"") == ""
        assert locate_cache_folder() == tmp_path / "here"
        monkeypatch.delenv("LOBEWISE_CACHE")
        monkeypatch.setenv("XDG_CACHE_HOME", "here")
        found = locate_cache_folder()
        assert found is None or found.is_absolute()


def test_a_compiler_without_its_folder_is_told() -> None:
    import halide as hl

    def refuse(path: str) -> None:
        raise hl.HalideError("Error: Unable to create temp directory.")

    with refuses(FileError, "kernels"):
        compile_object(refuse)


READ_ONLY = """
mount -t tmpfs tmpfs "$1"
cp -r "$2" "$1/cache"
mount -o remount,ro "$1" && mount --bind /tmp /tmp && mount -o remount,ro,bind /tmp || exit 3
shift 2
exec "$@"
"""
UNSHARE = ["unshare", "--mount"]


def can_unshare() -> bool:
    """Return whether a process can have file systems of its own here."""
    return (
        bool(shutil.which("unshare"))
        and subprocess.run([*UNSHARE, "true"], capture_output=True, check=False).returncode == 0
    )


@pytest.mark.nightly
@pytest.mark.skipif(not can_unshare(), reason="needs a process that may mount file systems of its own")
def test_a_read_only_machine_uses_the_kernels_of_its_cache(tmp_path: Path) -> None:
    # /tmp stays to be read: the interpreter or the package may lie there.
    place, kept = tempfile.mkdtemp(dir="/var/tmp"), tmp_path / "kept"
    try:
        program = PROGRAM.format(feature="ScreenFeature(1.0)")
        run_python("-c", program, LOBEWISE_CACHE=str(kept))
        for cache, code, words in ((f"{place}/cache", 0, "0 True"), ("off", 1, "a folder /tmp that can be written")):
            told = {**os.environ, "LOBEWISE_CACHE": cache, "TMPDIR": "/missing", "PYTHONDONTWRITEBYTECODE": "1"}
            command = [*UNSHARE, "sh", "-c", READ_ONLY, "sh", place, str(kept), sys.executable, "-c", program]
            done = subprocess.run(command, env=told, check=False, capture_output=True, text=True)
            assert done.returncode == code, done.stderr
            assert words in done.stdout + done.stderr
    finally:
        os.rmdir(place)


def test_a_compiler_that_writes_nothing_is_told() -> None:
    with pytest.raises(OSError, match="disk full"):
        compile_object(lambda path: Path(path).write_bytes(b""))
