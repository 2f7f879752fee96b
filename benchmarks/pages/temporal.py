"""The figures of docs/temporal.md, measured by `benchmarks/interactive/reflections.py`."""

from __future__ import annotations

from typing import Any

from benchmarks.pages.tables import describe_run, list_facts, make_table

MOTIONS = {"ball": "the ball moves", "mirror": "the mirror turns"}
WAYS = ("guided", "unguided", "fresh", "single")


def make_reflection_table(reflections: dict[str, Any]) -> str:
    """Return the errors of the reflection of each mirror and motion."""
    rows = []
    for name, motions in reflections["cases"].items():
        for motion, found in motions.items():
            errors = [f"{found['error'][way]['reflection']:.3f}" for way in WAYS]
            whole = f"{found['guided_over_unguided']['mirror']:.2f}"
            title = f"{name} (alpha {reflections['alpha'][name]:g}), {MOTIONS[motion]}"
            rows.append([title, *errors, f"{found['guided_over_fresh']['reflection']:.2f}", whole])
    header = [
        "mirror",
        "with the guide",
        "without",
        "fresh start",
        "no history",
        "with, over fresh start",
        "whole mirror: with, over without",
    ]
    return make_table(header, rows)


def make_figures(reflections: dict[str, Any]) -> dict[str, str]:
    """Return the marked places of docs/temporal.md."""
    return {
        "reflections": make_reflection_table(reflections),
        "reflections-run": list_facts(
            {
                "Frames": f"{reflections['frames']} of {reflections['size']}x{reflections['size']} pixels",
                "Samples of a pixel of the references": reflections["reference_spp"],
                "Sessions of each row": reflections["seeds"],
                "Machine": describe_run(reflections),
            }
        ),
    }
