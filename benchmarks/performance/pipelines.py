"""Processor time of every part of exported pipelines, and their memory.

Each pipeline is exported for this machine, loaded as a shared library, and given frames of the example's scene. Its own
clock tells the processor time of each part, all threads together; the least of all runs counts. One thread runs, so
that other programs on the machine change little.

    python -m benchmarks.performance.pipelines -o benchmarks/results/pipelines.json
"""

import argparse
import ctypes
import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, describe_machine, write_json
from lobewise.exporting.pipeline.recording import make_pipeline
from lobewise.exporting.pipeline.sample import collect_images, get_place, make_sparse, prepare_frame
from lobewise.exporting.pipeline.scene import CUT, SPP, make_frame
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.pipeline.writing import export_pipeline

RESULT = RESULTS / "pipelines.json"
SIZE = (540, 960)
"""Height and width of the frames."""
REPEATS = 4
"""How often the frames are run."""
PIPELINES: Mapping[str, dict[str, Any]] = {
    "fast, separable, sg": {"form": "separable", "similarity": "sg"},
    "fast, separable": {"form": "separable"},
    "fast": {},
    "fast, separable, history": {"form": "separable", "history": True},
    "fast, separable, history, hit distances": {"form": "separable", "history": True, "hit_distance": True},
    "upsample 4": {"upsample": 4, "radius": 5},
    "upsample 4, history": {"upsample": 4, "radius": 5, "history": True},
    "balanced": {"plan": "balanced"},
    "balanced, without halves": {"plan": "balanced", "halves": False},
    "high": {"plan": "high"},
}


class Library:
    """A pipeline in a shared library, for images of one size."""

    def __init__(self, folder: Path, size: tuple[int, int]) -> None:
        self._library = ctypes.CDLL(str(folder / "liblobewise.so"))
        self._library.lobewise_get_stage.restype = ctypes.c_char_p
        self._library.lobewise_get_message.restype = ctypes.c_char_p
        self._library.lobewise_count_bytes.restype = ctypes.c_size_t
        self._pipeline = ctypes.c_void_p()
        height, width = size
        assert self._library.lobewise_create(width, height, ctypes.byref(self._pipeline)) == 0

    @property
    def bytes(self) -> int:
        """Bytes that the pipeline holds."""
        return int(self._library.lobewise_count_bytes(self._pipeline))

    def set(self, *, samples_per_pixel: float) -> None:
        """Set the number that others follow: the first of the settings."""
        settings = (ctypes.c_double * 64)()
        self._library.lobewise_get_settings(self._pipeline, settings)
        settings[0] = samples_per_pixel
        assert self._library.lobewise_set_settings(self._pipeline, settings) == 0

    def run(self, view: Sequence[float], frame: ctypes.Structure) -> dict[str, float]:
        """Denoise a frame; return the seconds of each part."""
        camera = (ctypes.c_double * len(view))(*view)
        if self._library.lobewise_run(self._pipeline, camera, ctypes.byref(frame)) != 0:
            raise RuntimeError(self._library.lobewise_get_message(self._pipeline).decode())
        found: dict[str, float] = {}
        number, seconds = 0, ctypes.c_double()
        while name := self._library.lobewise_get_stage(self._pipeline, number, ctypes.byref(seconds)):
            found[name.decode()] = found.get(name.decode(), 0.0) + seconds.value
            number += 1
        return found

    def free(self) -> None:
        """Free the pipeline."""
        self._library.lobewise_destroy(self._pipeline)


def pack_frame(given: Mapping[str, Any], place: tuple[int, int], image: Any, told: Mapping[str, Any]) -> Any:
    """Return the structure of a frame in C; results beside the image are not asked for."""
    sparse = [("row", ctypes.c_int), ("column", ctypes.c_int)] if told["settings"]["upsample"] > 1 else []
    fields = [(name, ctypes.c_void_p) for name in given]
    fields += [*sparse, *((each["name"], ctypes.c_void_p) for each in told["results"])]
    frame = type("Frame", (ctypes.Structure,), {"_fields_": fields})()
    for name, array in given.items():
        setattr(frame, name, array.ctypes.data)
    if sparse:
        frame.row, frame.column = place
    frame.image = image.ctypes.data
    return frame


def measure(settings: PipelineSettings, size: tuple[int, int], folder: Path) -> dict[str, Any]:
    """Return the nanoseconds for each pixel of each part of a pipeline, and the bytes for each pixel."""
    export_pipeline(folder, settings)
    told = json.loads((folder / "lobewise-export.json").read_text())
    graph, library = make_pipeline(settings).graph, Library(folder, size)
    image, runs = np.empty((*size, 3), np.float32), []
    halves = settings.quality.reads_halves
    for number in (k for _ in range(REPEATS) for k in range(CUT)):
        whole = prepare_frame(settings, make_frame(number, size=size, halves=halves))
        frame = make_sparse(settings, whole, number)
        given = {name: np.ascontiguousarray(each) for name, each in collect_images(graph, frame).items()}
        camera = frame.require_camera("a pipeline")
        view = [*camera.position, *camera.forward, *camera.up, camera.fov_y, 0.0, *camera.shift]
        packed = pack_frame(given, get_place(frame), image, told)
        runs.append(library.run(view, packed))
    # A frame without a past has less to do.
    runs = runs[1:]
    pixels, held = size[0] * size[1], library.bytes
    library.free()
    stages = {name: 1e9 * min(run[name] for run in runs) / pixels for name in runs[0]}
    return {
        "settings": told["settings"],
        "kernels": len(told["kernels"]),
        "bytes_per_pixel": held / pixels,
        "planned_bytes_per_pixel": told["bytes_per_pixel"],
        "nanoseconds_per_pixel": sum(stages.values()),
        "stages": stages,
    }


def main() -> None:
    """Measure all pipelines and write the JSON file."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    parser.add_argument("--size", type=int, nargs=2, default=SIZE, metavar=("HEIGHT", "WIDTH"))
    arguments = parser.parse_args()
    os.environ["HL_NUM_THREADS"] = "1"
    size = (arguments.size[0], arguments.size[1])
    found = {}
    for name, changes in PIPELINES.items():
        with tempfile.TemporaryDirectory() as folder:
            found[name] = measure(PipelineSettings(**changes), size, Path(folder) / "out")
        print(name, f"{found[name]['nanoseconds_per_pixel']:.0f} ns for each pixel", flush=True)
    record = {"machine": describe_machine(), "size": list(size), "spp": SPP, "threads": 1, "pipelines": found}
    write_json(arguments.output, record)


if __name__ == "__main__":
    main()
