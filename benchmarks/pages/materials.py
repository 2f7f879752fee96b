"""The figures of docs/materials.md, measured by `quality/fit_materials.py`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import list_facts, make_table

SHOWN = (0.01, 0.1, 0.3, 0.5)
"""GGX alphas that the page shows."""


def name_fit(key: str) -> str:
    """Return what was fitted, in words."""
    if key == "tabulated":
        return "the MERL table itself"
    kind, count = key.split()
    return f"{count} `{kind}` lobe{'s' if count != '1' else ''}"


def make_figures(results: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/materials.md by place."""
    whole, machine = results["whole file"], results["machine"]
    rows = [
        [f"{fit['alpha']:g}", name_fit(key), *(f"{nearness:.4f}" for nearness in values)]
        for fit in results["fits"]
        if fit["alpha"] in SHOWN
        for key, values in fit.items()
        if not key.startswith("alpha")
    ]
    run = {
        "Time for a whole file, with the start of the program and the plot": f"{min(whole['seconds']):.1f} s",
        "Size of the lobe file": f"{whole['lobe file bytes']:,} bytes",
        "Machine": f"{machine['processor']}, {machine['cores']} cores",
    }
    header = ["GGX alpha", "what", *(f"n.v {cosine:g}" for cosine in results["views"])]
    return {"fits": make_table(header, rows), "time": list_facts(run)}
