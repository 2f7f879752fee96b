"""The figures of light groups, measured by `foreign/groups.py`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.light_passes import make_pass_table
from benchmarks.pages.tables import RATIOS, describe_ratios, make_table

METHODS = ("noisy", "fast", "balanced", "high", "auto", "Open Image Denoise")


def make_figures(measured: Mapping[str, Any], passes: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/renderers_results.md by place."""
    files = measured["files"].values()
    groups = [errors for file in files for errors in file["errors"].values() if errors["noisy"] > 0.0]
    rows = []
    for method in METHODS:
        ratios = np.array([errors[method] / errors["noisy"] for errors in groups])
        times = [file["time"][method] for file in files if method in file["time"]]
        time = f"{np.median(times):.1f}" if times else ""
        rows.append([method, *describe_ratios(ratios, 2), time])
    header = ["", *RATIOS, "time over the picture alone"]
    return {"groups": make_table(header, rows), "passes": make_pass_table(passes)}
