"""Builds a wheel with compiled kernels, checks it, and measures it in fresh environments.

    python -m releasing.libraries build/kernels
    python -m releasing.wheels build/kernels --python python3.11 --python python3.12 --readme

The wheel comes to ``dist``, the figures to ``benchmarks/results/core.json``: the size of all that ``pip install``
brings apart from NumPy, and the times of the first and the second ``lobewise denoise`` by a user without caches.
The environment must be that of ``lock.txt``: it compiles the kernels and builds the wheel
(docs/developers/releasing.md). ``--readme`` also runs the commands of the README from a fresh clone.

Only wheels of the system that this runs on can be measured. Others are built and checked (``--no-measure``).
"""

from __future__ import annotations

import argparse
import json
import os
import re
import resource
import shlex
import shutil
import subprocess
import sys
import tempfile
import time
from collections import defaultdict
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, ROOT, SHOWROOM, describe_machine, write_json
from releasing.lock import require_locked
from releasing.sbom import make_sbom
from releasing.trial import install

MAX_MEGABYTES = 120.0
"""Largest size of an installation without NumPy."""
MAX_SECONDS_OF_FIRST_CALL = 2.0
"""Most time that the first call on a machine may take beyond the second one."""
OWN_OF_ENVIRONMENT = ("pip", "setuptools", "pkg_resources", "_distutils_hack", "distutils-precedence.pth")
_REPEATS = 3


def run_nightly_tests() -> None:
    """Run the tests that no build runs, such as: do the verbs ask for a kernel that the catalogue lacks?"""
    subprocess.run([sys.executable, "-m", "pytest", "-q", "-m", "nightly"], cwd=ROOT, check=True)


def build_wheel(libraries: Path, folder: Path) -> Path:
    """Build the wheel of a folder of libraries with its bill of materials, check its metadata, and return its path.

    A copy of the bill lies beside the wheel.
    """
    asked = ["git", "-C", str(ROOT), "log", "-1", "--format=%ct"]
    seconds = int(subprocess.run(asked, capture_output=True, text=True, check=True).stdout)
    with tempfile.TemporaryDirectory() as made:
        bill = Path(made, "lobewise.cdx.json")
        bill.write_text(make_sbom(libraries, datetime.fromtimestamp(seconds, timezone.utc)), encoding="utf-8")
        # An isolated build would download its tools anew, without looking at the lock file.
        command = [sys.executable, "-m", "pip", "wheel", "--quiet", "--no-deps", "--no-build-isolation"]
        names = {"LOBEWISE_KERNELS": str(libraries.resolve()), "LOBEWISE_SBOM": str(bill)}
        subprocess.run([*command, "--wheel-dir", made, str(ROOT)], env={**os.environ, **names}, check=True)
        (wheel,) = Path(made).glob("*.whl")
        folder.mkdir(parents=True, exist_ok=True)
        found = Path(shutil.copy(wheel, folder))
        shutil.copy(bill, found.with_suffix(".cdx.json"))
    subprocess.run([sys.executable, "-m", "twine", "check", "--strict", str(found)], check=True)
    return found


def weigh_packages(programs: Path) -> dict[str, float]:
    """Return the size of each folder and file of site-packages, MB, without the environment's own packages."""
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    told = subprocess.run([str(programs / "python"), "-c", ask], capture_output=True, text=True, check=True)
    found: dict[str, int] = defaultdict(int)
    root = Path(told.stdout.strip())
    for path in root.rglob("*"):
        if path.is_file() and not path.is_symlink():
            name = path.relative_to(root).parts[0]
            # The description of a package counts with the package.
            found[re.split(r"-\d|\.libs$", name)[0].lower()] += path.stat().st_size
    return {name: round(size / 1e6, 2) for name, size in found.items() if name not in OWN_OF_ENVIRONMENT}


def time_call(command: list[str], home: Path) -> tuple[float, float]:
    """Return wall time and processor time of a command by a user whose home is a folder, seconds."""
    kept = {name: value for name, value in os.environ.items() if name in ("PATH", "LANG", "TMPDIR")}
    before, start = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    subprocess.run(command, env={**kept, "HOME": str(home)}, check=True, capture_output=True, cwd=home)
    passed, after = time.perf_counter() - start, resource.getrusage(resource.RUSAGE_CHILDREN)
    return passed, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measure(python: str, wheel: Path) -> dict[str, Any]:
    """Return the figures of a wheel with one version of Python."""
    with tempfile.TemporaryDirectory() as scratch:
        programs = install(python, wheel, Path(scratch, "environment"))
        packages = weigh_packages(programs)
        present = sorted(name for name in ("halide", "llvmlite") if name in packages)
        if present:
            raise SystemExit(f"{wheel.name} brings {', '.join(present)} along")
        home = Path(scratch, "home")
        home.mkdir()
        command = [str(programs / "lobewise"), "denoise", str(SHOWROOM), "-o", "clean.exr"]
        first = time_call(command, home)
        later = [time_call(command, home) for _ in range(_REPEATS)]
        ask = "import platform; print(platform.python_version())"
        version = subprocess.run([str(programs / "python"), "-c", ask], capture_output=True, text=True, check=True)
    total = sum(size for name, size in packages.items() if name != "numpy")
    return {
        "python": version.stdout.strip(),
        "megabytes_without_numpy": round(total, 1),
        "megabytes": dict(sorted(packages.items(), key=lambda each: -each[1])),
        "first_seconds": round(first[0], 2),
        "second_seconds": round(min(each[0] for each in later), 2),
        "first_processor_seconds": round(first[1], 2),
        "second_processor_seconds": round(min(each[1] for each in later), 2),
    }


def run_readme(python: str) -> list[dict[str, Any]]:
    """Run the README's commands in a fresh clone, and return each with its time. Of the tests the quick ones run."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    commands = [line for line in text.splitlines() if line.startswith("python3 -m venv .venv && ")]
    if len(commands) != 2:
        raise SystemExit("README.md no longer has two commands that begin with an environment")
    found = []
    for command in commands:
        with tempfile.TemporaryDirectory() as scratch:
            subprocess.run(["git", "clone", "--quiet", str(ROOT), scratch], check=True)
            words = command.replace("python3 -m venv", f"{shlex.quote(python)} -m venv", 1)
            words += " tests/test_startup.py tests/backend" if words.endswith("pytest") else ""
            start = time.perf_counter()
            subprocess.run(["bash", "-c", words], cwd=scratch, check=True)
            found.append({"command": command, "ran": words, "seconds": round(time.perf_counter() - start)})
    return found


def list_faults(rows: list[dict[str, Any]]) -> list[str]:
    """Return a sentence for every figure that is above its limit."""
    faults = []
    for row in rows:
        size, late = row["megabytes_without_numpy"], row["first_processor_seconds"] - row["second_processor_seconds"]
        if size > MAX_MEGABYTES:
            faults.append(f"Python {row['python']}: {size} MB are more than {MAX_MEGABYTES}.")
        if late > MAX_SECONDS_OF_FIRST_CALL:
            faults.append(f"Python {row['python']}: the first call takes {late:.1f} s more than the second.")
    return faults


def main() -> int:
    """Build, check and measure a wheel."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("libraries", type=Path, help="folder that `python -m releasing.libraries` made")
    parser.add_argument("--output", type=Path, default=ROOT / "dist", help="folder of the wheel")
    parser.add_argument("--python", action="append", help="an interpreter to measure with; may be given several times")
    parser.add_argument("--no-measure", action="store_true", help="build and check only")
    parser.add_argument("--readme", action="store_true", help="also run the commands of the README")
    parser.add_argument("--no-tests", action="store_true", help="do not run the nightly tests")
    options = parser.parse_args()
    require_locked()
    if not options.no_tests:
        run_nightly_tests()
    wheel = build_wheel(options.libraries, options.output)
    print(f"{wheel}: {wheel.stat().st_size / 1e6:.1f} MB")
    if options.no_measure:
        return 0
    interpreters = options.python or [sys.executable]
    rows = [measure(python, wheel) for python in interpreters]
    index = json.loads((options.libraries / "index.json").read_bytes())
    found = {
        "machine": describe_machine(),
        "wheel": {"name": wheel.name, "megabytes": round(wheel.stat().st_size / 1e6, 1)},
        "kernels": len(index["kernels"]),
        "libraries": [
            {
                "file": level["file"],
                "target": level["target"],
                "megabytes": round((options.libraries / level["file"]).stat().st_size / 1e6, 1),
            }
            for level in index["levels"]
        ],
        "installed": rows,
        "readme": run_readme(interpreters[0]) if options.readme else [],
    }
    write_json(RESULTS / "core.json", found)
    faults = list_faults(rows)
    print("\n".join(faults) or "All figures are within their limits.")
    return int(bool(faults))


if __name__ == "__main__":
    raise SystemExit(main())
