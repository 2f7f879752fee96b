"""Processor time of whole recipes, over that of their kernels alone and over Open Image Denoise's fast call.

What a recipe takes beyond its kernels is spent between them: on checks, sentences for the user and passes over images.

    python -m benchmarks.performance.budget --against [--shot factory/jewels_0/16.exr]

measures every recipe on one thread, tells each beside the committed file, and writes that file anew. It exits with 1
where a recipe takes more than `LARGEST_RISE` times as much of Open Image Denoise's time as before. Kernels and their
recipe are timed in one run, and Open Image Denoise in turn with both, so that a slow machine slows all. ``--shot`` adds
the recipes of a Blender frame with all passes, repeated to the same size.
"""

import argparse
import json
import sys
import time
import warnings
from collections.abc import Callable, Mapping
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.same_bits.frames import load_bundled, roughen
from lobewise import peers
from lobewise.backend.runtime import Runtime
from lobewise.cli.bench.timing import limit_threads
from lobewise.peers import denoise_oidn
from lobewise.records.frame import Frame, GBuffer, Radiance
from lobewise.records.radiance import RadianceLayer
from lobewise.settings import QUALITY_NAMES

RESULT = RESULTS / "budget.json"
SIZE = (1920, 1080)
LARGEST_RISE = 1.2
"""Largest time over that of the older file, both over Open Image Denoise's. Beside other work, times of one version
differ by 10 %."""
RECIPES: dict[str, dict[str, Any]] = {
    "fast, separable, sg": {"quality": "fast", "form": "separable", "similarity": "sg"},
    "fast": {"quality": "fast"},
    "balanced": {"quality": "balanced"},
    "high": {"quality": "high"},
    "auto": {},
}
AVERAGED = ("normal", "diffuse_albedo", "specular_albedo")
"""Guides of which our own renderer writes means without the noise of samples."""
MIN_SECONDS, MIN_ROUNDS = 8.0, 2
"""Processor time and runs after which a recipe is measured, without the first run."""
MAX_PEER_ROUNDS = 3
"""Runs of Open Image Denoise beside each recipe."""


def tile(frame: Frame, width: int, height: int) -> Frame:
    """Return a frame of another size that repeats a frame; the camera sees the surfaces askew, which takes no time."""
    down, right = -(-height // frame.height), -(-width // frame.width)

    def repeat(value: Any) -> Any:
        if isinstance(value, np.ndarray):
            return np.ascontiguousarray(np.tile(value, (down, right, 1)[: value.ndim])[:height, :width])
        if isinstance(value, Mapping):
            return {name: repeat(image) for name, image in value.items()}
        if isinstance(value, (Radiance, GBuffer, RadianceLayer)):
            return type(value)(**{item.name: repeat(getattr(value, item.name)) for item in fields(value)})
        return value

    return Frame(
        repeat(frame.radiance),
        repeat(frame.gbuffer),
        frame.camera,
        spp=frame.spp,
        layers=tuple(map(repeat, frame.layers)),
        unscattered=repeat(frame.unscattered),
    )


def make_shot_calls(frame: Frame) -> dict[str, Callable[[], Any]]:
    """Return the recipes of a Blender frame by their names."""
    names = {quality: {"quality": quality} for quality in QUALITY_NAMES} | {"auto": {}}
    calls: dict[str, Callable[[], Any]] = {
        f"Blender, {name}": partial(lobewise.denoise, frame, device="cpu", **settings)
        for name, settings in names.items()
    }
    calls["Blender, Open Image Denoise as called"] = partial(denoise_oidn, frame, guides="noisy")
    calls["Blender, Open Image Denoise at its best"] = partial(denoise_oidn, frame)
    return calls


def make_calls(frame: Frame) -> dict[str, Callable[[], Any]]:
    """Return every recipe by its name."""
    calls: dict[str, Callable[[], Any]] = {
        name: partial(lobewise.denoise, frame, device="cpu", **settings) for name, settings in RECIPES.items()
    }
    means = {f"mean_{name}": getattr(frame.gbuffer, name) for name in AVERAGED}
    clean = frame.with_changes(gbuffer=replace(frame.gbuffer, **means))
    calls["auto, guides without noise"] = partial(lobewise.denoise, clean, device="cpu")
    calls["high, normals of noise"] = partial(lobewise.denoise, roughen(frame), device="cpu", quality="high")
    calls["Open Image Denoise as called"] = partial(denoise_oidn, frame, guides="noisy")
    calls["Open Image Denoise at its best"] = partial(denoise_oidn, frame)
    calls["upsampling"] = partial(lobewise.upsample, lobewise.make_sparse(frame, 4), device="cpu")
    calls["history"] = partial(lobewise.TemporalFilter(device="cpu").add, frame)
    return calls


def time_processor(call: Callable[[], Any]) -> tuple[float, float, float]:
    """Return the processor time of a call, that of its kernels, and that of the library it calls, seconds."""
    kernels: list[float] = []
    library: list[float] = []

    def timed(run: Callable[..., Any], spent: list[float]) -> Callable[..., Any]:
        def wrapped(*given: Any, **named: Any) -> Any:
            start = time.process_time()
            try:
                return run(*given, **named)
            finally:
                spent.append(time.process_time() - start)

        return wrapped

    with (
        patch.object(Runtime, "call", timed(Runtime.call, kernels)),
        patch.object(peers, "_run_library", timed(peers._run_library, library)),
    ):
        start = time.process_time()
        call()
        return time.process_time() - start, sum(kernels), sum(library)


def measure(call: Callable[[], Any], peer: Callable[[], Any]) -> dict[str, Any]:
    """Return the least times of a recipe and of the peer's call, which run in turn, and their ratios."""
    call()
    runs: list[tuple[float, float, float]] = []
    peers: list[float] = []
    while len(runs) < MIN_ROUNDS or sum(total for total, *_ in runs) < MIN_SECONDS:
        runs.append(time_processor(call))
        if len(peers) < MAX_PEER_ROUNDS:
            peers.append(time_processor(peer)[0])
    total, kernels, library = min(runs)
    return {
        "seconds": round(total, 3),
        "of_library": round(library, 3),
        "over_kernels": round(total / (kernels + library), 3),
        "over_oidn_fast": round(total / min(peers), 4),
    }


def list_rises(before: Mapping[str, Any], after: Mapping[str, Any]) -> list[str]:
    """Return the recipes that take too much more time than before, of Open Image Denoise's."""
    shared = before["recipes"].keys() & after["recipes"].keys()
    times = {name: [each["recipes"][name]["over_oidn_fast"] for each in (before, after)] for name in shared}
    return sorted(name for name, (old, new) in times.items() if new > LARGEST_RISE * old)


def main(arguments: list[str] | None = None) -> int:
    """Measure, compare and write; return the exit code."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    parser.add_argument("--against", type=Path, nargs="?", const=RESULT, help=f"an older result ({RESULT.name})")
    parser.add_argument("--only", default="", help="recipes whose name has this in it; the others keep their figures")
    parser.add_argument("--shot", type=Path, help="a Blender frame of benchmarks/foreign/factory")
    asked = parser.parse_args(arguments)
    limit_threads(1)
    warnings.simplefilter("ignore")
    before = json.loads(asked.against.read_text()) if asked.against else {"recipes": {}}
    found = json.loads(asked.output.read_text())["recipes"] if asked.output.exists() else {}
    frame, machine = tile(load_bundled(), *SIZE), describe_machine()
    peer = partial(denoise_oidn, frame, quality="fast", guides="centre")
    peer()
    calls = make_calls(frame)
    if asked.shot:
        calls |= make_shot_calls(tile(lobewise.read_frame(asked.shot), *SIZE))
    what = "least processor time of one call, one thread for kernels"
    for name, call in calls.items():
        if asked.only not in name:
            continue
        old = before["recipes"].get(name, {})
        found[name] = {**measure(call, peer), "commit": machine["commit"]}
        told = ", ".join(f"{key} {value} ({old.get(key, 'new')})" for key, value in found[name].items())
        print(f"{name}: {told}", flush=True)
        recipes = {**found, **{name: found[name] for name in calls if name in found}}
        result = {"what": what, "size": list(SIZE), "machine": machine, "recipes": recipes}
        write_json(asked.output, result)
    rises = list_rises(before, {"recipes": found})
    if rises:
        print(f"slower than {LARGEST_RISE} times before, over Open Image Denoise: {', '.join(rises)}", file=sys.stderr)
    return int(bool(rises))


if __name__ == "__main__":
    sys.exit(main())
