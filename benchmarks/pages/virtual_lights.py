"""The figures of docs/virtual_lights.md, measured by `interactive/virtual_lights.py` and `interactive/clusters.py`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import make_table

TITLES = {
    "one sample": "one sample, not filtered",
    "normal-aware": "normal-aware",
    "sg, default": "`sg`, default tau",
    "sg, limited": "`sg`, tau by the lights",
    "ggx, default": "`ggx`, default tau",
    "ggx, limited": "`ggx`, tau by the lights",
    "sg, default, radius 8": "`sg`, default tau, full form of radius 8",
    "sg, limited, radius 8": "`sg`, tau by the lights, full form of radius 8",
    "all lights": "all lights, not filtered",
}
ERRORS = ("paths, all", "paths, sharp", "all lights, sharp")
"""What images are compared with, and in which pixels."""
SIMILARITIES = ("sg", "ggx")
CLUSTER_METHODS = {"paths": "paths", "points": "points", "clusters": "clusters"}
"""Methods that are compared at equal time, and their titles."""
CLUSTER_PARTS = ("all", "glossy")
"""Pixels whose errors are shown."""


def make_error_table(scenes: Mapping[str, Any]) -> str:
    """Return the errors of every image, and what the noise of the reference adds."""
    header = [f"{name}, {what}" for name in scenes for what in ("all", "sharp", "sharp, own lights")]
    rows = [
        [title, *(f"{row['errors'][key][what]:.3f}" for row in scenes.values() for what in ERRORS)]
        for key, title in TITLES.items()
    ]
    noise = [
        f"{row['reference_errors'][what]:.3f}" if what in row["reference_errors"] else ""
        for row in scenes.values()
        for what in ERRORS
    ]
    return make_table(["", *header], [*rows, ["added by the noise of the reference", *noise]])


def make_sweep_table(scenes: Mapping[str, Any]) -> str:
    """Return the errors on sharp pixels by band-limit."""
    taus = next(iter(scenes.values()))["sweep"]["sg"]
    rows = [
        [tau, *(f"{row['sweep'][s][tau]['paths, sharp']:.3f}" for row in scenes.values() for s in SIMILARITIES)]
        for tau in taus
    ]
    return make_table(["tau", *(f"{name}, `{s}`" for name in scenes for s in SIMILARITIES)], rows)


def make_limit_table(scenes: Mapping[str, Any]) -> str:
    """Return how many lights there are, and the band-limit that follows from them."""
    rows = [
        [
            name,
            str(row["lights"]),
            str(row["lights_per_pixel"]),
            f"{row['lights_seen']:.1f}",
            f"{row['tau']:.2f}",
            f"{row['default_tau']:.2f}",
        ]
        for name, row in scenes.items()
    ]
    return make_table(["", "lights", "a pixel takes", "worth", "tau by the lights", "default tau"], rows)


def make_box_table(counts: Mapping[str, Any]) -> str:
    """Return error and mean of the Cornell box by number of light paths."""
    kinds = list(next(iter(counts.values())))
    rows = [
        [count, *(f"{row[kind]['rel_mse']:.4f} ({100 * (row[kind]['mean'] - 1):+.1f} %)" for kind in kinds)]
        for count, row in counts.items()
    ]
    return make_table(["light paths", *kinds], rows)


def make_cluster_table(scenes: Mapping[str, Any], stage: str) -> str:
    """Return the errors of a stage by scene and method, over all pixels and over glossy ones."""
    header = [f"{title}, {part}" for part in CLUSTER_PARTS for title in CLUSTER_METHODS.values()]
    rows = [
        [name, *(f"{row['errors'][method][stage][part]:.3f}" for part in CLUSTER_PARTS for method in CLUSTER_METHODS)]
        for name, row in scenes.items()
    ]
    return make_table(["", *header], rows)


def make_cluster_time_table(scenes: Mapping[str, Any]) -> str:
    """Return the time of a sample, the samples that each method took, and the brightness over that of paths."""
    titles = list(CLUSTER_METHODS.values())
    rows = [
        [
            name,
            *(f"{row['milliseconds'][method]:.0f} ms x {row['samples'][method]}" for method in CLUSTER_METHODS),
            *(f"{row['update_milliseconds'][method]:.0f} ms" for method in ("points", "clusters")),
            *(f"{100.0 * (row['errors'][method]['brightness'] - 1.0):+.1f} %" for method in ("points", "clusters")),
        ]
        for name, row in scenes.items()
    ]
    header = ["", *titles, "tracing points", "tracing clusters", "brightness of points", "of clusters"]
    return make_table(header, rows)


def make_figures(results: Mapping[str, Any], clusters: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/virtual_lights.md by place."""
    scenes = results["scenes"]
    speed = [
        [name, *(f"{row[key]} ms" for key in ("update", "shade", "shade_cpu"))]
        for name, row in results["speed"].items()
    ]
    return {
        "box": make_box_table(results["box"]["counts"]),
        "speed": make_table(["", "tracing the lights", "shading", "of all threads together"], speed),
        "limits": make_limit_table(scenes),
        "errors": make_error_table(scenes),
        "sweep": make_sweep_table(scenes),
        "clusters-plain": make_cluster_table(clusters["scenes"], "not filtered"),
        "clusters-one": make_cluster_table(clusters["scenes"], "one frame"),
        "clusters-eighth": make_cluster_table(clusters["scenes"], "eighth frame"),
        "clusters-times": make_cluster_time_table(clusters["scenes"]),
    }
