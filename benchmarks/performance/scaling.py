"""Time per pixel over the size of the image, and what a second thread gives: separable, radius 8.

Sizes and threads are measured in turn, each number of threads in a process of its own, which Halide's pool asks for.

    python -m benchmarks.performance.scaling -o benchmarks/results/scaling.json
"""

from __future__ import annotations

import argparse
import json
import os
from pathlib import Path
from typing import Any

from benchmarks.common import describe_machine, write_json
from lobewise.bench.kernels import make_kernel_calls
from lobewise.bench.plane import make_features, make_frame
from lobewise.bench.timing import keep_best, open_pools, time_best

SIZES = ((512, 512), (1024, 1024), (1920, 1080), (3840, 2160), (7680, 4320))
NAMES = ("normal", "sg", "ggx")
RADIUS = 8


def time_sizes(rounds: int) -> dict[str, dict[str, float]]:
    """Return the best seconds of every size and similarity in this process."""
    best: dict[str, dict[str, float]] = {}
    for width, height in SIZES:
        frame = make_frame(width, height)
        calls = make_kernel_calls(frame, make_features(frame, NAMES), RADIUS, "separable")
        # As many pixels for every size, so that none has more chances of a quiet moment.
        best[f"{width}x{height}"] = time_best(calls, 0.0, rounds=max(rounds * 2_000_000 // (width * height), 3))
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
    arguments = parser.parse_args()
    runs: dict[int, dict[str, dict[str, float]]] = {}
    with open_pools((1, os.cpu_count() or 1)) as pools:
        for _ in range(arguments.turns):
            for threads, pool in pools.items():
                known = runs.setdefault(threads, {})
                for size, row in pool.submit(time_sizes, arguments.rounds).result().items():
                    known[size] = keep_best(known.get(size), row)
    value = {"what": "separable, radius 8, best wall time", "machine": describe_machine(), **summarize(runs)}
    print(json.dumps(value, indent=1))
    if arguments.output:
        write_json(arguments.output, value)


if __name__ == "__main__":
    main()
