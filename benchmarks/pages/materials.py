"""The figures of docs/materials.md, measured by `quality/fit_materials.py` and `quality/textured_lobes.py`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import describe_run, list_facts, make_table

SHOWN = (0.01, 0.1, 0.3, 0.5)
"""GGX alphas that the page shows."""
WAYS = {"one place": "one place", "places of the texture": "places", "the formula": "formula"}
"""Titles of the ways in which a frame gets its lobes, and their names in the results."""


def name_fit(key: str) -> str:
    """Return what was fitted, in words."""
    if key == "tabulated":
        return "the MERL table itself"
    kind, count = key.split()
    return f"{count} `{kind}` lobe{'s' if count != '1' else ''}"


def make_texture_table(textured: Mapping[str, Any]) -> str:
    """Return the errors of floors of two roughnesses, by the lobes that a frame has."""
    header = ["floor", "filter", "noisy", *(f"lobes of {way}" for way in WAYS)]
    rows = []
    for material, found in textured["scenes"].items():
        for name in found["places"]["errors"]:
            errors = [found[way]["errors"].get(name) if way in found else None for way in WAYS.values()]
            cells = ["" if error is None else f"{error:.5f}" for error in errors]
            rows.append([material, name, f"{found['noisy']:.5f}", *cells])
    return make_table(header, rows)


def list_texture_run(textured: Mapping[str, Any]) -> str:
    """Return how these floors were measured."""
    seconds = [found["places"]["seconds of one core"] for found in textured["scenes"].values()]
    return list_facts(
        {
            "Size": f"{textured['size']}x{textured['size']}, {textured['spp']} samples per pixel",
            "Seeds": f"{textured['seeds']}, of which the mean is shown",
            "Samples per pixel of the reference": textured["reference_spp"],
            "Fit of two places": f"{min(seconds):.1f} to {max(seconds):.1f} s of one core",
            "Machine": describe_run(textured),
        }
    )


def make_figures(results: Mapping[str, Any], textured: Mapping[str, Any]) -> dict[str, str]:
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
    return {
        "fits": make_table(header, rows),
        "time": list_facts(run),
        "textures": make_texture_table(textured),
        "textures-run": list_texture_run(textured),
    }
