"""The figures of docs/developers/bench.md, by `performance/startup.py` and `lobewise bench` on several machines."""

import json
from collections.abc import Mapping
from typing import Any

from benchmarks.common import ROOT
from benchmarks.pages.tables import describe_run, judge, list_facts, make_table
from lobewise.cli.bench.filters import make_tables
from lobewise.cli.bench.machine import describe_machine_in_words

MACHINES = ROOT / "benchmarks" / "results" / "machines"
MAX_MILLISECONDS_OF_HELP = 300.0
"""Goal: longest time of `lobewise --help`. Users notice longer waits."""


def load_machines() -> dict[str, dict[str, Any]]:
    """Return what `lobewise bench` found on each machine, by the name of its file."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(MACHINES.glob("*.json"))}


def make_figures(startup: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/bench.md by place."""
    return {**make_startup(startup), "machines": make_machines(load_machines())}


def make_machines(machines: Mapping[str, Any]) -> str:
    """Return a chapter for each machine."""
    return "\n\n".join(make_machine(name, data) for name, data in machines.items())


def make_machine(name: str, measured: Mapping[str, Any]) -> str:
    """Return the chapter of a machine."""
    parts = [f"## {name}", describe_machine_in_words(measured)]
    parts.append("\n".join(f"- `{key}`: {reason}" for key, reason in measured["devices"].items()))
    parts += [f"Left out: {sentence}" for sentence in measured["skipped"]]
    for title, (header, rows) in make_tables(measured).items():
        parts += [f"### {title}", make_table(header, rows)]
    return "\n\n".join(parts)


def make_startup(startup: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of whole processes by place."""
    helps = [
        [f"`{name}`", f"{row['milliseconds']:.0f} ms", f"{row['ratio_to_python']:.1f}"]
        for name, row in startup["help"].items()
    ]
    peers = [name for name in startup["denoise"] if name.startswith("oidnDenoise")]
    runs = [
        [
            f"`{name}`" if name in peers else name,
            f"{row['seconds']:.2f} s",
            f"{row['seconds_filtering']:.2f} s" if "seconds_filtering" in row else "",
            *(f"{row[f'times {peer}']:.2f}" for peer in peers),
        ]
        for name, row in startup["denoise"].items()
    ]
    slowest = startup["help"]["lobewise --help"]["milliseconds"]
    header = ["what", "whole process", "of which `denoise`", *(f"times faster than `{peer}`" for peer in peers)]
    whole, lean = (
        f"{file['megabytes']:.0f} MB, {file['channels']} channels"
        for file in map(startup["files"].get, ("whole", "lean"))
    )
    goal = (
        f"at most {MAX_MILLISECONDS_OF_HELP:.0f} ms for `lobewise --help`, {judge(slowest <= MAX_MILLISECONDS_OF_HELP)}"
    )
    return {
        "processes-run": list_facts({"Machine": describe_run(startup), "Goal": goal}),
        "help": make_table(["program", "time", "over a Python that does nothing"], helps),
        "files": list_facts(
            {
                "Frame": f"`showroom`, {startup['width']}x{startup['height']}, 1 sample per pixel",
                "Whole file": whole,
                "Lean file": lean,
            }
        ),
        "processes": make_table(header, runs),
    }
