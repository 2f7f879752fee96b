"""Upsampling over space and time on ``showroom``: errors, ghosts, flicker and time, part by part.

Writes a JSON with everything and prints a table; parts that a run leaves out keep their rows, each of which names its
commit. Geometry-aware weights (``normal``) are tuned on the frame against its reference, coordinate by coordinate from
several starts; lobe-aware weights are both tuned likewise and left at their defaults.

Frames and references are rendered on first use. The references take an hour on two cores.

    python -m benchmarks.upsampling.measure --cache ~/.cache/lobewise-quality -o benchmarks/results/upsampling.json
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.upsampling.over_time import (
    run_adaptive,
    run_cut,
    run_flicker,
    run_ghosting,
    run_orbit,
    run_still,
)
from benchmarks.upsampling.shots import (
    Cache,
)
from benchmarks.upsampling.spatial import (
    GEOMETRY_GRID,
    LOBE_GRID,
    run_spatial,
)
from benchmarks.upsampling.speed import run_speed

PARTS: dict[str, Callable[[Cache, dict[str, Any]], dict[str, Any]]] = {
    "spatial": run_spatial,
    "orbit": run_orbit,
    "adaptive": run_adaptive,
    "still": run_still,
    "ghosting": run_ghosting,
    "cut": run_cut,
    "flicker": run_flicker,
    "speed": run_speed,
}


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for frames and references")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "upsampling.json")
    parser.add_argument("--only", choices=tuple(PARTS), nargs="+", help="only these parts")
    parser.add_argument("--pieces", type=int, default=2, help="renders that make a reference of the orbit")
    arguments = parser.parse_args()
    cache = Cache(arguments.cache, arguments.pieces)
    rows: dict[str, Any] = {}
    if arguments.output.exists():
        rows = json.loads(arguments.output.read_text())["parts"]
    for name in arguments.only or PARTS:
        rows[name] = {**PARTS[name](cache, rows), "commit": describe_machine()["commit"]}
        write_json(
            arguments.output,
            {
                "what": "rel_mse (epsilon 0.01) of showroom at 4 spp per shaded pixel, one of 4x4 pixels shaded",
                "version": lobewise.__version__,
                "machine": describe_machine(),
                "grid": {"normal": GEOMETRY_GRID, "lobes": LOBE_GRID},
                "parts": {part: rows[part] for part in PARTS if part in rows},
            },
        )


if __name__ == "__main__":
    main()
