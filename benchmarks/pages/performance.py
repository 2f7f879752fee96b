"""The figures of performance.md and filter_results.md in docs/developers, by `benchmarks/performance`."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import describe_run, judge, list_facts, make_table

GOALS = {"sg": 1.20, "ggx": 1.80}
"""Times of `normal` that a similarity may take."""
PEER_GOALS = {"sg": (8.0, 4.0), "ggx": (5.0, 2.5)}
"""How many times faster than Open Image Denoise, by default and with its `fast` quality."""
TIMED = ("normal", "sg", "sg_mixture, 3 lobes", "sg_mixture, 3 coaxial", "ggx")
"""Names in filters.json."""


def make_figures(filters: Mapping[str, Any], budget: Mapping[str, Any], files: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/performance.md by place."""
    return {
        "run": list_facts({"Machine": describe_run(filters)}),
        "ratios": make_ratio_rows(filters),
        "peer": make_peer_rows(filters),
        "budget-run": list_facts({"Machine": f"{budget['machine']['processor']}, one thread"}),
        "budget": make_budget_rows(budget),
        "files": make_file_rows(files),
    }


def make_result_figures(filters: Mapping[str, Any], lobes: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/filter_results.md by place: times of kernels, errors of similarities."""
    rows = []
    for row in filters["kernels"]:
        cells = [f"{row['width']}x{row['height']}", row["form"], str(row["radius"])]
        for name in TIMED:
            cells.append(f"{row[name]['milliseconds']:.1f} ms ({row[name]['ratio_to_normal']:.2f})")
        rows.append([*cells, f"{row['normal']['ns_per_tap_and_pixel']:.3f}"])
    kernels = make_table(["size", "form", "radius", *TIMED, "normal, ns per tap and pixel"], rows)
    return {
        "kernels": kernels,
        "kernels-run": list_facts({"Machine": describe_run(filters)}),
        "lobes": make_lobe_rows(lobes),
    }


def make_lobe_rows(lobes: Mapping[str, Any]) -> str:
    """Return the table of `benchmarks.quality.lobes`: means over frames, of all pixels and of glossy ones."""
    rows = []
    for group, filters in lobes["means"].items():
        for name, pixels in filters.items():
            pairs = zip(*(each.items() for each in pixels.values()), strict=True)
            cells = {mine[0]: f"{mine[1]:.2f} ({glossy[1]:.2f})" for mine, glossy in pairs}
            rows.append([group, name, *(cells[similarity] for similarity in cells if similarity != "normal")])
    similarities = [name for name in cells if name != "normal"]
    table = make_table(["frames", "filter", *(f"`{name}`" for name in similarities)], rows)
    return f"{table}\n\n{len(lobes['frames'])} frames; {describe_run(lobes)}."


def make_ratio_rows(filters: Mapping[str, Any]) -> str:
    """Return the table of ratios, with goals at radius 8."""
    rows = []
    for row in filters["kernels"]:
        if row["form"] == "atrous":
            continue
        cells = [f"{row['width']}x{row['height']}", f"`{row['form']}`", str(row["radius"])]
        cells += [f"{row['normal']['milliseconds']:.1f} ms"]
        for name in ("sg", "ggx"):
            ratio = row[name]["ratio_to_normal"]
            told = f"{ratio:.2f}"
            if row["radius"] == 8 and name in GOALS:
                told += f" ({GOALS[name]:.2f}: {judge(ratio <= GOALS[name])})"
            cells.append(told)
        rows.append(cells)
    return make_table(["size", "form", "radius", "`normal`", "`sg` (goal)", "`ggx` (goal)"], rows)


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


def make_file_rows(files: Mapping[str, Any]) -> str:
    """Return the table of reading and writing files."""
    steps = ("read", "write", "OpenEXR read", "OpenEXR write")
    rows = [
        [name, *(f"{each[step]:.2f}" for step in steps), f"{each['over OpenEXR']:.2f}"]
        for name, each in files["files"].items()
    ]
    return make_table(["file", *(f"{step}, s" for step in steps), "both over OpenEXR"], rows)


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
