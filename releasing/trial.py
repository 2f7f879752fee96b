"""Installs a wheel into a fresh environment, and runs the README's lines of Python and ``lobewise doctor`` there.

    python -m releasing.trial dist

The folder holds one wheel, for the system that this runs on. Only Python's own library is needed.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[1]
FRAME = ROOT / "src" / "lobewise" / "data" / "demo.exr"


def install(python: str, wheel: Path, folder: Path) -> Path:
    """Install a wheel and what it needs into a fresh environment, and return the environment's folder of programs."""
    subprocess.run([python, "-m", "venv", str(folder)], check=True)
    programs = folder / ("Scripts" if sys.platform == "win32" else "bin")
    command = [str(programs / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check", str(wheel)]
    # What PYTHONPATH shows would count as installed.
    subprocess.run(command, env={name: value for name, value in os.environ.items() if name != "PYTHONPATH"}, check=True)
    return programs


def read_lines() -> str:
    """Return the README's lines of Python."""
    (lines,) = re.findall(r"^```python\n(.*?)^```", (ROOT / "README.md").read_text(encoding="utf-8"), re.S | re.M)
    return str(lines)


def try_wheel(wheel: Path, folder: Path) -> None:
    """Install a wheel in a folder and use it there. Ends this program where a step fails."""
    programs = install(sys.executable, wheel, folder / "environment")
    shutil.copy(FRAME, folder / "frame.exr")
    # `-I` hides the variables and folders of Python that this machine has.
    subprocess.run([str(programs / "python"), "-I", "-c", read_lines()], cwd=folder, check=True)
    if not (folder / "clean.exr").exists():
        raise SystemExit("The README's lines wrote no clean.exr.")
    subprocess.run([str(programs / "lobewise"), "doctor"], cwd=folder, check=True)


def main() -> int:
    """Try the wheel of a folder."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path, help="folder of the wheel")
    (wheel,) = parser.parse_args().folder.resolve().glob("*.whl")
    with tempfile.TemporaryDirectory() as folder:
        try_wheel(wheel, Path(folder))
    print(f"{wheel.name} works here.")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
