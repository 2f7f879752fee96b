"""Errors on frames of real renderers, which other programs made: with the guides that these have, and no others.

    python render_blender.py FOLDER/blender                       with Python 3.11 and bpy 4.5
    python render_blender.py FOLDER/blender-5.2 --multipart       with Python 3.13 and bpy 5.2
    python render_luxcore.py FOLDER/luxcore                       with Python 3.11 and pyluxcore
    python -m benchmarks.foreign FOLDER --output benchmarks/results/foreign.json

Renderers without a folder and scenes without a reference are left out; what was measured before stays. "normal-aware"
is tuned on the first seed of each scene and sample count against its reference; all others run with their defaults.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.foreign.files import REFERENCE, REFERENCES, RENDERERS, Renderer, list_frames
from benchmarks.foreign.judging import Judge, make_judge
from benchmarks.foreign.methods import BASE, HALVES, METHODS, PEER, TUNED, Shot, run_halves, run_tuned, tune
from benchmarks.quality.measure import round_figure
from lobewise import read_frame

RATIOS = ("fast", "balanced", "high")
KINDS = ("rel_mse", "without the worst")


def measure_shots(shots: Mapping[int, Shot], judge: Judge) -> dict[str, Any]:
    """Return the errors of all methods on one scene and sample count, a value for each seed of two."""
    best = tune(shots[min(shots)], judge)
    row: dict[str, Any] = {"normal-aware settings": {"normal_exponent": best[0], "screen_sigma": best[1]}}
    for name, method in {**METHODS, TUNED: lambda shot: run_tuned(shot, *best)}.items():
        row[name] = _list(judge.measure(method(shot)) for shot in shots.values())
    for name, quality in HALVES.items():
        row[name] = _list([judge.measure(run_halves(*list(shots.values())[:2], quality))])
    return row


def _list(errors: Iterable[tuple[float, ...]]) -> dict[str, list[float]]:
    """Return figures by their kind, rounded."""
    return {
        kind: [round_figure(value) for value in values]
        for kind, values in zip(KINDS, zip(*errors, strict=True), strict=True)
    }


def measure_scene(renderer: Renderer, folder: Path, scene: str, frames: Mapping[int, Mapping[int, Path]]) -> Any:
    """Return the errors on a scene by samples per pixel."""
    paths = [renderer.find(folder, f"{scene}_{REFERENCE}_{half}") for half in REFERENCES]
    references = [read_frame(path, light_passes=False) for path in paths]
    judge = make_judge(*(each.radiance.color for each in references))
    row: dict[str, Any] = {
        "size": [references[0].width, references[0].height],
        "reference_spp": sum(each.spp or 0 for each in references) or None,
        "reference_error": round_figure(judge.measure_noise()),
        "commit": describe_machine()["commit"],
        "samples": {},
    }
    for spp, paths in sorted(frames.items()):
        shots = {seed: Shot(renderer, path) for seed, path in sorted(paths.items())}
        row["samples"][str(spp)] = found = measure_shots(shots, judge)
        cells = "  ".join(f"{name} {_average(found[name][KINDS[0]]):.5f}" for name in (*METHODS, TUNED, *HALVES))
        print(f"{renderer.name} {scene} {spp} spp  {cells}", flush=True)
    return row


def _average(values: Iterable[float]) -> float:
    found = list(values)
    return sum(found) / len(found)


def summarise(scenes: Mapping[str, Any]) -> dict[str, Any]:
    """Return by sample count, and over all, geometric means over scenes of one method's error over another's."""
    logs: dict[str, dict[str, dict[str, list[float]]]] = {kind: {} for kind in KINDS}
    rows = [(spp, row) for scene in scenes.values() for spp, row in scene["samples"].items()]
    for (spp, row), kind, base, name in itertools.product(rows, KINDS, (BASE, PEER), RATIOS):
        above, below = _average(row[name][kind]), _average(row[base][kind])
        for key in (spp, "all"):
            found = logs[kind].setdefault(f"{name} / {base}", {}).setdefault(key, [])
            found.append(math.log(above / below))
    return {
        kind: {
            pair: {key: round_figure(math.exp(_average(values))) for key, values in found.items()}
            for pair, found in pairs.items()
        }
        for kind, pairs in logs.items()
    }


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "foreign.json")
    parser.add_argument("--renderer", choices=[each.name for each in RENDERERS], action="append", help="only this one")
    parser.add_argument("--scene", action="append", help="only this scene (may be repeated)")
    asked = parser.parse_args()
    before = json.loads(asked.output.read_text())["renderers"] if asked.output.exists() else {}
    for renderer in RENDERERS:
        folder = asked.folder / renderer.name
        if (asked.renderer and renderer.name not in asked.renderer) or not folder.is_dir():
            continue
        for scene, frames in list_frames(renderer, folder).items():
            if asked.scene and scene not in asked.scene:
                continue
            scenes = before.get(renderer.name, {"scenes": {}})["scenes"]
            scenes[scene] = measure_scene(renderer, folder, scene, frames)
            before[renderer.name] = {"scenes": scenes, "summary": summarise(scenes)}
            value = {
                "what": "relative mean squared error, epsilon 0.01, freed of the reference's noise "
                "(benchmarks/foreign/judging.py), of all pixels and without the worst 0.1 %; a value for each seed",
                "renderers": before,
                "machine": describe_machine(),
            }
            write_json(asked.output, value)


if __name__ == "__main__":
    main()
