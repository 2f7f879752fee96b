"""The figures of docs/developers/users_results.md, measured by `benchmarks/users`."""

import statistics
from collections.abc import Iterable, Mapping
from typing import Any

from benchmarks.interiors.scenes import INTERIORS
from benchmarks.pages.tables import describe_run, list_facts, make_table
from benchmarks.users.summary import (
    HELD_OUT,
    MIXED,
    MOST_DOUBT,
    MOST_ENERGY,
    MOST_OVER_NOISY,
    MOST_OVER_PEER,
    NOISY,
    PEER,
    PROMISED,
    TRAIN,
    UNKNOWN,
    list_rows,
)

TITLES = {
    "noisy": "noisy",
    "normal-aware": "normal-aware, tuned",
    "fast": "`fast`",
    "balanced": "`balanced`",
    "high": "`high`",
    "auto": "`auto`",
    "best": "`best`",
    "oidn, color alone": "OIDN, color alone",
    "oidn, as called": "OIDN, as called",
    "oidn": "OIDN, at its best",
}
SETS = {
    "all": "All guides",
    "passes": "Passes: light by lobe, albedos, normal, roughness, depth",
    "plain": "Plain: one albedo, normal, depth",
    "color": "Color alone",
}
GROUPS = {
    "interiors": "Public interiors",
    "factory": "Random shots of Blender 4.5, Cycles",
    "blender": "Blender 4.5, Cycles",
    "blender-5.2": "Blender 5.2, Cycles",
    "luxcore": "LuxCoreRender",
    "mitsuba": "Mitsuba's own integrator",
    "own": "Built-in scenes",
}
SHOTS_TRIMMED = "without the worst"
SHOT_ROWS = (
    ("all", "noisy"),
    ("all", PEER),
    ("all", "oidn, as called"),
    ("all", "oidn, color alone"),
    ("all", "balanced"),
    ("all", "high"),
    ("all", "auto"),
    ("all", "best"),
    ("plain", "high"),
    ("plain", "auto"),
    ("color", "high"),
)
"""Guides and method of each row of the table of random Blender shots."""
MAX_LISTED = 60
"""Number of broken promises that are listed one by one. The others are counted."""


def make_figures(data: Mapping[str, Any], shots: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/users_results.md by place."""
    summary = data["summary"]
    held_out, train = (summary["ratios"].get(part, {}) for part in (HELD_OUT, TRAIN))
    return {
        "blender-shots": make_shots(shots),
        "blender-kinds": make_kinds(shots),
        "run": list_facts({"Machine": describe_run(data)}),
        "held-out-over-noisy": make_ratios(held_out, NOISY),
        "held-out-over-oidn": make_ratios(held_out, PEER),
        "promises": "\n\n".join(make_promises(summary)),
        "groups": "\n\n".join(make_groups(summary["ratios"])),
        "tuned-on-over-noisy": make_ratios(train, NOISY),
        "tuned-on-over-oidn": make_ratios(train, PEER),
        **make_method(data),
    }


def make_shots(shots: Mapping[str, Any]) -> str:
    """Return the errors on random Blender shots over those of OIDN at its best, without the worst pixels."""
    rows = {(row.scene, row.guides, row.spp): row.methods for row in list_rows(shots["scenes"])}
    counts = sorted({spp for _, _, spp in rows})
    table = []
    for guides, method in SHOT_ROWS:
        cells = {key: methods[method] for key, methods in rows.items() if key[1] == guides and method in methods}
        if not cells:
            continue
        peers = {key: rows[key[0], "all", key[2]][PEER] for key in cells}
        ratios = {key: cell[SHOTS_TRIMMED] / peers[key][SHOTS_TRIMMED] for key, cell in cells.items()}
        worse = [key for key, cell in cells.items() if cell["rel_mse"] > rows[key]["noisy"]["rel_mse"]]
        by_count = [[ratio for key, ratio in ratios.items() if key[2] == spp] for spp in counts]
        alone = [sum(cell[name] for cell in cells.values()) for name in ("bright", "dark")]
        light = [cell["energy"] for cell in cells.values()]
        table.append(
            [
                guides,
                TITLES[method],
                *(f"{_average(each):.2f}" if each else "" for each in (*by_count, list(ratios.values()))),
                f"{max(ratios.values()):.2f}",
                str(len(worse)),
                *map(str, alone),
                f"{min(light):.3f} to {max(light):.3f}",
            ]
        )
    header = ["guides", "method", *(f"{spp} spp" for spp in counts), "all", "largest", "worse than input"]
    header += ["bright dots", "dark dots", "brightness"]
    frames = len({key for key in rows if key[1] == "all"})
    return make_table(header, table) + f"\n\n{frames} frames; {describe_run(shots)}."


def make_kinds(shots: Mapping[str, Any]) -> str:
    """Return the means of `make_shots` for every kind of shot, with all guides."""
    rows = {(row.scene, row.guides, row.spp): row.methods for row in list_rows(shots["scenes"])}
    kinds = sorted({_get_kind(scene) for scene, _, _ in rows})
    measured = {method for methods in rows.values() for method in methods}
    methods = [method for guides, method in SHOT_ROWS if guides == "all" and method in measured - {PEER}]
    table = []
    for method in methods:
        means = [
            _average(
                methods[method][SHOTS_TRIMMED] / methods[PEER][SHOTS_TRIMMED]
                for key, methods in rows.items()
                if key[1] == "all" and _get_kind(key[0]) == kind
            )
            for kind in kinds
        ]
        table.append([TITLES[method], *(f"{mean:.2f}" for mean in means)])
    return make_table(["method", *kinds], table)


def _get_kind(scene: str) -> str:
    return scene.partition("/")[2].rpartition("_")[0]


def _average(ratios: Iterable[float]) -> float:
    """Return a geometric mean."""
    return statistics.geometric_mean(list(ratios))


def make_ratios(bases: Mapping[str, Any], base: str) -> str:
    """Return the geometric means of the errors over those of one method."""
    found = bases.get(base, {})
    counts = list_counts(spp for methods in found.values() for cells in methods.values() for spp in cells)
    rows = []
    for guides in SETS:
        for method in TITLES:
            cells = found.get(guides, {}).get(method, {})
            if cells:
                shown = (cells.get(spp) for spp in counts)
                rows.append([guides, TITLES[method], *("" if one is None else f"{one['ratio']:.2f}" for one in shown)])
        scenes = [_count_frames(found.get(guides, {}), spp) for spp in counts]
        if guides in found:
            rows.append([guides, "frames", *(str(count) if count else "" for count in scenes)])
    return make_table(["guides", "method", *(f"{spp} spp" for spp in counts)], rows) if rows else ""


def make_promises(summary: Mapping[str, Any]) -> list[str]:
    """Return in how many cells each promise is broken, and the worst of them."""
    energy = summary["energy"]
    over = {f"Error at most {MOST_OVER_NOISY} times that of the noisy image": summary["over noisy"]}
    if MIXED in energy:
        over[f"Error of `{MIXED}` at most {MOST_OVER_PEER} times that of OIDN at its best"] = summary["over oidn"]
    parts = []
    for promise, broken in over.items():
        counted = [
            [TITLES[method], guides, str(len(found)), f"{max(one['ratio'] for one in found):.2f}"]
            for method in TITLES
            for guides in SETS
            if (found := [one for one in broken if one["method"] == method and one["guides"] == guides])
        ]
        promised = [one for one in broken if one["method"] in PROMISED]
        parts.append(f"{promise}: broken in {len(promised)} cells. `fast` promises nothing and is not counted.")
        if counted:
            parts += [make_table(["method", "guides", "cells", "worst ratio"], counted), make_broken(promised)]
    kept = [
        [
            TITLES[method],
            str(one["cells"]),
            str(one["off"]),
            *(f"{one[end][0]:.3f} ({one[end][1]})" for end in ("least", "most")),
        ]
        for method in TITLES
        if method != NOISY and (one := energy.get(method))
    ]
    title = "Brightness of the result over that of the noisy image. Off means a difference of more than "
    title += f"{100 * MOST_ENERGY:g} %."
    header = ["method", "cells", "off", "least", "most"]
    return [*parts, title, make_table(header, kept)] if kept else parts


def make_broken(broken: list[Mapping[str, Any]]) -> str:
    """Return the worst cells in which a promise is broken."""
    rows = [
        [
            one["scene"] + ("" if one["held_out"] else ", tuned on"),
            one["guides"],
            str(one["spp"]),
            TITLES[one["method"]],
            f"{one['ratio']:.2f}" + ("" if one["sure"] else " (not sure)"),
        ]
        for one in broken[:MAX_LISTED]
    ]
    more = len(broken) - len(rows)
    table = make_table(["scene", "guides", "spp", "method", "ratio"], rows)
    return table + (f"\n\nAnd {more} more, in the JSON file." if more else "")


def make_groups(ratios: Mapping[str, Any]) -> list[str]:
    """Return the means by kind of frame, those over Open Image Denoise."""
    parts = []
    for group, title in GROUPS.items():
        table = make_ratios(ratios.get(group, {}), PEER)
        parts += [f"### {title}", table] if table else []
    return parts


def make_method(data: Mapping[str, Any]) -> dict[str, str]:
    """Return the limits that judge the figures, the scenes and where they come from, and the baseline's settings."""
    limits = {
        "Pixels at which the references differ most, which count for no method": f"{100 * UNKNOWN:g} %",
        "Largest standard error, from the references' noise, of an error that counts in a mean": (
            f"{100 * MOST_DOUBT:g} % of the error"
        ),
    }
    origins = [[f"interiors/{name}", one.source.url, one.origin] for name, one in INTERIORS.items()]
    sizes = [
        [name, "x".join(map(str, scene["size"])), f"{scene['reference_error']:.1e}"]
        for name, scene in data["scenes"].items()
        if "size" in scene
    ]
    tuned = [[spp, f"{one['normal_exponent']:g}", f"{one['screen_sigma']:g}"] for spp, one in data["tuning"].items()]
    return {
        "limits": list_facts(limits),
        "scenes": make_table(["scene", "size", "error of both references together"], sizes),
        "origins": make_table(["scene", "repository", "origin"], origins),
        "tuning": make_table(["spp", "normal exponent", "screen sigma"], tuned),
    }


def list_counts(counts: Iterable[str]) -> list[str]:
    """Return sample counts in their order, each once."""
    return sorted(set(counts), key=int)


def _count_frames(methods: Mapping[str, Any], spp: str) -> int:
    return max((cells[spp]["scenes"] for cells in methods.values() if spp in cells), default=0)
