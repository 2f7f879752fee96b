"""The figures of docs/paper.md. The tag `trials-2026-11` keeps the programs that measured them."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import describe_run, make_table

FILTERS = {
    "noisy": "noisy",
    "geometry": "by geometry",
    "geometry, tuned": "by geometry, tuned",
    "lobes: sg": "by lobes, `sg`",
    "lobes: ggx": "by lobes, `ggx`",
}


def make_figures(pair: Mapping[str, Any], times: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/paper.md by place."""
    return {"paper-errors": make_errors(pair), "paper-times": make_times(times)}


def make_errors(pair: Mapping[str, Any]) -> str:
    """Return the errors of both filters here and in the paper."""
    rows = []
    named = {title: pair["mse"][name] for name, title in FILTERS.items()}
    papers = {f"the paper: by {name}": mse for name, mse in pair["paper"].items()}
    for errors, base in ((named, pair["mse"]["geometry"]), (papers, pair["paper"]["geometry"])):
        rows += [[title, f"{mse:.4f}", f"{base / mse:.1f}"] for title, mse in errors.items()]
    return f"{make_table(['filter', 'MSE', 'MSE by geometry over this'], rows)}\n\n{describe_run(pair)}."


def make_times(times: Mapping[str, Any]) -> str:
    """Return the times of every similarity, and their ratios to the normal-aware filter here and in the paper."""
    rows = []
    for part in times["rows"]:
        found = dict(part["similarities"])
        # The paper's anisotropic Gaussian stands beside our covariance.
        papers = found.pop("asg", {})
        for name, row in found.items():
            theirs = (papers if name == "ggx" else row).get("paper_ratio_to_normal")
            rows.append(
                [
                    part["form"],
                    str(part["radius"]),
                    f"`{name}`",
                    f"{row['milliseconds']:.1f} ms",
                    f"{row['ratio_to_normal']:.2f}",
                    "" if theirs is None else f"{theirs:.2f}",
                ]
            )
    header = ["form", "radius", "similarity", "time", "ratio to normal", "the paper's ratio"]
    return f"{make_table(header, rows)}\n\n{describe_run(times)}."
