"""The figures of docs/bench.md, measured by `performance/startup.py` and by `lobewise bench` on several machines."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from benchmarks.common import ROOT
from benchmarks.pages.tables import describe_run, judge, list_facts, make_table
from lobewise.bench.plots import PLOTS, draw_plots
from lobewise.bench.summary import Section, describe_machine_in_words, make_sections

MACHINES = ROOT / "benchmarks" / "results" / "machines"
IMAGES = ROOT / "docs" / "images"
MAX_MILLISECONDS_OF_HELP = 300.0
"""Goal: longest time of `lobewise --help`. Users notice longer waits."""


def load_machines() -> dict[str, dict[str, Any]]:
    """Return what `lobewise bench` found on each machine, by the name of its file."""
    return {path.stem: json.loads(path.read_text()) for path in sorted(MACHINES.glob("*.json"))}


def name_picture(machine: str, plot: str) -> str:
    """Return the file name of a plot of a machine."""
    return f"bench-{machine}-{plot}.png"


def list_pictures(machines: Mapping[str, Any]) -> list[str]:
    """Return the file names of the plots that stand in the page."""
    drawn = {name: [section.key for section in make_sections(data)] for name, data in machines.items()}
    return [name_picture(name, plot) for name, keys in drawn.items() for plot in PLOTS if plot in keys]


def write_pictures(machines: Mapping[str, Any]) -> None:
    """Draw the plots of every machine."""
    for name, data in machines.items():
        for plot, png in draw_plots(data).items():
            (IMAGES / name_picture(name, plot)).write_bytes(png)


def make_figures(startup: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/bench.md by place."""
    return {**make_startup(startup), "machines": make_machines(load_machines())}


def make_machines(machines: Mapping[str, Any]) -> str:
    """Return a chapter for each machine."""
    return "\n\n".join(make_machine(name, data) for name, data in machines.items())


def make_machine(name: str, data: Mapping[str, Any]) -> str:
    """Return the chapter of a machine."""
    devices = "\n".join(f"- `{key}`: {told}" for key, told in data["devices"].items())
    left_out = "".join(f"Left out: {sentence}\n\n" for sentence in data["skipped"])
    pictures = list_pictures({name: data})
    body = "\n".join(_make_section(section, name, pictures) for section in make_sections(data))
    return f"""## {name}

{describe_machine_in_words(data)}

{devices}

{left_out}{body}"""


def _make_section(section: Section, machine: str, pictures: list[str]) -> str:
    file = name_picture(machine, section.key)
    picture = f"\n![{section.title} on {machine}](images/{file})\n" if file in pictures else ""
    return f"### {section.title}\n\n{section.note}\n\n{make_table(section.header, section.rows)}\n{picture}"


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
