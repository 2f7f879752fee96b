"""The text of docs/performance.md, from what the programs in ``benchmarks/performance`` have measured."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from statistics import mean
from typing import Any

from benchmarks.pages.tables import make_table

GOALS = {"sg": 1.20, "ggx": 1.80}
"""Times of `normal` that a similarity may take."""
PEER_GOALS = {"sg": (8.0, 4.0), "ggx": (5.0, 2.5)}
"""How many times faster than Open Image Denoise, by default and with its `fast` quality."""
LEAST_SHARE, FLATNESS, GAIN = 0.5, 1.15, 1.8


def judge(met: bool) -> str:
    """Return whether a goal is met."""
    return "met" if met else "missed"


USUAL = "separable, radius 8"
"""The way to take taps that others are compared with."""


def make_performance_page(
    filters: Mapping[str, Any],
    roofline: Mapping[str, Any],
    scaling: Mapping[str, Any],
    trials: Mapping[str, Any],
    taps: Mapping[str, Any],
) -> str:
    """Return docs/performance.md."""
    machine = roofline["machine"]
    peaks = roofline["peaks"]
    return f"""# Performance

Written by `benchmarks/publish.py`; no figure is typed by hand. {machine["processor"]}, {machine["cores"]} cores, vectors of {roofline["lanes"]} floats. How fast your machine is: `lobewise bench`
([bench.md](bench.md)). What the qualities cost beside Open Image Denoise: [quality_results.md](quality_results.md). Measured with the sources of
commits {filters["machine"]["commit"]} (ratios, Open Image Denoise), {roofline["machine"]["commit"]} (roofline) and {scaling["machine"]["commit"]} (sizes and threads); what changed since stands in the last tables.

## Devices

`lobewise devices` lists where filters run, or why not there. `--device auto` takes a graphics card where there is one.

| device | what | tested |
| --- | --- | --- |
| `cpu` | processor, all threads, widest vectors it has | every test |
| `vulkan` | Vulkan 1.3 | the kernels' tests, on Mesa's software device; never chosen by `auto` where the device is software |
| `cuda` | NVIDIA, compute capability 3.0 and above | compiled; not run yet |
| `metal` | macOS | compiled ([export.md](export.md)); not run yet |

Filters, upsampling, histories, fireflies, guides of noise and the networks of `high` run there; guides and lobes are made by the processor, once a frame. Images go
up once, and what one kernel writes for the next stays there. The same inputs give the same result as on the processor to a relative 0.001 for filtered radiance of every form
(`full`, `separable`, `atrous`), because every float operation is rounded once, but not in the same order; on the software device the difference is below 0.0001.

Direct3D 12, WebGPU and others are targets of [`lobewise export`](export.md).

## Kernels on disk

A kernel is compiled the first time that a machine needs it and then lies in the user's cache folder (Linux: `~/.cache/lobewise`), from which the next process loads it in
milliseconds. `LOBEWISE_CACHE` names another folder, or is `off`. Nothing in it is needed: delete it whenever you like. A file that is not whole is made again.

A compiled kernel is code that runs as you. Folder and files are made for you alone (0700, 0600); what others can write or own is not used, as ssh does with keys, and
one line on standard error (a warning of Python's logger `lobewise.backend.disk`) says which path and why. The same line comes where there is no home folder or nothing can be written: kernels are then compiled in every process.
Windows has no such modes, and nothing is checked there.

## One core: how near to its limits

A tap of a vector of {roofline["lanes"]} pixels, full form. Operations and bytes are counted in the machine code of the loops over taps; the peaks are measured by loops of nothing else: {peaks["fused"]:.2f}
thousand million fused multiplications a second, as many additions beside them ({peaks["both"]:.2f} together), and {peaks["loads"]:.2f} loads of whole vectors. Of operations the higher peak
is taken, which only a kernel with as many additions as multiplications could reach. `python -m benchmarks.performance.roofline`.

{make_roofline_rows(roofline)}

Goal: {LEAST_SHARE:.0%} of the roofline: {judge(min(each["share_of_roofline"] for each in roofline["kernels"].values()) >= LEAST_SHARE)}. What is missing: loads that begin anywhere cross cache lines, which takes two cycles instead of one.

## Beside geometry-aware filtering

Times of `normal`, which compares positions and normals alone, same run. `python -m benchmarks.performance.filters`.

{make_ratio_rows(filters)}

## Beside Open Image Denoise

One image filtered, and the whole recipe (diffuse and specular apart, guides made, separable, radius 8), beside Open Image Denoise on the same image with its guides, same run.
It removes more noise than these (docs/quality_results.md); this is what their speed is.

{make_peer_rows(filters)}

## Sizes and threads

Separable, radius 8, {scaling["threads"]} threads; nanoseconds per pixel. `python -m benchmarks.performance.scaling`.

{make_scaling_rows(scaling)}

{make_scaling_goals(scaling)}

## Other ways to take taps

Time and error over those of `separable` with radius 8: both layers of the recipe `fast` with `ggx`, {taps["size"]}x{taps["size"]}; times are means over all frames of the run, errors (relative
mean squared, against 512 samples per pixel) geometric means over frames of 4 and 16 samples per pixel. `python -m benchmarks.performance.taps`.

{make_tap_rows(taps)}

*Sparse* takes its taps on a spiral that turns from row to row; *two levels* filters averages of two by two pixels and brings them to every pixel by what it has in common
with them (without the time that averaging takes); *adaptive* is the full square as far as it holds 99 % of the weight of any pixel in a tile. {make_tap_verdict(taps)}

## What was tried

{make_trials(trials["groups"])}

What one tap costs is set by the number of vector operations: `normal` has fewest of them. Whatever makes the part faster that all have in common therefore raises the ratios above.
"""


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
    return "For each of them there is a form that takes no longer and has no more error in one of the scenes: none is kept."


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
            if size == "1920x1080" and "denoise" not in name:
                values = cell["times_faster_than_oidn"], cell["times_faster_than_oidn_fast"]
                goals = PEER_GOALS[similarity]
                told = [f"{t} ({g:g}: {judge(v >= g)})" for t, v, g in zip(told, values, goals, strict=True)]
            rows.append([size, name, f"{cell['milliseconds']:.0f} ms", *told])
    return make_table(["size", "what", "time", "times faster than default (goal)", "than `fast` (goal)"], rows)


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
    """Return the two goals and whether they are met."""
    flat = max(scaling["largest_over_smallest"].values())
    gain = min(min(row.values()) for row in scaling["gain_of_threads"].values())
    return (
        f"Goals: no size takes more than {FLATNESS:.2f} times the time per pixel of another: {flat:.2f}, {judge(flat <= FLATNESS)}; "
        f"{scaling['threads']} threads give at least {GAIN:g} times one at every size: {gain:.2f}, {judge(gain >= GAIN)}."
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
