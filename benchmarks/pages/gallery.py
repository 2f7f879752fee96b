"""The errors that stand under the pictures of docs/gallery.md, measured by `pictures/gallery.py`."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import list_facts

SHOWN = {
    "brushed": ("Error on the anisotropic pixels", ("sg", "asg", "ggx")),
    "plastic": ("Error of the whole image", ("sg", "sg_mixture", "normal")),
    "measured": ("Error on the measured pixels", ("normal", "sg", "sg_mixture", "asg", "ggx")),
    "upsampling": ("Error", ("bilinear", "normal", "ggx")),
    "chain": ("Error", ("shaded", "normal", "ggx", "with time", "with adaptive pixels")),
    "animation": ("Flicker", ("alone", "with time")),
}
"""What is told of each picture, and of which of its panels."""


def make_figures(gallery: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/gallery.md by place."""
    figures = {}
    for name, (title, panels) in SHOWN.items():
        errors, key = gallery[name]["errors"], "flicker" if title == "Flicker" else "rel_mse"
        shown = ", ".join(f"`{panel}` {errors[panel][key]:.4f}" for panel in panels)
        figures[name] = list_facts({title: shown, "Samples per pixel": gallery[name]["spp"]})
    return figures
