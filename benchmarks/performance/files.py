"""Processor time of reading and writing files, over that of OpenEXR itself for the same channels.

    python -m benchmarks.performance.files --shot factory/jewels_0/16.exr [--against]

reads files of several renderers, sizes and compressions with `lobewise.read_frame`, filters them by the quality "fast"
and writes the result into a copy with `lobewise.write_result`. OpenEXR reads the same file and writes the same copy in
turn, with as many threads. Files of Arnold and Mitsuba are those in the folder that LOBEWISE_TEST_DATA names. All are
repeated to the same sizes; ``--frame`` names a Blender frame that is measured as it is. The program exits with 1 where
reading and writing take more than `LARGEST_RISE` times as much of OpenEXR's time as in the older file of ``--against``.
"""

import argparse
import json
import os
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

import lobewise
from benchmarks.common import RESULTS, SHOWROOM, describe_machine, write_json
from benchmarks.performance.budget import LARGEST_RISE

RESULT = RESULTS / "files.json"
SIZES = {"0.3": (640, 480), "2": (1920, 1080), "8": (3840, 2160)}
"""Columns and rows, by megapixels."""
COMPRESSIONS = {
    "ZIP": OpenEXR.ZIP_COMPRESSION,
    "ZIPS": OpenEXR.ZIPS_COMPRESSION,
    "PIZ": OpenEXR.PIZ_COMPRESSION,
    "DWAA": OpenEXR.DWAA_COMPRESSION,
}
TILE_SIDE_PIXELS = 64
ROUNDS = 3
"""Runs of each step, of which the least time counts."""


def repeat_file(source: Path, path: Path, size: tuple[int, int], compression: str, *, tiled: bool) -> None:
    """Write a file of another size, (columns, rows), that repeats the channels of a file."""
    before = OpenEXR.File(str(source), separate_channels=True)
    width, height = size

    def repeat(plane: Any) -> Any:
        copies = -(-height // plane.shape[0]), -(-width // plane.shape[1])
        return np.ascontiguousarray(np.tile(plane, copies)[:height, :width])

    own = ("channels", "chunkCount", "dataWindow", "displayWindow", "lineOrder", "tiles", "type")
    header = {name: value for name, value in before.header().items() if name not in own}
    header["compression"] = COMPRESSIONS[compression]
    header["type"] = OpenEXR.tiledimage if tiled else OpenEXR.scanlineimage
    if tiled:
        header["tiles"] = OpenEXR.TileDescription()
        header["tiles"].xSize = header["tiles"].ySize = TILE_SIDE_PIXELS
    OpenEXR.File(header, {name: repeat(each.pixels) for name, each in before.channels().items()}).write(str(path))


def time_processor(call: Callable[[], Any]) -> tuple[float, Any]:
    """Return the processor time of a call, seconds, and what it returns."""
    start = time.process_time()
    value = call()
    return time.process_time() - start, value


def measure(path: Path, folder: Path) -> dict[str, float]:
    """Return the least times of reading and writing a file, seconds, and their ratios to those of OpenEXR."""
    output, copy, result = folder / "output.exr", folder / "copy.exr", None
    times: dict[str, list[float]] = {}
    for _ in range(ROUNDS):
        steps: dict[str, tuple[float, Any]] = {"read": time_processor(lambda: lobewise.read_frame(path))}
        result = result or lobewise.denoise(steps["read"][1], quality="fast")
        steps["write"] = time_processor(partial(lobewise.write_result, output, result, source=path))
        steps["OpenEXR read"] = time_processor(lambda: OpenEXR.File(str(path), separate_channels=True))
        written = OpenEXR.File(str(output), separate_channels=True)
        steps["OpenEXR write"] = time_processor(partial(written.write, str(copy)))
        for name, (seconds, _) in steps.items():
            times.setdefault(name, []).append(seconds)
    least = {name: min(each) for name, each in times.items()}
    whole = (least["read"] + least["write"]) / (least["OpenEXR read"] + least["OpenEXR write"])
    return {**{name: round(seconds, 3) for name, seconds in least.items()}, "over OpenEXR": round(whole, 3)}


def list_cases(shot: Path, frame: Path | None) -> dict[str, Callable[[Path], Path]]:
    """Return by name what makes each file in a folder, of those whose sources are there, and returns its path."""
    data = Path(os.environ.get("LOBEWISE_TEST_DATA", "")) / "exr"
    sources = {"Blender": shot, "Arnold": data / "arnold_multichannel.exr", "lobewise": SHOWROOM}
    sources["Mitsuba"] = data / "mitsuba_multi_channels.exr"
    kinds = [(renderer, size, "ZIP", False) for renderer in sources for size in SIZES]
    kinds += [("Blender", "2", compression, False) for compression in COMPRESSIONS if compression != "ZIP"]
    kinds += [("Blender", "2", "ZIP", True)]

    def repeat(source: Path, size: str, compression: str, tiled: bool, folder: Path) -> Path:
        repeat_file(source, folder / "source.exr", SIZES[size], compression, tiled=tiled)
        return folder / "source.exr"

    cases: dict[str, Callable[[Path], Path]] = {} if frame is None else {"Blender, frame": lambda _: frame}
    for renderer, size, compression, tiled in kinds:
        if sources[renderer].is_file():
            name = f"{renderer}, {size} megapixels, {compression}{', tiles' if tiled else ''}"
            cases[name] = partial(repeat, sources[renderer], size, compression, tiled)
    return cases


def main(arguments: list[str] | None = None) -> int:
    """Measure, compare and write; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    parser.add_argument("--against", type=Path, nargs="?", const=RESULT, help=f"an older result ({RESULT.name})")
    parser.add_argument("--only", default="", help="cases whose name has this in it; the others keep their figures")
    parser.add_argument("--shot", type=Path, required=True, help="a Blender frame of benchmarks/foreign/factory")
    parser.add_argument("--frame", type=Path, help="a Blender frame of 1920x1080 pixels")
    asked = parser.parse_args(arguments)
    warnings.simplefilter("ignore")
    OpenEXR.set_global_thread_count(len(os.sched_getaffinity(0)))
    before = json.loads(asked.against.read_text())["files"] if asked.against else {}
    found = json.loads(asked.output.read_text())["files"] if asked.output.exists() else {}
    machine, slower = describe_machine(), []
    for name, make in list_cases(asked.shot, asked.frame).items():
        if asked.only not in name:
            continue
        with tempfile.TemporaryDirectory() as folder:
            found[name] = {**measure(make(Path(folder)), Path(folder)), "commit": machine["commit"]}
        told = ", ".join(f"{key} {value}" for key, value in found[name].items())
        print(f"{name}: {told} ({before.get(name, {}).get('over OpenEXR', 'new')})", flush=True)
        if name in before and found[name]["over OpenEXR"] > LARGEST_RISE * before[name]["over OpenEXR"]:
            slower.append(name)
        what = "least processor time, seconds, and reading and writing over OpenEXR's own"
        write_json(asked.output, {"what": what, "machine": machine, "files": found})
    if slower:
        print(f"slower than {LARGEST_RISE} times before, over OpenEXR: {', '.join(slower)}", file=sys.stderr)
    return int(bool(slower))


if __name__ == "__main__":
    sys.exit(main())
