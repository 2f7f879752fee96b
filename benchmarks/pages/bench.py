"""The text of docs/bench.md, from what ``performance/startup.py`` has measured and ``lobewise bench`` on several machines."""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from benchmarks.common import ROOT
from benchmarks.pages.tables import make_table
from lobewise.bench.plots import PLOTS, draw_plots
from lobewise.bench.summary import Section, describe_machine_in_words, make_sections

MACHINES = ROOT / "benchmarks" / "results" / "machines"
IMAGES = ROOT / "docs" / "images"
LIMIT = 300.0
"""Milliseconds that help may take: longer feels like waiting."""


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


def make_bench_page(startup: Mapping[str, Any] | None, machines: Mapping[str, Any]) -> str:
    """Return docs/bench.md."""
    shown = "\n".join(make_machine(name, data) for name, data in machines.items())
    starts = "" if startup is None else make_startup(startup)
    return f"""# How fast is it here?

Written by `benchmarks/publish.py`; no figure is typed by hand.

```bash
lobewise bench                    # up to ten minutes, of which nothing else should run
lobewise bench --quick            # about a minute, on small images
lobewise bench --device cuda -o there
```

times the filters on this machine and writes a folder, `lobewise-bench` unless `-o` names another: `index.html` with all tables and
plots, `bench.json` with every time, and the plots as PNG (these need `lobewise[fit]`, Open Image Denoise needs `lobewise[compare]`; what is
missing is left out and said). Without `--device` every device is measured that `lobewise devices` lists and that is no software.
`lobewise bench interactive` measures the chain of the viewer instead: [docs/interactive.md](interactive.md).

## How to read it

- All candidates of a table run in turn, again and again, and the best time of each counts: a disturbance of the machine meets all of
  them, and ratios within a table hold better than times between tables.
- The first run of each, in which kernels are compiled, is not counted.
- *Kernel* times are those of one image of three channels. *Whole frames* are `lobewise.denoise`: diffuse and specular light, each with
  its own lobes, and all that surrounds the filter.
- Everything is measured on a plane of patches made of formulas, so that machines compare. Times on a rendered frame stand in
  [docs/quality_results.md](quality_results.md).
- Open Image Denoise is given colour, albedo and normal, declared clean: one network. Filtering its guides first takes two more. It
  chooses its device itself: a graphics card where it finds one, which the figures do not tell.
- On a graphics card a time has the way there and back in it.
- In `bench.json` a row of `rows` is one time: `part`, `device`, `name`, `milliseconds`, and what the part varies (`width`, `height`, `form`,
  `radius`, `lobes`, `scale`, `threads`).

To have a machine stand here: put its `bench.json` into `benchmarks/results/machines/`, with a short name, and run
`benchmarks/publish.py`.

{starts}{shown}"""


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


def make_startup(startup: Mapping[str, Any]) -> str:
    """Return the chapter on whole processes."""
    machine = startup["machine"]
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
    verdict = "within" if slowest <= LIMIT else "over"
    header = ["what", "whole process", "of which `denoise`", *(f"times faster than `{peer}`" for peer in peers)]
    files = {
        name: f"{file['megabytes']:.0f} MB with {file['channels']} channels" for name, file in startup["files"].items()
    }
    return f"""## From the command line

`benchmarks/performance/startup.py`, {machine["processor"]}, {machine["threads"]} threads, commit {machine["commit"]}. Whole processes, in turn, the best of each.

{make_table(["program", "time", "over a Python that does nothing"], helps)}

`lobewise --help` is {verdict} the {LIMIT:.0f} ms that were set for it. It imports neither NumPy nor Halide; what is left is the parser of the
command line and the frame about the text.

`lobewise denoise` of `showroom`, {startup["width"]}x{startup["height"]}, 1 sample per pixel, beside `oidnDenoise` on the same pixels. "first run": no kernel
has been compiled before; "again": the run after it. The file is what `lobewise render` writes, {files["whole"]}, all of
which are read and written again; "lean file" holds only what `fast` looks at, {files["lean"]}. `oidnDenoise` reads colour, albedo and normal
as three uncompressed PFM files and writes one.

{make_table(header, runs)}

"""
