"""Plots of times against pixels, radius, lobes and threads."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from operator import itemgetter
from typing import Any

from lobewise.bench.summary import Row, is_peer, name_series, pick
from lobewise.reporting.plotting import encode_figure, make_figure

PIXELS, RADIUS, LOBES, THREADS = PLOTS = ("pixels", "radius", "lobes", "threads")
COLORS = {
    "normal": "0.35",
    "sg": "tab:blue",
    "ggx": "tab:orange",
    "asg": "tab:green",
    "sg_mixture, 3 lobes": "tab:red",
    "sg_mixture, 3 coaxial": "tab:purple",
    "own axes": "tab:red",
    "one axis": "tab:purple",
    "OIDN, fast": "tab:olive",
    "OIDN, default": "tab:brown",
}
MARKS = {"cpu": "o", "cuda": "s", "vulkan": "^", "metal": "D"}


def draw_plots(data: Mapping[str, Any]) -> dict[str, bytes]:
    """Return a PNG of every plot that has rows, by its name.

    Raises MissingDependencyError if Matplotlib is not installed.
    """
    rows = data["rows"]
    rows_of_plots = {name: pick(rows, name) for name in PLOTS}
    drawn = {}
    if rows_of_plots[PIXELS]:
        drawn[PIXELS] = _draw(
            rows_of_plots[PIXELS],
            lambda row: 1e-6 * row["width"] * row["height"],
            lambda row: 1e6 * row["milliseconds"] / (row["width"] * row["height"]),
            ("megapixels", "nanoseconds a pixel"),
            log=True,
        )
    for part, across in ((RADIUS, "radius, pixels"), (LOBES, "Gaussians of a pixel")):
        if rows_of_plots[part]:
            drawn[part] = _draw(
                rows_of_plots[part], itemgetter(part), itemgetter("milliseconds"), (across, "milliseconds")
            )
    if len({row["threads"] for row in rows_of_plots[THREADS]}) > 1:
        single = {row["name"]: row["milliseconds"] for row in rows_of_plots[THREADS] if row["threads"] == 1}
        drawn[THREADS] = _draw(
            rows_of_plots[THREADS],
            itemgetter("threads"),
            lambda row: single[row["name"]] / row["milliseconds"],
            ("threads", "times faster than one thread"),
            diagonal=True,
        )
    return drawn


def _draw(
    rows: list[Row],
    across: Callable[[Row], float],
    up: Callable[[Row], float],
    labels: tuple[str, str],
    *,
    log: bool = False,
    diagonal: bool = False,
) -> bytes:
    """Return a plot with one line per series; ``diagonal`` adds the line of equal coordinates, the ideal speedup."""
    figure = make_figure(6.4, 4.0)
    panel = figure.subplots()
    name = name_series(rows)
    series: dict[str, list[Row]] = {}
    for row in rows:
        series.setdefault(name(row), []).append(row)
    places = sorted({across(row) for row in rows})
    if diagonal:
        panel.plot(places, places, color="0.8", lw=1.0, label="ideal")
    for label, points in series.items():
        # A line through few of the places would mislead. The tables hold these times as well.
        if 2 * len(points) < len(places):
            continue
        points = sorted(points, key=across)
        panel.plot(
            [across(point) for point in points],
            [up(point) for point in points],
            color=COLORS.get(points[0]["name"]),
            marker=MARKS.get(points[0]["device"], "x"),
            markersize=4.0,
            ls="--" if is_peer(points[0]) else "-",
            lw=1.4,
            label=label,
        )
    if log:
        panel.set_xscale("log")
        panel.set_yscale("log")
        panel.yaxis.set_major_formatter("{x:g}")
    else:
        panel.set_ylim(bottom=0.0)
    panel.set_xticks(places, [f"{place:.2g}" for place in places])
    panel.minorticks_off()
    panel.set_xlabel(labels[0])
    panel.set_ylabel(labels[1])
    panel.grid(color="0.92")
    panel.set_axisbelow(True)
    panel.legend(frameon=False, fontsize="small")
    return encode_figure(figure)
