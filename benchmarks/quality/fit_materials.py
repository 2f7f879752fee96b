"""Measure how near fitted lobes are to GGX tabulated as MERL, what the table itself loses, and how long a file takes.

python -m benchmarks.quality.fit_materials -o benchmarks/results/fit_materials.json
"""

from __future__ import annotations

import argparse
import json
import math
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common import describe_machine, write_json
from lobewise.fitting.fit import fit_lobes
from lobewise.fitting.ggx import ggx_brdf
from lobewise.fitting.nodes import make_nodes
from lobewise.fitting.table import evaluate_lobes, evaluate_table
from lobewise.io.materials import write_merl
from tests.fitting.merl_tables import make_merl

ALPHAS = (0.005, 0.01, 0.02, 0.05, 0.1, 0.3, 0.5, 0.8)
KINDS = ("sg", "asg")
LOBES = (1, 2, 3)
VIEWS = (0.1, 0.2, 0.3, 0.5, 0.7, 0.9, 1.0)
"""Cosines n.v at which fits are measured. Only the last one is a view of the table."""
RUNS = 3
UP = np.asarray([0.0, 0.0, 1.0])


def make_ggx(alpha: float) -> Callable[[Any, Any], Any]:
    """Return the GGX BRDF of one roughness."""
    return lambda view, light: ggx_brdf(view, light, alpha)


def measure_view(cosine: float, exact: Callable[[Any, Any], Any], other: Callable[[Any, Any], Any]) -> float:
    """Return the L2 cosine between ``exact`` times the cosine and ``other(view, light)`` at one view."""
    nodes = make_nodes(cosine, 128)
    view = np.tile([math.sqrt(1.0 - cosine * cosine), 0.0, cosine], (len(nodes.light), 1))
    a = exact(view, nodes.light) * np.maximum(nodes.light[:, 2], 0.0)
    b = other(view, nodes.light)
    w = nodes.weight
    return float(np.sum(w * a * b) / math.sqrt(np.sum(w * a * a) * np.sum(w * b * b)))


def measure_fits(alpha: float) -> dict[str, Any]:
    """Return what the table of bins and each kind and number of lobes keep of a GGX lobe."""
    exact = make_ggx(alpha)
    merl = make_merl(exact)

    def tabulated(view: Any, light: Any) -> Any:
        return np.nan_to_num(merl(view, light)[:, 0]).astype(np.float64) * np.maximum(light[:, 2], 0.0)

    found: dict[str, Any] = {"alpha": alpha, "tabulated": [measure_view(c, exact, tabulated) for c in VIEWS]}
    for kind in KINDS:
        for lobes in LOBES:
            table = fit_lobes(merl, lobes=lobes, kind=kind)

            def fitted(view: Any, light: Any, table: Any = table) -> Any:
                return evaluate_lobes(evaluate_table(table, UP, view[0]), light, table.kind)

            found[f"{kind} {lobes}"] = [measure_view(c, exact, fitted) for c in VIEWS]
            found["alpha found"] = [float(np.interp(c, table.cosine, table.alpha[:, 0, 0])) for c in VIEWS]
    return found


def measure_seconds(folder: Path) -> dict[str, Any]:
    """Return the wall time of `lobewise fit` on a file of the full size, from start to end of the program."""
    path = folder / "material.binary"
    write_merl(path, make_merl(lambda view, light: 0.9 * ggx_brdf(view, light, 0.2) + 0.1 / np.pi))
    program = [sys.executable, "-c", "from lobewise.cli import main; main()"]
    seconds = []
    for _ in range(RUNS):
        start = time.perf_counter()
        subprocess.run([*program, "fit", str(path), "-o", str(folder / "a.lobes")], check=True, capture_output=True)
        seconds.append(time.perf_counter() - start)
    return {
        "bytes": path.stat().st_size,
        "seconds": seconds,
        "lobe file bytes": (folder / "a.lobes").stat().st_size,
        "what": "lobewise fit with 3 asg lobes, 20 views, plot and start of the program included",
    }


def main() -> None:
    """Measure and write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        whole = measure_seconds(Path(folder))
    results = {
        "machine": describe_machine(),
        "views": VIEWS,
        "fits": [measure_fits(alpha) for alpha in ALPHAS],
        "whole file": whole,
    }
    if chosen.output is None:
        sys.stdout.write(json.dumps(results, indent=1) + "\n")
    else:
        write_json(chosen.output, results)


if __name__ == "__main__":
    main()
