"""The workflows of GitHub build, try and publish what the programs of `releasing` make; so does the Dockerfile."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from releasing.sbom import read_project
from releasing.systems import SYSTEMS

ROOT = Path(__file__).parents[2]
GITHUB = ROOT / ".github"
FILES = sorted([*GITHUB.glob("workflows/*.yml"), *GITHUB.glob("actions/*/action.yml")])
RELEASE: dict[str, Any] = yaml.safe_load((GITHUB / "workflows" / "release.yml").read_text())["jobs"]
DOCKERFILE = (ROOT / "Dockerfile").read_text()


def list_before(job: str) -> set[str]:
    """Return the jobs that must have passed before a job of the release."""
    needs = RELEASE[job].get("needs", [])
    direct = {needs} if isinstance(needs, str) else set(needs)
    return direct.union(*map(list_before, direct))


def test_nothing_is_published_before_all_was_tried() -> None:
    publishing = {"bills", "publish", "release"}
    for name in publishing:
        assert list_before(name) - publishing == RELEASE.keys() - publishing, name
    assert list_before("release") >= {"bills", "publish"}


def test_every_wheel_is_tried_on_its_own_system() -> None:
    built = RELEASE["wheels"]["strategy"]["matrix"]["system"]
    assert set(built) <= SYSTEMS.keys()
    assert RELEASE["bills"]["strategy"]["matrix"]["system"] == built
    tried = RELEASE["trials"]["strategy"]["matrix"]
    assert tried["system"] == built
    runners = {each["system"]: each["runner"] for each in tried["include"]}
    assert runners.keys() == set(built)
    for system, runner in runners.items():
        name = system.partition("-")[0].replace("linux", "ubuntu")
        assert runner.startswith(name), system
        assert runner.endswith("-arm") == (system == "linux-arm-64"), system
    named = re.findall(r"Programming Language :: Python :: (3\.\d+)", "\n".join(read_project()["classifiers"]))
    assert tried["python"] == [named[0], named[-1]]


def test_programs_of_the_workflows_exist() -> None:
    found = set()
    for path in FILES:
        for line in re.findall(r"python -m releasing\.(.+)", path.read_text()):
            name, *words = line.split()
            source = (ROOT / "releasing" / f"{name}.py").read_text()
            found.add(name)
            for option in (word for word in words if word.startswith("--")):
                assert f'"{option}"' in source, line
    assert found == {"libraries", "wheels", "trial", "blender"}


def test_every_action_is_pinned_to_one_commit() -> None:
    versions: dict[str, set[str]] = {}
    for path in FILES:
        for name in re.findall(r"uses: (.+)", path.read_text()):
            if not name.startswith("./"):
                match = re.fullmatch(r"([\w/-]+)@([0-9a-f]{40} # v\d+\.\d+\.\d+)", name)
                assert match is not None, name
                versions.setdefault(match[1], set()).add(match[2])
    assert versions
    for name, pins in versions.items():
        assert len(pins) == 1, name


def find_checker(name: str) -> str:
    """Return a program that checks workflows. Skips the test where it is missing, and fails it on GitHub."""
    program = shutil.which(name, path=os.pathsep.join([str(Path(sys.executable).parent), os.environ["PATH"]]))
    if program is None:
        reason = f"{name} is not installed: see CONTRIBUTING.md"
        pytest.fail(reason) if os.environ.get("GITHUB_ACTIONS") else pytest.skip(reason)
    return program


def test_actionlint_finds_nothing() -> None:
    done = subprocess.run([find_checker("actionlint")], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_zizmor_finds_nothing() -> None:
    command = [find_checker("zizmor"), "--offline", "--no-progress", str(GITHUB)]
    done = subprocess.run(command, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_image_has_a_python_of_the_project_and_an_ordinary_user() -> None:
    stages = re.split(r"^FROM ", DOCKERFILE, flags=re.M)[1:]
    names = {re.search(r" AS (\w+)", stage)[1]: stage for stage in stages}  # type: ignore[index]
    assert names.keys() == {"core", "farm"}
    python = re.match(r"python:(3\.\d+)-", stages[0])
    assert f"Programming Language :: Python :: {python[1]}" in read_project()["classifiers"]
    for name, stage in names.items():
        assert re.findall(r"^USER (\d+)", stage, flags=re.M)[-1] != "0", name
    for extras in re.findall(r"\.whl\)\[([\w,]+)\]", DOCKERFILE):
        assert set(extras.split(",")) <= read_project()["optional-dependencies"].keys()


def test_the_image_is_made_of_files_that_reach_the_builder() -> None:
    sources = set(re.findall(r"source=(\w+)", DOCKERFILE)) | set(re.findall(r"^COPY (\S+)", DOCKERFILE, flags=re.M))
    ignored = (ROOT / ".dockerignore").read_text().split()
    assert ignored == ["*", *(f"!{name}" for name in sorted(sources))]
    built = {command.split()[3] for command in re.findall(r"docker build .*", RELEASE["image"]["steps"][-1]["run"])}
    assert built == {"core", "farm"}
