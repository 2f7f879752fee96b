"""What the affinity network owes to lobes and to halves: the same training with and without each.

    python -m benchmarks.training.affinity_ablation --frames FOLDER --folder OTHER --steps 1500

Every variant is trained for as many steps on the same frames and judged on those that are kept aside; a second seed of
the whole network tells how far runs differ by chance. A variant whose curve in ``OTHER`` has so many steps is not
trained again, so the program may be stopped between variants.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, describe_machine, write_json

RESULT = RESULTS / "affinity_ablation.json"
STEPS = 1500
VARIANTS: dict[str, list[str]] = {
    "full": ["--seed", "1"],
    "full2": ["--seed", "2"],
    "nolobes": ["--seed", "1", "--no-lobes"],
    "nohalves": ["--seed", "1", "--no-halves"],
}
"""Options of the trainer by the variant's name."""


def find_point(curve: Path, steps: int) -> dict[str, Any] | None:
    """Return the last point of a curve, None before a variant has had all of its steps."""
    points: list[dict[str, Any]] = json.loads(curve.read_text())["points"] if curve.exists() else []
    return points[-1] if points and points[-1]["steps"] >= steps else None


def train_variant(name: str, frames: Path, folder: Path, steps: int) -> dict[str, Any]:
    """Return the last point of a variant's curve; train it first where it has none."""
    curve = folder / f"{name}.json"
    point = find_point(curve, steps)
    if point is None:
        from benchmarks.training import affinity

        checkpoint = folder / f"{name}.pt"
        # What was begun is begun again: a run that goes on has another rate.
        for path in (curve, checkpoint):
            path.unlink(missing_ok=True)
        words = ["--frames", str(frames), "--checkpoint", str(checkpoint), "--curve", str(curve)]
        affinity.main([*words, "--steps", str(steps), *VARIANTS[name]])
        point = find_point(curve, steps)
        assert point is not None
    return point


def main(words: list[str] | None = None) -> None:
    """Train every variant and write the last errors of each."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--frames", type=Path, required=True, help="folder that make_frames.py filled")
    parser.add_argument("--folder", type=Path, required=True, help="for checkpoints and curves")
    parser.add_argument("--steps", type=int, default=STEPS, help="of every variant")
    parser.add_argument("--output", type=Path, default=RESULT)
    arguments = parser.parse_args(words)
    arguments.folder.mkdir(parents=True, exist_ok=True)
    points = {name: train_variant(name, arguments.frames, arguments.folder, arguments.steps) for name in VARIANTS}
    write_json(
        arguments.output,
        {
            "metric": "rel_mse over that of Open Image Denoise with the same guides, geometric means over frames",
            "variants": points,
            "machine": describe_machine(),
        },
    )


if __name__ == "__main__":
    main()
