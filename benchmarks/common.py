"""What every benchmark records: machine, threads, commit; and how its JSON is written."""

from __future__ import annotations

import json
import os
import platform
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lobewise.frame import FloatArray, Frame
from lobewise.io.exr import read_frame, read_image, write_frame, write_image


def describe_machine() -> dict[str, Any]:
    """Return processor, cores, threads used by Halide, Python and the commit that was measured."""
    model = platform.processor()
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        names = [line.split(":", 1)[1].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = names[0] if names else model
    here = Path(__file__).parent
    commit = subprocess.run(
        ["git", "rev-parse", "--short", "HEAD"], cwd=here, capture_output=True, text=True, check=False
    ).stdout.strip()
    dirty = subprocess.run(
        ["git", "status", "--porcelain", "--", "../src"], cwd=here, capture_output=True, text=True, check=False
    ).stdout.strip()
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return {
        "processor": model,
        "cores": cores,
        "threads": int(os.environ.get("HL_NUM_THREADS", cores or 1)),
        "python": platform.python_version(),
        "commit": commit + ("+changes" if dirty else ""),
    }


def write_json(path: Path, value: Any) -> None:
    """Write ``value`` readably, through a temporary file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(json.dumps(value, indent=1) + "\n")
    temporary.replace(path)


def fetch_frame(path: Path, render: Callable[[], Frame]) -> Frame:
    """Return the frame in ``path``, rendered there on first use."""
    if not path.exists():
        write_frame(path, render())
    return read_frame(path)


def fetch_image(path: Path, render: Callable[[], Frame]) -> FloatArray:
    """Return the radiance in ``path``, rendered there on first use."""
    if not path.exists():
        print(f"rendering {path.name}", file=sys.stderr)
        write_image(path, render().radiance.color)
    return read_image(path)
