"""The folders that lobewise reads and writes: compiled kernels, files of the package, temporary files."""

from __future__ import annotations

import os
import shutil
import tempfile
from contextlib import suppress
from importlib.resources import files
from pathlib import Path

from lobewise.backend.disk import locate_cache_folder, write_whole
from lobewise.backend.trust import describe_folder_problem
from lobewise.cli.doctor.report import Problem, Section, name_path

NEEDED = ("denoising/weights.npz", "denoising/refinement.npz", "data/report.html")
"""Files of the package without which verbs fail."""
MIN_FREE_BYTES = 200e6
"""Free bytes of a disk below which the user is told."""
_TRIAL = "doctor-trial"


def examine_cache() -> Section:
    """Return where compiled kernels are kept, how many there are, and whether more can be kept."""
    folder, named = locate_cache_folder(), os.environ.get("LOBEWISE_CACHE", "")
    facts = {"LOBEWISE_CACHE": named or "not set"}
    if folder is None:
        facts["folder"] = "none"
        if named == "off":
            return Section("Kernel cache", facts)
        what = "compiled kernels are not kept, because this user has no home folder"
        return Section("Kernel cache", facts, (Problem(what, "let LOBEWISE_CACHE name a folder"),))
    facts["folder"] = name_path(folder)
    count, size = _measure_kernels(folder)
    facts["size"] = f"{count} kernels, {size / 1e6:.1f} MB"
    reason = describe_folder_problem(folder) or _try_to_write(folder)
    facts["writable"] = "no" if reason else "yes"
    problems = []
    if reason:
        what = f"compiled kernels cannot be kept in {name_path(folder)} ({reason}), so every run compiles them again"
        problems.append(Problem(what, "let LOBEWISE_CACHE name a folder that only you can write to"))
    return Section("Kernel cache", facts, (*problems, *_list_full(facts, folder)))


def examine_data() -> Section:
    """Return the files of the package and the folder of temporary files."""
    root = files("lobewise")
    missing = [name for name in NEEDED if not root.joinpath(*name.split("/")).is_file()]
    facts = {
        "of the package": name_path(str(root)),
        "files": f"missing: {', '.join(missing)}" if missing else "all there",
    }
    problems = []
    if missing:
        what = f"files of the package are missing ({', '.join(missing)})"
        problems.append(Problem(what, "pip install --force-reinstall --no-deps lobewise", fatal=True))
    try:
        folder = Path(tempfile.gettempdir())
    except FileNotFoundError:
        facts["temporary"] = "none"
        what, action = "there is no folder for temporary files", "let TMPDIR name a folder that can be written to"
        return Section("Data folders", facts, (*problems, Problem(what, action)))
    facts["temporary"] = name_path(folder)
    return Section("Data folders", facts, (*problems, *_list_full(facts, folder)))


def _measure_kernels(folder: Path) -> tuple[int, int]:
    """Return the number of kernels in a folder, and their bytes."""
    count = size = 0
    with suppress(OSError), os.scandir(folder) as entries:
        for entry in entries:
            if entry.name.endswith(".kernel"):
                with suppress(OSError):
                    size += entry.stat(follow_symlinks=False).st_size
                    count += 1
    return count, size


def _locate_existing(folder: Path) -> Path:
    """Return the folder, or the nearest one above it that exists."""
    return next((candidate for candidate in (folder, *folder.parents) if candidate.exists()), folder)


def _try_to_write(folder: Path) -> str:
    """Return why no file can be written into a folder, or an empty text. A folder that is absent stays so."""
    existing = _locate_existing(folder)
    if existing != folder:
        return "" if os.access(existing, os.W_OK) else f"{name_path(existing)} cannot be written to"
    reason = write_whole(folder / _TRIAL, b"")
    with suppress(OSError):
        (folder / _TRIAL).unlink()
    return reason


def _list_full(facts: dict[str, str], folder: Path) -> tuple[Problem, ...]:
    """Add the free space of a folder's disk to the facts; return a problem if it is nearly full."""
    try:
        free = shutil.disk_usage(_locate_existing(folder)).free
    except OSError:
        return ()
    facts["free"] = f"{free / 1e9:.1f} GB"
    if free >= MIN_FREE_BYTES:
        return ()
    return (Problem(f"the disk of {name_path(folder)} has only {free / 1e6:.0f} MB left", "free some space"),)
