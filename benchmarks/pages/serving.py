"""The figures of docs/developers/robustness.md, measured by `robustness/circumstances.py` and `robustness/farm.py`."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.farm import make_farm_figures
from benchmarks.pages.tables import list_facts, make_table

RIGHT = ("finished", "finished before", "sentence", "stopped")
"""Ends of runs that are right: whole outputs, one sentence with the outputs as they were, or the system's signal."""
CIRCUMSTANCES = {
    "cold cache": "8 processes at once, no kernel compiled before",
    "bad caches": "kernels on disk damaged, exchanged, of another processor or user",
    "vanishing folder": "the folder of the outputs is removed meanwhile",
    "processor time": "the system stops the process (RLIMIT_CPU)",
    "jumping clock": "the clock jumps by years at every look",
}


def make_figures(measured: Mapping[str, Any], farm: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/robustness.md by place."""
    parts = {name: part["found"] for name, part in measured["parts"].items()}
    (first, early), (last, late) = parts["calls"].items()
    large = parts["16k"]["file"]
    size = f"{large['side']}x{large['side']} pixels, {large['channels']} channels"
    resident = [f"{row['resident_mib']:.0f} MiB after {number}" for number, row in ((first, early), (last, late))]
    facts = {
        f"{last} calls in one process, all qualities, with files": ", ".join(resident),
        f"A file of {size}, in bands, with {large['limit']}": (
            f"{large['peak_gib']:.2f} GiB, {large['seconds'] / 60.0:.0f} minutes"
        ),
        f"Fuzzing by coverage, ten minutes for each of {len(parts['fuzzing'])} kinds of files": (
            f"{sum(row['executions'] for row in parts['fuzzing'].values()) / 1e6:.1f} million files, "
            f"{sum(row['findings_mended'] for row in parts['fuzzing'].values())} findings, all mended"
        ),
        "Machine": f"{measured['processor']}, {measured['cores']} cores",
    }
    return {
        "circumstances": make_circumstances(parts),
        "run": list_facts(facts),
        **make_farm_figures(farm),
    }


def make_limits(measured: Mapping[str, Any]) -> str:
    """Return the table of the limits that a frame of 1600x1200 pixels needs, and of what the process then takes."""
    memory, time = (measured["parts"][name]["found"] for name in ("memory", "time"))
    header = ["quality", "least `--max-memory`", "peak", "time of a call", "latest end after `max_seconds`"]
    rows = [
        [
            f"`{quality}`",
            f"{row['limit_gib']:.1f} GiB",
            f"{row['peak_gib']:.1f} GiB",
            f"{time[quality]['whole_seconds']:.1f} s",
            f"{time[quality]['most_seconds_late']:.1f} s",
        ]
        for quality, row in memory.items()
    ]
    return make_table(header, rows)


def make_circumstances(parts: Mapping[str, Any]) -> str:
    """Return the table of how runs end."""
    header = ["", "runs", "finished", "one sentence", "stopped", "wrong"]
    rows = []
    for name, text in CIRCUMSTANCES.items():
        counts: dict[str, int] = {}
        for one in parts[name].values():
            for end, count in one.items():
                counts[end] = counts.get(end, 0) + count
        left = counts.pop("temporary files in the cache", 0)
        wrong = left + sum(count for end, count in counts.items() if end not in RIGHT)
        finished = counts.get("finished", 0) + counts.get("finished before", 0)
        figures = (sum(counts.values()), finished, counts.get("sentence", 0), counts.get("stopped", 0), wrong)
        rows.append([text, *map(str, figures)])
    return make_table(header, rows)
