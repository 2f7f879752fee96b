"""What the measurements of `measure.py` amount to: mean ratios between methods, and which goals they reach."""

import math
from typing import Any

TRAIN = ("showroom", "parlour", "stilllife", "corridor")
"""Scenes on which parameters may be tuned, ours and those of the baselines."""
HELD_OUT = ("brushed", "sparks", "kitchen", "street")
"""Scenes that are looked at for measuring only."""
PARTS = {"train": TRAIN, "held out": HELD_OUT}
BASES = ("single SG", "oidn")
"""What the others are compared with."""
CLASSES = ("all", "silhouette", "diffuse", "rough", "glossy", "near-mirror", "anisotropic")
WIDE = "1920x1080"

ERROR_GOALS: tuple[tuple[str, str, str, dict[str, float]], ...] = (
    ("balanced", "single SG", "all", {"4": 0.65, "16": 0.65}),
    ("high", "single SG", "all", {"4": 0.5, "16": 0.5}),
    ("high", "oidn", "all", {"4": 1.6, "16": 1.4, "64": 1.2}),
    ("high", "oidn", "near-mirror", {"16": 1.0, "64": 1.0}),
    ("high", "oidn", "anisotropic", {"16": 1.0, "64": 1.0}),
    ("high + oidn", "oidn", "all", {"16": 0.95, "64": 0.95}),
)
"""Method, what it is compared with, class of pixels, and by sample count the largest ratio that is a success."""

TIME_GOALS: tuple[tuple[str, str, float], ...] = (
    ("balanced", "single SG", 2.5),
    ("high", "oidn, guides as they come", 3.0),
    ("balanced", "oidn fast", 1.0),
)
"""Method, what it is compared with, largest ratio of times. The peer is taken with one network, its fastest way."""


def summarise(data: dict[str, Any]) -> dict[str, Any]:
    """Return the ratios of every method by part, base, class and sample count, and the goals."""
    ratios: dict[str, Any] = {}
    methods = dict.fromkeys(
        name for scene in data["scenes"].values() for rows in scene["samples"].values() for name in rows
    )
    for part, scenes in PARTS.items():
        for base in BASES:
            for method in methods:
                for kind in CLASSES:
                    by_spp = compute_ratios(data, scenes, method, base, kind)
                    if method != base and by_spp:
                        ratios.setdefault(part, {}).setdefault(base, {}).setdefault(method, {})[kind] = by_spp
    return {"ratios": ratios, "goals": check_goals(ratios, data.get("speed", {}))}


def compute_ratios(
    data: dict[str, Any], scenes: tuple[str, ...], method: str, base: str, kind: str
) -> dict[str, dict[str, Any]]:
    """Return by sample count the geometric mean of the error's ratio over scenes and seeds, and how many scenes.

    A scene counts where both methods were measured on it and it shows the class.
    """
    found: dict[str, dict[str, Any]] = {}
    for spp in data["samples"]:
        logs, used = [], 0
        for scene in scenes:
            rows = data["scenes"].get(scene, {}).get("samples", {}).get(str(spp), {})
            pair = [rows.get(name, {}).get("rel_mse", {}).get(kind) for name in (method, base)]
            if pair[0] and pair[1]:
                logs += [math.log(a / b) for a, b in zip(*pair, strict=True)]
                used += 1
        if logs:
            found[str(spp)] = {"ratio": round(math.exp(sum(logs) / len(logs)), 4), "scenes": used}
    return found


def check_goals(ratios: dict[str, Any], speed: dict[str, Any]) -> list[dict[str, Any]]:
    """Return every goal with what was measured and whether it is met; None where nothing was measured."""
    goals: list[dict[str, Any]] = []
    for method, base, kind, limits in ERROR_GOALS:
        for spp, limit in limits.items():
            values = {
                part: ratios.get(part, {}).get(base, {}).get(method, {}).get(kind, {}).get(spp, {}).get("ratio")
                for part in PARTS
            }
            goals.append(_judge(f"error of {method} over {base}, {kind} pixels, {spp} spp", limit, values))
    times = speed.get(WIDE, {}).get("milliseconds", {})
    for method, base, limit in TIME_GOALS:
        value = round(times[method] / times[base], 3) if method in times and base in times else None
        goals.append(_judge(f"time of {method} over {base}, {WIDE}", limit, {"time": value}))
    return goals


def _judge(goal: str, limit: float, values: dict[str, float | None]) -> dict[str, Any]:
    met = {part: None if value is None else value <= limit for part, value in values.items()}
    return {"goal": goal, "limit": limit, "values": values, "met": met}


def make_lines(summary: dict[str, Any]) -> list[str]:
    """Return the summary as lines of plain text."""
    lines = []
    for part, bases in summary["ratios"].items():
        for base, methods in bases.items():
            lines += ["", f"{part}: error over {base}, geometric mean"]
            for kind in CLASSES:
                for method, kinds in methods.items():
                    cells = "  ".join(f"{spp} spp {cell['ratio']:6.3f}" for spp, cell in kinds.get(kind, {}).items())
                    if cells:
                        lines.append(f"  {kind:12} {method:26} {cells}")
    lines += ["", "goals"]
    words = {True: "met", False: "missed", None: "not measured"}
    for goal in summary["goals"]:
        cells = ", ".join(
            f"{part} {'-' if value is None else format(value, '.3f')} {words[goal['met'][part]]}"
            for part, value in goal["values"].items()
        )
        lines.append(f"  {goal['goal']} <= {goal['limit']}: {cells}")
    return lines[1:]
