"""What goes into a wheel, and how it is weighed."""

import importlib.util
import json
import sys
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from releasing import wheels
from releasing.systems import SYSTEMS

ROOT = Path(__file__).parents[2]


@pytest.fixture
def hook(monkeypatch: pytest.MonkeyPatch) -> Any:
    """Return the hook of the build; only its base class is hatchling's."""
    parent = ModuleType("hatchling.builders.hooks.plugin.interface")
    parent.BuildHookInterface = object  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, parent.__name__, parent)
    described = importlib.util.spec_from_file_location("wheel_hook", ROOT / "releasing" / "wheel_hook.py")
    module = importlib.util.module_from_spec(described)
    described.loader.exec_module(module)
    made = module.KernelsHook()
    made.target_name = "wheel"
    made.metadata = SimpleNamespace(core=SimpleNamespace(optional_dependencies={"jit": ["halide>=21", "llvmlite"]}))
    return made


COMPILER = [
    f"{package}; python_version < '3.14' and (sys_platform != 'linux' or platform_machine == 'x86_64')"
    for package in ("halide>=21", "llvmlite")
]


def make_data() -> dict[str, Any]:
    """Return the data of a build before hooks."""
    return {"pure_python": True, "force_include": {}, "dependencies": [], "sbom_files": []}


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda system: system.name)
def test_a_wheel_with_kernels_is_for_one_system(
    system: Any, hook: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "index.json").write_text(json.dumps({"wheel": system.tag}))
    monkeypatch.setenv("LOBEWISE_KERNELS", str(tmp_path))
    monkeypatch.setenv("LOBEWISE_SBOM", "bill.json")
    data = make_data()
    hook.initialize("standard", data)
    assert data == {
        "pure_python": False,
        "tag": f"py3-none-{system.tag}",
        "force_include": {str(tmp_path): "lobewise/backend/prebuilt"},
        "dependencies": [],
        "sbom_files": ["bill.json"],
    }


@pytest.mark.parametrize(
    ("target", "version", "folder"),
    [("wheel", "standard", ""), ("wheel", "editable", "kernels"), ("sdist", "standard", "kernels")],
)
def test_what_has_no_kernels_requires_their_compiler(
    target: str, version: str, folder: str, hook: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("LOBEWISE_KERNELS", folder)
    hook.target_name = target
    data = make_data()
    hook.initialize(version, data)
    assert data == {**make_data(), "dependencies": COMPILER}


def test_the_hook_is_run_for_every_kind_of_build() -> None:
    assert "[tool.hatch.build.hooks.custom]" in (ROOT / "pyproject.toml").read_text()


def make_row(megabytes: float, first: float) -> dict[str, Any]:
    """Return the figures of an installation whose second call takes a second."""
    return {
        "python": "3.12.1",
        "megabytes_without_numpy": megabytes,
        "first_processor_seconds": first,
        "second_processor_seconds": 1.0,
    }


@pytest.mark.parametrize(
    ("row", "words"), [(make_row(120.0, 3.0), ""), (make_row(120.1, 1.0), "120.1 MB"), (make_row(1.0, 3.1), "2.1 s")]
)
def test_limits(row: dict[str, Any], words: str) -> None:
    faults = wheels.list_faults([row])
    assert len(faults) == bool(words)
    assert words in "".join(faults)


def test_sizes_of_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name, size in {
        "numpy/core.so": 3_000_000,
        "numpy.libs/blas.so": 2_000_000,
        "numpy-2.1.0.dist-info/METADATA": 1_000_000,
        "lobewise/backend/prebuilt/index.json": 4_000_000,
        "lobewise-0.1.0.dist-info/RECORD": 500_000,
        "pip/main.py": 9_000_000,
        "pip-25.0.dist-info/RECORD": 9_000_000,
    }.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(bytes(size))

    class Done:
        stdout = f"{tmp_path}\n"

    monkeypatch.setattr(wheels.subprocess, "run", lambda *_, **__: Done())
    assert wheels.weigh_packages(Path("bin")) == {"numpy": 6.0, "lobewise": 4.5}


def test_wheels_hold_pictures_only_where_verbs_read_them() -> None:
    data = ROOT / "src" / "lobewise" / "data"
    sizes = {path.name: path.stat().st_size for path in data.iterdir() if path.suffix != ".html"}
    assert sizes.keys() == {"demo.exr", "demo-reference.exr"}
    assert sizes["demo.exr"] < 400_000
    assert sum(sizes.values()) < 500_000


def test_the_readme_has_the_commands_that_a_release_runs(monkeypatch: pytest.MonkeyPatch) -> None:
    ran: list[list[str]] = []
    monkeypatch.setattr(wheels.subprocess, "run", lambda command, **_: ran.append(command))
    demo, tests = wheels.run_readme("python3.12")
    assert demo["ran"].endswith("lobewise demo")
    assert tests["ran"].endswith("pytest tests/test_startup.py tests/backend")
    assert [command[0] for command in ran] == ["git", "bash"] * 2
