"""Error and time of every method on eight scenes: what this project claims comes from here.

Eight built-in scenes, 384x384, at 1, 4, 16 and 64 samples per pixel, three noise seeds each, against references of 4096
samples. Parameters, ours and the baseline's, may be tuned on four of them; the other four are only measured. Whatever
is measured is written after every scene and sample count; what a run leaves out keeps its figures, and each names the
commit it was measured at.

    python -m benchmarks.quality.measure --render      once: frames and references, about an hour on two cores
    python -m benchmarks.quality.measure --tune        the baseline's parameters, again where its filter changes
    python -m benchmarks.quality.measure               every method; one again: --method high; go on: --missing
    python -m benchmarks.quality.measure --speed       times, of all methods in turn
    python -m benchmarks.quality.measure --summary     ratios and goals, from the JSON alone
"""

import argparse
import json
import re
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.common import RESULTS, describe_machine
from benchmarks.quality.frames import FEWEST, SAMPLES, SCENES, SEEDS, Bench, Mask, classify_pixels
from benchmarks.quality.methods import METHODS, NORMAL_EXPONENTS, SCREEN_SIGMAS, TUNING_SEED, Tuning, tune
from benchmarks.quality.summary import HELD_OUT, TRAIN, make_lines, summarise
from lobewise.cli.bench.timing import time_best
from lobewise.display.tones import choose_exposure, map_tones
from lobewise.errors import MissingDependencyError
from lobewise.metrics import flip, mse, rel_mse, smape
from lobewise.records.frame import FloatArray, Frame

RESULT = RESULTS / "quality.json"
CACHE = Path("~/.cache/lobewise/quality")
METRICS = {"rel_mse": rel_mse, "mse": mse, "smape": smape}
DIGITS = 4
"""Significant digits of the figures in the JSON; noise from seed to seed is in the second."""
TIMED_RUNS = 3
WIDE = (1920, 1080)


def compute_ssim(image: FloatArray, reference: FloatArray) -> float:
    """Return the mean structural similarity of what a screen shows of two images, at most 1, which is equality.

    Of the sRGB-encoded luma under the reference's exposure (`lobewise.display.tones`), in [0, 1].

    Notes
    -----
    Source: Wang, Bovik, Sheikh, Simoncelli 2004, "Image quality assessment: From error visibility to structural
    similarity", doi 10.1109/TIP.2003.819861: a Gaussian window of 11x11 pixels and standard deviation 1.5, K1 = 0.01,
    K2 = 0.03; windows that leave the image do not count.
    """
    exposure = choose_exposure(reference)
    x, y = (_compute_luma(map_tones(each, exposure)) for each in (image, reference))

    def blur(values: NDArray[np.float64]) -> NDArray[np.float64]:
        whole = gaussian_filter(values, 1.5, truncate=5.0 / 1.5)
        return np.asarray(whole[5:-5, 5:-5])

    mean_x, mean_y = blur(x), blur(y)
    squares = blur(x * x) + blur(y * y) - mean_x**2 - mean_y**2
    product = blur(x * y) - mean_x * mean_y
    c1, c2 = 0.01**2, 0.03**2
    similarity = (2.0 * mean_x * mean_y + c1) * (2.0 * product + c2)
    similarity /= (mean_x**2 + mean_y**2 + c1) * (squares + c2)
    return float(similarity.mean())


def _compute_luma(picture: NDArray[np.uint8]) -> NDArray[np.float64]:
    return np.asarray(picture @ np.array([0.2126, 0.7152, 0.0722]) / 255.0)


def measure(
    image: FloatArray, reference: FloatArray, masks: dict[str, Mask], *, with_flip: bool = True
) -> dict[str, Any]:
    """Return the errors of one image: by metric and class of pixels, and two that are of the whole image."""
    row: dict[str, Any] = {
        name: {kind: function(image, reference, mask) for kind, mask in masks.items()}
        for name, function in METRICS.items()
    }
    row["ssim"] = compute_ssim(image, reference)
    if with_flip:
        with suppress(MissingDependencyError):
            row["flip"] = flip(image, reference)
    return row


def round_figure(value: float) -> float:
    """Return ``value`` with as many significant digits as the JSON has."""
    return float(f"{value:.{DIGITS}g}")


def join_seeds(rows: list[dict[str, Any]]) -> dict[str, Any]:
    """Return one row with, for every figure, the list of its values from seed to seed where it was taken."""
    joined: dict[str, Any] = {}
    for name, value in rows[0].items():
        if isinstance(value, dict):
            joined[name] = {kind: [round_figure(row[name][kind]) for row in rows] for kind in value}
        else:
            joined[name] = [round_figure(row[name]) for row in rows if name in row]
    return joined


def make_masks(frame: Frame) -> dict[str, Mask]:
    """Return the classes of pixels that the scene shows enough of, and "all"."""
    masks = {kind: mask for kind, mask in classify_pixels(frame).items() if mask.mean() >= FEWEST}
    return {"all": np.ones(frame.shape, dtype=np.bool_), **masks}


def run_methods(
    bench: Bench, scene: str, spp: int, names: list[str], masks: dict[str, Mask], tuning: Tuning
) -> dict[str, Any]:
    """Return the rows of some methods on one scene and sample count."""
    reference, _ = bench.fetch_reference(scene)
    measured: dict[str, list[dict[str, Any]]] = {name: [] for name in names}
    for seed in SEEDS:
        frame = bench.fetch(scene, spp, seed)
        for name in names:
            image = METHODS[name].run(frame, tuning)
            # FLIP looks at many exposures and takes longer than the filters.
            measured[name].append(measure(image, reference, masks, with_flip=seed == SEEDS[0]))
    commit = describe_machine()["commit"]
    return {name: {"commit": commit, **join_seeds(rows)} for name, rows in measured.items()}


def choose_methods(wanted: list[str] | None, tuning: Tuning) -> tuple[list[str], dict[str, str]]:
    """Return the methods that can run, and why the others cannot."""
    skipped = {name: method.describe_obstacle() for name, method in METHODS.items()}
    if not all(str(spp) in tuning for spp in SAMPLES):
        skipped["normal-aware"] = "its parameters are not tuned yet: run with --tune"
    skipped = {name: reason for name, reason in skipped.items() if reason}
    return [name for name in METHODS if name not in skipped and (not wanted or name in wanted)], skipped


def time_methods(frame: Frame, names: list[str], tuning: Tuning) -> dict[str, Any]:
    """Return the best wall time of each method in turn, after a round that compiles and allocates."""
    calls = {name: partial(METHODS[name].run, frame, tuning) for name in names}
    best = time_best(calls, 0.0, rounds=TIMED_RUNS)
    milliseconds = {name: round(1e3 * seconds, 2) for name, seconds in best.items() if name != "noisy"}
    row: dict[str, Any] = {"spp": frame.spp, "machine": describe_machine(), "milliseconds": milliseconds}
    for base in ("single SG", "oidn", "oidn, guides as they come"):
        if base in milliseconds:
            row[f"over {base}"] = {name: round(best[name] / best[base], 3) for name in milliseconds}
    return row


def load(path: Path, bench: Bench) -> dict[str, Any]:
    """Return what was measured so far."""
    data: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {"tuning": {}, "scenes": {}, "speed": {}}
    return {
        "what": "rel_mse (epsilon 0.01), mse, smape by class of pixels, ssim; a value per seed; flip of the first",
        "size": bench.size,
        "reference_spp": bench.reference_spp,
        "samples": list(SAMPLES),
        "seeds": list(SEEDS),
        "train": list(TRAIN),
        "held_out": list(HELD_OUT),
        "tuning_grid": {"normal_exponent": NORMAL_EXPONENTS, "screen_sigma": SCREEN_SIGMAS, "seed": TUNING_SEED},
        **{name: data[name] for name in ("tuning", "scenes", "speed")},
        "timed_runs": TIMED_RUNS,
        "skipped": data.get("skipped", {}),
    }


def save(path: Path, data: dict[str, Any]) -> None:
    """Write what was measured and its summary through a temporary file; a list of values stays on one line."""
    text = json.dumps({**data, "machine": describe_machine(), "summary": summarise(data)}, indent=1)
    text = re.sub(r"\[[^][{}]*\]", lambda found: re.sub(r"\s*\n\s*", " ", found[0]).replace("[ ", "["), text)
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".tmp")
    temporary.write_text(text.replace(" ]", "]") + "\n")
    temporary.replace(path)


def run_scene(
    bench: Bench,
    data: dict[str, Any],
    scene: str,
    samples: list[int],
    wanted: list[str],
    path: Path,
    *,
    missing: bool = False,
) -> None:
    """Measure some methods on a scene, or those of them that have no figures yet, saving after every sample count."""
    masks = make_masks(bench.fetch(scene, max(SAMPLES), SEEDS[0]))
    row = data["scenes"].setdefault(scene, {"samples": {}})
    row["reference_rel_mse"] = round_figure(bench.fetch_reference(scene)[1])
    row["classes"] = {kind: round(float(mask.mean()), 4) for kind, mask in masks.items()}
    for spp in samples:
        found = row["samples"].setdefault(str(spp), {})
        names = [name for name in wanted if not (missing and name in found)]
        if not names:
            continue
        found.update(run_methods(bench, scene, spp, names, masks, data["tuning"]))
        row["samples"][str(spp)] = {name: found[name] for name in METHODS if name in found}
        save(path, data)
        cells = "  ".join(f"{name} {np.mean(found[name]['rel_mse']['all']):.4f}" for name in names)
        print(f"{scene:9} {spp:3} spp  {cells}", flush=True)


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--cache", type=Path, default=CACHE, help=f"folder for frames and references ({CACHE})")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    parser.add_argument("--scene", choices=SCENES, action="append", help="only this scene (may be repeated)")
    parser.add_argument("--spp", type=int, choices=SAMPLES, action="append", help="only this sample count")
    parser.add_argument("--method", choices=tuple(METHODS), action="append", help="only this method")
    for name, text in (
        ("missing", "only what has no figures yet"),
        ("render", "render what the cache lacks, and measure nothing"),
        ("tune", "search the baseline's parameters"),
        ("speed", "time all methods"),
        ("summary", "print ratios and goals"),
    ):
        parser.add_argument(f"--{name}", action="store_true", help=text)
    # Figures of other sizes compare with nothing: these are for trying the program out.
    parser.add_argument("--size", type=int, default=Bench.size, help=argparse.SUPPRESS)
    parser.add_argument("--reference-spp", type=int, default=Bench.reference_spp, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    bench = Bench(arguments.cache.expanduser(), arguments.size, arguments.reference_spp)
    bench.cache.mkdir(parents=True, exist_ok=True)
    if bench != Bench(bench.cache) and arguments.output == RESULT:
        parser.error("other sizes need an --output of their own")
    scenes, samples = arguments.scene or list(SCENES), arguments.spp or list(SAMPLES)
    data = load(arguments.output, bench)
    if arguments.render:
        bench.render(tuple(scenes), tuple(samples))
        if bench.size == Bench.size:
            bench.fetch_wide(*WIDE)
        return
    names, data["skipped"] = choose_methods(arguments.method, data["tuning"])
    if arguments.tune:
        chosen = tuple(scene for scene in TRAIN if scene in scenes)
        commit = describe_machine()["commit"]
        for spp, row in tune(bench, chosen, tuple(samples)).items():
            data["tuning"][spp] = {**row, "scenes": list(chosen), "commit": commit}
    elif arguments.speed:
        small = bench.fetch("showroom", 4, SEEDS[0])
        wide = bench.fetch_wide(*WIDE) if bench.size == Bench.size else small
        for frame in (small, wide):
            every, _ = choose_methods(None, data["tuning"])
            data["speed"][f"{frame.width}x{frame.height}"] = time_methods(frame, every, data["tuning"])
    elif not arguments.summary:
        for scene in scenes:
            run_scene(bench, data, scene, samples, names, arguments.output, missing=arguments.missing)
    if arguments.summary:
        print("\n".join(make_lines(summarise(data))))
    else:
        save(arguments.output, data)


if __name__ == "__main__":
    main()
