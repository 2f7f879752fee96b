"""The figures of docs/developers/windows.md, measured by `benchmarks/films`."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import judge, make_table

WAYS = {
    "noisy": "noisy",
    "auto": "`auto`",
    "auto, window": "`auto`, `--window 2`",
    "high": "`high`",
    "high, window": "`high`, `--window 2`",
    "temporal": "`--temporal`",
}
GOALS = {
    ("auto, window", "error over oidn"): ("`--window 2`: error over Open Image Denoise", 0.72),
    ("auto, window", "textures over oidn"): ("`--window 2`: the same of textures alone", 0.75),
    ("auto, window", "worst frame"): ("`--window 2`: error of the worst frame over the same alone", 1.0),
    ("auto, window", "flicker over oidn"): ("`--window 2`: flicker over Open Image Denoise", 0.5),
    ("auto, window", "cpu_seconds over alone"): ("`--window 2`: processor time over single frames", 1.4),
    ("temporal", "error over oidn"): ("`--temporal`: error over Open Image Denoise", 0.85),
    ("temporal", "flicker over oidn"): ("`--temporal`: flicker over Open Image Denoise", 0.55),
}
"""What each figure is, and the largest that it should be."""


def make_film_table(films: Mapping[str, Any], figure: str) -> str:
    """Return a figure of every film and way, over that of Open Image Denoise frame by frame."""
    rows = []
    for name, film in films.items():
        base = film["ways"]["oidn"][figure]
        ratios = [f"{film['ways'][way][figure] / base:.2f}" for way in WAYS]
        rows.append([f"`{name}`: {', '.join(film['moves'])}", *ratios])
    return make_table(["", *WAYS.values()], rows)


def make_summary(summary: Mapping[str, Any]) -> str:
    """Return the geometric means over the films."""
    keys = (
        *("error over oidn", "textures over oidn", "flicker over oidn"),
        *("error over alone", "cpu_seconds over alone", "worst frame"),
    )
    header = [
        "",
        "error over Open Image Denoise",
        "of textures alone",
        "flicker over Open Image Denoise",
        "error over single frames",
        "processor time over single frames",
        "worst frame over the same alone",
    ]
    rows = [
        [title, *(f"{summary[way][key]:.2f}" if key in summary[way] else "" for key in keys)]
        for way, title in WAYS.items()
    ]
    return make_table(header, rows)


def make_goals(summary: Mapping[str, Any]) -> str:
    """Return the goals, and whether they are met."""
    rows = [
        [title, f"{summary[way][key]:.2f}", f"{goal:.2f}", judge(summary[way][key] <= goal)]
        for (way, key), (title, goal) in GOALS.items()
    ]
    return make_table(["", "measured", "goal", ""], rows)


def make_figures(data: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/windows.md by place."""
    return {
        "error": make_film_table(data["films"], "error"),
        "flicker": make_film_table(data["films"], "flicker"),
        "summary": make_summary(data["summary"]),
        "goals": make_goals(data["summary"]),
    }
