"""Render the frames that `python -m benchmarks.users` measures on; what is there is not rendered again.

    python -m benchmarks.users.render FOLDER --group interiors
    python -m benchmarks.users.render FOLDER --group own

``FOLDER/GROUP/SCENE-SPP.exr`` are noisy frames with every guide, halves and the variance; ``SCENE-ref-1.exr`` and
``SCENE-ref-2.exr`` are radiance alone, of independent seeds. Few samples and references come first. Scenes of other
renderers are rendered by `benchmarks/foreign`.
"""

import argparse
import time
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

from benchmarks.interiors.fetch import CACHE, parse_clones, prepare
from benchmarks.interiors.scenes import INTERIORS
from benchmarks.quality.frames import SCENES
from lobewise.io.exr import write_frame
from lobewise.records.frame import Frame
from lobewise.render import load_scene, render_frame, render_reference

SAMPLES = (1, 4, 16, 64, 256, 1024)
FEW = 64
"""Samples per pixel up to which frames are rendered before the references."""
SEED = 0
REFERENCE_SEEDS = {1: 77, 2: 78}
REFERENCE_SPP = 1024
OWN_SIZE = 256
GROUPS = {"interiors": tuple(INTERIORS), "own": SCENES}


def list_work(samples: tuple[int, ...]) -> list[tuple[str, Callable[[Any], Frame]]]:
    """Return what is rendered of a scene, by the end of its file's name, in order."""

    def noisy(spp: int) -> tuple[str, Callable[[Any], Frame]]:
        return f"{spp}", lambda scene: render_frame(scene, spp=spp, seed=SEED)

    def reference(half: int) -> tuple[str, Callable[[Any], Frame]]:
        return f"ref-{half}", lambda scene: render_reference(scene, spp=REFERENCE_SPP, seed=REFERENCE_SEEDS[half])

    few = [noisy(spp) for spp in samples if spp <= FEW]
    many = [noisy(spp) for spp in samples if spp > FEW]
    return [*few, *(reference(half) for half in REFERENCE_SEEDS), *many]


def render_missing(folder: Path, name: str, work: list[tuple[str, Callable[[Any], Frame]]], load: Any) -> None:
    """Render what a scene's files lack, each through a temporary file."""
    scene = cache(load)
    for end, render in work:
        path = folder / f"{name}-{end}.exr"
        if path.exists():
            continue
        begun = time.perf_counter()
        temporary = path.with_name(f"unfinished-{path.name}")
        write_frame(temporary, render(scene()))
        temporary.replace(path)
        print(f"{path.name} {time.perf_counter() - begun:.0f} s", flush=True)


def main() -> None:
    """Render."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--group", choices=tuple(GROUPS), action="append", help="only this (may be repeated)")
    parser.add_argument("--scene", action="append", help="only this (may be repeated)")
    parser.add_argument("--spp", type=int, choices=SAMPLES, action="append", help="only this (may be repeated)")
    parser.add_argument("--cache", type=Path, default=CACHE, help=f"where the interiors are ({CACHE})")
    parser.add_argument("--clone", action="append", default=[], metavar="NAME=FOLDER", help="see benchmarks.interiors")
    asked = parser.parse_args()
    work = list_work(tuple(asked.spp or SAMPLES))
    for group in asked.group or GROUPS:
        folder = asked.folder / group
        folder.mkdir(parents=True, exist_ok=True)
        for name in GROUPS[group]:
            if asked.scene and name not in asked.scene:
                continue

            def load(group: str = group, name: str = name) -> Any:
                if group == "own":
                    return load_scene(name, width=OWN_SIZE, height=OWN_SIZE)
                return load_scene(prepare(INTERIORS[name], asked.cache.expanduser(), parse_clones(asked.clone)))

            render_missing(folder, name, work, load)


if __name__ == "__main__":
    main()
