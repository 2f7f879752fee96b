"""Measure light groups: ``python -m benchmarks.foreign.groups FOLDER``.

FOLDER is that of the factory (``factory FOLDER --groups``). The error is the relative squared one of each group, freed
of the noise of the references. The peer is Open Image Denoise on each group with the guides of the picture, as in
Blender's compositor. ``sum`` is the largest difference of the groups' sum from the picture, as a share of the picture's
mean light.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.users.measuring import make_reference_judge
from lobewise.peers import denoise_oidn
from lobewise.records.frame import Radiance

QUALITIES = ("fast", "balanced", "high", "auto")


def measure_seconds(call: Callable[[], Any]) -> tuple[Any, float]:
    """Return what a call gives the second time, and the processor time of this."""
    call()
    start = time.process_time()
    return call(), time.process_time() - start


def measure_file(path: Path) -> dict[str, Any]:
    """Return the errors of every light group of a noisy file, by group and method, and facts on the whole."""
    frame = lobewise.read_frame(path)
    references = [lobewise.read_frame(path.parent / f"reference_{part}.exr") for part in (1, 2)]
    results = {}
    facts: dict[str, Any] = {"sum": {}, "time": {}}
    for quality in QUALITIES:
        result, seconds = measure_seconds(lambda: lobewise.denoise(frame, quality=quality))  # noqa: B023
        _, alone = measure_seconds(lambda: lobewise.denoise(frame.with_changes(also={}), quality=quality))  # noqa: B023
        apart = np.abs(sum(result.also[name] for name in frame.also) - result.image)
        facts["sum"][quality] = float(apart.max() / result.image.mean())
        facts["time"][quality] = round(seconds / alone, 2)
        results[quality] = result.also
    results["noisy"] = frame.also
    results["Open Image Denoise"] = {
        name: denoise_oidn(frame.with_changes(radiance=Radiance(image), layers=(), also={}))[0]
        for name, image in frame.also.items()
    }
    errors: dict[str, dict[str, float]] = {}
    for name in frame.also:
        judge = make_reference_judge(*(one.also[name] for one in references))
        errors[name.rpartition("_")[2]] = {
            method: round(judge.measure(images[name])[0], 6) for method, images in results.items()
        }
    return {"errors": errors, **facts}


def main() -> None:
    """Write benchmarks/results/groups.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    files = {
        f"{shot.parent.name}, {spp} spp": shot.parent / f"{spp}.exr"
        for shot in sorted(parser.parse_args().folder.glob("*/shot.json"))
        for spp in (4, 16, 64)
    }
    rows = {name: measure_file(path) for name, path in files.items()}
    write_json(RESULTS / "groups.json", {"files": rows, "machine": describe_machine()})


if __name__ == "__main__":
    main()
