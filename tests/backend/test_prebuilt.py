"""Kernels that come compiled with the package: used without a compiler, with the bits of the compiler, or refused."""

import ctypes
import json
import re
import shutil
import subprocess
from collections.abc import Callable
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import lobewise
from lobewise.backend import prebuilt
from lobewise.errors import MissingDependencyError
from releasing.frames import make_frame
from releasing.libraries import build, compile_kernels, write_exports
from releasing.recording import record_kernels
from releasing.systems import SYSTEMS, System
from tests.mistakes import refuses
from tests.pythons import run_python

pytestmark = pytest.mark.skipif(
    prebuilt.name_system() not in SYSTEMS or shutil.which("cc") is None, reason="needs a C compiler and a known system"
)

RUN = """
import sys
from pathlib import Path
from lobewise.backend import prebuilt
{setup}
import numpy as np
import lobewise
from releasing.frames import make_frame
clean = lobewise.denoise(make_frame(), quality="fast", radius=3, device="cpu")
np.save({output!r}, clean.image)
print(sorted(name for name in ("halide", "llvmlite") if sys.modules.get(name)))
"""
BLOCKED = "sys.modules.update(halide=None, llvmlite=None); prebuilt.FOLDER = Path({folder!r})"
COMPILED = """
import halide as hl
hl.get_host_target = lambda: hl.Target({target!r})
"""


def get_system() -> System:
    """Return this system, with the two levels that most processors run."""
    system = SYSTEMS[prebuilt.name_system()]
    return replace(system, levels=system.levels[-2:])


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with libraries of the kernels of the quality "fast", and of a kernel that counts by lanes."""
    with record_kernels() as kernels:
        lobewise.denoise(make_frame(), quality="fast", radius=3, device="cpu")
    assert len(kernels) >= 5
    with record_kernels() as more:
        lobewise.denoise(make_frame(), quality="balanced", radius=3, device="cpu")
    kernels |= dict([next(each for each in more.items() if "fireflies" in str(each[1].make))])
    made = tmp_path_factory.mktemp("libraries") / "kernels"
    build(get_system(), made, ["cc"], kernels, lambda target, work: compile_kernels(kernels, target, work))
    return made


def run(setup: str, output: Path) -> str:
    """Run the recipe in a process of its own, and return what it printed."""
    return run_python("-c", RUN.format(setup=setup, output=str(output)))


@pytest.mark.nightly
def test_the_library_has_the_bits_of_the_compiler(folder: Path, tmp_path: Path) -> None:
    library = prebuilt.open_library(folder)
    printed = run(BLOCKED.format(folder=str(folder)), tmp_path / "library.npy")
    assert printed.strip() == "[]", "a compiler was loaded"
    run(COMPILED.format(target=library.target.replace("-no_asserts-no_bounds_query", "")), tmp_path / "compiled.npy")
    found, expected = (np.load(tmp_path / f"{name}.npy") for name in ("library", "compiled"))
    assert np.isfinite(found).all()
    np.testing.assert_array_equal(found, expected)


@pytest.mark.nightly
def test_every_level_has_the_parameters_of_its_own_lanes(folder: Path, tmp_path: Path) -> None:
    copy = shutil.copytree(folder, tmp_path / "copy")
    for level in json.loads((folder / prebuilt.INDEX_NAME).read_bytes())["levels"]:
        edit_index(copy, lambda index, level=level: index.update(levels=[level]))
        library = prebuilt.open_library(copy)
        (parameters,) = [told for name, told in library.kernels.values() if name == "fireflies"]
        counts = {each[0]: each[3] for each in parameters}
        assert counts["seen"] == counts["taken"] == ["height", level["lanes"]]


@pytest.mark.nightly
def test_a_compiled_kernel_runs_beside_the_library(folder: Path, tmp_path: Path) -> None:
    """A kernel that the library lacks is compiled for its target, and calls its runtime."""
    code = f"""
from pathlib import Path
from lobewise.backend import prebuilt
prebuilt.FOLDER = Path({str(folder)!r})
from lobewise.backend.devices import make_target
from lobewise.backend.runtime import get_runtime
import lobewise
from releasing.frames import make_frame
library = prebuilt.choose_library()
assert str(make_target("cpu")) == library.target
clean = lobewise.denoise(make_frame(), quality="fast", radius=2, device="cpu")
assert get_runtime("cpu").find("halide_malloc") == library.find("halide_malloc")
print(clean.image.mean() > 0.0)
"""
    assert run_python("-c", code) == "True\n"


@pytest.mark.nightly
def test_a_kernel_that_the_library_lacks_is_refused_without_a_compiler(folder: Path, tmp_path: Path) -> None:
    code = f"""
import sys
from pathlib import Path
from lobewise.backend import prebuilt
{BLOCKED.format(folder=str(folder))}
import lobewise
from releasing.frames import make_frame
for changes in ({{"form": "atrous"}}, {{"radius": 3, "device": "vulkan"}}):
    try:
        lobewise.denoise(make_frame(), quality="fast", **changes)
    except lobewise.LobewiseError as problem:
        print(problem)
"""
    told = run_python("-c", code).splitlines()
    assert len(told) == 2
    assert all("pip install 'lobewise[jit]'" in line for line in told)


def edit_index(folder: Path, change: Callable[[dict[str, Any]], None]) -> Path:
    """Change the index of a copy of a folder, and return the copy."""
    index = json.loads((folder / prebuilt.INDEX_NAME).read_text())
    change(index)
    (folder / prebuilt.INDEX_NAME).write_text(json.dumps(index))
    return folder


def test_the_index_names_what_the_libraries_were_made_with(folder: Path) -> None:
    index = json.loads((folder / prebuilt.INDEX_NAME).read_text())
    assert index["halide"] == version("halide")
    # Halide is numbered as the LLVM that it was made with.
    assert re.fullmatch(rf"{index['halide'].partition('.')[0]}\.\d+\.\d+", index["llvm"])
    assert index["linker"] == "cc"


@pytest.fixture
def copy(folder: Path, tmp_path: Path) -> Path:
    """Return a copy of the folder of libraries."""
    return Path(shutil.copytree(folder, tmp_path / "copy"))


def change_source(index: dict[str, Any]) -> None:
    """Pretend that a module was another one when the kernels were compiled."""
    assert index["sources"].keys() >= {"filters/cross_pass.py", "backend/expressions.py"}
    index["sources"]["filters/cross_pass.py"] = "0" * 32


def change_system(index: dict[str, Any]) -> None:
    """Pretend that the kernels are those of another system."""
    index["system"] = "amiga-m68k"


@pytest.mark.parametrize(("change", "words"), [(change_source, "filters/cross_pass.py"), (change_system, "amiga-m68k")])
def test_libraries_of_other_code_or_systems_are_not_used(
    copy: Path, monkeypatch: pytest.MonkeyPatch, change: Callable[[dict[str, Any]], None], words: str
) -> None:
    assert prebuilt.open_library(copy) is not None
    edit_index(copy, change)
    assert prebuilt.open_library(copy) is None
    monkeypatch.setattr(prebuilt, "has_compiler", lambda: False)
    with refuses(MissingDependencyError, "kernels") as caught:
        prebuilt.open_library(copy)
    assert words in caught.value.got


def test_the_best_level_that_the_processor_runs_is_chosen(
    copy: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    text = tmp_path / "other.c"
    text.write_text("int lobewise_runs_here(void) { return 0; }\n")
    subprocess.run(["cc", "-shared", "-fPIC", "-o", str(copy / "other.so"), str(text)], check=True)
    other = {"file": "other.so", "target": "x86-64-linux-avx1024", "lanes": 32}
    edit_index(copy, lambda index: index["levels"].insert(0, other))
    library = prebuilt.open_library(copy)
    assert library.target != other["target"]
    edit_index(copy, lambda index: index.update(levels=[other]))
    assert prebuilt.open_library(copy) is None
    monkeypatch.setattr(prebuilt, "has_compiler", lambda: False)
    with refuses(MissingDependencyError, "kernels"):
        prebuilt.open_library(copy)


def test_a_source_install_has_no_libraries(tmp_path: Path) -> None:
    assert prebuilt.open_library(tmp_path) is None


def test_libraries_of_windows_show_kernels_and_what_they_call(tmp_path: Path) -> None:
    kernel, runtime = tmp_path / "0123abcd.o", tmp_path / "runtime.o"
    kernel.write_bytes(b"code\0halide_do_par_for\0kernel_0123abcd\0halide_error \0")
    runtime.write_bytes(b"\0halide_internal\0")
    told = write_exports([kernel, runtime], tmp_path / "exports.c").read_text()
    names = re.findall(r"-export:(\w+)", told)
    called = ["halide_set_custom_print", "halide_set_error_handler", "halide_shutdown_thread_pool"]
    assert names == ["halide_do_par_for", *called, "kernel_0123abcd_argv"]


FLAGS = {
    "x86-64-v2": {"sse4_1", "sse4_2", "ssse3"},
    "x86-64-v3": {"avx2", "fma", "f16c", "bmi1", "bmi2"},
    "x86-64-v4": {"avx512f", "avx512dq", "avx512cd", "avx512bw", "avx512vl"},
}


@pytest.mark.skipif(prebuilt.name_system() != "linux-x86-64", reason="reads Linux' list of instructions")
def test_libraries_know_the_processor(tmp_path: Path) -> None:
    text = Path("/proc/cpuinfo").read_text()
    has = set(next(line for line in text.splitlines() if line.startswith("flags")).split())
    source = Path(__file__).parents[2] / "releasing" / "processor.c"
    wanted: set[str] = set()
    for level in reversed(SYSTEMS["linux-x86-64"].levels):
        wanted |= FLAGS[level.name]
        output = tmp_path / f"{level.name}.so"
        options = ["-Wall", "-Wextra", "-Werror", "-O2", "-shared", "-fPIC", f"-DLEVEL={level.number}"]
        subprocess.run(["cc", *options, "-o", str(output), str(source)], check=True)
        assert bool(ctypes.CDLL(str(output)).lobewise_runs_here()) == (wanted <= has), level.name
