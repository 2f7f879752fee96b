"""Measure sequences frame by frame, with windows in time, and over time, on films with references.

    python -m benchmarks.films FOLDER [-o benchmarks/results/films.json] [--film NAME ...] [--pictures FOLDER]

FOLDER holds the films of ``python benchmarks/foreign/factory FOLDER --films --split validation --seeds 100-102``:
kinds on which nothing is tuned or trained, 16 samples per pixel, two references of each frame. A film of this package's
own scenes, ``mitsuba_NAME``, is made by ``lobewise render NAME --frames 12 --width 192 --height 144``: 16 samples in
``16.####.exr``, and 96 with other seeds in ``reference_1.####.exr`` and ``reference_2.####.exr``. Each way is
the command line, as people call it, in a process of its own; Open Image Denoise runs at its best, frame by frame.

- "error": relative squared error of a frame, freed of the references' noise, without the worst 0.1 % of the pixels; the
  mean over the frames. "every" counts all pixels.
- "worst frame": the largest error of a frame over that of the same frame denoised alone.
- "flicker": relative squared change from frame to frame, where the clean images agree; without the worst 0.1 %.
- "textures": error of pixels within surfaces at which the albedo changes.
- "came into view": error of pixels whose surface came into view less than two frames ago, where the film has a camera.
- "cpu_seconds" of a frame, and "peak_gib" of the process.
"""

import argparse
import json
import resource
import tempfile
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image
from scipy.ndimage import maximum_filter, minimum_filter, uniform_filter

from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.foreign.judging import WORST, Judge
from benchmarks.performance.streaming import run
from benchmarks.users.measuring import make_reference_judge
from lobewise.denoising.layers import compute_whole_albedo
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.interchange import read_frame
from lobewise.metrics import EPSILON, find_disoccluded
from lobewise.peers import denoise_oidn
from lobewise.records.frame import FloatArray, Frame

SPP = 16
WAYS: dict[str, list[str]] = {
    "auto": [],
    "auto, window": ["--window", "2"],
    "high": ["--quality", "high"],
    "high, window": ["--quality", "high", "--window", "2"],
    "temporal": ["--temporal"],
}
"""Options of the command line."""
ALONE = {"auto, window": "auto", "high, window": "high", "temporal": "auto"}
"""What the frames of a way are compared with, frame by frame."""
OWN_SCENES = "mitsuba_"
"""Beginning of the names of films that ``lobewise render`` made."""
STRIP = ("noisy", "oidn", "auto", "auto, window", "temporal")
"""Rows of a strip, above the clean frames."""
MIN_ALBEDO_STEP, MIN_NORMAL_LENGTH = 0.1, 0.9
"""Difference of albedo within 3x3 pixels from which a pixel shows a texture, and length of the mean normal there from
which the pixels lie on one surface."""
ANIMATED, ANIMATION_ZOOM, FRAME_MILLISECONDS = ("noisy", "auto", "auto, window"), 2, 125
"""Pictures of an animation, side by side."""
MAX_CLEAN_CHANGE = 0.002
"""Largest relative squared change of the clean images at a pixel where they agree."""


def read_film(folder: Path) -> tuple[list[Frame], list[Judge]]:
    """Return the noisy frames of a film, and what judges images of each."""
    paths = sorted(folder.glob(f"{SPP}.*.exr"))
    frames = [read_frame(path, light_passes=False) for path in paths]
    judges = []
    for path in paths:
        number = path.name.split(".")[1]
        pair = [read_frame(folder / f"reference_{half}.{number}.exr", light_passes=False) for half in (1, 2)]
        judges.append(make_reference_judge(*(each.radiance.color for each in pair)))
    return frames, judges


def mark_new(frames: list[Frame]) -> list[NDArray[np.bool_]] | None:
    """Return the pixels of every frame whose surface came into view in it or the frame before; None where unknown."""
    found = [np.zeros(frames[0].shape, np.bool_)]
    first = found[0]
    for before, frame in pairwise(frames):
        motion = frame.gbuffer.motion
        if frame.camera is None or before.camera is None or motion is None:
            return None
        new = find_disoccluded(frame.gbuffer, frame.camera, before.gbuffer, before.camera)
        rows, columns = np.indices(frame.shape)
        spots = np.rint(rows + motion[..., 1]), np.rint(columns + motion[..., 0])
        where = tuple(np.clip(spot, 0, size - 1).astype(int) for spot, size in zip(spots, frame.shape, strict=True))
        found.append(new | first[where])
        first = new
    return found


def mark_textures(frame: Frame) -> NDArray[np.bool_]:
    """Return the pixels of a frame at which the albedo changes within a surface."""
    albedo, normal = frame.gbuffer.denoiser_albedo, frame.gbuffer.normal
    if albedo is None:
        albedo = compute_whole_albedo(frame.gbuffer)
    if albedo is None or normal is None:
        return np.zeros(frame.shape, np.bool_)
    gray = albedo.mean(axis=-1)
    step = maximum_filter(gray, 3) - minimum_filter(gray, 3)
    mean = np.stack([uniform_filter(normal[..., axis], 3) for axis in range(3)], axis=-1)
    return np.asarray((step > MIN_ALBEDO_STEP) & (np.linalg.norm(mean, axis=-1) > MIN_NORMAL_LENGTH))


def measure_flicker(images: list[FloatArray], judges: list[Judge]) -> float:
    """Return the change from frame to frame where the clean images agree."""
    steps = []
    for (before, image), (old, new) in zip(pairwise(images), pairwise(judges), strict=True):
        scale = 0.5 * (old.clean**2 + new.clean**2) + EPSILON
        steady = ((new.clean - old.clean) ** 2 / scale).mean(axis=-1) <= MAX_CLEAN_CHANGE
        change = np.sort((((image - before) - (new.clean - old.clean)) ** 2 / scale).mean(axis=-1)[steady])
        if len(change):
            steps.append(float(change[: len(change) - round(WORST * len(change))].mean()))
    return float(np.mean(steps))


def measure(
    images: list[FloatArray],
    judges: list[Judge],
    textures: list[NDArray[np.bool_]],
    new: list[NDArray[np.bool_]] | None,
) -> dict[str, Any]:
    """Return the figures of the images of a film, but for those of time and memory."""
    every, errors = zip(*(judge.measure(image) for judge, image in zip(judges, images, strict=True)), strict=True)
    found = {"error": float(np.mean(errors)), "every": float(np.mean(every)), "errors": list(errors)}
    found["flicker"] = measure_flicker(images, judges)
    pairs = zip(judges, images, textures, strict=True)
    on_textures = np.sort(np.concatenate([judge.make_error_map(image)[mask] for judge, image, mask in pairs]))
    kept = on_textures[: len(on_textures) - round(WORST * len(on_textures))]
    found["textures"] = float(kept.mean()) if len(kept) else None
    if new is not None:
        maps = [judge.make_error_map(image)[mask] for judge, image, mask in zip(judges, images, new, strict=True)]
        shown = np.concatenate(maps)
        found["came into view"] = float(shown.mean()) if len(shown) else None
    return found


def denoise_film(folder: Path, options: list[str], count: int) -> tuple[list[FloatArray], dict[str, float]]:
    """Return what the command line makes of a film, and its processor time for a frame and its memory."""
    with tempfile.TemporaryDirectory() as home:
        output = Path(home, "out.####.exr")
        used = run(["denoise", str(folder / f"{SPP}.####.exr"), "-o", str(output), "--progress", "off", *options])
        paths = [Path(home, f"out.{number:04d}.exr") for number in range(1, count + 1)]
        images = [read_frame(path, light_passes=False).radiance.color for path in paths]
    return images, {"cpu_seconds": round(used["cpu_seconds"] / count, 3), "peak_gib": used["peak_gib"]}


def measure_film(folder: Path, pictures: Path | None) -> dict[str, Any]:
    """Return the figures of every way on a film; write a strip of frames of each if ``pictures`` is given."""
    frames, judges = read_film(folder)
    new = mark_new(frames)
    shots = {"noisy": [frame.radiance.color for frame in frames]}
    start = resource.getrusage(resource.RUSAGE_SELF)
    shots["oidn"] = [denoise_oidn(frame)[0] for frame in frames]
    end = resource.getrusage(resource.RUSAGE_SELF)
    seconds = end.ru_utime + end.ru_stime - start.ru_utime - start.ru_stime
    used: dict[str, dict[str, float]] = {"oidn": {"cpu_seconds": round(seconds / len(frames), 3)}}
    for way, options in WAYS.items():
        shots[way], used[way] = denoise_film(folder, options, len(frames))
    textures = [mark_textures(frame) for frame in frames]
    found = {way: {**measure(images, judges, textures, new), **used.get(way, {})} for way, images in shots.items()}
    for way, alone in ALONE.items():
        ratios = np.divide(found[way]["errors"], found[alone]["errors"])
        found[way]["worst frame"] = float(ratios.max())
    if pictures is not None:
        pictures.mkdir(parents=True, exist_ok=True)
        clean = [np.asarray(judge.clean, np.float32) for judge in judges]
        exposure = choose_exposure(clean[0])
        rows = [np.concatenate(images[4:8], axis=1) for images in (*map(shots.__getitem__, STRIP), clean)]
        Image.fromarray(map_tones(np.concatenate(rows), exposure)).save(pictures / f"{folder.name}.png")
        draw_animation([shots[way] for way in ANIMATED], exposure, pictures / f"{folder.name}.webp")
    return {"moves": json.loads((folder / "moves.json").read_text()), "ways": found}


def draw_animation(films: list[list[FloatArray]], exposure: float, path: Path) -> None:
    """Write films side by side, as they are."""
    rows = [map_tones(np.concatenate(images, axis=1), exposure) for images in zip(*films, strict=True)]
    pictures = [Image.fromarray(row.repeat(ANIMATION_ZOOM, 0).repeat(ANIMATION_ZOOM, 1)) for row in rows]
    options: dict[str, Any] = {"duration": FRAME_MILLISECONDS, "loop": 0, "quality": 85}
    pictures[0].save(path, save_all=True, append_images=pictures[1:], **options)


def summarize(films: dict[str, Any]) -> dict[str, Any]:
    """Return the geometric means over the films, of ratios: to Open Image Denoise, and to the same frames alone."""

    def average(ratios: list[float]) -> float:
        return float(np.exp(np.mean(np.log(ratios))))

    # Scenes of this package are in the table, not in the means: they are not held out.
    films = {name: film for name, film in films.items() if not name.startswith(OWN_SCENES)} or films
    found: dict[str, Any] = {}
    for way in ("noisy", *WAYS):
        cells = [(film["ways"][way], film["ways"]["oidn"]) for film in films.values()]
        found[way] = {
            f"{key} over oidn": average([a[key] / b[key] for a, b in cells if a[key] is not None])
            for key in ("error", "flicker", "textures")
        }
        if way in ALONE:
            pairs = [(film["ways"][way], film["ways"][ALONE[way]]) for film in films.values()]
            keys = ("error", "flicker", "cpu_seconds")
            found[way] |= {f"{key} over alone": average([a[key] / b[key] for a, b in pairs]) for key in keys}
            found[way]["worst frame"] = max(a["worst frame"] for a, _ in pairs)
    return found


def main() -> None:
    """Measure the films that are complete, one by one; films that the JSON file holds are not measured again."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "films.json")
    parser.add_argument("--film", action="append")
    parser.add_argument("--pictures", type=Path)
    asked = parser.parse_args()
    told = json.loads(asked.output.read_text()) if asked.output.exists() else {"films": {}}
    for folder in sorted(path.parent for path in asked.folder.glob("*/reference_2.0012.exr")):
        if folder.name in told["films"] or (asked.film and folder.name not in asked.film):
            continue
        told["films"][folder.name] = measure_film(folder, asked.pictures)
        print(folder.name, json.dumps(summarize({folder.name: told["films"][folder.name]})), flush=True)
        told |= {"machine": describe_machine(), "spp": SPP, "summary": summarize(told["films"])}
        write_json(asked.output, told)


if __name__ == "__main__":
    main()
