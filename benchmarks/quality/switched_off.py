"""What each mechanism of the denoiser is worth: it is switched off by itself, and the pictures are measured.

    python benchmarks/foreign/factory SHOTS --split validation --seeds 0-2 --spp 16     (where `bpy` is)
    python -m benchmarks.quality.switched_off [--shots SHOTS] [--qualities high,auto] [--only "specks,take back"]

A mechanism stands for itself in `SWITCHES`: what is replaced, and what replaces it. The frames are those of
`tests/images`, which have their references, its crops, which are larger, and the shots of a folder of
`benchmarks/foreign/factory`, on which nothing was tuned. The table says, by quality and group of frames, the error
without the mechanism over the error with it: below 1, the picture is better without. Errors are relative mean square
errors of all pixels ("error") and without the worst thousandth ("trimmed"); "moved" names the frames whose trimmed
error changes by 1 % or more. "light" is the same ratio of the errors of the passes that are filtered, averaged over the
passes of a frame, of those frames whose reference has passes; null where none has. "energy" says by how many per cent
the sum of the image is off that of the reference, averaged over frames without signs: with the mechanism, and without.
"time" is the processor time without over with, of all frames together. "shots" has, of every Blender shot, the trimmed
errors of the noisy image, of Open Image Denoise as people call it and of each quality, over the error of Open Image
Denoise at its best.
"""

from __future__ import annotations

import argparse
import math
import time
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

import lobewise
from benchmarks.common import RESULTS, ROOT, describe_machine, write_json
from benchmarks.quality.measure import round_figure
from benchmarks.users.measuring import make_reference_judge
from benchmarks.users.methods import METHODS, Shot
from benchmarks.users.scenes import find_shots
from lobewise.denoising import (
    automatic,
    chain,
    combining,
    layers,
    noisy,
    passes,
    recipe,
)
from lobewise.denoising.refining import network
from lobewise.denoising.refining.unguided import limit_to_noise
from lobewise.filters.specks import Sharing
from lobewise.guides import negative, stand_ins, usable
from lobewise.metrics import rel_mse
from lobewise.records.frame import FloatArray, Frame, Result
from tests.images.frames import (
    CROPS,
    NAMES,
    SPARSE,
    denoise_view,
    join_views,
    list_filtered_light,
    list_noisy_light,
    read_views,
)
from tests.images.measuring import measure_image

RESULT = RESULTS / "switched_off.json"
DATA = ROOT / "src" / "lobewise" / "data"
"""The bundled frame of our own renderer, with halves, is measured with the crops."""
QUALITIES = ("balanced", "high", "auto")
GROUPS = IMAGES, LARGE, BLENDER = "tests/images", "crops", "blender"
SPP, PEER = 16, "oidn"
MEASURED = "error", "trimmed", "light", "energy"
NAMED_PERCENT = 1.0
"""Change of its trimmed error from which a frame is named in the table."""


@dataclass(frozen=True)
class Switch:
    """What replaces a mechanism: attributes of modules, or a change of the frame.

    Parameters
    ----------
    stand_ins : sequence of (module, attribute, value)
    change : function, optional
        Returns the frame to filter.
    """

    stand_ins: Sequence[tuple[Any, str, Any]] = ()
    change: Callable[[Frame], Frame] = lambda frame: frame

    @contextmanager
    def off(self) -> Iterator[None]:
        """Switch the mechanism off inside the context."""
        with ExitStack() as stack:
            for module, name, value in self.stand_ins:
                stack.enter_context(patch.object(module, name, value))
            yield


def replace_one(module: Any, name: str, value: Any) -> Switch:
    """Return the switch that replaces one attribute of a module."""
    return Switch([(module, name, value)])


def drop_guides(*names: str) -> Switch:
    """Return the switch that takes guides out of the frame."""
    changes: Any = dict.fromkeys(names)
    return Switch(change=lambda frame: frame.with_changes(gbuffer=replace(frame.gbuffer, **changes)))


def mark_nothing(image: FloatArray, *_: Any) -> NDArray[np.bool_]:
    """Return a mask of an image without a pixel."""
    return np.zeros(image.shape[:2], np.bool_)


def make_no_share(image: FloatArray, *_: Any, **__: Any) -> FloatArray:
    """Return a share of 0 at every pixel of an image."""
    return np.zeros(image.shape[:2], np.float32)


def share_nothing(_rest: FloatArray, blur: FloatArray, _scattered: Any) -> Sharing:
    """Stand for `choose_sharing`: every pixel keeps its light."""
    return Sharing(np.zeros(blur.shape, np.int64), np.ones(blur.shape, np.float32))


def split_no_highlights(halves: Any, _albedo: Any, mask: FloatArray, **_: Any) -> tuple[Any, Any, FloatArray]:
    """Stand for `split_highlights`: no light is a highlight."""
    return (*halves, np.zeros((*mask.shape, 3), np.float32))


def keep_discs(share: FloatArray, rest: FloatArray, image: FloatArray, _: Any) -> FloatArray:
    """Stand for `limit_to_noise`: the light of no surface stays, in focus or not."""
    return limit_to_noise(share, rest, image, None)


def compute_no_salt(_: FloatArray, image: FloatArray, __: Any) -> FloatArray:
    """Stand for `compute_salt_share`: no light is salt."""
    return np.zeros(image.shape[:2], np.float32)


def average_at_16_samples(*images: FloatArray, average: Any = combining.average_alike) -> FloatArray:
    """Stand for `average_alike`: as at 16 samples per pixel."""
    result: FloatArray = average(*images[:3], None)
    return result


def choose_peer(noisy: FloatArray, *_: Any, **__: Any) -> FloatArray:
    """Stand for `compute_mixture`: the peer's image everywhere."""
    share = np.zeros((*noisy.shape[:2], 3), np.float32)
    share[..., 2] = 1.0
    return share


def skip_pilot(*given: Any, make: Any = passes.make_passes, **named: Any) -> Any:
    """Stand for `make_passes`: the pilot reads no neighbours, so that the samples guide the wide pass."""
    pilot, wide = make(*given, **named)
    return replace(pilot, radius=0), wide


SWITCHES: dict[str, Switch] = {
    "lobes": replace_one(automatic, "GUIDED_SIMILARITY", "normal"),
    "pilot pass": replace_one(passes, "make_passes", skip_pilot),
    "spread lobes": replace_one(layers, "spread_lobes", lambda field: field),
    "highlights": replace_one(noisy, "split_highlights", split_no_highlights),
    "specks": replace_one(chain, "choose_sharing", share_nothing),
    "bound of fireflies": replace_one(chain, "cut_samples", lambda color, _: color),
    "lamps": replace_one(network, "mark_shining", mark_nothing),
    "network": replace_one(chain, "refine", lambda _frame, filtered, _whole: filtered),
    "take back": replace_one(chain, "take_back", lambda _frame, filtered: filtered),
    "proof by halves": replace_one(combining, "estimate_share_proved", make_no_share),
    "halves": Switch(change=lambda frame: frame.with_changes(half_a=None, half_b=None)),
    "keep light": replace_one(chain, "keep_light", lambda filtered: filtered),
    "color alone where guides are noise": replace_one(chain, "compute_unguided_share", make_no_share),
    "lamps out of focus by their color": Switch(
        [(chain, "limit_to_noise", keep_discs), (chain, "compute_salt_share", compute_no_salt)]
    ),
    "surfaces stand in": replace_one(usable, "stand_in_surfaces", lambda frame: (frame, ())),
    "lamps without normals kept": replace_one(stand_ins, "keep_lamps", lambda frame: (frame, 0)),
    "light below 0": replace_one(recipe, "split_negative", lambda frame: (frame, None)),
    "damage": replace_one(negative, "mark_damaged", mark_nothing),
    "coverage": drop_guides("coverage"),
    "mean emission": drop_guides("mean_emission"),
    "blur of the lens": drop_guides("blur_radius"),
    "peer without guides": Switch([(combining, "UNGUIDED_SHARE", 0.0)]),
    "peer's images may differ as noise does": replace_one(combining, "average_alike", average_at_16_samples),
    "peer by layers": replace_one(chain, "list_peer_layers", lambda *_: []),
    "albedos of lobes for the peer": replace_one(combining, "mix_albedos", lambda guides: guides),
    "own image in the mixture": replace_one(combining, "compute_mixture", choose_peer),
}
"""Every mechanism by the words of the table. What is added to the denoiser gets its line here."""


@dataclass(frozen=True)
class Case:
    """A frame to measure on.

    Parameters
    ----------
    group, name : str
    frames : sequence of Frame
        The views.
    measure : function
        Returns "error" and "trimmed" of the views' images, side by side.
    truth : sequence of mapping of str to (height, width, 3)
        All light of the reference of each view, by name; the image's is "".
    peer : Frame, optional
        What Open Image Denoise is given of a Blender shot.
    """

    group: str
    name: str
    frames: Sequence[Frame]
    measure: Callable[[FloatArray], dict[str, float]]
    truth: Sequence[Mapping[str, FloatArray]]
    peer: Frame | None = None


def list_cases(shots: Path | None) -> Iterator[Case]:
    """Yield the frames of the image tests, and the complete shots of a folder."""
    for name in (*NAMES, *CROPS):
        views = read_views(name)
        if name != SPARSE:
            reference = join_views([view.reference.radiance.color for view in views])
            frames = [view.noisy for view in views if isinstance(view.noisy, Frame)]
            truth = [average_light([view.reference]) for view in views]
            group = LARGE if name in CROPS else IMAGES
            yield Case(group, name, frames, partial(measure_image, reference=reference), truth)
    demo, truth = (lobewise.read_frame(DATA / f"{name}.exr") for name in ("demo", "demo-reference"))
    yield Case(LARGE, "demo", [demo], partial(measure_image, reference=truth.radiance.color), [average_light([truth])])
    for scene in find_shots(shots) if shots else ():
        judge = make_reference_judge(*scene.reference_images)

        def measure(image: FloatArray, judge: Any = judge) -> dict[str, float]:
            return dict(zip(("error", "trimmed"), judge.measure(image), strict=True))

        frame = scene.read(SPP)
        truth = [average_light([lobewise.read_frame(path, light_passes=False) for path in scene.references])]
        yield Case(BLENDER, scene.name, [frame], measure, truth, scene.read_peer(SPP, frame))


def average_light(references: Sequence[Frame]) -> dict[str, FloatArray]:
    """Return the mean of all light of a frame's references, that of the image by the name ""."""
    every = [{"": each.radiance.color, **list_noisy_light(each)} for each in references]
    return {name: np.mean([each[name] for each in every], axis=0, dtype=np.float32) for name in every[0]}


def measure_light(case: Case, results: Sequence[Result]) -> dict[str, float]:
    """Return the mean error of the passes that the reference has, if any, and the error of the image's sum."""
    pairs = list(zip(results, case.truth, strict=True))
    errors = [
        rel_mse(image, truth[name])
        for result, truth in pairs
        for name, image in list_filtered_light(result).items()
        if name in truth
    ]
    sums = [
        sum(float(image.sum(dtype=np.float64)) for image in images)
        for images in ([each.image for each in results], [truth[""] for truth in case.truth])
    ]
    return {"light": float(np.mean(errors)) if errors else math.nan, "energy": abs(sums[0] / sums[1] - 1.0)}


def measure_cases(cases: Sequence[Case], quality: str, switch: Switch) -> dict[str, dict[str, float]]:
    """Return the errors of image, passes and sum, and processor seconds, of every frame with a mechanism off."""
    found = {}
    with switch.off(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        for case in cases:
            start = time.process_time()
            results = [denoise_view(switch.change(frame), quality) for frame in case.frames]
            seconds = time.process_time() - start
            figures = case.measure(join_views([each.image for each in results])) | measure_light(case, results)
            found[case.name] = {name: figures[name] for name in MEASURED} | {"seconds": seconds}
    return found


def compare_with_peer(case: Case) -> dict[str, float]:
    """Return the trimmed errors of the noisy image and of the peer as called, over that of the peer at its best."""
    assert case.peer is not None
    shot = Shot(case.frames[0], case.peer, "all", SPP)
    best, called = (case.measure(METHODS[name](shot, {}))["trimmed"] for name in (PEER, f"{PEER}, as called"))
    noisy_error = case.measure(shot.frame.radiance.color)["trimmed"]
    return {"best": best, "noisy": noisy_error / best, "as called": called / best}


def compute_geometric_mean(ratios: Sequence[float]) -> float | None:
    """Return the geometric mean of those ratios that are known, None if none is."""
    known = [ratio for ratio in ratios if not math.isnan(ratio)]
    return math.exp(np.mean(np.log(known))) if known else None


def compare(
    cases: Sequence[Case], without: Mapping[str, Mapping[str, float]], with_it: Mapping[str, Mapping[str, float]]
) -> dict[str, Any]:
    """Return the row of a mechanism: by group of frames, its figures without over those with it."""
    row: dict[str, Any] = {}
    for group in GROUPS:
        names = [case.name for case in cases if case.group == group]
        if not names:
            continue
        ratios = {
            figure: {name: without[name][figure] / with_it[name][figure] for name in names}
            for figure in ("error", "trimmed", "light")
        }
        means = {figure: compute_geometric_mean(list(each.values())) for figure, each in ratios.items()}
        off = [100.0 * float(np.mean([figures[name]["energy"] for name in names])) for figures in (with_it, without)]
        trimmed = ratios["trimmed"]
        moved = {name: value for name, value in trimmed.items() if abs(value - 1.0) >= NAMED_PERCENT / 100.0}
        row[group] = {
            **{figure: value and round(value, 4) for figure, value in means.items()},
            "energy": [round_figure(value) for value in off],
            "time": round(sum(without[n]["seconds"] for n in names) / sum(with_it[n]["seconds"] for n in names), 2),
            "frames": len(names),
            "moved": {name: round(moved[name], 3) for name in sorted(moved, key=moved.__getitem__)},
        }
    return row


def main() -> None:
    """Measure what the command line asks for, and write the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument(
        "--shots", type=Path, help="folder of benchmarks/foreign/factory; without, tests/images and its crops"
    )
    parser.add_argument("--qualities", default=",".join(QUALITIES))
    parser.add_argument("--only", default="", help="mechanisms, by their names in the table")
    parser.add_argument("--output", type=Path, default=RESULT)
    asked = parser.parse_args()
    wanted = asked.only.split(",") if asked.only else list(SWITCHES)
    if unknown := set(wanted) - set(SWITCHES):
        parser.error(f"unknown mechanisms: {', '.join(sorted(unknown))}; there are {', '.join(SWITCHES)}")
    cases = list(list_cases(asked.shots))
    shots = {case.name: compare_with_peer(case) for case in cases if case.peer}
    rows: dict[str, Any] = {name: {} for name in wanted}
    for quality in asked.qualities.split(","):
        # The first run fills caches; its figures are the same.
        usual = [measure_cases(cases, quality, Switch()) for _ in range(2)][1]
        for name, ratios in shots.items():
            ratios[quality] = usual[name]["trimmed"] / ratios["best"]
        for name in wanted:
            rows[name][quality] = row = compare(cases, measure_cases(cases, quality, SWITCHES[name]), usual)
            print(quality, name, {group: (each["trimmed"], each["time"]) for group, each in row.items()}, flush=True)
    what = __doc__.split("\n\n")[2].replace("\n", " ").strip()
    rounded = {name: {key: round_figure(value) for key, value in ratios.items()} for name, ratios in shots.items()}
    table = {"what": what, "machine": describe_machine(), "mechanisms": rows, "shots": rounded}
    write_json(asked.output, table, one_line=r'\{\s*"(?:error|best)": (?:[^{}]|\{[^{}]*\})*\}')


if __name__ == "__main__":
    main()
