"""The figures of README.md and of the pages for users: all from the same JSON files."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.films import make_summary
from benchmarks.pages.serving import make_limits
from benchmarks.pages.tables import describe_run, make_table
from benchmarks.pages.users import TITLES, list_counts, make_kinds
from benchmarks.users.summary import HELD_OUT, NOISY, PEER

GUIDES = {"all": "all guides", "plain": "albedo, normal, depth alone"}
COLUMNS = (
    ("all", NOISY),
    ("all", f"{PEER}, as called"),
    ("all", PEER),
    ("all", "high"),
    ("all", "auto"),
    ("all", "best"),
    ("plain", "auto"),
)
"""Guides and method of each column of the tables."""


def make_shot_figures(shots: Mapping[str, Any], budget: Mapping[str, Any]) -> dict[str, str]:
    """Return the table of random shots of Blender, whose first row is the time of each method."""
    return {"blender-shots": make_means(shots, price_methods(budget))}


def make_figures(
    shots: Mapping[str, Any],
    budget: Mapping[str, Any],
    training_shots: Mapping[str, Any],
    data: Mapping[str, Any],
    films: Mapping[str, Any],
    without_lobes: Mapping[str, Any],
    robustness: Mapping[str, Any],
) -> dict[str, str]:
    """Return the figures of docs/results.md by place."""
    return {
        **make_shot_figures(shots, budget),
        "blender-kinds": make_kinds(shots),
        "training-kinds": make_kinds(training_shots),
        "scenes": make_means(data),
        "films": f"{make_summary(films['summary'])}\n\n{len(films['films'])} films; {describe_run(films)}.",
        "lobes": make_lobes(without_lobes),
        "limits": make_limits(robustness),
    }


QUALITIES = {
    NOISY: (NOISY, ""),
    "`fast`": ("fast", "Blender, fast"),
    "`balanced`": ("balanced", "Blender, balanced"),
    "`high`": ("high", "Blender, high"),
    "`auto`": ("auto", "Blender, auto"),
    "`best`": ("best", "Blender, best"),
    "Open Image Denoise as called": (f"{PEER}, as called", "Blender, Open Image Denoise as called"),
    "Open Image Denoise at its best": (PEER, "Blender, Open Image Denoise at its best"),
}
"""Rows of the table of qualities: method of `benchmarks.users`, and recipe of `benchmarks.performance.budget`."""
PRICED_SPP = "16"


def price_methods(budget: Mapping[str, Any]) -> dict[str, str]:
    """Return the processor time of every method on a Blender frame, over Open Image Denoise as called."""
    recipes = budget["recipes"]
    plain = recipes[QUALITIES["Open Image Denoise as called"][1]]["seconds"]
    return {
        method: f"{recipes[recipe]['seconds'] / plain:.1f}" if recipe else "" for method, recipe in QUALITIES.values()
    }


def make_quality_figures(shots: Mapping[str, Any], budget: Mapping[str, Any]) -> dict[str, str]:
    """Return the table of docs/quality.md: what every quality costs, and the error that it leaves."""
    found = shots["summary"]["ratios"][HELD_OUT][PEER]["all"] | {PEER: {PRICED_SPP: {"ratio": 1.0}}}
    prices = price_methods(budget)
    rows = [
        [name, prices[method], f"{found[method][PRICED_SPP]['ratio']:.2f}"] for name, (method, _) in QUALITIES.items()
    ]
    scenes = len(shots["scenes"])
    header = ["", "time, over Open Image Denoise as called", "error, over Open Image Denoise at its best"]
    return {"prices": f"{make_table(header, rows)}\n\n{scenes} shots; {describe_run(shots)}."}


def make_means(data: Mapping[str, Any], prices: Mapping[str, str] | None = None) -> str:
    """Return the means over the error of Open Image Denoise with the same guides, by sample count.

    ``prices`` are those of `price_methods`, for a first row; they are of frames with all guides.
    """
    found = data["summary"]["ratios"][HELD_OUT][PEER]
    counts = list_counts(spp for methods in found.values() for cells in methods.values() for spp in cells)
    itself = {PEER: {spp: {"ratio": 1.0} for spp in counts}}
    columns = [(guides, method) for guides, method in COLUMNS if method in found.get(guides, {}) | itself]
    cells = [(found[guides] | itself)[method] for guides, method in columns]
    names = {**TITLES, PEER: "Open Image Denoise at its best", f"{PEER}, as called": "Open Image Denoise as called"}
    header = [names[method] + ("" if guides == "all" else f", {GUIDES[guides]}") for guides, method in columns]
    rows = [[spp, *(f"{each[spp]['ratio']:.2f}" if spp in each else "" for each in cells)] for spp in counts]
    if prices is not None:
        rows.insert(0, ["time", *(prices[method] if guides == "all" else "" for guides, method in columns)])
    scenes = sum(1 for scene in data["scenes"].values() if scene["held_out"])
    return make_table(["spp", *header], rows) + f"\n\n{scenes} scenes; {describe_run(data)}."


def make_lobes(measured: Mapping[str, Any]) -> str:
    """Return the errors of glossy pixels over those of filters that compare normals, by quality and sample count."""
    counts = list(dict.fromkeys(name.split()[1] for name in measured["frames"]))
    rows = [
        [f"`{quality}`", *(f"{means[f'glossy, {spp} spp']:.2f}" for spp in counts), f"{means['glossy']:.2f}"]
        for quality, means in measured["means"].items()
    ]
    scenes = len({name.split()[0] for name in measured["frames"]})
    table = make_table(["filter", *(f"{spp} spp" for spp in counts), "all"], rows)
    return f"{table}\n\n{scenes} scenes; {describe_run(measured)}."
