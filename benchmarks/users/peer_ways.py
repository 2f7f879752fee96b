"""What the ways of calling Open Image Denoise cost and give: the choice of `lobewise.denoising.combining`.

    python -m benchmarks.users.peer_ways FRAMES --foreign FOLDER

Folders as of `benchmarks.users`, without the kinds of `benchmarks/foreign/factory` that are for validation. Errors and
times are over those of the library at its best: guides prefiltered at its quality "high", then declared clean. Errors
are geometric means by group, without the worst 0.1 % of pixels, and the largest of all frames.
"""

from __future__ import annotations

import argparse
import json
import math
import time
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.users.measuring import make_reference_judge
from benchmarks.users.scenes import FACTORY, Scene, list_scenes
from lobewise.denoising.combining import UNGUIDED_QUALITY, average_alike
from lobewise.filters.noise.albedo import clean_albedo
from lobewise.frame import FloatArray, Frame, GBuffer, Radiance
from lobewise.peers import denoise_oidn

TIMED_SHAPE = (1080, 1920)
BEST = "prefiltered high, filter high"
Way = Callable[[Frame], FloatArray]
OURS = {"prefilter": "fast", "clean_albedo": clean_albedo}
"""Normals prefiltered by the library, albedos by `clean_albedo`."""


def call(**options: Any) -> Way:
    """Return a way that calls the library once."""
    return lambda frame: denoise_oidn(frame, **options)[0]


def call_unguided(quality: str) -> Way:
    """Return a way that passes no guides on."""
    return lambda frame: denoise_oidn(Frame(Radiance(frame.radiance.color)), quality=quality)[0]


def average(guided: Way) -> Way:
    """Return a way that averages an image with the one without guides."""
    return lambda frame: average_alike(guided(frame), call_unguided(UNGUIDED_QUALITY)(frame))


WAYS: dict[str, Way] = {
    BEST: call(),
    "prefiltered fast, filter high": call(prefilter="fast"),
    "prefiltered fast, filter balanced": call(prefilter="fast", quality="balanced"),
    "albedo by lobewise, filter high": call(**OURS),
    "not prefiltered, filter high": call(guides="mean"),
    **{f"no guides, {quality}": call_unguided(quality) for quality in ("high", "balanced", "fast")},
    "prefiltered high, filter high; no guides": average(call()),
    "prefiltered fast, filter high; no guides": average(call(prefilter="fast")),
    "prefiltered fast, filter balanced; no guides": average(call(prefilter="fast", quality="balanced")),
    "albedo by lobewise, filter high; no guides": average(call(**OURS)),
    "not prefiltered, filter high; no guides": average(call(guides="mean")),
}


def measure_errors(scene: Scene) -> dict[int, dict[str, float]]:
    """Return the error of every way by the samples per pixel, over the best way's."""
    judge, found = make_reference_judge(*scene.reference_images), {}
    for spp in scene.frames:
        frame = scene.read(spp)
        given = scene.read_peer(spp, frame) or frame
        errors = {name: judge.measure(way(given))[1] for name, way in WAYS.items()}
        found[spp] = {name: error / errors[BEST] for name, error in errors.items()}
    return found


def measure_times() -> dict[str, float]:
    """Return the processor time of every way on one large frame, over the best way's: the least of two runs each."""
    rng = np.random.default_rng(1)
    color, albedo = rng.gamma(0.5, 1.0, (*TIMED_SHAPE, 3)), rng.random((*TIMED_SHAPE, 3))
    frame = Frame(Radiance(color), GBuffer(normal=rng.normal(size=color.shape), diffuse_albedo=albedo))
    seconds = dict.fromkeys(WAYS, math.inf)
    for _ in range(2):
        for name, way in WAYS.items():
            start = time.process_time()
            way(frame)
            seconds[name] = min(seconds[name], time.process_time() - start)
    return {name: round(each / seconds[BEST], 3) for name, each in seconds.items()}


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--foreign", type=Path, help="frames of other renderers")
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "peer_ways.json")
    asked = parser.parse_args()
    groups: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for scene in list_scenes(asked.frames, asked.foreign):
        if scene.group == FACTORY.name:
            continue
        for spp, errors in measure_errors(scene).items():
            print(scene.key, spp, json.dumps({name: round(error, 3) for name, error in errors.items()}), flush=True)
            for name, error in errors.items():
                groups[scene.group][name].append(error)
    result = {
        group: {
            name: {
                "mean": round(float(np.exp(np.mean(np.log(errors)))), 3),
                "most": round(max(errors), 3),
                "frames": len(errors),
            }
            for name, errors in ways.items()
        }
        for group, ways in groups.items()
    }
    write_json(asked.output, {"machine": describe_machine(), "processor time": measure_times(), "error": result})


if __name__ == "__main__":
    main()
