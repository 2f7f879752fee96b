"""What the history of direct light brings while the camera moves, and after it stopped.

    python -m benchmarks.interactive.direct

Twelve frames of an orbit, one degree a frame, 192x192 pixels; then the camera stands still. The direct light of the
last frame is compared with the mean of 256 unfiltered frames. "alone" is filtered without a history. Errors are
`rel_mse` (epsilon 0.01), means over four seeds.
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import RESULTS, describe_machine, write_json
from lobewise.interactive import InteractiveSettings, Session
from lobewise.metrics import rel_mse
from lobewise.render import find_orbit_centre, make_orbit

SCENES = ("showroom", "brushed", "parlour", "kitchen")
SIZE_PIXELS, FRAMES, DEGREES, SEEDS, REFERENCE_FRAMES = 192, 12, 1.0, 4, 256
STILL_FRAMES = (2, 8, 32)
"""Frames with the same camera, the last of the orbit included."""


def make_settings(**changes: Any) -> InteractiveSettings:
    """Return settings under which indirect light costs little."""
    return InteractiveSettings(method="paths", scale=16, adaptive=0.0, **changes)


def measure_scene(name: str) -> dict[str, float]:
    """Return the errors of a scene's direct light."""
    session = Session(name, width=SIZE_PIXELS, height=SIZE_PIXELS)
    path = make_orbit(session.camera, find_orbit_centre(session.scene), FRAMES, DEGREES)
    still, raw = session.make_sibling(), make_settings(filter_direct=False, temporal=False)
    reference = [still.render(path[-1], raw) for _ in range(REFERENCE_FRAMES)][-1].get_view("direct")
    errors: dict[str, list[float]] = {}
    for seed in range(1, SEEDS + 1):
        for kind, temporal in (("alone", False), ("with history", True)):
            stream = Session(session.scene, width=SIZE_PIXELS, height=SIZE_PIXELS, seed=seed)
            frames = list(stream.frames(path, make_settings(temporal=temporal)))
            errors.setdefault(kind, []).append(rel_mse(frames[-1].get_view("direct"), reference))
        for count in range(2, max(STILL_FRAMES) + 1):
            frame = stream.render(path[-1], make_settings())
            if count in STILL_FRAMES:
                errors.setdefault(f"still, {count} frames", []).append(rel_mse(frame.get_view("direct"), reference))
    return {kind: float(f"{np.mean(values):.4g}") for kind, values in errors.items()}


def main() -> None:
    """Measure every scene, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "interactive_direct.json")
    asked = parser.parse_args()
    scenes = {}
    for name in SCENES:
        scenes[name] = measure_scene(name)
        print(name, scenes[name], flush=True)
    write_json(asked.output, {"scenes": scenes, "machine": describe_machine()})


if __name__ == "__main__":
    main()
