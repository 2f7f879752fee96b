"""The text of docs/users_results.md, from what `benchmarks/users` has measured."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from benchmarks.interiors.scenes import INTERIORS
from benchmarks.pages.tables import describe_run, make_table
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
    Row,
    is_known,
    list_rows,
)

TITLES = {
    "noisy": "noisy",
    "normal-aware": "normal-aware, tuned",
    "fast": "`fast`",
    "balanced": "`balanced`",
    "high": "`high`",
    "auto": "`auto`",
    "oidn, as called": "OIDN, as called",
    "oidn": "OIDN, at its best",
}
SETS = {
    "all": "All guides",
    "passes": "Passes: light by lobe, albedos, normal, roughness, depth",
    "plain": "Plain: one albedo, normal, depth",
    "color": "Color alone",
}
README_SETS = {"all": "all that the file has", "plain": "albedo, normal, depth"}
GROUPS = {
    "interiors": "Public interiors",
    "blender": "Blender 4.5, Cycles",
    "blender-5.2": "Blender 5.2, Cycles",
    "luxcore": "LuxCoreRender",
    "mitsuba": "Mitsuba's own integrator",
    "own": "Built-in scenes",
}
FIGURES = {"rel_mse": "Error", "flip": "FLIP"}
MOST_LISTED = 60
"""Broken promises that are listed one by one; the others are counted."""


def make_users_page(data: Mapping[str, Any]) -> str:
    """Return docs/users_results.md."""
    rows, summary = list(list_rows(data["scenes"])), data["summary"]
    parts = [
        make_head(data),
        "## Held-out scenes, geometric means",
        *(make_ratios(summary["ratios"].get(HELD_OUT, {}), base) for base in (NOISY, PEER)),
        "## Promises",
        *make_promises(summary),
        "## By kind of frame, held out",
        *make_groups(summary["ratios"]),
        "## Every held-out frame",
        *make_details([row for row in rows if row.held_out]),
        "## Scenes that parameters were chosen on",
        *(make_ratios(summary["ratios"].get(TRAIN, {}), base) for base in (NOISY, PEER)),
        *make_details([row for row in rows if not row.held_out]),
        "## How",
        make_method(data),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def make_head(data: Mapping[str, Any]) -> str:
    """Return what the page is of."""
    return f"""# Results on the frames that users have

Written by `benchmarks/publish.py` from `benchmarks/results/users.json`, which `python -m benchmarks.users` makes; no figure is typed by hand. {describe_run(dict(data))}.

The same frames with all that is known of them and with less, at many sample counts, beside the noisy input and Open Image Denoise (OIDN) with the same guides. No network was
trained on the scenes that are called held out; how lost light is shared out, and how far the mixing network is trusted without halves ([quality.md](quality.md)), were chosen with some of them in view. Scenes that were last measured with filters of an earlier version are left out.
Errors are `rel_mse` (epsilon 0.01) without the noise of the references; less is better."""


def make_readme_users(data: Mapping[str, Any]) -> str:
    """Return what the README says of users' frames: the means over Open Image Denoise, the noisy image among them."""
    found = data["summary"]["ratios"][HELD_OUT][PEER]
    scenes = sum(1 for scene in data["scenes"].values() if scene["held_out"])
    counts = _list_counts(spp for methods in found.values() for cells in methods.values() for spp in cells)
    rows = [
        [README_SETS[guides], TITLES[method], *(f"{cells[spp]['ratio']:.2f}" if spp in cells else "" for spp in counts)]
        for guides in README_SETS
        for method in ("noisy", "balanced", "high", "auto")
        if (cells := found.get(guides, {}).get(method))
    ]
    table = make_table(["guides", "", *(f"{spp} spp" for spp in counts)], rows)
    return f"""Error over that of Open Image Denoise with the same guides, geometric means over {scenes} scenes that no network was trained on: Blender Cycles, public interiors, built-in ones.
One factor, how far the mixing network is trusted on frames without halves, was chosen on these scenes. `auto` is the default. Every frame: [docs/users_results.md](docs/users_results.md).

{table}"""


def make_ratios(bases: Mapping[str, Any], base: str) -> str:
    """Return the geometric means of the errors over those of one method."""
    found = bases.get(base, {})
    counts = _list_counts(spp for methods in found.values() for cells in methods.values() for spp in cells)
    rows = []
    for guides in SETS:
        for method in TITLES:
            cells = found.get(guides, {}).get(method, {})
            if cells:
                shown = (cells.get(spp) for spp in counts)
                rows.append([guides, TITLES[method], *("" if one is None else f"{one['ratio']:.2f}" for one in shown)])
        scenes = [max((found[guides][m].get(spp, {"scenes": 0})["scenes"] for m in found[guides]), default=0) for spp in counts] if guides in found else []  # fmt: skip
        if scenes:
            rows.append([guides, "frames", *(str(count) if count else "" for count in scenes)])
    if not rows:
        return ""
    return f"Error over {_name(base)}:\n\n" + make_table(["guides", "method", *(f"{spp} spp" for spp in counts)], rows)


def make_promises(summary: Mapping[str, Any]) -> list[str]:
    """Return in how many cells each promise is broken, and the worst of them."""
    energy = summary["energy"]
    over = {f"error at most {MOST_OVER_NOISY} of the noisy image's": summary["over noisy"]}
    if MIXED in energy:
        over[f"`{MIXED}`: error at most {MOST_OVER_PEER} of OIDN's at its best"] = summary["over oidn"]
    parts = []
    for promise, broken in over.items():
        counted = [
            [TITLES[method], guides, str(len(found)), f"{max(one['ratio'] for one in found):.2f}"]
            for method in TITLES
            for guides in SETS
            if (found := [one for one in broken if one["method"] == method and one["guides"] == guides])
        ]
        promised = [one for one in broken if one["method"] in PROMISED]
        parts.append(f"Broken, {promise}: {len(promised)} cells, without those of `fast`, which promises nothing.")
        if counted:
            parts += [make_table(["method", "guides", "cells", "worst ratio"], counted), make_broken(promised)]
    kept = [
        [TITLES[method], str(one["cells"]), str(one["off"]), *(f"{one[end][0]:.3f} ({one[end][1]})" for end in ("least", "most"))]
        for method in TITLES
        if method != NOISY and (one := energy.get(method))
    ]  # fmt: skip
    title = f"Energy of the result over the noisy image's; off is by more than {100 * MOST_ENERGY:g} %:"
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
        for one in broken[:MOST_LISTED]
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


def make_details(rows: list[Row]) -> list[str]:
    """Return the figures of every frame, a table for each set of guides."""
    parts = []
    for guides, title in SETS.items():
        chosen = [row for row in rows if row.guides == guides]
        for figure, name in FIGURES.items():
            if chosen:
                parts += [f"{title}. {name}:", make_figures(chosen, figure)]
    return parts


def make_figures(rows: list[Row], figure: str) -> str:
    """Return one figure of every row, a column for each method that any of them has."""
    methods = [method for method in TITLES if any(method in row.methods for row in rows)]
    ordered = sorted(rows, key=lambda row: (list(GROUPS).index(row.scene.partition("/")[0]), row.scene, row.spp))
    cells = [
        [row.scene, str(row.spp), *(_show_cell(row.methods.get(method), figure) for method in methods)]
        for row in ordered
    ]
    return make_table(["scene", "spp", *(TITLES[method] for method in methods)], cells)


def make_method(data: Mapping[str, Any]) -> str:
    """Return how it was measured, and where the scenes come from."""
    origins = [[f"interiors/{name}", one.source.url, one.origin] for name, one in INTERIORS.items()]
    errors = [
        [name, "x".join(map(str, scene["size"])), f"{scene['reference_error']:.1e}"]
        for name, scene in data["scenes"].items()
        if "size" in scene
    ]
    tuned = [[spp, f"{one['normal_exponent']:g}", f"{one['screen_sigma']:g}"] for spp, one in data["tuning"].items()]
    return "\n\n".join(
        [
            """Guides. *All* is the file as it is: of `lobewise render` every guide, halves and variance; of another renderer whatever its file holds. *Passes* keeps diffuse and specular light,
an albedo of each, the normal averaged over the pixel, one roughness, the depth and the camera. *Plain* keeps color, one albedo, the same normal and the depth. *Color* keeps color alone; our
filters then get what reading such a file gives, OIDN gets no guide. The last three have no halves, no variance and no sample count, and are read as a file of an unknown renderer.""",
            """OIDN as called is given albedo and normal as they come and is told that they are noisy. At its best each goes through its own filter first, and it is told that they are clean.
Of other renderers' frames it gets the albedo and normal that the renderer itself hands to it, but for *color*. The tuned normal-aware filter has the least mean error on the scenes that
parameters were chosen on, at that sample count.""",
            f"""Errors. A reference is two renders r1 and r2 with seeds of their own; the error of x is the mean of (x - r1)(x - r2) / (c^2 + 0.01), in which the references' noise leaves nothing on
average. c is the mean of both references, cleaned by OIDN without guides, the same for all methods. The {100 * UNKNOWN:g} % of the pixels at which the references differ most count for no method.
FLIP compares with the mean of both, whose noise counts. "Not sure" marks an excess of less than two standard errors. A frame is left out of a mean where the references'
noise leaves a standard error of more than {100 * MOST_DOUBT:g} % of either error; in the tables of every frame such errors have a question mark.""",
            make_table(["scene", "size", "error of both references together"], errors),
            make_table(["scene", "repository", "origin"], origins),
            "The interiors are not part of this project. `benchmarks/interiors` fetches them, at a pinned commit, and tells what is changed.",
            make_table(["spp", "normal exponent", "screen sigma"], tuned) if tuned else "",
        ]
    )


def _list_counts(counts: Iterable[str]) -> list[str]:
    return sorted(set(counts), key=int)


def _name(base: str) -> str:
    return "the noisy image's" if base == NOISY else "that of OIDN at its best"


def _show_cell(cell: Mapping[str, float] | None, figure: str) -> str:
    if cell is None:
        return ""
    value = cell[figure]
    text = f"{value:.1e}" if abs(value) < 1e-3 else f"{value:.3g}"
    return f"{text}?" if figure == "rel_mse" and not is_known(cell) else text
