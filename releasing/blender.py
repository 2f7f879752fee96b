"""Builds extensions for Blender from wheels of lobewise: a file for each system and each Python of Blender.

    python -m releasing.wheels build/kernels
    python -m releasing.blender dist/*.whl

A file holds ``extensions/blender``, the wheel, and the wheels of what that needs, in the versions of ``lock.txt``. The
files come to ``dist``. Blender's own program builds and validates them: that of the package ``bpy`` in this Python, or
in the one that the variable ``LOBEWISE_BPY_PYTHON`` tells, or that of a ``blender`` on the PATH.

A wheel without kernels gives an extension for this machine's system, with Halide in place of the kernels.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from packaging.metadata import parse_email
from packaging.requirements import Requirement
from packaging.utils import parse_wheel_filename

from benchmarks.common import ROOT
from lobewise.backend.prebuilt import name_system
from releasing.lock import Locked, list_environments, read_lock
from releasing.sbom import PYTHON_SYSTEMS, list_needed, read_project
from releasing.systems import SYSTEMS, System

SOURCE = ROOT / "extensions" / "blender"
MANIFEST = "blender_manifest.toml"
OF_BLENDER = frozenset({"numpy"})
"""Packages that Blender has. A wheel of an extension would replace them for all of Blender."""
LINUX_TAGS = (*(f"manylinux_2_{minor}" for minor in range(28, 16, -1)), "manylinux2014")
MACOS_TAG = "macosx_13_0"
"""The newest macOS that wheels may require."""


@dataclass(frozen=True)
class Release:
    """Versions of Blender that have the same Python.

    Parameters
    ----------
    first : str
        The first version.
    end : str
        The first version that has another Python; empty if none has.
    minor : int
        Number of the version of Python 3.
    """

    first: str
    end: str
    minor: int


RELEASES = (Release("4.2.0", "5.1.0", 11), Release("5.1.0", "", 13))
"""Blender 4.2 unpacks wheels of every Python, so that a file may hold those of one Python only."""


def list_systems(wheel: Path) -> list[System]:
    """Return the systems of a wheel of lobewise; one without kernels is for this machine's system."""
    tags = {tag.platform for tag in parse_wheel_filename(wheel.name)[3]}
    names = {name_system()} if tags == {"any"} else {each.name for each in SYSTEMS.values() if each.tag in tags}
    return [each for each in SYSTEMS.values() if each.name in names]


def make_environment(system: System, minor: int) -> dict[str, str]:
    """Return the values of markers for Blender's Python on a system."""
    name, _, machine = system.name.partition("-")
    (environment,) = (
        each for each in list_environments([PYTHON_SYSTEMS[name]]) if each["python_version"] == f"3.{minor}"
    )
    arm = "aarch64" if name == "linux" else "arm64"
    return {**environment, "platform_machine": arm if machine == "arm-64" else "x86_64"}


def list_bundled(wheel: Path, system: System, minor: int) -> list[Locked]:
    """Return the packages that an extension with a wheel of lobewise brings along, and Blender has not."""
    with zipfile.ZipFile(wheel) as file:
        (name,) = (name for name in file.namelist() if name.endswith(".dist-info/METADATA"))
        metadata, _ = parse_email(file.read(name))
    environment = make_environment(system, minor)
    lines = [
        line
        for line in metadata["requires_dist"]
        if (marker := Requirement(line).marker) is None or marker.evaluate({**environment, "extra": "best"})
    ]
    return [each for each in list_needed(lines, read_lock(), [environment]) if each.name not in OF_BLENDER]


def list_pip_platforms(system: System) -> list[str]:
    """Return the platform tags of wheels that run on a system."""
    first, _, rest = system.tag.partition("_")
    tags = {"manylinux": LINUX_TAGS, "macosx": [MACOS_TAG]}.get(first, [first])
    machine = re.sub(r"^\d+_\d+_", "", rest)
    return [f"{tag}_{machine}" for tag in tags]


def download(packages: Iterable[Locked], system: System, minor: int, folder: Path) -> None:
    """Download the wheels of packages, with the digests of the lock file."""
    platforms = [f"--platform={tag}" for tag in list_pip_platforms(system)]
    command = [sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:"]
    with tempfile.TemporaryDirectory() as scratch:
        wanted = Path(scratch, "wanted.txt")
        wanted.write_text("".join(f"{line}\n" for line in list_lines(packages)), encoding="utf-8")
        command += ["--require-hashes", "-r", str(wanted), f"--python-version=3.{minor}", "-d", str(folder)]
        subprocess.run([*command, *platforms], check=True)


def list_lines(packages: Iterable[Locked]) -> Iterator[str]:
    """Yield the lines that ask pip for packages."""
    for each in packages:
        yield " ".join([f"{each.name}=={each.version}", *(f"--hash=sha256:{digest}" for digest in each.digests)])


def lay_out(wheels: Iterable[Path], system: System, release: Release, folder: Path) -> None:
    """Write the files of an extension, with its whole manifest, to a folder."""
    shutil.copytree(SOURCE, folder, ignore=shutil.ignore_patterns("__pycache__"), dirs_exist_ok=True)
    shutil.copy(ROOT / "LICENSE", folder)
    (folder / "wheels").mkdir()
    names = sorted(Path(shutil.copy(wheel, folder / "wheels")).name for wheel in wheels)
    added = {
        "version": read_project()["version"],
        "blender_version_min": release.first,
        **({"blender_version_max": release.end} if release.end else {}),
        "platforms": [name_platform(system)],
        "wheels": [f"./wheels/{name}" for name in names],
    }
    # Strings, and lists of strings, are the same in JSON and TOML.
    text = "".join(f"{name} = {json.dumps(value)}\n" for name, value in added.items())
    (folder / MANIFEST).write_text(text + (SOURCE / MANIFEST).read_text(encoding="utf-8"), encoding="utf-8")


def name_platform(system: System) -> str:
    """Return Blender's name of a system."""
    return system.name.replace("x86-64", "x64").replace("arm-64", "arm64")


def list_tool() -> list[str]:
    """Return how the command of Blender's program for extensions begins. Ends this program where Blender is absent."""
    python = os.environ.get("LOBEWISE_BPY_PYTHON", sys.executable)
    ask = "import importlib.util as util; spec = util.find_spec('bpy'); print(spec.origin if spec else '')"
    place = subprocess.run([python, "-c", ask], capture_output=True, text=True, check=True).stdout.strip()
    if place:
        (program,) = Path(place).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py")
        return [python, str(program)]
    if (blender := shutil.which("blender")) is not None:
        return [blender, "--command", "extension"]
    raise SystemExit("No Blender: put blender on the PATH, or set LOBEWISE_BPY_PYTHON to a Python that has bpy.")


def build_extension(wheel: Path, system: System, release: Release, output: Path) -> Path:
    """Build and validate the extension with a wheel of lobewise, and return its path."""
    name = f"lobewise-{read_project()['version']}-blender{release.first[:3]}-{name_platform(system)}.zip"
    with tempfile.TemporaryDirectory() as scratch:
        wheels, folder = Path(scratch, "wheels"), Path(scratch, "extension")
        download(list_bundled(wheel, system, release.minor), system, release.minor, wheels)
        lay_out([wheel, *wheels.iterdir()], system, release, folder)
        output.mkdir(parents=True, exist_ok=True)
        command = [*list_tool(), "build", "--source-dir", str(folder), "--output-filepath", str(output / name)]
        subprocess.run(command, check=True)
    subprocess.run([*list_tool(), "validate", str(output / name)], check=True)
    return output / name


def main() -> int:
    """Build the extensions of wheels."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("wheels", type=Path, nargs="+", help="wheels of lobewise, one for each system")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder of the extensions")
    options = parser.parse_args()
    for wheel in options.wheels:
        for system in list_systems(wheel):
            for release in RELEASES:
                made = build_extension(wheel, system, release, options.output)
                print(f"{made}: {made.stat().st_size / 1e6:.1f} MB")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
