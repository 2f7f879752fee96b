"""The figures of docs/developers/quality_results.md, measured by `quality/measure.py`."""

from typing import Any

import numpy as np

from benchmarks.pages.tables import list_facts, make_table
from benchmarks.quality.summary import CLASSES, PARTS

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
BY_SCENE = ("noisy", "normal-aware", "single SG", "balanced", "high", "oidn", "high + oidn")
SCREEN_SAMPLES = ("4", "16")
"""Sample counts at which the metrics of what a screen shows are given."""
WORDS = {True: "met", False: "missed", None: "not measured"}


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


def make_commit_table(data: dict[str, Any]) -> str:
    """Return the commits that figures of each method come from, or why a method was not measured."""
    found: dict[str, dict[str, None]] = {}
    for row in data["scenes"].values():
        for methods in row["samples"].values():
            for name, cells in methods.items():
                found.setdefault(name, {})[cells["commit"]] = None
    rows = [[TITLES[name], ", ".join(found[name])] for name in TITLES if name in found]
    rows += [[TITLES[name], f"not measured: {reason}"] for name, reason in data["skipped"].items()]
    return make_table(["method", "commit"], rows)


def _list_rows(data: dict[str, Any], scenes: tuple[str, ...], samples: list[str]) -> list[tuple[str, str, Any]]:
    return [
        (scene, spp, data["scenes"][scene]["samples"][spp])
        for scene in scenes
        for spp in samples
        if spp in data["scenes"].get(scene, {}).get("samples", {})
    ]


def _show(value: Any, digits: int) -> str:
    return "" if value is None else f"{value:.{digits}f}"


def make_part(data: dict[str, Any], part: str, samples: list[str]) -> dict[str, str]:
    """Return the figures of the scenes that were tuned on, or of those that were not."""
    bases, place = data["summary"]["ratios"].get(part, {}), part.replace(" ", "-")
    return {
        f"{place}-over-sg": make_ratio_table(bases, "single SG", samples),
        f"{place}-over-oidn": make_ratio_table(bases, "oidn", samples),
        f"{place}-classes": make_class_table(bases, samples),
        f"{place}-errors": make_scene_table(data, PARTS[part], samples),
        f"{place}-screen": make_screen_table(data, PARTS[part]),
    }


def make_figures(data: dict[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/quality_results.md by place."""
    samples = [str(spp) for spp in data["samples"]]
    machine = data["machine"]
    train, held_out = (", ".join(f"`{scene}`" for scene in PARTS[part]) for part in PARTS)
    run = {
        "Scenes that parameters were chosen on": train,
        "Held-out scenes, which were only measured": held_out,
        "Size": f"{data['size']}x{data['size']}",
        "Samples per pixel": ", ".join(samples),
        "Noise seeds": len(data["seeds"]),
        "Samples per pixel of the references, which have other seeds": data["reference_spp"],
        "Times": f"best of {data['timed_runs']} after a warm-up, all methods in turn in one process",
        "Machine": f"{machine['processor']}, {machine['threads']} threads",
    }
    parts = [make_part(data, part, samples) for part in PARTS]
    return {
        "run": list_facts(run),
        "goals": make_goal_table(data["summary"]["goals"]),
        **parts[0],
        **parts[1],
        "time": make_time_table(data["speed"]),
        "classes": make_class_shares(data),
        "tuning": make_tuning_table(data["tuning"]),
        "commits": make_commit_table(data),
    }
