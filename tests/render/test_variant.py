"""The search for libLLVM, and the import of Mitsuba; most of it needs neither."""

import sys
from pathlib import Path
from typing import Any

import pytest

from lobewise.errors import DeviceError, InputError, MissingDependencyError
from lobewise.render import variant
from tests.mistakes import refuses
from tests.pythons import run_python


def _run(code: str, **environment: str) -> str:
    """Run code in a fresh interpreter, warnings as errors, and return what it prints."""
    return run_python("-W", "error", "-c", code, **environment).strip()


@pytest.mark.parametrize(
    ("path", "version"),
    [
        ("/usr/lib/x86_64-linux-gnu/libLLVM.so.19.1", 19),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-19.so", 19),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-15.so.1", 15),
        ("/usr/lib/x86_64-linux-gnu/libLLVM-14.0.6.so.1", 14),
        ("/usr/lib/llvm-18/lib/libLLVM.so", 18),
        ("/usr/lib64/libLLVM.so.20.1", 20),
        ("/opt/homebrew/opt/llvm@17/lib/libLLVM.dylib", 17),
        ("/usr/local/lib/libLLVM.so", None),
    ],
)
def test_version_is_read_from_the_path(path: str, version: int | None) -> None:
    assert variant.parse_llvm_version(path) == version


def test_ranking_prefers_the_tested_version_then_the_newest_and_drops_the_old() -> None:
    paths = ["/a/libLLVM-15.so", "/a/libLLVM.so", "/a/libLLVM-16.so", "/a/libLLVM-21.so", "/a/libLLVM.so.19.1"]
    expected = ["/a/libLLVM.so.19.1", "/a/libLLVM-21.so", "/a/libLLVM-16.so", "/a/libLLVM.so"]
    assert variant.rank_llvm_libraries(paths) == expected


def test_first_library_that_reports_a_good_version_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    reported = {"/a/libLLVM-19.so": None, "/a/libLLVM-18.so": 18, "/a/libLLVM-17.so": 17}
    monkeypatch.delenv(variant.LIBRARY_VARIABLE, raising=False)
    monkeypatch.setattr(variant, "list_llvm_libraries", lambda: list(reported))
    monkeypatch.setattr(variant, "query_llvm_version", reported.get)
    assert variant.locate_llvm() == "/a/libLLVM-18.so"


def test_set_variable_is_honoured(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(variant.LIBRARY_VARIABLE, "/mine/libLLVM.so")
    monkeypatch.setattr(variant, "query_llvm_version", lambda path: 16)
    monkeypatch.setattr(variant, "list_llvm_libraries", lambda: pytest.fail("the variable says it all"))
    assert variant.locate_llvm() == "/mine/libLLVM.so"


@pytest.mark.parametrize("version", [None, 15])
def test_set_variable_that_names_a_bad_library_is_an_error(
    monkeypatch: pytest.MonkeyPatch, version: int | None
) -> None:
    monkeypatch.setenv(variant.LIBRARY_VARIABLE, "/mine/libLLVM-15.so")
    monkeypatch.setattr(variant, "query_llvm_version", lambda path: version)
    with refuses(
        MissingDependencyError, "DRJIT_LIBLLVM_PATH", "libLLVM-15.so", "the path of a libLLVM of version 16 or newer"
    ):
        variant.locate_llvm()


@pytest.mark.parametrize("found", [[], ["/a/libLLVM-15.so"]])
def test_no_library_names_the_package_to_install(monkeypatch: pytest.MonkeyPatch, found: list[str]) -> None:
    monkeypatch.delenv(variant.LIBRARY_VARIABLE, raising=False)
    monkeypatch.setattr(variant, "list_llvm_libraries", lambda: found)
    with refuses(MissingDependencyError, "libLLVM") as caught:
        variant.locate_llvm()
    assert (found[0] if found else "none on this machine") in str(caught.value)


def test_a_file_that_is_no_library_has_no_version(tmp_path: Path) -> None:
    path = tmp_path / "libLLVM-19.so"
    path.write_text("not a library")
    assert variant.query_llvm_version(str(path)) is None
    assert variant.query_llvm_version(str(tmp_path / "absent.so")) is None


def test_old_libraries_of_this_machine_are_refused() -> None:
    old = [path for path in variant.list_llvm_libraries() if (variant.parse_llvm_version(path) or 99) < 16]
    if not old:
        pytest.skip("no LLVM older than 16 is installed here; there is nothing to refuse")
    assert all(variant.query_llvm_version(path) is None for path in old)


def test_unknown_device_is_an_error() -> None:
    with refuses(InputError, "device"):
        variant.load_mitsuba("cudda")


def test_missing_package_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    monkeypatch.delitem(sys.modules, "lobewise.render.bridge", raising=False)
    with refuses(MissingDependencyError, "rendering"):
        variant.load_mitsuba()


def test_missing_package_is_told_at_first_use_too() -> None:
    code = """
import sys
sys.modules["mitsuba"] = None
import lobewise.render
try:
    lobewise.render.render_frame
except Exception as error:
    print(type(error).__name__, error)
"""
    printed = _run(code)
    assert printed.startswith("MissingDependencyError")
    assert "pip install 'lobewise[mitsuba]'" in printed


def test_importing_the_room_imports_no_mitsuba() -> None:
    code = "import sys, lobewise.render; print('mitsuba' in sys.modules, 'drjit' in sys.modules)"
    assert _run(code) == "False False"
    names = "showroom brushed parlour sparks stilllife corridor kitchen street"
    assert _run("from lobewise.render import list_scenes; print(*list_scenes())") == names


def test_unknown_name_is_an_attribute_error() -> None:
    import lobewise.render

    with pytest.raises(AttributeError, match="rendr_frame"):
        lobewise.render.rendr_frame  # noqa: B018 - the access is what is tested


@pytest.mark.mitsuba
def test_variant_that_the_user_set_is_kept(mi: Any) -> None:
    code = """
import mitsuba
from lobewise.render.variant import locate_llvm, load_mitsuba
import os
os.environ["DRJIT_LIBLLVM_PATH"] = locate_llvm()
mitsuba.set_variant("llvm_ad_rgb")
scene = mitsuba.load_dict({"type": "scene"})
print(load_mitsuba("auto").variant(), load_mitsuba("cpu").variant())
try:
    load_mitsuba("cuda")
except Exception as error:
    print(type(error).__name__)
"""
    assert _run(code).split() == ["llvm_ad_rgb", "llvm_ad_rgb", "DeviceError"]


@pytest.mark.mitsuba
def test_cuda_without_a_device_is_an_error(mi: Any) -> None:
    import drjit

    if drjit.has_backend(drjit.JitBackend.CUDA):
        pytest.skip("this machine has a CUDA device")
    with refuses(DeviceError, "device"):
        variant.load_mitsuba("cuda")
