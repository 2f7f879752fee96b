"""The machine and version of a measurement."""

from __future__ import annotations

import platform
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import lobewise
from lobewise.work.chunks import count_cores, count_threads


def describe_machine() -> dict[str, Any]:
    """Return processor, cores, threads used by Halide, Python, version, and in a checkout the commit."""
    facts = {
        "processor": look_up_processor(),
        "cores": count_cores(),
        "threads": count_threads(),
        "python": platform.python_version(),
        "version": lobewise.__version__,
    }
    commit = _look_up_commit()
    return {**facts, "commit": commit} if commit else facts


def describe_machine_in_words(measured: Mapping[str, Any]) -> str:
    """Return processor, threads, other devices, version and commit of a measurement, in a sentence."""
    machine = measured["machine"]
    others = [f"{name}: {reason}" for name, reason in measured["devices"].items() if name != "cpu"]
    version = f"lobewise {machine['version']}" + (f", commit {machine['commit']}" if "commit" in machine else "")
    return "; ".join([f"{machine['processor']}, {machine['threads']} threads", *others, version]) + "."


def look_up_processor() -> str:
    """Return the name of the processor."""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        for line in cpuinfo.read_text(encoding="utf-8").splitlines():
            if "model name" in line:
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _look_up_commit() -> str:
    """Return the commit of the checkout that holds this package, marked if files were changed; empty without one."""
    package = Path(__file__).resolve().parents[2]
    if not (package.parents[1] / ".git").exists():
        return ""

    def ask(*arguments: str) -> str:
        try:
            done = subprocess.run(["git", *arguments], cwd=package, capture_output=True, text=True, check=False)
        except OSError:
            return ""
        return done.stdout.strip()

    commit = ask("rev-parse", "--short", "HEAD")
    return commit + ("+changes" if commit and ask("status", "--porcelain", "--", ".") else "")
