"""The figures on the rays of samples, measured by `upsampling/rays.py`."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import describe_run, list_facts, make_table

KINDS = ("one frame", "over time")
TITLES = {
    "no rays": "no rays",
    "weights": "weights of rays",
    "lobes": "own lobes",
    "lobes widened by 0.1": "own lobes, widened by 0.1",
    "widened by 0.1, hits followed": "the same, hits followed",
    "lobes widened by 0.3": "own lobes, widened by 0.3",
}
"""Titles of the trials."""


def make_scene_table(scenes: dict[str, Any], means: dict[str, Any], trials: tuple[str, ...]) -> str:
    """Return the errors of trials in every scene, and the means of the errors over those without rays."""
    header = ["scene", *(f"{TITLES[trial]}, {kind}" for kind in KINDS for trial in trials)]
    rows = [
        [name, *(f"{cells[trial]['auto'][kind]:.4f}" for kind in KINDS for trial in trials)]
        for name, cells in scenes.items()
    ]
    mean = ["mean ratio", *(f"{means[trial]['auto'][kind]:.2f}" for kind in KINDS for trial in trials)]
    return make_table(header, [*rows, mean])


def make_upsampling_figures(rays: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/upsampling.md on rays."""
    pair = ("no rays", "weights")
    lights = {"rays-indirect": "indirect", "rays-sky": "sky"}
    tables = {
        place: make_scene_table(rays["lights"][light], rays["mean ratios"][light], pair)
        for place, light in lights.items()
    }
    return {**tables, "rays-run": list_facts({"Machine": describe_run(rays)})}


def make_trial_figures(rays: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/research/rays.md."""
    places = {}
    for light, means in rays["mean ratios"].items():
        columns = [(beta, kind) for kind in KINDS for beta in next(iter(means.values()))]
        header = ["trial", *(f"{kind}, beta {beta}" for beta, kind in columns)]
        rows = [
            [title, *(f"{means[trial][beta][kind]:.2f}" for beta, kind in columns)] for trial, title in TITLES.items()
        ]
        places[f"means-{light}"] = make_table(header, rows)
        scenes = rays["lights"][light]
        cells = [
            [title, *(f"{cells[trial]['auto']['over time']:.4f}" for cells in scenes.values())]
            for trial, title in TITLES.items()
        ]
        places[f"scenes-{light}"] = make_table(["over time, beta auto", *scenes], cells)
    return {**places, "run": list_facts({"Machine": describe_run(rays)})}
