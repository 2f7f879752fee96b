"""The text of docs/quality_results.md, from what `quality/measure.py` has measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from benchmarks.quality.summary import CLASSES, PARTS, WIDE

TITLES = {
    "noisy": "noisy",
    "normal-aware": "normal-aware, tuned",
    "single SG": "single SG lobe",
    "fast": '`quality="fast"`',
    "balanced": '`quality="balanced"`',
    "high": '`quality="high"`',
    "high + oidn": "`high` with Open Image Denoise",
    "oidn": "Open Image Denoise",
    "oidn, guides as they come": "Open Image Denoise, guides as they come",
    "oidn balanced": "Open Image Denoise, `balanced`, guides as they come",
    "oidn fast": "Open Image Denoise, `fast`, guides as they come",
}
BASE_TITLES = {"single SG": "the single SG lobe", "oidn": "Open Image Denoise"}
TIME_BASES = ("single SG", "oidn", "oidn, guides as they come")
BY_CLASS = ("normal-aware", "single SG", "balanced", "high", "high + oidn")
"""Methods whose errors are shown by class of pixels."""
README = ("noisy", "normal-aware", "single SG", "balanced", "high", "high + oidn", "oidn")
README_SAMPLES = "4"
TIMED = ("single SG", "balanced", "high", "oidn, guides as they come", "oidn fast")
BY_SCENE = ("noisy", "normal-aware", "single SG", "balanced", "high", "oidn", "high + oidn")
SCREEN_SAMPLES = ("4", "16")
"""Sample counts at which the metrics of what a screen shows are given."""
WORDS = {True: "met", False: "missed", None: "not measured"}


def make_table(header: list[str], rows: list[list[str]]) -> str:
    """Return a Markdown table."""
    lines = [header, ["---"] + ["---:"] * (len(header) - 1), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def make_goal_table(goals: list[dict[str, Any]]) -> str:
    """Return every goal, what was measured, and whether it is met."""
    rows = []
    for goal in goals:
        cells = [
            " ".join(
                each for each in ("" if part == "time" else part, _show(value, 2), WORDS[goal["met"][part]]) if each
            )
            for part, value in goal["values"].items()
        ]
        rows.append([goal["goal"], f"{goal['limit']:g}", "; ".join(cells)])
    return make_table(["ratio", "at most", "measured"], rows)


def make_ratio_table(bases: dict[str, Any], base: str, samples: list[str]) -> str:
    """Return the ratios of every method to one base, over all pixels."""
    methods = bases.get(base, {})
    rows = [
        [TITLES[name], *(_show(kinds["all"].get(spp, {}).get("ratio"), 2) for spp in samples)]
        for name, kinds in methods.items()
        if "all" in kinds
    ]
    return make_table([f"over {BASE_TITLES[base]}", *(f"{spp} spp" for spp in samples)], rows)


def make_class_table(bases: dict[str, Any], samples: list[str]) -> str:
    """Return the ratios to Open Image Denoise by class of pixels."""
    rows = [
        [
            kind,
            TITLES[name],
            *(_show(bases["oidn"][name][kind].get(spp, {}).get("ratio"), 2) for spp in samples),
            str(max(cell["scenes"] for cell in bases["oidn"][name][kind].values())),
        ]
        for kind in CLASSES[1:]
        for name in BY_CLASS
        if kind in bases.get("oidn", {}).get(name, {})
    ]
    return make_table(["pixels", "over Open Image Denoise", *(f"{spp} spp" for spp in samples), "scenes"], rows)


def make_scene_table(data: dict[str, Any], scenes: tuple[str, ...], samples: list[str]) -> str:
    """Return rel_mse, the mean over the seeds, of every scene and sample count."""
    rows = []
    for scene, spp, methods in _list_rows(data, scenes, samples):
        cells = [np.mean(methods[name]["rel_mse"]["all"]) if name in methods else None for name in BY_SCENE]
        rows.append([scene, spp, *(_show(cell, 4) for cell in cells)])
    return make_table(["scene", "spp", *(TITLES[name] for name in BY_SCENE)], rows)


def make_screen_table(data: dict[str, Any], scenes: tuple[str, ...]) -> str:
    """Return FLIP and structural similarity of every scene, at some sample counts."""
    rows = []
    for scene, spp, methods in _list_rows(data, scenes, list(SCREEN_SAMPLES)):
        cells = []
        for name in BY_SCENE:
            row = methods.get(name, {})
            pair = [_show(np.mean(row[key]) if row.get(key) else None, 3) for key in ("flip", "ssim")]
            cells.append(", ".join(pair) if any(pair) else "")
        rows.append([scene, spp, *cells])
    return make_table(["scene", "spp", *(TITLES[name] for name in BY_SCENE)], rows)


def make_time_table(speed: dict[str, Any]) -> str:
    """Return the time of every method and its ratios, by size."""
    rows = []
    for pixels, row in speed.items():
        size = f"{pixels}, {row['spp']} spp"
        for name, milliseconds in row["milliseconds"].items():
            ratios = [_show(row.get(f"over {base}", {}).get(name), 2) for base in TIME_BASES]
            rows.append([size, TITLES[name], f"{milliseconds:.0f} ms", *ratios])
    return make_table(["size", "method", "time", *(f"over {TITLES[base]}" for base in TIME_BASES)], rows)


def make_tuning_table(tuning: dict[str, Any]) -> str:
    """Return the parameters of the normal-aware baseline."""
    rows = [
        [spp, f"{row['settings']['normal_exponent']:g}", f"{row['settings']['screen_sigma']:g}", row["commit"]]
        for spp, row in tuning.items()
    ]
    return make_table(["spp", "normal exponent", "screen sigma", "commit"], rows)


def make_class_shares(data: dict[str, Any]) -> str:
    """Return which share of each scene's pixels is of which class, and the error of the references."""
    rows = [
        [
            scene,
            *(f"{100.0 * row['classes'][kind]:.1f} %" if kind in row["classes"] else "" for kind in CLASSES[1:]),
            f"{row['reference_rel_mse']:.1e}",
        ]
        for scene, row in data["scenes"].items()
    ]
    return make_table(["scene", *CLASSES[1:], "rel_mse of the reference"], rows)


def list_commits(data: dict[str, Any]) -> str:
    """Return the commits that figures of each method come from."""
    found: dict[str, list[str]] = {}
    for row in data["scenes"].values():
        for methods in row["samples"].values():
            for name, cells in methods.items():
                commits = found.setdefault(name, [])
                if cells["commit"] not in commits:
                    commits.append(cells["commit"])
    return make_table(
        ["method", "commit"], [[TITLES[name], ", ".join(found[name])] for name in TITLES if name in found]
    )


def make_pictures_section(pictures: dict[str, Any]) -> str:
    """Return the section of the pictures with what they show, nothing where there are none."""
    parts = ["## Pictures"] if pictures else []
    for scene, row in pictures.items():
        kinds = " and ".join(row["crops"])
        panels = ", ".join(row["panels"])
        parts.append(
            f"### {scene}\n\n![{scene}: {panels}](images/quality-{scene}.png)\n\n"
            f"{row['spp']} samples per pixel; from left to right: {panels}. The crops are those that show most of: {kinds}."
        )
    return "\n\n".join([*parts, ""]) if parts else ""


def _list_rows(data: dict[str, Any], scenes: tuple[str, ...], samples: list[str]) -> list[tuple[str, str, Any]]:
    return [
        (scene, spp, data["scenes"][scene]["samples"][spp])
        for scene in scenes
        for spp in samples
        if spp in data["scenes"].get(scene, {}).get("samples", {})
    ]


def _show(value: Any, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def make_readme_quality(data: dict[str, Any]) -> str:
    """Return what the README says of errors and times: every scene at one sample count, then the means of the others."""
    scenes = [scene for part in PARTS.values() for scene in part]
    rows = [
        [scene, *(_show(np.mean(methods[name]["rel_mse"]["all"]), 4) for name in README)]
        for scene, _, methods in _list_rows(data, tuple(scenes), [README_SAMPLES])
    ]
    errors = make_table(["scene", *(TITLES[name] for name in README)], rows)
    bases = data["summary"]["ratios"]["held out"]["oidn"]
    samples = [str(spp) for spp in data["samples"]]
    ratios = make_table(
        ["held out, over Open Image Denoise", *(f"{spp} spp" for spp in samples)],
        [[TITLES[name], *(_show(bases[name]["all"][spp]["ratio"], 2) for spp in samples)] for name in README[1:-1]],
    )
    times = data["speed"][WIDE]["milliseconds"]
    cells = [f"{TITLES[name]} {times[name] / 1000.0:.2f} s" for name in TIMED]
    train, held_out = (", ".join(f"`{scene}`" for scene in PARTS[part]) for part in PARTS)
    return f"""On built-in scenes, measured at commit {data["machine"]["commit"]} (the [changelog](CHANGELOG.md) tells what came since): error (`rel_mse`, epsilon 0.01, lower is better) at {README_SAMPLES} samples per pixel, {data["size"]}x{data["size"]}, mean of {len(data["seeds"])} noise seeds. Parameters, ours and
the baseline's, were chosen on {train}; {held_out} were only measured:

{errors}

{ratios}

Time at {WIDE} on {data["machine"]["processor"]}, {data["machine"]["threads"]} threads: {"; ".join(cells)}. Goals, met and missed, classes
of pixels, FLIP and pictures: [docs/quality_results.md](docs/quality_results.md)."""


def make_part(data: dict[str, Any], part: str, samples: list[str]) -> str:
    """Return the section of the scenes that were tuned on, or of those that were not."""
    bases = data["summary"]["ratios"].get(part, {})
    return f"""{make_ratio_table(bases, "single SG", samples)}

{make_ratio_table(bases, "oidn", samples)}

By what pixels show:

{make_class_table(bases, samples)}

`rel_mse`, mean over the seeds:

{make_scene_table(data, PARTS[part], samples)}

What a screen shows: FLIP (less is better, first seed) and structural similarity (more is better):

{make_screen_table(data, PARTS[part])}"""


def make_quality_page(data: dict[str, Any]) -> str:
    """Return docs/quality_results.md."""
    samples = [str(spp) for spp in data["samples"]]
    machine = data["machine"]
    skipped = "\n".join(f"- {TITLES[name]}: {reason}" for name, reason in data["skipped"].items())
    pictures = make_pictures_section(data["pictures"])
    train, held_out = (", ".join(f"`{scene}`" for scene in PARTS[part]) for part in PARTS)
    return f"""# Quality

Written by `benchmarks/publish.py` from `benchmarks/results/quality.json`, which `benchmarks/quality/measure.py` makes; do not edit.

{len(data["train"]) + len(data["held_out"])} built-in scenes, {data["size"]}x{data["size"]} pixels, {", ".join(samples)} samples per pixel, {len(data["seeds"])} noise seeds each, references of {data["reference_spp"]} samples per
pixel with other seeds. Parameters, ours and those of the baseline, were chosen on {train}; {held_out} were only measured. `rel_mse` is the mean of
(a - r)^2 / (r^2 + 0.01). Ratios are geometric means over scenes and seeds, below 1 is better. {machine["processor"]}, {machine["threads"]} threads.

The normal-aware baseline has the exponent and screen sigma with the least error on the scenes tuned on, by sample count. Open Image Denoise has the
best guides we know to give it: albedo and normal averaged over the samples, each through its own filter for guides first, which takes two networks more;
the rows with guides as they come take one. Goals of time compare with those. `high` with Open Image Denoise is `denoise(..., quality="high", with_oidn=True)`.

## Goals

{make_goal_table(data["summary"]["goals"])}

## Held out

{make_part(data, "held out", samples)}

## Tuned on

{make_part(data, "train", samples)}

## Time

Best of {data["timed_runs"]} after a warm-up, all methods in turn in one process:

{make_time_table(data["speed"])}

{pictures}## How

Pixels are told apart by the G-buffer of the {samples[-1]}-sample frame. Silhouettes differ from a neighbour in surface, orientation or material, or were
seen in part. The others go by the lobe that carries their radiance: diffuse, rough (alpha above 0.25), glossy (above 0.06), near-mirror. Coated pixels go
by their specular lobe where it carries more than 30 % of the radiance. Anisotropic are those of the specular pixels whose alphas differ by more than a third.

{make_class_shares(data)}

The baseline's parameters:

{make_tuning_table(data["tuning"])}

Figures come from:

{list_commits(data)}
{chr(10) + "Not measured:" + chr(10) * 2 + skipped + chr(10) if skipped else ""}"""
