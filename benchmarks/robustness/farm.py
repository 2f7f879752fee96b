"""A farm of two workers: what killed workers and a restarted scheduler cost, and its time over the work divided by two.

    python -m benchmarks.robustness.farm --part work|farm|losses [--frames 240] [--output benchmarks/results/farm.json]

- "work": one process on one core filters a quarter of the frames, and one frame alone. The difference is the work.
- "farm": `lobewise denoise --workers 2` filters all frames, from the start of the program to its end.
- "losses": a scheduler and two workers, each a process. A worker is killed after a third of the frames, the scheduler
  after two thirds. Both are started again. Then every frame must be there, once, with the bytes of one process.

Each part adds its figures to the JSON file. Wall times count where nothing else runs meanwhile: ``--quiet`` says so.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.robustness import kills
from lobewise.io import write_frame
from tests.farm.processes import PROGRAM, Farm, count_outputs, wait_until

FRAMES = 240
HEIGHT, WIDTH = 256, 320
WORKERS = 2
QUALITY, SMALL_QUALITY = "high", "fast"
"""Quality of the frames that are timed, and of those that processes are killed for."""
MAX_SECONDS = 400.0
"""Longest time until enough frames are there for the next kill, seconds."""
ONE_THREAD = {"HL_NUM_THREADS": "1", "OIDN_NUM_THREADS": "1"}
FOLDER = Path(tempfile.gettempdir()) / "lobewise-farm-frames"


def make_sources(count: int) -> Path:
    """Return a folder of noisy frames, which is kept for the next part."""
    kills.HEIGHT, kills.WIDTH = HEIGHT, WIDTH
    folder = FOLDER / f"{WIDTH}x{HEIGHT}"
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1, count + 1):
        path = folder / f"in.{number:04d}.exr"
        if not path.exists():
            write_frame(path, kills.make_frame(number))
    return folder


def make_command(sources: Path, outputs: Path, *options: str, quality: str = QUALITY) -> list[str]:
    """Return the command that filters a sequence."""
    names = [str(sources / "in.####.exr"), "-o", str(outputs / "out.####.exr")]
    return [*PROGRAM, "denoise", *names, "--quality", quality, "--progress", "off", *options]


def run_program(command: list[str], *, on_one_core: bool = False) -> dict[str, float]:
    """Run a program; return its wall time and the processor time of it and its children, seconds."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    core = min(os.sched_getaffinity(0))
    environment = {**os.environ, **(ONE_THREAD if on_one_core else {})}
    start = time.perf_counter()
    subprocess.run(
        command,
        check=True,
        capture_output=True,
        env=environment,
        preexec_fn=partial(os.sched_setaffinity, 0, {core}) if on_one_core else None,
    )
    seconds = time.perf_counter() - start
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    used = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    return {"seconds": seconds, "cpu_seconds": used}


def pick_frames(sources: Path, count: int, home: Path) -> Path:
    """Return a folder of links to the first frames."""
    folder = home / f"first{count}"
    folder.mkdir()
    for number in range(1, count + 1):
        (folder / f"in.{number:04d}.exr").symlink_to(sources / f"in.{number:04d}.exr")
    return folder


def measure_work(sources: Path, count: int, home: Path) -> dict[str, Any]:
    """Return the time of a frame in one process on one core, without the start of the process."""
    found = {}
    for frames in (1, count):
        outputs = home / f"out{frames}"
        outputs.mkdir()
        command = make_command(pick_frames(sources, frames, home), outputs)
        found[frames] = run_program(command, on_one_core=True)
    frame = {key: (found[count][key] - found[1][key]) / (count - 1) for key in ("seconds", "cpu_seconds")}
    return {"frames": count, "frame": frame, "start": found[1]["seconds"] - frame["seconds"]}


def measure_farm(sources: Path, count: int, home: Path) -> dict[str, Any]:
    """Return the time of a whole run on a farm of this machine."""
    outputs = home / "out"
    outputs.mkdir()
    command = make_command(pick_frames(sources, count, home), outputs, "--workers", str(WORKERS))
    found = run_program(command)
    return {"frames": count, **found, "written": count_outputs(outputs)}


def measure_losses(sources: Path, count: int, home: Path) -> dict[str, Any]:
    """Return how many frames came out how after a killed worker, a killed scheduler, and the same command again."""
    picked = pick_frames(sources, count, home)
    alone, together = home / "alone", home / "together"
    for folder in (alone, together):
        folder.mkdir()
    subprocess.run(make_command(picked, alone, quality=SMALL_QUALITY), check=True, capture_output=True)
    with Farm(home, WORKERS) as farm:
        command = make_command(picked, together, "--farm", farm.address, quality=SMALL_QUALITY)
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as program:
            moments = [_strike(farm.kill_worker, together, count // 3)]
            moments.append(_strike(farm.restart_scheduler, together, 2 * count // 3))
            program.communicate()
        subprocess.run(command, check=True, capture_output=True)
    expected = {path.name: path.read_bytes() for path in alone.iterdir()}
    made = {path.name: path.read_bytes() if path.is_file() else b"" for path in together.iterdir()}
    return {
        "frames": count,
        "frames_before_worker_was_killed": moments[0],
        "frames_before_scheduler_was_killed": moments[1],
        "same_bytes_as_one_process": sum(made.get(name) == data for name, data in expected.items()),
        "missing": len(expected.keys() - made.keys()),
        "left_over": len(made.keys() - expected.keys()),
    }


def _strike(strike: Callable[[], None], folder: Path, count: int) -> int:
    """Call a function as soon as a folder has a number of frames; return how many it had."""
    wait_until(lambda: count_outputs(folder) >= count, MAX_SECONDS)
    seen = count_outputs(folder)
    strike()
    return seen


def compare(parts: dict[str, Any]) -> dict[str, float]:
    """Return the time of a farm over the work divided by its workers: processor time, and wall time where it counts.

    The processors of a farm share its processor time, so the first ratio is that of processor time and work.
    """
    found = {}
    for suffix, key, workers in (("", "cpu_seconds", 1), ("_quiet", "seconds", WORKERS)):
        work, farm = parts.get(f"work{suffix}"), parts.get(f"farm{suffix}")
        if work and farm:
            found[key] = farm[key] / (work["frame"][key] * farm["frames"] / workers)
    return found


PARTS = {"work": measure_work, "farm": measure_farm, "losses": measure_losses}


def main() -> None:
    """Measure a part, and add it to the JSON file."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=sorted(PARTS), required=True)
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("--output", type=Path, default=RESULTS / "farm.json")
    parser.add_argument("--quiet", action="store_true", help="nothing else runs: wall times count")
    options = parser.parse_args()
    sources = make_sources(options.frames)
    count = options.frames // 4 if options.part == "work" else options.frames
    with tempfile.TemporaryDirectory() as home:
        found = PARTS[options.part](sources, count, Path(home))
    known = json.loads(options.output.read_text()) if options.output.exists() else {}
    size = {"width": WIDTH, "height": HEIGHT, "quality": QUALITY, "workers": WORKERS}
    name = f"{options.part}_quiet" if options.quiet else options.part
    parts = {**known.get("parts", {}), name: {**found, "machine": describe_machine()}}
    result = {**size, "parts": parts, "over_divided_work": compare(parts)}
    write_json(options.output, result)
    json.dump(result, sys.stdout, indent=1)


if __name__ == "__main__":
    main()
