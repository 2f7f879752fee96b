"""The bill of materials names what a wheel contains, what made it, and what pip installs beside it."""

import hashlib
import json
import zipfile
from collections.abc import Callable
from datetime import datetime, timezone
from functools import cache
from importlib.metadata import distributions
from pathlib import Path
from typing import Any

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from releasing.lock import list_environments, parse_lock, read_lock
from releasing.sbom import LICENCES, PYTHON_SYSTEMS, list_needed, make_sbom, read_project
from releasing.systems import SYSTEMS
from releasing.wheels import build_wheel

Bill = Callable[..., dict[str, Any]]
MADE = datetime(2026, 1, 2, 3, 4, 5, tzinfo=timezone.utc)


def make_bill(folder: Path, system: str = "linux-x86-64", linker: str = "ziglang 0.13.0") -> dict[str, Any]:
    """Return the bill of a wheel with one library."""
    (folder / "x86-64-v3.so").write_bytes(b"code")
    level = {"file": "x86-64-v3.so"}
    index = {"halide": "21.0.0", "llvm": "21.1.1", "linker": linker, "system": system, "levels": [level]}
    index["wheel"] = SYSTEMS[system].tag
    (folder / "index.json").write_text(json.dumps(index))
    bill: dict[str, Any] = json.loads(make_sbom(folder, MADE))
    return bill


@pytest.fixture(scope="module")
def get_bill(tmp_path_factory: pytest.TempPathFactory) -> Bill:
    """Return what makes a bill and keeps it: each takes a second."""
    return cache(lambda *words, **more: make_bill(tmp_path_factory.mktemp("kernels"), *words, **more))


def read_place(component: dict[str, Any]) -> str:
    """Return where a component is."""
    return {one["name"]: one["value"] for one in component["properties"]}["lobewise:place"]


def test_the_bill_names_what_the_wheel_contains(get_bill: Bill) -> None:
    bill = get_bill()
    assert (bill["bomFormat"], bill["specVersion"]) == ("CycloneDX", "1.6")
    own = bill["metadata"]["component"]
    assert own["purl"] == f"pkg:pypi/lobewise@{read_project()['version']}"
    contained = {one["name"]: one for one in bill["components"] if read_place(one) == "in the wheel"}
    assert contained.keys() == {"halide", "lobewise/backend/prebuilt/x86-64-v3.so"}
    library = contained["lobewise/backend/prebuilt/x86-64-v3.so"]
    assert library["hashes"] == [{"alg": "SHA-256", "content": hashlib.sha256(b"code").hexdigest()}]
    depends = {one["ref"]: one.get("dependsOn", []) for one in bill["dependencies"]}
    assert depends[library["bom-ref"]] == ["pkg:pypi/halide@21.0.0"]
    assert library["bom-ref"] in depends[own["purl"]]
    tools = {one["name"]: one["version"] for one in bill["metadata"]["tools"]["components"]}
    assert tools["llvm"] == "21.1.1"
    assert tools["ziglang"] == "0.13.0"
    assert bill["metadata"]["timestamp"] == MADE.isoformat()


@pytest.mark.sampled("linux-x86-64", "windows-x86-64")
@pytest.mark.parametrize("system", SYSTEMS)
def test_the_bill_names_all_that_pip_installs(system: str, get_bill: Bill) -> None:
    bill = get_bill() if system == "linux-x86-64" else get_bill(system)
    needed = [one for one in bill["components"] if read_place(one) == "beside the wheel"]
    assert {one["name"] for one in needed} >= {
        canonicalize_name(Requirement(line).name) for line in read_project()["dependencies"]
    }
    assert ("colorama" in {one["name"] for one in needed}) == system.startswith("windows")
    locked = {(each.name, str(each.version)): each.digests for each in read_lock()}
    for one in needed:
        digests = [each["content"] for each in one["externalReferences"][0]["hashes"]]
        assert sorted(digests) == sorted(locked[one["name"], one["version"]])
    assert all(one["licenses"] for one in bill["components"])


def test_other_versions_of_python_have_their_own_packages(get_bill: Bill) -> None:
    bill = get_bill()
    depends = {one["ref"]: one.get("dependsOn", []) for one in bill["dependencies"]}
    several = {}
    for one in bill["components"]:
        several.setdefault(one["name"], []).append(one["bom-ref"])
    old, new = sorted(several["openexr"])
    numpy_of_old, numpy_of_new = ({each for each in depends[one] if "numpy" in each} for one in (old, new))
    assert numpy_of_old
    assert numpy_of_new
    assert not numpy_of_old & numpy_of_new


def test_the_same_release_has_the_same_bill(get_bill: Bill, tmp_path: Path) -> None:
    assert make_bill(tmp_path) == get_bill()


def test_a_linker_of_the_system_is_named(tmp_path: Path) -> None:
    tools = make_bill(tmp_path, linker="cc")["metadata"]["tools"]["components"]
    assert "cc" in {one["name"] for one in tools}


def test_packages_of_packages_are_needed() -> None:
    lines = ["asked==1", "inner==1", "innermost==1", "other==1"]
    notes = ["lobewise (pyproject.toml)", "asked", "inner", "lobewise (pyproject.toml)"]
    digest = f" \\\n    --hash=sha256:{'0' * 64}\n"
    locked = parse_lock("".join(f"{line}{digest}    # via {note}\n" for line, note in zip(lines, notes, strict=True)))
    found = list_needed(["Asked>=1"], locked, list_environments(["linux"]))
    assert [each.name for each in found] == ["asked", "inner", "innermost"]


def test_every_system_has_a_name_in_markers() -> None:
    assert {name.partition("-")[0] for name in SYSTEMS} == PYTHON_SYSTEMS.keys()


def test_no_licence_is_left_of_a_package_that_is_gone(get_bill: Bill) -> None:
    bill = get_bill("windows-x86-64")
    named = bill["components"] + bill["metadata"]["tools"]["components"] + [bill["metadata"]["component"]]
    assert {one["name"] for one in named} >= LICENCES.keys()


def test_licences_are_those_of_the_installed_packages() -> None:
    told = {}
    for one in distributions():
        name = canonicalize_name(one.name)
        # Where `importlib_metadata` was imported, a missing key is an error.
        if name in LICENCES and "License-Expression" in one.metadata:
            told[name] = one.metadata["License-Expression"]
    assert len(told) > len(LICENCES) / 2
    assert told == {name: LICENCES[name] for name in told}


@pytest.mark.nightly
def test_a_wheel_holds_its_bill(tmp_path: Path) -> None:
    (tmp_path / "kernels").mkdir()
    make_bill(tmp_path / "kernels")
    wheel = build_wheel(tmp_path / "kernels", tmp_path / "dist")
    beside = json.loads(wheel.with_suffix(".cdx.json").read_bytes())
    with zipfile.ZipFile(wheel) as file:
        (name,) = (name for name in file.namelist() if "/sboms/" in name)
        assert json.loads(file.read(name)) == beside
        assert file.read("lobewise/backend/prebuilt/x86-64-v3.so") == b"code"
    assert name == f"lobewise-{read_project()['version']}.dist-info/sboms/lobewise.cdx.json"
    assert wheel.name.endswith("-py3-none-manylinux_2_28_x86_64.whl")
