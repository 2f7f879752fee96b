"""Time of the filter kernels: sizes, radii, forms and similarities, as ratios to ``normal`` within the run.

Every group (one size, radius and form) runs its candidates in turn, again and again, and takes the best of each, so
that a disturbance of the machine meets all of them. One image is filtered, as Open Image Denoise does beside it.

    python -m benchmarks.performance.filters -o benchmarks/results/filters.json
"""

import argparse
from collections.abc import Callable
from pathlib import Path
from typing import Any

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from lobewise.cli.bench.filters import make_kernel_calls
from lobewise.cli.bench.plane import make_features, make_frame
from lobewise.cli.bench.timing import time_best
from lobewise.filters.forms import count_taps
from lobewise.peers import denoise_oidn, has_oidn
from lobewise.records.frame import Frame
from lobewise.settings import FORM_NAMES

SIZES = ((512, 512), (1024, 1024), (1920, 1080))
RADII = (8, 16)


def time_kernels(frame: Frame, radius: int, form: str, seconds: float) -> dict[str, dict[str, float]]:
    """Return times of the similarities for one size, radius and form, and their ratios to ``normal``.

    The frame is one of `lobewise.cli.bench.plane.make_frame`; see `lobewise.filters.cross_filter.run_filter` and
    `lobewise.cli.bench.timing.time_best`.
    """
    best = time_best(make_kernel_calls(frame, make_features(frame), radius, form), seconds)
    taps = count_taps(form, radius) * frame.width * frame.height
    return {
        name: {
            "milliseconds": round(1e3 * value, 3),
            "ns_per_tap_and_pixel": round(1e9 * value / taps, 4),
            "ratio_to_normal": round(value / best["normal"], 3),
        }
        for name, value in best.items()
    }


def bench_against_oidn(frame: Frame, seconds: float) -> dict[str, Any]:
    """Return times of one separable filter run and of Open Image Denoise on the same frame."""
    kernels = make_kernel_calls(frame, make_features(frame, ("sg", "ggx")), 8, "separable")
    candidates: dict[str, Callable[[], Any]] = {
        "sg kernel, separable, radius 8": kernels["sg"],
        "ggx kernel, separable, radius 8": kernels["ggx"],
        "oidn, default quality": lambda: denoise_oidn(frame, guides="centre"),
        "oidn, fast quality": lambda: denoise_oidn(frame, quality="fast", guides="centre"),
    }
    best = time_best(candidates, seconds)
    oidn, quick = best["oidn, default quality"], best["oidn, fast quality"]
    return {
        name: {
            "milliseconds": round(1e3 * value, 2),
            "times_faster_than_oidn": round(oidn / value, 2),
            "times_faster_than_oidn_fast": round(quick / value, 2),
        }
        for name, value in best.items()
    }


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "filters.json")
    parser.add_argument("--seconds", type=float, default=3.0, help="least time per group")
    arguments = parser.parse_args()
    rows: list[dict[str, Any]] = []
    peers: dict[str, Any] = {}
    for width, height in SIZES:
        frame = make_frame(width, height)
        for form in FORM_NAMES:
            for radius in RADII if form != "atrous" else RADII[:1]:
                result = time_kernels(frame, radius, form, arguments.seconds)
                rows.append({"width": width, "height": height, "form": form, "radius": radius, **result})
                cells = "  ".join(
                    f"{name} {cell['milliseconds']:8.2f} ms ({cell['ratio_to_normal']:.2f})"
                    for name, cell in result.items()
                )
                print(f"{width}x{height} {form:9} radius {radius:2}  {cells}", flush=True)
        if has_oidn():
            peers[f"{width}x{height}"] = bench_against_oidn(frame, arguments.seconds)
            for name, cell in peers[f"{width}x{height}"].items():
                print(f"{width}x{height} {name}: {cell['milliseconds']} ms, {cell['times_faster_than_oidn']}x")
    write_json(
        arguments.output,
        {
            "what": "best wall time of one run; atrous: five 5x5 levels, whatever the radius",
            "version": lobewise.__version__,
            "machine": describe_machine(),
            "kernels": rows,
            "oidn": peers,
        },
    )


if __name__ == "__main__":
    main()
