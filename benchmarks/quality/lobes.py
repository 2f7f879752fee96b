"""Which similarity has the least error, in the quality "fast" and in upsampling.

    python benchmarks/foreign/factory SHOTS --split validation --seeds 0-2 --spp 16     (where `bpy` is)
    python -m benchmarks.quality.lobes FRAMES [--shots SHOTS]

Measured are the built-in scenes, rendered into the folder FRAMES on first use, and the shots of a folder of
`benchmarks/foreign/factory`. "fast" filters the frame; "upsample 2" and "upsample 4" are given the first pixel of every
2x2 and 4x4. Errors are relative mean square errors without the worst thousandth of the pixels, over the error with the
similarity "normal"; beside it those of the glossy pixels alone (alpha of at most 0.25).
"""

from __future__ import annotations

import argparse
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

import lobewise
from benchmarks.common import RESULTS, describe_machine, fetch_frame, write_json
from benchmarks.foreign.judging import Judge
from benchmarks.quality.frames import SCENES, Bench
from benchmarks.quality.measure import round_figure
from benchmarks.quality.without_lobes import MAX_ALPHA, mark_glossy
from benchmarks.users.measuring import make_reference_judge
from benchmarks.users.scenes import find_shots
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.sparse_frame import SparseFrame
from lobewise.render import load_scene, render_reference
from lobewise.settings.choices import SimilarityName

RESULT = RESULTS / "lobes.json"
SIMILARITIES = ("normal", "sg", "ggx")
SIZE, SPP, REFERENCE_SPP = 256, 16, 1024
"""Pixels of a side of the built-in scenes' frames, and samples per pixel."""
REFERENCE_SEEDS = (1001, 1002)
MIN_GLOSSY_PIXELS = 200
"""A frame with fewer has no figure of its glossy pixels."""


@dataclass(frozen=True)
class Case:
    """A frame to measure on, its judge, and which pixels are glossy, (height, width)."""

    name: str
    frame: Frame
    judge: Judge
    glossy: NDArray[np.bool_]


def list_cases(folder: Path, shots: Path | None) -> Iterator[Case]:
    """Yield the built-in scenes, and the complete shots of a folder."""
    bench = Bench(folder, SIZE)
    for name in SCENES:
        frame = bench.fetch(name, SPP, 1)
        references = [
            fetch_frame(folder / f"{name}-{seed}.exr", partial(render_one, name, seed)) for seed in REFERENCE_SEEDS
        ]
        yield make_case(name, frame, *(each.radiance.color for each in references))
    for scene in find_shots(shots) if shots else ():
        frame = scene.read(SPP)
        # Half of the shots have no roughness, and so no lobes.
        if frame.gbuffer.alpha_u is not None and frame.camera is not None:
            yield make_case(scene.name, frame, *scene.reference_images)


def render_one(name: str, seed: int) -> Frame:
    """Return a reference of a built-in scene."""
    return render_reference(load_scene(name, width=SIZE, height=SIZE), spp=REFERENCE_SPP, seed=seed)


def make_case(name: str, frame: Frame, first: FloatArray, second: FloatArray) -> Case:
    """Return the case of a frame and two references."""
    guides = frame.gbuffer
    is_split = guides.diffuse_albedo is not None and guides.specular_albedo is not None
    glossy = mark_glossy(frame) if is_split else np.asarray(guides.alpha_u <= MAX_ALPHA)
    return Case(name, frame, make_reference_judge(first, second), glossy)


def make_sparse(frame: Frame, scale: int) -> SparseFrame:
    """Return the frame with the first pixel of each block shaded."""
    radiance = frame.radiance
    names = ("color", "diffuse", "specular")
    parts = {name: getattr(radiance, name) for name in names}
    few = {name: None if image is None else image[::scale, ::scale] for name, image in parts.items()}
    return SparseFrame(Radiance(**few), frame.gbuffer, scale, camera=frame.camera, spp=frame.spp)


FILTERS: Mapping[str, Callable[[Frame, SimilarityName], FloatArray]] = {
    "fast": lambda frame, name: lobewise.denoise(frame, quality="fast", similarity=name).image,
    "upsample 2": lambda frame, name: lobewise.upsample(make_sparse(frame, 2), similarity=name).image,
    "upsample 4": lambda frame, name: lobewise.upsample(make_sparse(frame, 4), similarity=name).image,
}


def measure_case(case: Case) -> dict[str, dict[str, list[float]]]:
    """Return of every filter and similarity the error over that of "normal": of all pixels, and of glossy ones."""
    known = np.ones(case.glossy.shape, np.bool_) if case.judge.known is None else case.judge.known
    chosen = known & case.glossy
    judges = [case.judge, *([replace(case.judge, known=chosen)] if chosen.sum() >= MIN_GLOSSY_PIXELS else [])]
    found: dict[str, dict[str, list[float]]] = {}
    for name, filter_frame in FILTERS.items():
        images = {similarity: filter_frame(case.frame, similarity) for similarity in SIMILARITIES}
        errors = {similarity: [judge.measure(image)[1] for judge in judges] for similarity, image in images.items()}
        found[name] = {
            similarity: [round_figure(own / usual) for own, usual in zip(each, errors["normal"], strict=True)]
            for similarity, each in errors.items()
        }
    return found


def average(rows: Mapping[str, dict[str, dict[str, list[float]]]]) -> dict[str, dict[str, dict[str, float]]]:
    """Return the geometric means of frames: by filter, pixels and similarity."""
    means: dict[str, dict[str, dict[str, float]]] = {}
    for name in FILTERS:
        for number, pixels in enumerate(("all", "glossy")):
            for similarity in SIMILARITIES:
                ratios = [row[name][similarity][number] for row in rows.values() if len(row[name][similarity]) > number]
                if ratios:
                    mean = round_figure(float(np.exp(np.mean(np.log(ratios)))))
                    means.setdefault(name, {}).setdefault(pixels, {})[similarity] = mean
    return means


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--shots", type=Path)
    parser.add_argument("--output", type=Path, default=RESULT)
    asked = parser.parse_args()
    rows = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for case in list_cases(asked.frames, asked.shots):
            rows[case.name] = measure_case(case)
            print(case.name, rows[case.name], flush=True)
    groups = {
        "built-in scenes": {name: row for name, row in rows.items() if name in SCENES},
        "Blender": {name: row for name, row in rows.items() if name not in SCENES},
    }
    means = {group: average(some) for group, some in groups.items() if some}
    what = "error over that with the similarity normal: all pixels, glossy pixels; geometric means over frames"
    table = {"what": what, "machine": describe_machine(), "means": means, "frames": rows}
    write_json(asked.output, table, one_line=r"\[[^\[\]]*\]")


if __name__ == "__main__":
    main()
