"""Random scenes to learn from: rooms, stages, dark rooms and corridors, made in code from a seed.

A learned predictor of the denoiser's parameters is trained on them and on nothing else: the built-in scenes, which the
figures of this project are measured on, share no object, texture or light with them.

    python -m benchmarks.training.scenes --cache DIR --count 24 --size 192 --reference-spp 1024

renders for each seed from 1 a frame of 1, 4, 16 and 64 samples per pixel, ``train-<seed>-<spp>.exr``, and the reference
as two independent halves, ``train-<seed>-reference-a.exr`` and ``-b.exr``: with errors taken against both, the mean of
their product is free of the references' own noise. What is there already is not rendered again.
"""

from __future__ import annotations

import argparse
import gc
import time
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.training.frames import open_cache
from benchmarks.training.materials import draw_log
from benchmarks.training.settings import make_corridor, make_open_stage, make_room
from lobewise.io.exr import write_frame
from lobewise.render import load_mitsuba, render_frame, render_reference
from lobewise.render.loading import build_scene
from lobewise.scenes import parts

SAMPLES = (1, 4, 16, 64)
SETTINGS = ("room", "stage", "dark", "corridor", "room", "stage")
"""What the seeds go through in turn, so that few scenes already hold every kind."""

SALT = 20260215
"""Sets these random numbers apart from those of every other program that counts seeds from 1."""

MEDIANS = {"room": (0.12, 1.0), "stage": (0.15, 1.0), "dark": (0.08, 0.3), "corridor": (0.1, 0.7)}
"""Bounds of the median radiance, by setting: what a scene's lights are scaled to."""

PROBE_SIZE, PROBE_SPP = 32, 8
"""The small render that the scale of the lights is taken from: 8192 samples."""

LEAST_MEDIAN = 0.15
"""Of the brightness that a tenth of the pixels exceed: the median counts as no less, lest what is lit blows up."""


def _make_scene(seed: int, width: int, height: int, light: float) -> dict[str, Any]:
    """Return the scene of a seed with all its lights scaled by ``light``."""
    generator = np.random.default_rng([SALT, seed])
    kind = SETTINGS[(seed - 1) % len(SETTINGS)]
    if kind == "stage":
        stage = make_open_stage(generator, light)
    elif kind == "corridor":
        stage = make_corridor(generator, light)
    else:
        stage = make_room(generator, light, dark=kind == "dark")
    return {
        "type": "scene",
        "sensor": parts.camera(stage.origin, stage.target, stage.fov, width, height),
        "integrator": {"type": "path", "max_depth": 8},
        **stage.items,
    }


@cache
def measure_light(seed: int) -> float:
    """Return what the lights of a scene are multiplied by, so that its median radiance is what the seed draws."""
    low, high = MEDIANS[SETTINGS[(seed - 1) % len(SETTINGS)]]
    wanted = draw_log(np.random.default_rng([SALT, seed, 1]), low, high)
    probe = build_scene(_make_scene(seed, PROBE_SIZE, PROBE_SIZE, 1.0))
    brightness = render_reference(probe, spp=PROBE_SPP, seed=0).radiance.color.mean(axis=-1)
    found = max(float(np.median(brightness)), LEAST_MEDIAN * float(np.percentile(brightness, 90)))
    # Few digits: the last bits of a render may differ from machine to machine.
    return float(f"{wanted / found:.3g}")


def make_training_scene(seed: int, width: int, height: int) -> dict[str, Any]:
    """Return the scene of a seed, from 1, as a description for `build_scene`; the same seed, the same scene."""
    load_mitsuba()
    return _make_scene(seed, width, height, measure_light(seed))


def load_training_scene(seed: int, size: int) -> Any:
    """Return the ``mitsuba.Scene`` of a seed, from 1, ``size`` pixels a side."""
    return build_scene(make_training_scene(seed, size, size))


def list_files(folder: Path, seed: int) -> Iterator[tuple[Path, int, int]]:
    """Yield path, samples per pixel (0 for a half of the reference) and noise seed of each file of a scene."""
    for spp in SAMPLES:
        yield folder / f"train-{seed}-{spp}.exr", spp, 1000 * seed + spp
    for k, half in enumerate("ab"):
        yield folder / f"train-{seed}-reference-{half}.exr", 0, 1000 * seed + 500 + k


def render_files(folder: Path, seed: int, size: int, reference_spp: int) -> bool:
    """Render what the folder lacks of one scene; return whether anything was."""
    missing = [row for row in list_files(folder, seed) if not row[0].exists()]
    if not missing:
        return False
    scene = load_training_scene(seed, size)
    for path, spp, noise in missing:
        if spp:
            write_frame(path, render_frame(scene, spp=spp, seed=noise))
        else:
            write_frame(path, render_reference(scene, spp=-(-reference_spp // 2), seed=noise), half=False)
    return True


def main() -> None:
    """Render what is missing, and say how long each scene took."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, required=True, help="folder for the files, outside the repository")
    parser.add_argument("--first", type=int, default=1, help="seed of the first scene, from 1")
    parser.add_argument("--count", type=int, default=24, help="how many scenes")
    parser.add_argument("--size", type=int, default=192, help="pixels a side")
    parser.add_argument("--reference-spp", type=int, default=1024, help="samples of both halves together")
    arguments = parser.parse_args()
    folder = open_cache(parser, arguments.cache)
    for seed in range(arguments.first, arguments.first + arguments.count):
        start, spent = time.perf_counter(), time.process_time()
        if render_files(folder, seed, arguments.size, arguments.reference_spp):
            wall, cpu = time.perf_counter() - start, time.process_time() - spent
            print(f"scene {seed}: {wall:.1f} s, {cpu:.1f} s of CPU", flush=True)
        # Every BSDF that lives is compiled into the kernels of the next scene.
        gc.collect()


if __name__ == "__main__":
    main()
