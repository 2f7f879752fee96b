"""The figures of docs/developers/releasing.md, measured by ``python -m releasing.wheels``."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import list_facts, make_table


def make_figures(measured: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/releasing.md by place."""
    return {"installation": f"{list_wheel(measured)}\n\n{make_rows(measured['installed'])}"}


def list_wheel(measured: Mapping[str, Any]) -> str:
    """Return what the wheel is: its size, its kernels, the machine that measured it."""
    machine = measured["machine"]
    libraries = ", ".join(f"`{each['file']}` {each['megabytes']:.1f} MB" for each in measured["libraries"])
    return list_facts(
        {
            "Wheel": f"{measured['wheel']['megabytes']:.1f} MB",
            "Compiled filters": f"{measured['kernels']} kernels in each of {libraries}",
            "Machine": f"{machine['processor']}, {machine['cores']} cores, commit {machine['commit']}",
        }
    )


def make_rows(installed: list[Mapping[str, Any]]) -> str:
    """Return the table of sizes and times by version of Python."""
    header = ["Python", "installed, without NumPy", "NumPy", "first `denoise`", "a later one"]
    rows = []
    for row in installed:
        sizes = [f"{row['megabytes_without_numpy']:.0f} MB", f"{row['megabytes']['numpy']:.0f} MB"]
        times = [f"{row[f'{call}_processor_seconds']:.1f} s" for call in ("first", "second")]
        rows.append([row["python"], *sizes, *times])
    return make_table(header, rows)
