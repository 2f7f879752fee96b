"""What re-computation brings to the interactive chain, and what it brings that its samples enter the history.

    python -m benchmarks.interactive.again

An orbit of ten frames, one degree a frame, 128x128 pixels, indirect light at one of 4x4 pixels. The last frame is
compared with the same method at every pixel; paths then have 256 samples. "forgotten" leaves the samples out of the
history; "once each" shades every pixel once, and the others as often as is usual for the method, in as many times fewer
pixels. Errors are `rel_mse` (epsilon 0.01).
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from benchmarks.common import RESULTS, describe_machine, write_json
from lobewise.frame import FloatArray
from lobewise.interactive import InteractiveSettings, Session
from lobewise.metrics import rel_mse
from lobewise.render import find_orbit_centre, make_orbit
from lobewise.temporal import TemporalFilter

SCENES, METHODS = ("showroom", "parlour", "kitchen"), ("paths", "voxel_cones")
SIZE_PIXELS, FRAMES, DEGREES, BUDGET = 128, 10, 1.0, 0.05
REFERENCE_SPP = {"paths": 256, "voxel_cones": 1}


@contextmanager
def forget_samples() -> Iterator[None]:
    """Leave samples of re-computation out of histories."""
    original = TemporalFilter.add_samples
    TemporalFilter.add_samples = lambda *_, **__: None  # type: ignore[method-assign]
    try:
        yield
    finally:
        TemporalFilter.add_samples = original  # type: ignore[method-assign]


def render_last(session: Session, path: list[Any], **settings: Any) -> FloatArray:
    """Return the indirect light of the last frame of a path, by a session without history."""
    asked = InteractiveSettings(**settings)
    return [frame.get_view("indirect") for frame in session.make_sibling().frames(path, asked)][-1]


def measure_scene(name: str) -> dict[str, dict[str, float]]:
    """Return the errors of every method of indirect light."""
    session = Session(name, width=SIZE_PIXELS, height=SIZE_PIXELS)
    path = make_orbit(session.camera, find_orbit_centre(session.scene), frames=FRAMES, degrees_per_frame=DEGREES)
    errors = {}
    for method in METHODS:
        full = {"similarity": "none", "scale": 1, "temporal": False, "adaptive": 0.0, "spp": REFERENCE_SPP[method]}
        reference = render_last(session, path[-1:], method=method, **full)
        with forget_samples():
            forgotten = render_last(session, path, method=method, adaptive=BUDGET)
        images = {
            "without re-computation": render_last(session, path, method=method, adaptive=0.0),
            "once each": render_last(session, path, method=method, adaptive=BUDGET, adaptive_parts=1),
            "forgotten": forgotten,
            "kept": render_last(session, path, method=method, adaptive=BUDGET),
        }
        errors[method] = {each: float(f"{rel_mse(image, reference):.4g}") for each, image in images.items()}
    return errors


def main() -> None:
    """Measure every scene, and write the JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "interactive_again.json")
    asked = parser.parse_args()
    scenes = {name: measure_scene(name) for name in SCENES}
    print(*scenes.items(), sep="\n")
    write_json(asked.output, {"scenes": scenes, "machine": describe_machine()})


if __name__ == "__main__":
    main()
