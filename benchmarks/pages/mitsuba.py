"""The figures of docs/mitsuba.md, from what `benchmarks/foreign/mitsuba_users.py` has measured."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from benchmarks.pages.tables import describe_run, list_facts, make_table

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


def make_figures(measured: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/mitsuba.md by place."""
    settings, size = measured["settings"], measured["settings"]["size"]
    rows = [
        [f"{name}, {spp} spp", *(f"{np.mean(errors[method]):.4f}" for method in METHODS)]
        for name, scene in measured["scenes"].items()
        for spp, errors in scene["samples"].items()
    ]
    run = {
        "Size": f"{size}x{size}",
        "Seeds": f"{settings['seeds']}, of which the mean is shown",
        "Samples per pixel of the reference": settings["reference_spp"],
        "Machine": describe_run(measured),
    }
    return {"errors": make_table(["scene", *METHODS.values()], rows), "errors-run": list_facts(run)}
