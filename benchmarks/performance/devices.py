"""Time of whole calls of `denoise` on the devices of this machine, by quality, beside the processor.

    python -m benchmarks.performance.devices -o benchmarks/results/devices.json

The devices denoise one frame in turn, and the best time of each counts; images travel to the device and back.
"""

import argparse
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, describe_machine, write_json
from lobewise.backend.devices import list_devices
from lobewise.cli.bench.plane import make_frame
from lobewise.cli.bench.timing import time_best
from lobewise.denoising import denoise
from lobewise.errors import DeviceError
from lobewise.records.frame import Frame

CASES: dict[str, dict[str, Any]] = {
    "fast, separable, sg": {"quality": "fast", "form": "separable", "similarity": "sg"},
    "fast": {"quality": "fast"},
    "balanced": {"quality": "balanced"},
    "high": {"quality": "high"},
}


def measure_case(frame: Frame, settings: dict[str, Any], devices: list[str]) -> dict[str, Any]:
    """Return by device the milliseconds, the ratio to the processor's, and the largest difference to its image."""
    calls, row = {}, {}
    for name in devices:
        call = partial(denoise, frame, device=name, with_oidn=False, **settings)
        try:
            image = call().image
        except DeviceError as problem:
            row[name] = {"problem": str(problem)}
            continue
        calls[name] = call
        if name == "cpu":
            own = image
        row[name] = {"largest_difference": float(np.abs(image - own).max() / np.abs(own).max())}
    best = time_best(calls, 2.0)
    for name, seconds in best.items():
        row[name] |= {"milliseconds": round(1e3 * seconds, 1), "over_cpu": round(seconds / best["cpu"], 3)}
    return row


def main() -> None:
    """Time the calls and write the file."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "devices.json")
    parser.add_argument("--size", default="1920x1080")
    asked = parser.parse_args()
    width, height = map(int, asked.size.split("x"))
    frame, devices = make_frame(width, height), [each for each in list_devices() if each.available]
    cases = {}
    for name, settings in CASES.items():
        cases[name] = measure_case(frame, settings, [each.name for each in devices])
        print(name, cases[name], flush=True)
    told = {each.name: each.reason for each in devices}
    write_json(asked.output, {"size": [width, height], "devices": told, "machine": describe_machine(), "cases": cases})


if __name__ == "__main__":
    main()
