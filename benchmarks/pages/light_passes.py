"""The figures of passes of light, measured by `foreign/light_passes.py`."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.tables import RATIOS, describe_ratios, make_table

METHODS = {
    "noisy": "noisy",
    "before": "`auto` at caab0513",
    "now": "`auto`",
    "Open Image Denoise": "Open Image Denoise",
}
MIN_ERROR = 1e-9
"""Errors below this are those of references."""


def make_pass_table(measured: Mapping[str, Any]) -> str:
    """Return the error of passes over the noisy ones, and how far their sums are from the pictures."""
    shots = measured["shots"].values()
    passes = [errors for shot in shots for errors in shot["errors"].values() if errors["noisy"] > MIN_ERROR]
    rows = []
    for method, title in METHODS.items():
        ratios = np.array([max(errors[method], MIN_ERROR) / errors["noisy"] for errors in passes])
        sums = [shot["sum"][method] for shot in shots if method in shot["sum"]]
        steps = f"{np.median(sums):.1f} ({max(sums):.0f})" if sums else ""
        rows.append([title, *describe_ratios(ratios, 3), steps])
    return make_table(["", *RATIOS, "steps from the picture: median of the shots' largest (largest of all)"], rows)
