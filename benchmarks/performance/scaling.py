"""Time per pixel over the size of the image, and what a second thread gives: separable, radius 8.

Sizes and threads are measured in turn, each number of threads in a process of its own, which Halide's pool asks for.

    python -m benchmarks.performance.scaling -o benchmarks/results/scaling.json
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.common import describe_machine, write_json

SIZES = ((512, 512), (1024, 1024), (1920, 1080), (3840, 2160), (7680, 4320))
NAMES = ("normal", "sg", "ggx")
RADIUS = 8


def measure_sizes(threads: int, rounds: int) -> dict[str, dict[str, float]]:
    """Return the best seconds of every size and similarity in a process of so many threads."""
    told = {**os.environ, "HL_NUM_THREADS": str(threads)}
    command = [sys.executable, "-m", "benchmarks.performance.scaling", "--measure", str(rounds)]
    done = subprocess.run(command, capture_output=True, check=True, env=told, text=True)
    found: dict[str, dict[str, float]] = json.loads(done.stdout)
    return found


def time_sizes(rounds: int) -> dict[str, dict[str, float]]:
    """Return the best seconds of every size and similarity in this process."""
    from lobewise.bench.kernels import make_kernel_calls
    from lobewise.bench.plane import make_features, make_frame

    best: dict[str, dict[str, float]] = {}
    for width, height in SIZES:
        frame = make_frame(width, height)
        calls = make_kernel_calls(frame, make_features(frame, NAMES), RADIUS, "separable")
        row = dict.fromkeys(calls, float("inf"))
        for call in calls.values():
            call()
        # As many pixels for every size, so that none has more chances of a quiet moment.
        for _ in range(max(rounds * 2_000_000 // (width * height), 3)):
            for name, call in calls.items():
                begin = time.perf_counter()
                call()
                row[name] = min(row[name], time.perf_counter() - begin)
        best[f"{width}x{height}"] = row
    return best


def summarize(runs: dict[int, dict[str, dict[str, float]]]) -> dict[str, Any]:
    """Return nanoseconds per pixel by threads, size and similarity, how flat they are, and what threads gain."""
    pixels = {f"{width}x{height}": width * height for width, height in SIZES}
    costs = {
        threads: {
            size: {name: round(1e9 * value / pixels[size], 2) for name, value in row.items()}
            for size, row in run.items()
        }
        for threads, run in runs.items()
    }
    most = max(runs)
    return {
        "nanoseconds_per_pixel": {str(threads): each for threads, each in costs.items()},
        "largest_over_smallest": {
            name: round(
                max(row[name] for row in costs[most].values()) / min(row[name] for row in costs[most].values()), 3
            )
            for name in NAMES
        },
        "gain_of_threads": {
            size: {name: round(runs[1][size][name] / runs[most][size][name], 3) for name in NAMES} for size in pixels
        },
        "threads": most,
    }


def main() -> None:
    """Measure and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path)
    parser.add_argument("--rounds", type=int, default=20, help="rounds of an image of two million pixels")
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--measure", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.measure:
        print(json.dumps(time_sizes(arguments.measure)))
        return
    runs: dict[int, dict[str, dict[str, float]]] = {}
    for _ in range(arguments.turns):
        for threads in (1, os.cpu_count() or 1):
            found = measure_sizes(threads, arguments.rounds)
            known = runs.setdefault(threads, found)
            for size, row in found.items():
                for name, value in row.items():
                    known[size][name] = min(known[size][name], value)
    value = {"what": "separable, radius 8, best wall time", "machine": describe_machine(), **summarize(runs)}
    print(json.dumps(value, indent=1))
    if arguments.output:
        write_json(arguments.output, value)


if __name__ == "__main__":
    main()
