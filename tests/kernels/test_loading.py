"""Compiled kernels on disk: what is kept, what is not, and what happens to files that are not whole."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from lobewise.backend import jit as loading
from lobewise.backend.buffers import Buffer
from lobewise.backend.jit import Runtime, describe_key, fetch_object, find_cache_folder, get_runtime
from lobewise.errors import DeviceError
from lobewise.features.base import NormalFeature, ScreenFeature
from lobewise.filters.cross_pass import PassKey
from lobewise.filters.fireflies import find_energy_lost
from lobewise.filters.forms import Taps

pytestmark = pytest.mark.processor

PROGRAM = """
import numpy as np
from lobewise.filters.cross_filter import run_filter
from lobewise.features.base import NormalFeature, ScreenFeature
from lobewise.backend.jit import _compile
import lobewise.backend.jit as loading
made = []
loading._compile = lambda write: (made.append(1), _compile(write))[1]
Own = type("Own", (ScreenFeature,), {{}})
FEATURE = {feature}
image = run_filter(np.ones((4, 5, 3), np.float32), np.ones((4, 5), bool), [FEATURE], form="full", radius=1).image
print(len(made), np.abs(image - 1.0).max() < 1e-5)
"""


def run_program(folder: Path | str, feature: str = "ScreenFeature(1.0)") -> str:
    """Return how much a process that filters compiled, and whether its result is right."""
    told = {**os.environ, "LOBEWISE_CACHE": str(folder)}
    program = PROGRAM.format(feature=feature)
    return subprocess.run([sys.executable, "-c", program], capture_output=True, check=True, env=told, text=True).stdout


class TestFolder:
    def test_second_process_compiles_nothing(self, tmp_path):
        # The runtime and the kernel.
        assert run_program(tmp_path / "new") == "2 True\n"
        assert len(list((tmp_path / "new").glob("*.kernel"))) == 2
        assert run_program(tmp_path / "new") == "0 True\n"

    def test_features_of_others_are_compiled_in_every_process(self, tmp_path):
        assert run_program(tmp_path, "Own(1.0)") == "2 True\n"
        assert run_program(tmp_path, "Own(1.0)") == "1 True\n"

    def test_off(self, tmp_path):
        assert run_program("off") == "2 True\n"
        assert not Path("off").exists()

    @pytest.mark.parametrize("damage", [b"", b"nonsense", b"{}\n", b'{"sha256": "0"}\nabc'])
    def test_what_is_not_whole_is_made_again(self, tmp_path, monkeypatch, damage):
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path))
        made: list[int] = []

        def make() -> tuple[bytes, dict[str, Any]]:
            made.append(1)
            return b"code\nwith a line", {"kinds": ["buffer"]}

        content, head = fetch_object("something", make)
        (path,) = tmp_path.glob("*.kernel")
        path.write_bytes(damage)
        for _ in range(2):
            assert fetch_object("something", make)[0] == content == b"code\nwith a line"
        assert head["kinds"] == ["buffer"]
        assert len(made) == 2
        assert list(tmp_path.iterdir()) == [path]

    def test_a_folder_that_cannot_be_made_is_done_without(self, tmp_path, monkeypatch):
        (tmp_path / "file").write_text("")
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path / "file" / "folder"))
        assert fetch_object("something", lambda: (b"code", {}))[0] == b"code"

    def test_files_not_used_for_longest_go(self, tmp_path, monkeypatch):
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path))
        monkeypatch.setattr(loading, "OLD_FILES", 4)
        for number in range(4):
            path = tmp_path / f"{number}.kernel"
            path.write_text("")
            os.utime(path, (number, number))
        fetch_object("something", lambda: (b"code", {}))
        left = sorted(path.name for path in tmp_path.iterdir())
        assert len(left) == 2
        assert "3.kernel" in left

    def test_another_source_is_another_file(self, tmp_path, monkeypatch):
        monkeypatch.setenv("LOBEWISE_CACHE", str(tmp_path))
        fetch_object("something", lambda: (b"old", {}))
        monkeypatch.setattr(loading, "_describe_sources", lambda: "changed")
        assert fetch_object("something", lambda: (b"new", {}))[0] == b"new"

    @pytest.mark.parametrize(
        ("platform", "told", "expected"),
        [
            ("linux", {"XDG_CACHE_HOME": "/x"}, "/x/lobewise"),
            ("linux", {"HOME": "/home/a", "XDG_CACHE_HOME": ""}, "/home/a/.cache/lobewise"),
            ("darwin", {"HOME": "/Users/a"}, "/Users/a/Library/Caches/lobewise"),
            ("win32", {"LOCALAPPDATA": "/local"}, "/local/lobewise"),
        ],
    )
    def test_each_system_has_its_own_place(self, monkeypatch, platform, told, expected):
        monkeypatch.delenv("LOBEWISE_CACHE", raising=False)
        monkeypatch.setattr(sys, "platform", platform)
        for name, value in told.items():
            monkeypatch.setenv(name, value)
        assert find_cache_folder() == Path(expected)


class TestKey:
    def test_tells_classes_functions_and_values_apart(self):
        keys = [
            (ScreenFeature, ()),
            (NormalFeature, ()),
            (find_energy_lost, True),
            (find_energy_lost, False),
            PassKey(Taps.SQUARE, 1, (), first=True, last=True, demodulate=False),
            PassKey(Taps.SQUARE, 2, (), first=True, last=True, demodulate=False),
            PassKey(Taps.ATROUS, 1, (), first=True, last=True, demodulate=False),
            ("1",),
            (1,),
            ((1,), ()),
            ((), (1,)),
        ]
        told = [describe_key(key) for key in keys]
        assert None not in told
        assert len(set(told)) == len(keys)

    @pytest.mark.parametrize("part", [lambda: 0, type("Own", (ScreenFeature,), {}), np.zeros(2), object()])
    def test_knows_what_is_not_its_own(self, part):
        assert describe_key((ScreenFeature, part)) is None


class TestCalls:
    def test_a_problem_is_an_error(self):
        runtime = get_runtime("cpu")

        def tell(code: int) -> int:
            runtime._keep_problem(None, b"it burns")
            return code

        with pytest.raises(
            DeviceError, match="device: expected cpu to run a kernel, got it burns; try a smaller image"
        ):
            runtime.call(tell, 0)
        with pytest.raises(DeviceError, match="got code 3"):
            runtime.call(lambda: 3)

    def test_a_missing_function(self):
        with pytest.raises(LookupError, match="nothing_of_this_name"):
            get_runtime("cpu").find("nothing_of_this_name")

    def test_as_many_arguments_as_it_has(self):
        kernel = loading.Kernel(get_runtime("cpu"), 1, ["buffer", "int32"])
        with pytest.raises(TypeError, match="a kernel of 2 arguments was given 1"):
            kernel(Buffer(np.zeros(1, np.float32)))

    def test_one_runtime_for_a_device(self):
        assert get_runtime("cpu") is get_runtime("cpu")
        assert isinstance(get_runtime("cpu"), Runtime)
