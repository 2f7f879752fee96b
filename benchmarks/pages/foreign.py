"""The text of docs/renderers_results.md, from what `benchmarks/foreign` has measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from benchmarks.pages.tables import make_table

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


def make_foreign_page(measured: Mapping[str, Any], speed: Mapping[str, Any]) -> str:
    """Return docs/renderers_results.md, from errors and from the times of whole commands."""
    machine = measured["machine"]
    sections = [make_section(name, measured["renderers"][name]) for name in RENDERERS if name in measured["renderers"]]
    return f"""# Results on frames of other renderers

Written by `benchmarks/publish.py` from `benchmarks/results/foreign.json`; no figure is typed by hand. {machine["processor"]}.

Scenes made in code (`benchmarks/foreign/render_*.py`): metals and plastics on a chequered floor; textures; glass; a room with a lamp, a window and a mirror; and shots as artists make them:
a product shot with lamps out of focus, lacquer, flakes and glass, an interior lit through a window, things that move or lie out of focus, small lamps between mirrors. Filters and
settings are the renderer's defaults, but Blender's adaptive sampling is off; nothing is denoised before. Each file is read as it comes. The error is `rel_mse` with the noise
of the reference taken out (`benchmarks/foreign/judging.py`): a reference is two renders of different seeds. Few pixels can be most of it, fireflies and lamps seen in mirrors;
so it also stands without the 0.1 % of an image's pixels that are furthest off.

"Color, albedo and normal alone" is a file of which the other passes are taken away. "Normal-aware" was tuned on each scene and sample count against its reference, all
others run with their defaults. Open Image Denoise gets what the renderer itself hands to it (Blender: `Denoising Albedo` and `Denoising Normal`), prefiltered, at its best
quality. "Of both renders" is `--half`: both seeds as halves of twice the samples, so these columns compare with each other alone.

{chr(10).join(sections)}
{make_speed(speed)}"""


def make_speed(speed: Mapping[str, Any]) -> str:
    """Return the times of the command on a large file, and of its steps."""
    file = speed["file"]
    size = "x".join(map(str, file["size"]))
    steps = ("command", "filter", "read", "write", "command over filter")
    rows = [[f"`{name}`", *(f"{times[step]:.2f}" for step in steps)] for name, times in speed["qualities"].items()]
    return f"""## The whole command

`lobewise denoise room.exr -o out.exr`, a process of its own, on the room at {size} with {file["channels"]} channels ({file["bytes"] / 1e6:.0f} MB, {file["compression"]}), kernels compiled before;
beside it the same filter, reading and writing alone, warm, in turn, seconds, medians of {speed["rounds"]} rounds (`benchmarks/foreign/speed.py`, {speed["machine"]["threads"]} threads). Direct and indirect
light of every layer are filtered each, so that they can be written back.

{make_table(["quality", "command", "filter alone", "reading", "writing", "command over filter"], rows)}
"""


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
