"""The figures of docs/mitsuba.md, from what `benchmarks/foreign/mitsuba_users.py` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.tables import describe_run, make_table

METHODS = {
    "noisy": "`mi.render`, noisy",
    "denoiser": "`Denoiser`, the image alone",
    "denoiser, albedo and normals": "`Denoiser`, albedo and normals",
    "denoiser, positions too": "`Denoiser`, positions too",
    "denoiser, high": '`Denoiser`, positions too, `quality="high"`',
    "oidn, albedo and normals": "Open Image Denoise, albedo and normals",
    "scene": "`denoise(scene)`",
    "scene, high": '`denoise(scene, quality="high")`',
}


def make_mitsuba_figures(measured: Mapping[str, Any]) -> str:
    """Return the section of figures."""
    settings, scenes = measured["settings"], measured["scenes"]
    rows = []
    for name, scene in scenes.items():
        for spp, errors in scene["samples"].items():
            rows.append([f"{name}, {spp} spp", *(f"{np.mean(errors[method]):.4f}" for method in METHODS)])
    size = settings["size"]
    return f"""## How good it is

Error (`rel_mse`, epsilon 0.01, with the noise of the reference taken out; lower is better) at {size}x{size}, mean of {settings["seeds"]} seeds, {settings["reference_spp"]} samples per pixel of
reference. `cornell box` is Mitsuba's, `showroom` and `kitchen` (glossy) are built in, `fog` has participating media. Open Image Denoise is given the same image, albedo and normals, as they come.
Written by `benchmarks/publish.py` from `benchmarks/results/mitsuba.json`; {describe_run(dict(measured))}.

{make_table(["scene", *METHODS.values()], rows)}
"""
