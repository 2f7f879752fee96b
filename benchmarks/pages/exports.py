"""The figures of docs/developers/export.md, measured by `performance/pipelines.py` and `performance/chains.py`."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import list_facts, make_table

PARTS = "fast, separable, history, hit distances"
"""The pipeline whose parts are listed."""
MEGA = 1e6


def make_figures(measured: Mapping[str, Any], chains: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/export.md by place."""
    height, width = measured["size"]
    machine = measured["machine"]
    run = {
        "Frames": f"{width}x{height} pixels, {measured['spp']} samples per pixel",
        "Machine": f"{machine['processor']}, one thread; more threads share the rows",
    }
    return {
        "pipelines-run": list_facts(run),
        "pipelines": make_rows(measured["pipelines"]),
        "pipeline-parts": make_parts(measured["pipelines"][PARTS]),
        "chains": make_chain_rows(chains),
    }


def make_chain_rows(measured: Mapping[str, Any]) -> str:
    """Return the table of chains: time of a frame on a graphics card, and its most expensive passes."""
    header = ["chain", "radius", "passes", f"time on {measured['adapter']['device']}", "slowest pass"]
    rows = []
    for row in measured["chains"]:
        slowest = max(row["pass_ms"], key=row["pass_ms"].__getitem__)
        told = f"`{slowest}` {row['pass_ms'][slowest]:.2f} ms"
        radius = "5 sparse passes" if row["form"] == "atrous" else str(row["radius"])
        name = f"`{row['chain']}`, {row['form']}"
        rows.append([name, radius, str(len(row["pass_ms"])), f"{row['frame_ms']:.1f} ms", told])
    return make_table(header, rows)


def make_rows(pipelines: Mapping[str, Any]) -> str:
    """Return the table of pipelines: memory, processor time, kernels."""
    header = ["pipeline", "processor time per million pixels", "bytes per pixel", "of them state", "kernels"]
    rows = []
    for name, row in pipelines.items():
        seconds, planned = row["nanoseconds_per_pixel"] * MEGA / 1e9, row["planned_bytes_per_pixel"]
        numbers = [f"{row['bytes_per_pixel']:.0f}", f"{planned['state']:.0f}", str(row["kernels"])]
        rows.append([name, f"{seconds:.2f} s", *numbers])
    return make_table(header, rows)


def make_parts(row: Mapping[str, Any]) -> str:
    """Return the table of the parts of a pipeline, as shares of its time."""
    total = row["nanoseconds_per_pixel"]
    header = ["part", "share of the processor time"]
    shares = [[name, f"{100.0 * value / total:.0f} %"] for name, value in row["stages"].items()]
    return make_table(header, shares)
