"""The figures of docs/developers/bands.md, measured by `performance/streaming.py`."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import list_facts, make_table


def make_figures(measured: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of docs/developers/bands.md by place."""
    machine = next(iter(measured["rows"].values()))["machine"]
    width, height = measured["size"]
    small = "x".join(map(str, measured["small_size"]))
    run = {
        "File": (
            f"{width}x{height} pixels, {measured['channels']} channels, {measured['large_bytes'] / 1e9:.1f} GB as ZIP"
        ),
        "Times per pixel": f"as multiples of those of a frame of {small} that is filtered as a whole",
        "Machine": f"{machine['processor']}, {machine['cores']} cores",
    }
    return {"run": list_facts(run), "qualities": make_rows(measured)}


def make_rows(measured: Mapping[str, Any]) -> str:
    """Return the table of the qualities."""
    header = ["", "peak memory", "time", "processor time", "time per pixel", "processor time per pixel", "commit"]
    rows = []
    for name, row in measured["rows"].items():
        bands = row["bands"]
        ratios = [f"{row[f'{key}_per_pixel_ratio']:.2f}" for key in ("seconds", "cpu_seconds")]
        times = [f"{bands[key]:.0f} s" for key in ("seconds", "cpu_seconds")]
        kind = f"`{name}`" + (", `sg`" if name == "fast" else "")
        rows.append([kind, f"{bands['peak_gib']:.2f} GiB", *times, *ratios, row["machine"]["commit"]])
    return make_table(header, rows)
