"""The whole of ``lobewise denoise`` on another renderer's file beside its filter alone, both warm, in turn.

    python render_blender.py FOLDER --scenes room --spp 8 --seeds 1 --reference 0 --size 1920x1080
    python -m benchmarks.foreign.speed FOLDER/room_8_1.exr --output benchmarks/results/foreign_speed.json

The command is a process of its own: it starts, reads, filters, writes and ends. The filter alone is `lobewise.denoise`
on the frame that the command makes of the file, in a process that has run it before.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from statistics import median
from typing import Any

from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.quality.measure import round_figure
from lobewise import denoise
from lobewise.interchange.reading import import_file
from lobewise.interchange.replacing import write_result
from lobewise.io.exr.parsing import read_container

QUALITIES = ("fast", "balanced", "high")


def time_once(run: Callable[[], Any]) -> float:
    """Return seconds."""
    start = time.perf_counter()
    run()
    return time.perf_counter() - start


def measure_file(path: Path, quality: str, rounds: int) -> dict[str, Any]:
    """Return the times of the command and of its steps on one file, the median of some rounds, seconds."""
    found = import_file(path, light_passes=True)
    result = denoise(found.frame, quality=quality)  # type: ignore[arg-type]
    with tempfile.TemporaryDirectory() as folder:
        out = str(Path(folder) / "out.exr")
        run = "import sys; from lobewise.cli import main; sys.exit(main())"
        command = [sys.executable, "-c", run, "denoise", str(path), "-o", out, "--quality", quality]
        steps: dict[str, Callable[[], Any]] = {
            "command": lambda: subprocess.run(command, check=True, capture_output=True, env=dict(os.environ)),
            "filter": lambda: denoise(found.frame, quality=quality),  # type: ignore[arg-type]
            "read": lambda: import_file(path, light_passes=True),
            "write": lambda: write_result(out, result, source=found),
        }
        steps["command"]()
        times: dict[str, list[float]] = {name: [] for name in steps}
        for _ in range(rounds):
            for name, step in steps.items():
                times[name].append(time_once(step))
    ratio = median(a / b for a, b in zip(times["command"], times["filter"], strict=True))
    return {
        **{name: round_figure(median(values)) for name, values in times.items()},
        "command over filter": round_figure(ratio),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure one file and write the figures."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("file", type=Path)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "foreign_speed.json")
    asked = parser.parse_args(arguments)
    container = read_container(asked.file)
    window = container.parts[0].data_window
    figures = {
        "what": "seconds, medians; the ratio is that of each round, its median",
        "machine": describe_machine(),
        "rounds": asked.rounds,
        "file": {
            "size": [window.width, window.height],
            "channels": sum(len(part.channels) for part in container.parts),
            "bytes": asked.file.stat().st_size,
            "compression": container.parts[0].compression,
        },
        "qualities": {quality: measure_file(asked.file, quality, asked.rounds) for quality in QUALITIES},
    }
    write_json(asked.output, figures)


if __name__ == "__main__":
    main()
