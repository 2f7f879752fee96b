"""What comparing lobes is worth: the same filters and the same network, without the lobes.

    python -m benchmarks.users.render FRAMES --group own
    python -m benchmarks.quality.without_lobes FRAMES

Without lobes the passes compare normals, and the network compares place and normal; it was not trained again for that,
and still reads the roughness. Errors are those of `benchmarks.users` on the held-out built-in scenes: over all pixels,
and over the glossy ones.
"""

import argparse
from collections import defaultdict
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.foreign.judging import Judge
from benchmarks.quality.measure import round_figure
from benchmarks.users.measuring import make_reference_judge
from benchmarks.users.scenes import OWN, list_scenes
from lobewise.denoising.refining import network
from lobewise.lobes.vectors import compute_image_luminance
from lobewise.records.frame import FloatArray, Frame

RESULT = RESULTS / "without_lobes.json"
QUALITIES = ("fast", "balanced", "high")
SAMPLES = (4, 16, 64)
MAX_ALPHA, MIN_SPECULAR_SHARE = 0.25, 0.3
"""Largest roughness of a glossy pixel, and the smallest share of its albedo that the specular lobe has."""


def mark_glossy(frame: Frame) -> NDArray[np.bool_]:
    """Return which pixels are glossy, (height, width)."""
    guides = frame.gbuffer
    diffuse, specular = (compute_image_luminance(each) for each in (guides.diffuse_albedo, guides.specular_albedo))
    return (guides.alpha_u <= MAX_ALPHA) & (specular > MIN_SPECULAR_SHARE * (diffuse + specular))


def denoise(frame: Frame, quality: str, *, with_lobes: bool) -> FloatArray:
    """Return the filtered image; without lobes neither passes nor network compare them."""
    changes = {} if with_lobes else {"similarity": "normal"}
    blind = nullcontext() if with_lobes else patch.object(network, "compute_lobes", lambda *_: (None, None))
    with blind:
        return lobewise.denoise(frame, quality=quality, **changes).image


def measure_frame(frame: Frame, judge: Judge) -> dict[str, dict[str, float]]:
    """Return the error with lobes over the error without, by quality, of all pixels and of glossy ones."""
    glossy = mark_glossy(frame)
    known = np.ones(glossy.shape, np.bool_) if judge.known is None else judge.known
    judges = {"all": judge, "glossy": replace(judge, known=known & glossy)}
    found = {}
    for quality in QUALITIES:
        lobes, normals = (denoise(frame, quality, with_lobes=with_lobes) for with_lobes in (True, False))
        found[quality] = {
            name: round_figure(each.measure(lobes)[0] / each.measure(normals)[0]) for name, each in judges.items()
        }
    return found


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    asked = parser.parse_args()
    rows: dict[str, dict[str, dict[str, float]]] = {}
    logs: dict[str, dict[str, list[float]]] = defaultdict(lambda: defaultdict(list))
    for scene in (each for each in list_scenes(asked.frames) if each.group == OWN and each.is_held_out):
        judge = make_reference_judge(*scene.reference_images)
        for spp in (spp for spp in scene.frames if spp in SAMPLES):
            found = rows[f"{scene.name} {spp}"] = measure_frame(scene.read(spp), judge)
            print(scene.name, spp, found, flush=True)
            for quality, errors in found.items():
                for pixels, ratio in errors.items():
                    logs[quality][f"{pixels}, {spp} spp"].append(np.log(ratio))
                    logs[quality][pixels].append(np.log(ratio))
    if not rows:
        raise SystemExit(f"no held-out scene with two references in {asked.frames}")
    means = {
        quality: {name: round(float(np.exp(np.mean(each))), 3) for name, each in of_quality.items()}
        for quality, of_quality in logs.items()
    }
    what = "error with lobes over the error without, rel_mse; geometric means over the frames of held-out scenes"
    write_json(asked.output, {"what": what, "means": means, "frames": rows, "machine": describe_machine()})


if __name__ == "__main__":
    main()
