"""The figures of docs/how_it_works.md, measured by `benchmarks/quality/paper_pair.py`."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import make_table

NAMES = {
    "noisy": "noisy",
    "geometry": "by geometry",
    "geometry, tuned": "by geometry, tuned",
    "lobes: sg": "by lobes, `sg`",
    "lobes: ggx": "by lobes, `ggx`",
}


def make_figures(data: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/how_it_works.md by place."""
    found, paper = data["mse"], data["paper"]
    rows = [[name, f"{found[key]:.4f}", f"{found['geometry'] / found[key]:.1f}"] for key, name in NAMES.items()]
    rows.append(["the paper: by geometry", f"{paper['geometry']:.4f}", "1.0"])
    rows.append(["the paper: by lobes", f"{paper['lobes']:.4f}", f"{paper['geometry'] / paper['lobes']:.1f}"])
    return {"pair": make_table(["filter", "MSE", "geometry's MSE over this"], rows)}
