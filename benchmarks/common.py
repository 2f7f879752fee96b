"""What every benchmark shares: the machine it names, how its JSON is written, where its frames are kept."""

import json
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lobewise.cli.bench.machine import describe_machine
from lobewise.io.exr import read_frame, write_frame
from lobewise.records.frame import Frame

ROOT = Path(__file__).parents[1]
RESULTS = ROOT / "benchmarks" / "results"
FRAMES = ROOT / "benchmarks" / "frames"
SAMPLE = FRAMES / "sample.exr"
"""A part of a frame, black outside; made by `benchmarks/pictures/sample.py`."""
SHOWROOM, SHOWROOM_REFERENCE = FRAMES / "showroom-4spp.exr", FRAMES / "showroom-reference.exr"
"""A frame of 512x512 pixels with 4 samples per pixel, and its reference."""

__all__ = ["RESULTS", "ROOT", "describe_machine", "fetch_frame", "write_json"]


def write_json(path: Path, value: Any, *, one_line: str = "") -> None:
    """Write ``value`` readably, through a temporary file; what the pattern ``one_line`` matches stays on one line."""
    text = json.dumps(value, indent=1)
    if one_line:
        text = re.sub(one_line, lambda found: re.sub(r"\s*\n\s*", " ", found[0]), text)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(text + "\n")
    temporary.replace(path)


def fetch_frame(path: Path, render: Callable[[], Frame]) -> Frame:
    """Return the frame in ``path``, rendered there on first use."""
    if not path.exists():
        write_frame(path, render())
    return read_frame(path)
