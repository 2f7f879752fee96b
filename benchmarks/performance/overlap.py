"""Wall time of a sequence whose frames are read, filtered and written at the same time, over that of its slowest stage.

A Blender frame with all passes is repeated to 1920x1080 and counts as every frame of the sequence. First each frame is
read, filtered and written one after the other, which gives the time of each stage alone. Then `lobewise.denoise_files`
takes the same frames. Both run in turn, and the least time of each counts. Processor time says what the overlap costs,
and which wall time the cores allow: half of it on two.

    python -m benchmarks.performance.overlap --shot factory/jewels_0/16.exr
"""

import argparse
import os
import struct
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from lobewise.io.exr.container import Chunk, Window
from lobewise.io.exr.parsing import read_container
from lobewise.io.exr.pixels import decode_part, encode_part
from lobewise.io.exr.splice import write_container
from lobewise.io.sequence import name_frame
from lobewise.recipes.files import FileRequest
from lobewise.recipes.files.remarks import Remarks
from lobewise.recipes.files.running import open_filter
from lobewise.settings import DenoiseSettings
from lobewise.work.progress import FILTER, READ, WRITE

RESULT = RESULTS / "overlap.json"
SIZE = (1920, 1080)
FRAMES, ROUNDS = 24, 2
GOAL = 1.2
"""Largest wall time over that of the slowest stage."""


def repeat(source: Path, target: Path, width: int, height: int) -> None:
    """Write a file of another size that repeats the pixels of a file with one part."""
    container = read_container(source)
    (part,) = container.parts
    rows, columns = np.arange(height) % part.data_window.height, np.arange(width) % part.data_window.width
    pixels = {name: plane[rows][:, columns] for name, plane in decode_part(container, part).items()}
    window, box = Window(0, 0, width - 1, height - 1), struct.pack("<4i", 0, 0, width - 1, height - 1)
    windows = ("dataWindow", "displayWindow")
    header = [replace(item, value=box) if item.name in windows else item for item in part.attributes]
    count = -(-height // part.rows_per_chunk)
    whole = replace(part, data_window=window, display_window=window, chunks=(Chunk(0, 0, 0),) * count)
    with target.open("wb") as out, source.open("rb") as stream:
        chunks = iter(encode_part(container, whole, pixels))
        write_container(out, replace(container, parts=(whole,)), stream, [header], {0: chunks})


def time_stages(source: Path, output: Path, request: FileRequest, frames: int) -> dict[str, float]:
    """Return the time of each stage over all frames, one stage at a time, seconds."""
    files = open_filter(request, source, output, Remarks())
    seconds = dict.fromkeys((READ, FILTER, WRITE), 0.0)
    for number in range(1, frames + 1):
        times = [time.perf_counter()]
        file = files.read(name_frame(source, number))
        times.append(time.perf_counter())
        result = files.make_filter().add(file)
        times.append(time.perf_counter())
        files.write(name_frame(output, number), result, file)
        times.append(time.perf_counter())
        for stage, spent in zip(seconds, np.diff(times), strict=True):
            seconds[stage] += float(spent)
    return seconds


def measure(folder: Path, shot: Path, frames: int) -> dict[str, Any]:
    """Return the least times of the stages alone and of the whole sequence, and their ratios."""
    source, output = folder / "in.####.exr", folder / "out.####.exr"
    repeat(shot, name_frame(source, 1), *SIZE)
    for number in range(2, frames + 1):
        os.link(name_frame(source, 1), name_frame(source, number))
    request = FileRequest(settings=DenoiseSettings(quality="fast", device="cpu"))
    lobewise.denoise_files(source, output, request, numbers=[1])
    stages: list[dict[str, float]] = []
    runs: list[tuple[float, float, float]] = []
    for _ in range(ROUNDS):
        begun = time.process_time()
        stages.append(time_stages(source, output, request, frames))
        start, between = time.perf_counter(), time.process_time()
        lobewise.denoise_files(source, output, request)
        runs.append((time.perf_counter() - start, time.process_time() - between, between - begun))
    alone = {stage: round(min(each[stage] for each in stages), 2) for stage in stages[0]}
    wall = min(runs)[0]
    return {
        "seconds_alone": alone,
        "processor_seconds_alone": round(min(before for *_, before in runs), 2),
        "seconds": round(wall, 2),
        "processor_seconds": round(min(spent for _, spent, _ in runs), 2),
        "over_slowest": round(wall / max(alone.values()), 3),
        "over_sum": round(wall / sum(alone.values()), 3),
    }


def main() -> None:
    """Measure and write the result."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--shot", type=Path, required=True, help="a Blender frame of benchmarks/foreign/factory")
    parser.add_argument("--frames", type=int, default=FRAMES)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        row = measure(Path(folder), asked.shot, asked.frames)
    print(row)
    what = "quality fast; wall time of the sequence over that of its stages, one at a time"
    shot = f"{asked.shot.parent.name}/{asked.shot.name}"
    facts = {"what": what, "shot": shot, "size": list(SIZE), "frames": asked.frames, "goal": GOAL}
    write_json(asked.output, {**facts, **row, "machine": describe_machine()})


if __name__ == "__main__":
    main()
