"""Memory of whole recipes, and what the system takes of their time to clear fresh memory.

    python -m benchmarks.performance.memory --shot factory/jewels_0/16.exr [--only high]

calls every quality on a Blender frame with all passes, repeated to 1920x1080 and to 3840x2160. It tells the processor
time of both on one thread, what of it is the system's, and the largest resident memory beside the frame. A recipe whose
memory is not cleared anew takes four times as long for four times the pixels. Linux only: the peak is read in `/proc`.
"""

import argparse
import ctypes
import json
import resource
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.performance.budget import tile
from lobewise.cli.bench.timing import limit_threads
from lobewise.records.frame import Frame

RESULT = RESULTS / "memory.json"
SIZES = (1920, 1080), (3840, 2160)
QUALITIES = ("fast", "balanced", "high")
ROUNDS = 2, 1
"""Calls of each size; the first call of all loads the kernels. The time is the least."""


def read_peak() -> float:
    """Return the largest resident memory of this process since `forget_peak`, bytes."""
    status = Path("/proc/self/status").read_text(encoding="ascii")
    (line,) = (each for each in status.splitlines() if each.startswith("VmHWM"))
    return 1024.0 * float(line.split()[1])


def forget_peak() -> None:
    """Give free memory back to the system, and let the largest resident memory be the one of now."""
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5", encoding="ascii")


def measure(call: Callable[[], Any], pixels: int, rounds: int) -> dict[str, float]:
    """Return processor time, the system's part, and the largest memory beside what was there before."""
    runs = []
    for _ in range(rounds):
        forget_peak()
        held, before = read_peak(), resource.getrusage(resource.RUSAGE_SELF)
        call()
        after = resource.getrusage(resource.RUSAGE_SELF)
        user, system = after.ru_utime - before.ru_utime, after.ru_stime - before.ru_stime
        runs.append((user + system, system, read_peak() - held))
    seconds, system, peak = min(runs)
    return {
        "seconds": round(seconds, 2),
        "of_system": round(system, 2),
        "peak_gigabytes": round(peak / 1e9, 2),
        "bytes_per_pixel": round(peak / pixels),
    }


def measure_quality(frames: list[Frame], quality: Any) -> dict[str, Any]:
    """Return the measurements of a quality by the size of the image, and the time of the larger over four smaller."""
    small, large = (
        measure(partial(lobewise.denoise, frame, device="cpu", quality=quality), frame.width * frame.height, rounds)
        for frame, rounds in zip(frames, ROUNDS, strict=True)
    )
    names = ["x".join(map(str, size)) for size in SIZES]
    return {
        **dict(zip(names, (small, large), strict=True)),
        "over_4": round(large["seconds"] / small["seconds"] / 4, 3),
    }


def main(arguments: list[str] | None = None) -> int:
    """Measure and write; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    parser.add_argument("--shot", type=Path, required=True, help="a Blender frame of benchmarks/foreign/factory")
    parser.add_argument("--only", choices=QUALITIES, help="one quality; the others keep their figures")
    asked = parser.parse_args(arguments)
    limit_threads(1)
    warnings.simplefilter("ignore")
    found = json.loads(asked.output.read_text())["qualities"] if asked.output.exists() else {}
    shot, machine = lobewise.read_frame(asked.shot), describe_machine()
    frames = [tile(shot, *size) for size in SIZES]
    for quality in (asked.only,) if asked.only else QUALITIES:
        found[quality] = {**measure_quality(frames, quality), "commit": machine["commit"]}
        print(f"{quality}: {found[quality]}", flush=True)
        write_json(asked.output, {"what": "one call, one thread", "machine": machine, "qualities": found})
    return 0


if __name__ == "__main__":
    sys.exit(main())
