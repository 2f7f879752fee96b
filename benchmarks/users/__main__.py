"""Every method on the frames that users have, with all of their guides and with few.

    python -m benchmarks.interiors.fetch
    python -m benchmarks.users.render FRAMES
    python -m benchmarks.users FRAMES --foreign FOLDER

``FRAMES`` is the folder of `benchmarks.users.render`, ``FOLDER`` that of `benchmarks/foreign`; scenes without two
references are left out. What has figures is not measured again unless ``--again`` says so. The file is written after
every cell, so that the program may be stopped at any time. Errors need Open Image Denoise: they are relative to
references that it has cleaned.
"""

import argparse
import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.quality.measure import round_figure
from benchmarks.users.guides import GUIDE_SETS, make_peer, reduce_frame, sum_albedos
from benchmarks.users.measuring import FIGURES, Meter, make_reference_judge
from benchmarks.users.methods import METHODS, Shot, Tuning, list_methods, tune
from benchmarks.users.scenes import Scene, list_scenes
from benchmarks.users.summary import summarise
from lobewise.errors import LobewiseError
from lobewise.peers import require_oidn
from lobewise.records.frame import Frame

RESULT = RESULTS / "users.json"


def load(path: Path) -> dict[str, Any]:
    """Return what was measured so far."""
    before: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    return {
        "what": "rel_mse (epsilon 0.01) without the noise of the references; the standard error that this noise "
        "leaves in it, and in its difference to the noisy image's; the same without the worst 0.1 % of pixels; FLIP; "
        "energy over the noisy image's",
        "figures": FIGURES,
        "tuning": before.get("tuning", {}),
        "scenes": before.get("scenes", {}),
    }


def save(path: Path, data: Mapping[str, Any]) -> None:
    """Write what was measured and its summary through a temporary file; a cell stays on one line."""
    told = {**data, "machine": describe_machine(), "summary": summarise(data["scenes"])}
    write_json(path, told, one_line=r"[\[{][^][{}]*[\]}]")


def make_shot(scene: Scene, frame: Frame, guides: str, spp: int) -> Shot | None:
    """Return a frame with one set of guides, None where the set is not in it."""
    handed = scene.read_peer(spp, frame)
    reduced = reduce_frame(frame, guides, None if handed is None else sum_albedos(handed))
    if reduced is None:
        return None
    peer = handed if handed is not None else frame if guides == "all" else make_peer(frame)
    return Shot(reduced, peer, guides, spp)


class Bench:
    """Measures cells and keeps them in a file.

    Parameters
    ----------
    path : Path
        The file.
    again : bool
        Measure what has figures as well.
    """

    def __init__(self, path: Path, *, again: bool = False) -> None:
        self.path = path
        self.data = load(path)
        self._again = again

    def measure_scene(self, scene: Scene, samples: list[int], sets: list[str], names: list[str]) -> None:
        """Measure what is asked for and missing."""
        row = self.data["scenes"].setdefault(scene.key, {"held_out": scene.is_held_out, "guides": {}})
        wanted = [
            (spp, guides)
            for spp in scene.frames
            for guides in sets
            if spp in samples and self._list_missing(row, guides, spp, names)
        ]
        if not wanted:
            return
        first, second = scene.reference_images
        judge = make_reference_judge(first, second)
        row["size"] = [first.shape[1], first.shape[0]]
        row["reference_error"] = round_figure(judge.measure_noise())
        for spp in dict.fromkeys(spp for spp, _ in wanted):
            frame = scene.read(spp)
            meter = Meter(judge, 0.5 * (first + second), frame.radiance.color)
            for guides in (guides for count, guides in wanted if count == spp):
                shot = make_shot(scene, frame, guides, spp)
                if shot is not None:
                    self._measure_shot(row, shot, meter, self._list_missing(row, guides, spp, names))
                    self._tell(scene, row, guides, spp)

    def _list_missing(self, row: Mapping[str, Any], guides: str, spp: int, names: list[str]) -> list[str]:
        there = row["guides"].get(guides, {}).get(str(spp), {})
        known = {} if self._again else {**there.get("methods", {}), **there.get("skipped", {})}
        return [name for name in names if name not in known]

    def _measure_shot(self, row: dict[str, Any], shot: Shot, meter: Meter, names: list[str]) -> None:
        found = row["guides"].setdefault(shot.guides, {}).setdefault(str(shot.spp), {"methods": {}, "skipped": {}})
        for name in names:
            try:
                image = METHODS[name](shot, self.data["tuning"])
            except LobewiseError as error:
                found["skipped"][name] = str(error)
                continue
            found["methods"][name] = meter.measure(image)
            found["methods"] = {each: found["methods"][each] for each in METHODS if each in found["methods"]}
            found["skipped"].pop(name, None)
            found["commit"] = describe_machine().get("commit", "")
            save(self.path, self.data)

    def _tell(self, scene: Scene, row: Mapping[str, Any], guides: str, spp: int) -> None:
        cells = row["guides"][guides][str(spp)]["methods"]
        print(f"{scene.key} {guides} {spp} spp ", *(f"{name} {cell['rel_mse']:.5f}" for name, cell in cells.items()))
        sys.stdout.flush()

    def tune(self, scenes: list[Scene], samples: list[int]) -> None:
        """Search the settings of "normal-aware" by sample count, on the scenes that are not held out."""
        chosen = [scene for scene in scenes if not scene.is_held_out]
        judges = {scene.key: make_reference_judge(*scene.reference_images) for scene in chosen}
        for spp in samples:
            frames = [(scene.read(spp), judges[scene.key]) for scene in chosen if spp in scene.frames]
            if frames:
                self.data["tuning"][str(spp)] = tune(frames)
                save(self.path, self.data)
                print(f"{spp} spp, {len(frames)} scenes: {self.data['tuning'][str(spp)]}", flush=True)


def check_tuning(tuning: Tuning, names: list[str]) -> None:
    """Raise SystemExit where the tuned method is asked for and was not tuned."""
    if not tuning and "normal-aware" in names:
        raise SystemExit('"normal-aware" was not tuned: run with --tune first, or name other methods with --method')


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("frames", type=Path)
    parser.add_argument("--foreign", type=Path, help="frames of other renderers")
    parser.add_argument("-o", "--output", type=Path, default=RESULT)
    parser.add_argument("--scene", action="append", help="only scenes whose group/name begins so (may be repeated)")
    parser.add_argument("--spp", type=int, action="append", help="only this sample count (may be repeated)")
    parser.add_argument("--guides", choices=GUIDE_SETS, action="append", help="only this set (may be repeated)")
    parser.add_argument("--method", choices=tuple(METHODS), action="append", help="only this (may be repeated)")
    parser.add_argument("--again", action="store_true", help="measure what has figures as well")
    parser.add_argument("--tune", action="store_true", help='tune "normal-aware", and measure nothing')
    asked = parser.parse_args()
    require_oidn()
    bench = Bench(asked.output, again=asked.again)
    begins = tuple(asked.scene or [""])
    scenes = [scene for scene in list_scenes(asked.frames, asked.foreign) if scene.key.startswith(begins)]
    if not scenes:
        raise SystemExit(f"no scene with two references in {asked.frames}")
    samples = asked.spp or sorted({spp for scene in scenes for spp in scene.frames})
    if asked.tune:
        bench.tune(scenes, samples)
        return
    names = list_methods(asked.method)
    check_tuning(bench.data["tuning"], names)
    for scene in scenes:
        bench.measure_scene(scene, samples, asked.guides or list(GUIDE_SETS), names)
    save(asked.output, bench.data)


if __name__ == "__main__":
    main()
