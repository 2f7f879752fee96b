"""The figures of docs/performance.md and docs/research/kernel_trials.md, measured by `benchmarks/performance`."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import mean
from typing import Any

from benchmarks.pages.tables import judge, list_facts, make_table

GOALS = {"sg": 1.20, "ggx": 1.80}
"""Times of `normal` that a similarity may take."""
PEER_GOALS = {"sg": (8.0, 4.0), "ggx": (5.0, 2.5)}
"""How many times faster than Open Image Denoise, by default and with its `fast` quality."""
MIN_SHARE_OF_ROOFLINE = 0.5
"""Goal: smallest share of the roofline that a kernel reaches."""
MAX_LARGEST_OVER_SMALLEST = 1.15
"""Goal: largest time per pixel of one image size over that of another."""
MIN_GAIN_OF_THREADS = 1.8
"""Goal: how many times faster two threads are than one."""
USUAL = "separable, radius 8"
"""The way to take taps that the other ways are compared with."""


def make_figures(
    filters: Mapping[str, Any],
    roofline: Mapping[str, Any],
    scaling: Mapping[str, Any],
    budget: Mapping[str, Any],
    first_calls: Mapping[str, Any],
) -> dict[str, str]:
    """Return the figures of docs/performance.md by place."""
    machine, peaks = roofline["machine"], roofline["peaks"]
    share = min(each["share_of_roofline"] for each in roofline["kernels"].values())
    run = {
        "Machine": f"{machine['processor']}, {machine['cores']} cores, vectors of {roofline['lanes']} floats",
        "Ratios and Open Image Denoise": f"commit {filters['machine']['commit']}",
        "Roofline": f"commit {machine['commit']}",
        "Sizes and threads": f"commit {scaling['machine']['commit']}, {scaling['threads']} threads",
    }
    limits = {
        "Pixels in a vector": roofline["lanes"],
        "Fused multiplications, 10^9 a second": f"{peaks['fused']:.2f}",
        "Fused multiplications and additions together, 10^9 a second": f"{peaks['both']:.2f}",
        "Loads of whole vectors, 10^9 a second": f"{peaks['loads']:.2f}",
        "Goal": f"{MIN_SHARE_OF_ROOFLINE:.0%} of the roofline, {judge(share >= MIN_SHARE_OF_ROOFLINE)}",
    }
    return {
        "first-calls": make_first_call_rows(first_calls),
        "run": list_facts(run),
        "peaks": list_facts(limits),
        "roofline": make_roofline_rows(roofline),
        "ratios": make_ratio_rows(filters),
        "peer": make_peer_rows(filters),
        "budget-run": list_facts({"Machine": f"{budget['machine']['processor']}, one thread"}),
        "budget": make_budget_rows(budget),
        "sizes": make_scaling_rows(scaling),
        "sizes-goals": make_scaling_goals(scaling),
    }


def make_trial_figures(trials: Mapping[str, Any], taps: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/research/kernel_trials.md by place."""
    return {
        "taps-run": list_facts({"Size": f"{taps['size']}x{taps['size']}"}),
        "taps": make_tap_rows(taps),
        "taps-verdict": make_tap_verdict(taps),
        "trials": make_trials(trials["groups"]),
    }


def compare_taps(taps: Mapping[str, Any]) -> dict[str, tuple[float, dict[str, float]]]:
    """Return of every way its time and, by scene, its error, over those of `USUAL`."""
    rows = taps["rows"]
    usual = {(row["scene"], row["spp"]): row for row in rows if row["way"] == USUAL}
    found = {}
    for way in dict.fromkeys(row["way"] for row in rows):
        own = [(row, usual[row["scene"], row["spp"]]) for row in rows if row["way"] == way]
        errors: dict[str, list[float]] = {}
        for row, other in own:
            errors.setdefault(row["scene"], []).append(math.log(row["rel_mse"] / other["rel_mse"]))
        time = mean(row["milliseconds"] / other["milliseconds"] for row, other in own)
        found[way] = time, {scene: math.exp(mean(each)) for scene, each in errors.items()}
    return found


def make_tap_rows(taps: Mapping[str, Any]) -> str:
    """Return the table of ways to take taps."""
    found = compare_taps(taps)
    scenes = list(found[USUAL][1])
    rows = [
        [way, f"{time:.2f}", *(f"{errors[scene]:.2f}" for scene in scenes)] for way, (time, errors) in found.items()
    ]
    return make_table(["way", "time", *(f"error, {scene}" for scene in scenes)], rows)


def make_tap_verdict(taps: Mapping[str, Any]) -> str:
    """Return which ways beat every form in all scenes."""
    found = compare_taps(taps)
    forms = {way: each for way, each in found.items() if way.startswith(("full", "separable", "atrous"))}

    def wins(way: str) -> bool:
        time, errors = found[way]
        return not any(
            other <= time and errors_there[scene] <= error
            for other, errors_there in forms.values()
            for scene, error in errors.items()
        )

    winners = [way for way in found if way not in forms and wins(way)]
    if winners:
        return f"Better than every form that takes no longer, in all scenes: {', '.join(winners)}."
    return "For each way, some form takes no longer and has no more error in one of the scenes. None is kept."


def make_roofline_rows(roofline: Mapping[str, Any]) -> str:
    """Return the table of kernels."""
    rows = [
        [
            f"`{name}`" if "," not in name else name,
            str(each["operations"]),
            str(each["bytes_loaded"]),
            f"{each['bounds_nanoseconds']['operations']:.1f}",
            f"{each['bounds_nanoseconds']['loads']:.1f}",
            f"{each['nanoseconds']:.1f}",
            f"{each['share_of_roofline']:.0%}",
        ]
        for name, each in roofline["kernels"].items()
    ]
    header = [
        "similarity",
        "operations",
        "bytes loaded",
        "bound by operations, ns",
        "by loads, ns",
        "measured, ns",
        "share",
    ]
    return make_table(header, rows)


def make_ratio_rows(filters: Mapping[str, Any]) -> str:
    """Return the table of ratios, with goals at radius 8."""
    rows = []
    for row in filters["kernels"]:
        if row["form"] == "atrous":
            continue
        cells = [f"{row['width']}x{row['height']}", f"`{row['form']}`", str(row["radius"])]
        cells += [f"{row['normal']['milliseconds']:.1f} ms"]
        for name in ("sg", "ggx", "asg"):
            ratio = row[name]["ratio_to_normal"]
            told = f"{ratio:.2f}"
            if row["radius"] == 8 and name in GOALS:
                told += f" ({GOALS[name]:.2f}: {judge(ratio <= GOALS[name])})"
            cells.append(told)
        rows.append(cells)
    return make_table(["size", "form", "radius", "`normal`", "`sg` (goal)", "`ggx` (goal)", "`asg`"], rows)


def make_peer_rows(filters: Mapping[str, Any]) -> str:
    """Return the table of times beside Open Image Denoise, with goals at 1920x1080."""
    rows = []
    for size, cells in filters["oidn"].items():
        for name, cell in cells.items():
            if name.startswith("oidn"):
                rows.append(
                    [size, name.replace("oidn", "Open Image Denoise"), f"{cell['milliseconds']:.0f} ms", "", ""]
                )
                continue
            told = [f"{cell[key]:.1f}" for key in ("times_faster_than_oidn", "times_faster_than_oidn_fast")]
            similarity = "sg" if "sg" in name.split(",")[0] else "ggx"
            if size == "1920x1080":
                values = cell["times_faster_than_oidn"], cell["times_faster_than_oidn_fast"]
                goals = PEER_GOALS[similarity]
                told = [f"{t} ({g:g}: {judge(v >= g)})" for t, v, g in zip(told, values, goals, strict=True)]
            rows.append([size, name, f"{cell['milliseconds']:.0f} ms", *told])
    return make_table(["size", "what", "time", "times faster than default (goal)", "than `fast` (goal)"], rows)


def make_budget_rows(budget: Mapping[str, Any]) -> str:
    """Return the table of whole recipes."""
    rows = [
        [
            name,
            f"{each['seconds']:.2f}",
            f"{each['over_kernels']:.2f}",
            f"{each['over_oidn_fast']:.2f}",
            each["commit"],
        ]
        for name, each in budget["recipes"].items()
    ]
    header = ["recipe", "processor time, s", "over its kernels", "over Open Image Denoise's `fast`", "commit"]
    return make_table(header, rows)


def make_first_call_rows(first_calls: Mapping[str, Any]) -> str:
    """Return the table of what first calls compile."""
    after = {name: versions["after"] for name, versions in first_calls["calls"].items()}
    rows = [[name, f"{each['count']}", f"{each['compile_seconds']:.1f} s"] for name, each in after.items()]
    return make_table(["recipe", "kernels", "time to compile"], rows)


def make_scaling_rows(scaling: Mapping[str, Any]) -> str:
    """Return the table of sizes."""
    most = str(scaling["threads"])
    costs, gains = scaling["nanoseconds_per_pixel"][most], scaling["gain_of_threads"]
    rows = [
        [size, *(f"{row[name]:.1f}" for name in row), *(f"{gains[size][name]:.2f}" for name in row)]
        for size, row in costs.items()
    ]
    names = list(next(iter(costs.values())))
    return make_table(
        ["size", *(f"`{name}`" for name in names), *(f"`{name}`, times one thread" for name in names)], rows
    )


def make_scaling_goals(scaling: Mapping[str, Any]) -> str:
    """Return the two goals of sizes and threads, and whether they are met."""
    flat = max(scaling["largest_over_smallest"].values())
    gain = min(min(row.values()) for row in scaling["gain_of_threads"].values())
    return list_facts(
        {
            f"Largest time per pixel over the smallest, among sizes (goal: at most {MAX_LARGEST_OVER_SMALLEST:.2f})": (
                f"{flat:.2f}, {judge(flat <= MAX_LARGEST_OVER_SMALLEST)}"
            ),
            f"Smallest gain of {scaling['threads']} threads over one (goal: at least {MIN_GAIN_OF_THREADS:g})": (
                f"{gain:.2f}, {judge(gain >= MIN_GAIN_OF_THREADS)}"
            ),
        }
    )


def make_trials(groups: Sequence[Mapping[str, Any]]) -> str:
    """Return what was tried, group by group, each measured in its own way."""
    names = ("normal", "sg", "ggx")
    parts = []
    for group in groups:
        forms = [form for form in ("full", "separable") if any(row.get(form) for row in group["rows"])]
        header = ["what", *(f"{form}, `{name}`" for form in forms for name in names), "verdict"]
        rows = [
            [
                row["name"],
                *(cell for form in forms for cell in map(str, row.get(form) or ("", "", ""))),
                row["verdict"],
            ]
            for row in group["rows"]
        ]
        parts.append(
            f"{group['what'][0].upper()}{group['what'][1:]}. {group['machine']}.\n\n{make_table(header, rows)}"
        )
    return "\n\n".join(parts)
