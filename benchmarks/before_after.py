"""Times of every recipe, this version and an older one in turn: what a rebuilding may not cost.

``python -m benchmarks.before_after --before CHECKOUT`` starts a process for either version, asks them by turns for one
run of each case, and tells the ratio after over before of processor times: of the shortest runs, and the median of
neighbouring runs. A machine that slows down or speeds up meanwhile slows both. The result is
``benchmarks/results/before_after.json``.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from itertools import cycle
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.same_bits.frames import crop, enrich, load_bundled, name_layers

RESULTS = Path(__file__).parent / "results" / "before_after.json"
FIRST_FRAMES, ORBIT_FRAMES = 4, 20
"""Frames of the interactive chain before its first timed run, and on the part of the orbit that lies in the room."""
LEAST_SECONDS = 0.1
"""A run repeats a case until it has taken so much processor time."""


def make_cases() -> dict[str, Callable[[], Any]]:
    """Return every case by its name; public names alone, which both versions have."""
    import lobewise

    bundled = load_bundled()
    rich = enrich(bundled)
    sparse = lobewise.make_sparse(rich, 4)
    small = enrich(crop(bundled, slice(0, 256), slice(0, 256)))
    cases: dict[str, Callable[[], Any]] = {}

    def add(name: str, run: Callable[..., Any], *given: Any, **changes: Any) -> None:
        cases[name] = lambda: run(*given, device="cpu", **changes)

    for form in ("full", "separable", "atrous"):
        for similarity in ("normal", "sg", "sg_mixture", "ggx"):
            add(f"fast {form} {similarity}", lobewise.denoise, rich, quality="fast", form=form, similarity=similarity)
    for similarity in ("sg", "ggx"):
        add(f"balanced {similarity}", lobewise.denoise, rich, quality="balanced", similarity=similarity)
        add(f"upsampling {similarity}", lobewise.upsample, sparse, similarity=similarity)
    add("balanced, few guides", lobewise.denoise, bundled, quality="balanced")
    add("high", lobewise.denoise, rich, quality="high")
    passes = rich.with_changes(also={"key": 0.6 * rich.radiance.color, "fill": 0.4 * rich.radiance.color})
    for quality in ("fast", "balanced", "high"):
        add(f"light passes {quality}", lobewise.denoise, passes, quality=quality)
        add(f"layers and their parts {quality}", lobewise.denoise, name_layers(rich), quality=quality)
    add("fast full ggx, 256x256", lobewise.denoise, small, quality="fast")
    add("balanced, 256x256", lobewise.denoise, small, quality="balanced")
    for name, frame, changes in (
        ("history, sparse", sparse, {}),
        ("history, full", rich, {"radius": 4}),
        ("history, separable", rich, {"form": "separable"}),
    ):
        history = lobewise.TemporalFilter(device="cpu", **changes)
        history.add(frame)
        cases[name] = lambda history=history, frame=frame: history.add(frame)
    cases["interactive frame, 1024x1024"] = make_interactive()
    return cases


def make_interactive() -> Callable[[], Any]:
    """Return what renders the next frame of the interactive chain by paths, to and fro on an orbit."""
    from lobewise.cli.bench.interactive import DEGREES_PER_FRAME

    frames: Iterator[Any] | None = None

    def run() -> Any:
        nonlocal frames
        if frames is None:
            # The scene takes seconds, so it waits for the first run.
            from lobewise.interactive import InteractiveSettings, Session
            from lobewise.render import find_orbit_centre, load_mitsuba, make_orbit

            load_mitsuba("cpu")
            session = Session("showroom", width=1024, height=1024)
            path = make_orbit(session.camera, find_orbit_centre(session.scene), ORBIT_FRAMES, DEGREES_PER_FRAME)
            # No camera twice in turn: while it stands still, more pixels are shaded.
            frames = session.frames(cycle([*path, *path[-2:0:-1]]), InteractiveSettings(method="paths"))
            for _ in range(FIRST_FRAMES):  # they compile kernels, or have a shorter history
                next(frames)
        return next(frames)

    return run


def serve() -> None:
    """Answer names of cases on standard input with the processor seconds of a run, on standard output."""
    cases = make_cases()
    print(json.dumps(list(cases)), flush=True)
    for line in sys.stdin:
        run = cases[line.strip()]
        count, start = 0, time.process_time()
        while time.process_time() - start < LEAST_SECONDS:
            run()
            count += 1
        print((time.process_time() - start) / count, flush=True)


class Version:
    """A process of one version."""

    def __init__(self, checkout: Path) -> None:
        environment = {**os.environ, "PYTHONPATH": str(checkout / "src")}
        command = [sys.executable, "-m", "benchmarks.before_after", "--serve"]
        root = Path(__file__).parents[1]
        pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        self._process = subprocess.Popen(command, cwd=root, env=environment, text=True, **pipes)  # type: ignore[call-overload]
        self.cases: list[str] = json.loads(self._process.stdout.readline())
        found = subprocess.run(["git", "-C", str(checkout), "rev-parse", "--short", "HEAD"], capture_output=True)
        self.commit = found.stdout.decode().strip()

    def time(self, case: str) -> float:
        """Return the processor seconds of one run, of all threads."""
        self._process.stdin.write(f"{case}\n")
        self._process.stdin.flush()
        return float(self._process.stdout.readline())


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--before", type=Path, help="a checkout of the older version")
    parser.add_argument("--rounds", type=int, default=9, help="runs of each case and version")
    parser.add_argument("--only", default="", help="cases whose name has this in it")
    parser.add_argument("--output", type=Path, default=RESULTS)
    options = parser.parse_args()
    if options.serve:
        serve()
        return
    if options.before is None:
        parser.error("--before: expected a checkout of the older version, got nothing; make one with git worktree")
    # Not at the top: the older version's process has other modules.
    from benchmarks.common import describe_machine, write_json

    before, after = Version(options.before), Version(Path(__file__).parents[1])
    rows: dict[str, dict[str, float]] = {}
    for case in before.cases:
        if options.only not in case:
            continue
        for version in (before, after):  # kernels are compiled, and caches are warm
            version.time(case)
        pairs = [(before.time(case), after.time(case)) for _ in range(options.rounds)]
        best = [min(seconds) for seconds in zip(*pairs, strict=True)]
        rows[case] = {
            "before_ms": round(1e3 * best[0], 3),
            "after_ms": round(1e3 * best[1], 3),
            "ratio": round(best[1] / best[0], 3),
            "median_ratio": round(statistics.median(b / a for a, b in pairs), 3),
        }
        print(
            f"{rows[case]['ratio']:6.3f} {rows[case]['median_ratio']:6.3f} {1e3 * best[0]:9.2f} ms  {case}", flush=True
        )
    ratios = [row["ratio"] for row in rows.values()]
    mean = float(np.exp(np.mean(np.log(ratios))))
    print(f"{mean:6.3f} geometric mean")
    write_json(
        options.output,
        {
            "machine": describe_machine(),
            "before": before.commit,
            "after": after.commit,
            "rounds": options.rounds,
            "geometric_mean": round(mean, 4),
            "cases": rows,
        },
    )


if __name__ == "__main__":
    main()
