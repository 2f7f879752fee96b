"""What goes into an extension for Blender, and into its manifest. `tests/extensions` builds, installs and uses one."""

import sys
import zipfile
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from lobewise.backend.prebuilt import name_system
from releasing import blender
from releasing.blender import MANIFEST, RELEASES, SOURCE, lay_out, list_bundled, list_systems, list_tool
from releasing.sbom import read_project
from releasing.systems import SYSTEMS

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

KERNELS, COMPILED = ["numpy>=1.26", "typer>=0.15", "OpenEXR>=3.5.3; python_version >= '3.11'"], ["halide>=21,<22"]
BEST = [
    f"{package}; ({marker}) and extra == 'best'"
    for package, _, marker in (line.partition("; ") for line in read_project()["optional-dependencies"]["best"])
]


def make_wheel(folder: Path, tag: str, requirements: list[str]) -> Path:
    """Write a wheel that holds its metadata alone."""
    path = folder / f"lobewise-0.1.0-py3-none-{tag}.whl"
    lines = ["Metadata-Version: 2.4", "Name: lobewise", "Version: 0.1.0"]
    with zipfile.ZipFile(path, "w") as file:
        text = "\n".join([*lines, *(f"Requires-Dist: {each}" for each in [*requirements, *BEST])])
        file.writestr("lobewise-0.1.0.dist-info/METADATA", text + "\n")
    return path


@pytest.mark.parametrize("system", SYSTEMS.values(), ids=lambda system: system.name)
@pytest.mark.parametrize("release", RELEASES, ids=lambda release: release.first)
def test_all_that_blender_lacks_is_bundled(system: Any, release: Any, tmp_path: Path) -> None:
    wheel = make_wheel(tmp_path, system.tag, KERNELS)
    assert list_systems(wheel) == [system]
    names = {each.name for each in list_bundled(wheel, system, release.minor)}
    # Rich is needed by typer.
    assert names >= {"openexr", "typer", "rich"}
    assert names.isdisjoint({"numpy", "halide", "lobewise", "tomli"})
    assert ("pyoidn" in names) == (system.name != "linux-arm-64")
    assert ("colorama" in names) == system.name.startswith("windows")


def test_a_wheel_without_kernels_brings_their_compiler(tmp_path: Path) -> None:
    wheel = make_wheel(tmp_path, "any", [*KERNELS, *COMPILED])
    (system,) = list_systems(wheel)
    assert system.name == name_system()
    assert "halide" in {each.name for each in list_bundled(wheel, system, 11)}


def test_markers_are_those_of_blender(tmp_path: Path) -> None:
    wheel = make_wheel(tmp_path, "any", ["halide>=21; sys_platform != 'linux' or platform_machine == 'x86_64'"])
    for system in SYSTEMS.values():
        names = {each.name for each in list_bundled(wheel, system, 11)}
        assert ("halide" in names) == (system.name != "linux-arm-64"), system.name


def test_pip_is_asked_for_the_locked_files_of_the_system(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: dict[str, str] = {}

    def note(command: list[str], *, check: bool) -> None:
        asked["command"] = " ".join(command)
        asked["lines"] = Path(command[command.index("-r") + 1]).read_text()

    monkeypatch.setattr(blender.subprocess, "run", note)
    for name, tag in {
        "linux-arm-64": "manylinux_2_17_aarch64",
        "windows-x86-64": "win_amd64",
        "macos-arm-64": "macosx_13_0_arm64",
        "macos-x86-64": "macosx_13_0_x86_64",
    }.items():
        wheel = make_wheel(tmp_path, SYSTEMS[name].tag, KERNELS)
        packages = list_bundled(wheel, SYSTEMS[name], 13)
        blender.download(packages, SYSTEMS[name], 13, tmp_path)
        assert f"--platform={tag}" in asked["command"].split()
        assert "--require-hashes" in asked["command"]
        assert "--python-version=3.13" in asked["command"]
        assert len(asked["lines"].splitlines()) == len(packages)
        (typer,) = (each for each in packages if each.name == "typer")
        assert f"typer=={typer.version} --hash=sha256:{typer.digests[0]}" in asked["lines"]


@pytest.mark.parametrize("release", RELEASES, ids=lambda release: release.first)
def test_the_manifest_names_every_wheel(release: Any, tmp_path: Path) -> None:
    system = SYSTEMS["macos-arm-64"]
    wheel = make_wheel(tmp_path, system.tag, KERNELS)
    lay_out([wheel], system, release, tmp_path / "made")
    manifest = tomllib.loads((tmp_path / "made" / MANIFEST).read_text(encoding="utf-8"))
    assert manifest["wheels"] == [f"./wheels/{wheel.name}"]
    assert (tmp_path / "made" / manifest["wheels"][0]).read_bytes() == wheel.read_bytes()
    assert manifest["platforms"] == ["macos-arm64"]
    assert manifest["version"] == read_project()["version"]
    assert manifest["blender_version_min"] == release.first
    assert manifest.get("blender_version_max", "") == release.end
    assert manifest["license"] == [f"SPDX:{read_project()['license']}"]
    assert manifest["permissions"].keys() == {"files"}
    sources = {path.name for path in SOURCE.iterdir() if path.is_file()}
    assert {path.name for path in (tmp_path / "made").iterdir()} == {*sources, "LICENSE", "wheels"}


def test_versions_of_blender_follow_each_other() -> None:
    assert [each.end for each in RELEASES] == [*(each.first for each in RELEASES[1:]), ""]


def test_blender_on_the_path_builds_and_is_asked_for_where_it_is_absent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("LOBEWISE_BPY_PYTHON", raising=False)
    monkeypatch.setattr(blender.subprocess, "run", lambda *_, **__: SimpleNamespace(stdout="\n"))
    monkeypatch.setattr(blender.shutil, "which", lambda name: None)
    with pytest.raises(SystemExit, match="put blender on the PATH, or set LOBEWISE_BPY_PYTHON"):
        list_tool()
    monkeypatch.setattr(blender.shutil, "which", lambda name: f"/usr/bin/{name}")
    assert list_tool() == ["/usr/bin/blender", "--command", "extension"]
