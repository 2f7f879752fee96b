"""The paper's table of denoising times, measured here: 1024x1024, radius 8 and 16, beside the paper's own ratios.

The paper's filter must have been separable: its times grow by less than two from radius 8 to 16. Both forms are timed.

    python -m benchmarks.performance.paper_table -o benchmarks/results/paper_table.json
"""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

import lobewise
from benchmarks.common import RESULTS, describe_machine, write_json
from benchmarks.performance.filters import time_kernels
from lobewise.bench.kernels import PAPER_MILLISECONDS, PAPER_RADII, PAPER_SIZE
from lobewise.bench.plane import make_frame


def main() -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("-o", "--output", type=Path, default=RESULTS / "paper_table.json")
    parser.add_argument("--seconds", type=float, default=6.0, help="least time per group")
    arguments = parser.parse_args()
    frame = make_frame(PAPER_SIZE, PAPER_SIZE)
    rows: list[dict[str, Any]] = []
    for form in ("separable", "full"):
        for radius in PAPER_RADII:
            result = time_kernels(frame, radius, form, arguments.seconds)
            paper = PAPER_MILLISECONDS[radius]
            for name, cell in result.items():
                if name in paper:
                    cell["paper_milliseconds"] = paper[name]
                    cell["paper_ratio_to_normal"] = round(paper[name] / paper["normal"], 2)
                told = f"paper {cell['paper_ratio_to_normal']:.2f}" if name in paper else ""
                print(
                    f"{form:9} radius {radius:2}  {name:22} {cell['milliseconds']:8.1f} ms  "
                    f"ratio {cell['ratio_to_normal']:5.2f}  {told}",
                    flush=True,
                )
            rows.append({"form": form, "radius": radius, "similarities": result})
    write_json(
        arguments.output,
        {
            "what": "best wall time of one run at 1024x1024; ratios to normal-aware filtering within the run",
            "version": lobewise.__version__,
            "machine": describe_machine(),
            "rows": rows,
        },
    )


if __name__ == "__main__":
    main()
