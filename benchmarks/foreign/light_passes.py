"""Measure passes of light: ``python -m benchmarks.foreign.light_passes FOLDER [--before SOURCES]``.

FOLDER is that of the factory of Blender's files. `lobewise denoise` writes each ``16.exr`` anew. The error of
a pass is that of the light it adds to the picture, its light times the color of its layer, freed of the noise of the
references and without the worst pixels. ``--before`` names the sources of an earlier version, whose files are measured
beside. The peer is Open Image Denoise on each pass with the guides of the picture, as in Blender's compositor. ``sum``
is the largest difference of the passes' sum from the picture, in steps that half floats have at the brighter of the
noisy and the clean pixel.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.users.measuring import make_reference_judge
from lobewise.peers import denoise_oidn
from lobewise.records.frame import FloatArray, Radiance

SPP = 16
LAYERS = ("Diff", "Gloss", "Trans", "Volume")
UNSCATTERED = ("Emit", "Env")
MIN_LIGHT_SHARE = 0.001
"""Passes that hold less of the picture's light are left out."""


def read_passes(path: Path) -> dict[str, FloatArray]:
    """Return what the passes of a file of one layer add to the picture, (height, width, 3), and "Combined"."""
    with OpenEXR.File(str(path)) as file:
        channels = file.channels()
        images = {
            name.rpartition(".")[2]: channel.pixels[..., :3].astype(np.float32)
            for name, channel in channels.items()
            if channel.pixels.ndim == 3
        }
    passes = {"Combined": images["Combined"]}
    for layer in LAYERS:
        for way in ("Dir", "Ind"):
            if (name := f"{layer}{way}") in images:
                passes[name] = images[name] * images.get(f"{layer}Col", np.float32(1.0))
    return passes | {name: images[name] for name in UNSCATTERED if name in images}


def denoise_file(path: Path, sources: Path | None) -> dict[str, FloatArray]:
    """Return the passes of the file that the command writes, of the version of these sources, if any are given."""
    with tempfile.TemporaryDirectory() as folder:
        target = Path(folder) / "clean.exr"
        environment = os.environ | ({"PYTHONPATH": str(sources)} if sources else {})
        command = [sys.executable, "-m", "lobewise", "denoise", str(path), "-o", str(target)]
        subprocess.run(command, check=True, env=environment, capture_output=True)
        return read_passes(target)


def count_steps(passes: dict[str, FloatArray], noisy: dict[str, FloatArray]) -> float:
    """Return how far the passes' sum is from the picture at most, in steps of half floats of the brightest image."""
    total = np.sum([image for name, image in passes.items() if name != "Combined"], axis=0, dtype=np.float64)
    largest = np.max(np.abs([*passes.values(), *noisy.values()]), axis=0)
    steps = np.spacing(np.maximum(largest, 2.0**-14).astype(np.float16)).astype(np.float64)
    return round(float((np.abs(total - passes["Combined"]) / steps).max()), 2)


def measure_shot(folder: Path, sources: Path | None) -> dict[str, Any]:
    """Return the errors of every pass of a shot, by pass and method, and how far the sums are from the pictures."""
    path = folder / f"{SPP}.exr"
    frame = lobewise.read_frame(path)
    first, second = (read_passes(folder / f"reference_{part}.exr") for part in (1, 2))
    results = {"noisy": read_passes(path), "now": denoise_file(path, None)}
    if sources:
        results["before"] = denoise_file(path, sources)
    light = float(first["Combined"].mean())
    errors: dict[str, dict[str, float]] = {}
    for name, noisy in results["noisy"].items():
        if name in ("Combined", *UNSCATTERED) or float(first[name].mean()) < MIN_LIGHT_SHARE * light:
            continue
        judge = make_reference_judge(first[name], second[name])
        images = {method: passes[name] for method, passes in results.items()}
        one = frame.with_changes(radiance=Radiance(noisy), layers=(), also={})
        images["Open Image Denoise"] = denoise_oidn(one)[0]
        errors[name] = {method: round(judge.measure(image)[1], 7) for method, image in images.items()}
    sums = {method: count_steps(passes, results["noisy"]) for method, passes in results.items()}
    return {"errors": errors, "sum": sums}


def main() -> None:
    """Write benchmarks/results/light_passes.json."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--before", type=Path, help="sources of an earlier version")
    asked = parser.parse_args()
    shots = {}
    for path in sorted(asked.folder.glob(f"*/{SPP}.exr")):
        shots[path.parent.name] = measure_shot(path.parent, asked.before)
        print(path.parent.name, shots[path.parent.name], flush=True)
    write_json(RESULTS / "light_passes.json", {"spp": SPP, "shots": shots, "machine": describe_machine()})


if __name__ == "__main__":
    main()
