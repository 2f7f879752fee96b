"""The figures of docs/renderers_results.md, measured by `benchmarks/foreign`."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from benchmarks.pages.tables import list_facts, make_table

RENDERERS = {
    "blender": "Blender 4.5, Cycles, all passes in one part",
    "blender-5.2": "Blender 5.2, Cycles, a part for each pass",
    "luxcore": "LuxCoreRender 2.11, a file for each output, no roughness",
}
ALONE = "balanced, color, albedo and normal alone"
METHODS = {
    "noisy": "noisy",
    "normal-aware": "normal-aware, tuned",
    ALONE: "`balanced`, color, albedo and normal alone",
    "fast": "`fast`",
    "balanced": "`balanced`",
    "high": "`high`",
    "oidn": "Open Image Denoise",
    "balanced, both renders": "`balanced` of both renders",
    "high, both renders": "`high` of both renders",
}
KINDS = {"rel_mse": "", "without the worst": ", the worst 0.1 % of pixels left out"}


def make_figures(measured: Mapping[str, Any], speed: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/renderers_results.md by place: errors, and times of whole commands."""
    found = measured["renderers"]
    sections = [make_section(name, found[name]) for name in RENDERERS if name in found]
    return {
        "renderers": "\n".join(sections),
        "machine": list_facts({"Machine": measured["machine"]["processor"]}),
    } | make_speed(speed)


def make_speed(speed: Mapping[str, Any]) -> dict[str, str]:
    """Return the times of the command on a large file, and of its steps."""
    file = speed["file"]
    steps = ("command", "filter", "read", "write", "command over filter")
    rows = [[f"`{name}`", *(f"{times[step]:.2f}" for step in steps)] for name, times in speed["qualities"].items()]
    run = {
        "File": (
            f"the room at {'x'.join(map(str, file['size']))}, {file['channels']} channels, "
            f"{file['bytes'] / 1e6:.0f} MB, {file['compression']}"
        ),
        "Rounds": f"{speed['rounds']}, of which the median is shown",
        "Threads": speed["machine"]["threads"],
    }
    header = ["quality", "command", "filter alone", "reading", "writing", "command over filter"]
    return {"speed-run": list_facts(run), "speed": make_table(header, rows)}


def make_section(name: str, measured: Mapping[str, Any]) -> str:
    """Return what was measured with one renderer."""
    text = [f"## {RENDERERS[name]}", ""]
    text += [make_references(measured["scenes"]), ""]
    for kind, title in KINDS.items():
        text += [f"Error{title}, mean of the seeds:", "", make_errors(measured["scenes"], kind), ""]
    text += ["Ratios, geometric means over the scenes:", "", make_ratios(measured["summary"]), ""]
    return "\n".join(text)


def make_references(scenes: Mapping[str, Any]) -> str:
    """Return how good the references are."""
    sizes = " and ".join(dict.fromkeys("x".join(map(str, scene["size"])) for scene in scenes.values()))
    errors = ", ".join(f"{name} {_show(scene['reference_error'])}" for name, scene in scenes.items())
    return f"{sizes} pixels. Error of the references themselves: {errors}."


def make_errors(scenes: Mapping[str, Any], kind: str) -> str:
    """Return a row for each scene and sample count."""
    rows = [
        [name, spp, *(_show(_average(row[method][kind])) for method in METHODS)]
        for name, scene in scenes.items()
        for spp, row in scene["samples"].items()
    ]
    return make_table(["scene", "spp", *METHODS.values()], rows)


def make_ratios(summary: Mapping[str, Any]) -> str:
    """Return a row for each pair of methods."""
    rows = []
    for kind, title in KINDS.items():
        for pair, found in summary[kind].items():
            above, _, below = pair.partition(" / ")
            counts = [key for key in found if key != "all"]
            rows.append([f"`{above}` over {METHODS[below]}{title}", *(f"{found[key]:.2f}" for key in (*counts, "all"))])
    counts = [key for key in next(iter(summary["rel_mse"].values())) if key != "all"]
    return make_table(["error of", *(f"{key} spp" for key in counts), "all"], rows)


def _average(values: Iterable[float]) -> float:
    found = list(values)
    return sum(found) / len(found)


def _show(value: float) -> str:
    return f"{value:.2g}" if abs(value) < 1e-3 else f"{value:.4f}"
