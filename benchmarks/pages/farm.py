"""The figures of docs/developers/robustness.md, measured by `robustness/farm.py`."""

from collections.abc import Mapping
from typing import Any

from benchmarks.pages.tables import list_facts, make_table


def make_farm_figures(measured: Mapping[str, Any]) -> dict[str, str]:
    """Return the figures of a farm by place."""
    return {"costs": make_costs(measured), "losses": make_losses(measured["parts"]["losses"])}


def make_costs(measured: Mapping[str, Any]) -> str:
    """Return the table of the time of a farm over the work divided by its workers."""
    parts, ratios = measured["parts"], measured["over_divided_work"]
    farm = parts["farm"]
    facts = list_facts(
        {
            "Frames": f"{farm['frames']} of {measured['width']}x{measured['height']} pixels, quality "
            f"`{measured['quality']}`, {measured['workers']} workers",
            "Machine": f"{farm['machine']['processor']}, {farm['machine']['cores']} cores",
        }
    )
    rows = []
    for name, suffix, key in (("processor time", "", "cpu_seconds"), ("wall time", "_quiet", "seconds")):
        work, whole = parts[f"work{suffix}"]["frame"][key], parts[f"farm{suffix}"]
        cells = [f"{work:.3f} s", f"{whole[key]:.1f} s", f"{ratios[key]:.2f}", whole["machine"]["commit"]]
        rows.append([name, *cells])
    header = ["", "one frame in one process", "the whole run", "run over divided work", "commit"]
    return f"{facts}\n\n{make_table(header, rows)}"


def make_losses(losses: Mapping[str, Any]) -> str:
    """Return what came of the frames when processes were killed."""
    return list_facts(
        {
            "Frames": losses["frames"],
            "With the bytes that one process writes": losses["same_bytes_as_one_process"],
            "Missing": losses["missing"],
            "Other files left over": losses["left_over"],
        }
    )
