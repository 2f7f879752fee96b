"""Random shots of Blender Cycles, each from its kind and seed alone. Runs where `bpy` is, without lobewise.

    python benchmarks/foreign/factory FOLDER [--kinds a,b] [--split validation|training] [--seeds 0-3] [--spp 1]

A shot is the folder ``FOLDER/KIND_SEED``: ``shot.json``, ``SPP.exr`` for each number of samples, and three references
of seeds of their own. It is complete when the last, ``reference_3.exr``, is there. What is there is not rendered
again. Materials, geometry, textures, lamps and camera are drawn from the seed; the exposure follows from a small
render, so that no shot is black or blown out. Where there are many lamps the noise differs from run to run, since
Cycles chooses among them in another order; geometry and guides do not. ``--films`` renders films of 12 frames
instead, see `films`. The passes are those of `docs/blender.md`; half of the shots have no roughness. The kinds of the
split ``validation`` are for measuring alone: nothing is tuned or trained on them.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

sys.path.insert(1, str(Path(__file__).parents[1]))

from kinds import KINDS, REFERENCE_PARTS, TRAINING, VALIDATION, list_shots, plan_shot
from shots import render_shot

from films import render_film


def read_seeds(text: str) -> range:
    """Return the seeds that "3" or "0-3" names."""
    first, _, last = text.partition("-")
    return range(int(first), int(last or first) + 1)


def main() -> None:
    """Render what the command line asks for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    splits = {"validation": VALIDATION, "training": TRAINING}
    parser.add_argument("folder", type=Path)
    parser.add_argument("--kinds", default="", help=f"of {', '.join(KINDS)}")
    parser.add_argument("--split", choices=splits, help="all kinds of one purpose, instead of --kinds")
    parser.add_argument("--seeds", type=read_seeds, default=range(4), help="one, or the first and the last, as 0-3")
    parser.add_argument("--threads", type=int, default=0, help="0 for all")
    parser.add_argument("--spp", type=int, help="samples per pixel of the noisy frame, instead of those that are drawn")
    parser.add_argument("--reference", type=int, help="samples per pixel of all references together, likewise")
    parser.add_argument("--films", action="store_true", help="films of 12 frames with two references of each")
    parser.add_argument("--groups", action="store_true", help="put lamps and sky into light groups")
    parser.add_argument(
        "--width", type=int, help="pictures for the gallery: so many columns, 16 samples, one reference"
    )
    asked = parser.parse_args(sys.argv[1:])
    kinds = splits[asked.split] if asked.split else asked.kinds.split(",") if asked.kinds else list(KINDS)
    if unknown := set(kinds) - set(KINDS):
        parser.error(f"unknown kinds: {', '.join(sorted(unknown))}; there are {', '.join(KINDS)}")
    for kind, seed in list_shots(list(kinds), asked.seeds):
        plan, random = plan_shot(kind, seed)
        if asked.spp:
            plan = replace(plan, spp=(asked.spp,))
        if asked.reference:
            plan = replace(plan, reference_spp=(asked.reference // REFERENCE_PARTS,) * REFERENCE_PARTS)
        if asked.width:
            size = asked.width, round(plan.size[1] * asked.width / plan.size[0])
            plan = replace(plan, size=size, spp=(16,), reference_spp=(400,))
        if asked.films:
            more = {"reference_spp": asked.reference // 2} if asked.reference else {}
            render_film(asked.folder, plan, random, asked.threads, **more)
        else:
            render_shot(asked.folder, plan, random, asked.threads, groups=asked.groups)


if __name__ == "__main__":
    main()
