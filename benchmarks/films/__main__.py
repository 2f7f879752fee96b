"""Measure windows in time on sequences with references.

    python -m benchmarks.films FOLDER -o benchmarks/results/films.json [--film NAME ...] [--pictures FOLDER]

FOLDER holds ``NAME_8_1.0001.exr`` and on, 8 samples per pixel, and two references of each frame,
``NAME_reference_1.0001.exr`` and ``NAME_reference_2.0001.exr``. ``benchmarks/foreign/render_blender.py`` renders
`BLENDER_FILMS` with ``--frames 16 --spp 8 --seeds 1 --reference 512``, and ``lobewise render --frames 16 --speed 0.5``
the public interiors of `benchmarks.interiors` (``--spp 8 --seed 1``, then ``--spp 192 --reference`` with the seeds 9001
and 9002), all of 256 columns.

References have noise of their own. Errors are products of the differences to both, so that their noise leaves nothing
on average. A film is measured once; films that the JSON file holds already are not measured again.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

import lobewise
from benchmarks.common import describe_machine, write_json
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.frame import FloatArray, Frame
from lobewise.interchange import read_frame
from lobewise.metrics import EPSILON, find_disoccluded
from lobewise.peers import denoise_oidn
from lobewise.windows import WindowFilter

BLENDER_FILMS = ("hall", "juggler", "lamps")
MITSUBA_FILMS = ("dining-room", "country-kitchen")
SPP, COUNT, REACH, MIDDLE = 8, 16, 2, 8
MAX_NOISE_OF_REFERENCE = 0.005
"""Relative squared error of the mean of both references. Above it the changes from frame to frame, and the error of few
pixels, are mostly noise of the references: figures came out below 0."""
Truth = tuple[NDArray[np.float64], NDArray[np.float64]]
Alone = Callable[[Frame], FloatArray]

ALONE: dict[str, Alone] = {
    "noisy": lambda frame: frame.radiance.color,
    "balanced": lambda frame: lobewise.denoise(frame, quality="balanced").image,
    "high": lambda frame: lobewise.denoise(frame, quality="high").image,
    "oidn": lambda frame: denoise_oidn(frame)[0],
    "auto": lambda frame: lobewise.denoise(frame).image,
}
"""Frame by frame. "oidn" is Open Image Denoise at its best quality with the renderer's guides, prefiltered; "auto" is
lobewise with Open Image Denoise mixed in."""
WINDOWS = ("balanced", "high", "auto")
"""Qualities of the window of two frames to each side; "auto" is with Open Image Denoise."""
BASES = {"balanced": "balanced", "high": "high", "auto": "oidn"}
"""What the window of a quality is compared with, frame by frame."""


def compute_square(one: FloatArray, truth: Truth) -> NDArray[np.float64]:
    """Return the squared error of every pixel and channel, without the noise of the references on average."""
    return (one - truth[0]) * (one - truth[1])


def measure_error(image: FloatArray, truth: Truth, mask: NDArray[np.bool_] | None = None) -> float:
    """Return the relative mean squared error, of the pixels of ``mask`` if it is given."""
    scale = np.maximum(truth[0] * truth[1], 0.0) + EPSILON
    error = (compute_square(image, truth) / scale).mean(axis=-1)
    return float(error.mean() if mask is None else error[mask].mean())


def measure_flicker(images: Sequence[FloatArray], truths: Sequence[Truth]) -> float:
    """Return what `lobewise.metrics.flicker` measures, without the noise of the references on average."""
    steps = []
    for k in range(1, len(images)):
        change = images[k] - images[k - 1]
        wanted = truths[k][0] - truths[k - 1][0], truths[k][1] - truths[k - 1][1]
        light = [np.maximum(first * second, 0.0) for first, second in (truths[k], truths[k - 1])]
        steps.append(float((compute_square(change, wanted) / (0.5 * (light[0] + light[1]) + EPSILON)).mean()))
    return float(np.mean(steps))


def mark_new(frames: Sequence[Frame]) -> list[NDArray[np.bool_]]:
    """Return the pixels of every frame whose surface came into view in it or in the frame before."""
    found = [np.zeros(frames[0].shape, np.bool_)]
    first = found[0]
    for before, frame in pairwise(frames):
        assert frame.camera is not None
        assert before.camera is not None
        new = find_disoccluded(frame.gbuffer, frame.camera, before.gbuffer, before.camera)
        motion = frame.gbuffer.motion
        assert motion is not None
        rows, columns = np.indices(frame.shape)
        spots = np.rint(rows + motion[..., 1]), np.rint(columns + motion[..., 0])
        where = tuple(np.clip(spot, 0, size - 1).astype(int) for spot, size in zip(spots, frame.shape, strict=True))
        found.append(new | first[where])
        first = new
    return found


def measure(images: Sequence[FloatArray], frames: Sequence[Frame], truths: Sequence[Truth]) -> dict[str, float]:
    """Return error, flicker, and the error of pixels that came into view less than two frames ago."""
    new = mark_new(frames)
    shown = [measure_error(*each) for each in zip(images, truths, new, strict=True) if each[2].any()]
    return {
        "error": float(np.mean([measure_error(*pair) for pair in zip(images, truths, strict=True)])),
        "flicker": measure_flicker(images, truths),
        "came_into_view": float(np.mean(shown)) if shown else float("nan"),
    }


def measure_film(folder: Path, name: str, pictures: Path | None) -> dict[str, Any]:
    """Return the figures of every method on a film; write a contact sheet of one frame if ``pictures`` is given."""
    frames = [read_frame(folder / f"{name}_{SPP}_1.{k:04d}.exr", light_passes=False) for k in range(1, COUNT + 1)]
    halves = [[folder / f"{name}_reference_{half}.{k:04d}.exr" for half in (1, 2)] for k in range(1, COUNT + 1)]
    truths = [tuple(read_frame(path).radiance.color.astype(np.float64) for path in pair) for pair in halves]
    found: dict[str, Any] = {"alone": {}, "window": {}, "noise_of_reference": 0.0}
    noise = [0.25 * measure_error(pair[0], (pair[1], pair[1])) for pair in truths]
    found["noise_of_reference"] = float(np.mean(noise))
    shown = [np.asarray(0.5 * (truths[COUNT // 2][0] + truths[COUNT // 2][1]), np.float32)]
    for method, run in ALONE.items():
        images = [run(frame) for frame in frames]
        found["alone"][method] = measure(images, frames, truths)
        shown.append(images[COUNT // 2])
        print(name, method, found["alone"][method], flush=True)
    for quality in WINDOWS:
        window = WindowFilter(REACH) if quality == "auto" else WindowFilter(REACH, quality=quality)
        images = [window.denoise(frames, k).image for k in range(COUNT)]
        found["window"][quality] = measure(images, frames, truths)
        shown.append(images[COUNT // 2])
        print(name, "window", quality, found["window"][quality], flush=True)
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        sheet = np.concatenate([np.concatenate(shown[k : k + 3], axis=1) for k in (0, 3, 6)])
        Image.fromarray(map_tones(sheet, choose_exposure(shown[0]))).save(pictures / f"{name}.png")
    return found


def measure_many_samples(folder: Path, name: str) -> dict[str, Any]:
    """Return the errors of one frame whose noisy input is a reference: windows must not spoil what is nearly clean.

    One reference is the input, so the other one alone is the truth; its noise is subtracted.
    """
    numbers = range(MIDDLE - REACH - 1, MIDDLE + REACH + 2)
    frames = [read_frame(folder / f"{name}_reference_1.{k:04d}.exr", light_passes=False) for k in numbers]
    truth = read_frame(folder / f"{name}_reference_2.{MIDDLE:04d}.exr").radiance.color.astype(np.float64)
    noisy = frames[REACH + 1].radiance.color.astype(np.float64)
    scale = np.maximum(noisy * truth, 0.0) + EPSILON
    noise = 0.5 * float(((noisy - truth) ** 2 / scale).mean())

    def measure_one(image: FloatArray) -> float:
        return float(((image - truth) ** 2 / scale).mean()) - noise

    found: dict[str, Any] = {"spp": frames[0].spp, "noisy": noise}
    for quality in WINDOWS:
        window = WindowFilter(REACH) if quality == "auto" else WindowFilter(REACH, quality=quality)
        found[quality] = {
            "alone": measure_one(window.join(frames, REACH + 1).alone.image),
            "window": measure_one(window.denoise(frames, REACH + 1).image),
        }
    print(name, found, flush=True)
    return found


def summarize(films: dict[str, Any]) -> dict[str, Any]:
    """Return the mean ratio of every window to its base, over the films.

    Films whose references are too noisy for a figure do not count.
    """
    found: dict[str, Any] = {}
    for quality, base in BASES.items():
        found[quality] = {
            figure: float(
                np.mean(
                    [
                        film["window"][quality][figure] / film["alone"][base][figure]
                        for film in films.values()
                        if figure == "error" or film["noise_of_reference"] <= MAX_NOISE_OF_REFERENCE
                    ]
                )
            )
            for figure in ("error", "flicker", "came_into_view")
        }
    return found


def main() -> None:
    """Measure the films that the command line names."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, required=True)
    parser.add_argument("--film", action="append")
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    told = json.loads(asked.output.read_text()) if asked.output.exists() else {"films": {}}
    for name in asked.film or (*BLENDER_FILMS, *MITSUBA_FILMS):
        if name not in told["films"]:
            told["films"][name] = measure_film(asked.folder, name, asked.pictures)
        if name in BLENDER_FILMS and name not in told.setdefault("many_samples", {}):
            told["many_samples"][name] = measure_many_samples(asked.folder, name)
        told |= {"machine": describe_machine(), "spp": SPP, "frames": COUNT, "reach": REACH}
        told["ratios"] = summarize(told["films"])
        write_json(asked.output, told)


if __name__ == "__main__":
    main()
