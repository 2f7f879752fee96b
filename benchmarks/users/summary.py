"""What the cells of `benchmarks/users` amount to: mean ratios, and every cell in which a promise is broken."""

import math
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

NOISY, PEER = "noisy", "oidn"
BASES = (NOISY, PEER)
MOST_OVER_NOISY, MOST_OVER_PEER = 1.03, 1.02
"""Largest ratios of errors that are no broken promise: of any method over the input, of "auto" over the peer."""
MIXED = "auto"
PROMISED = ("balanced", "high", MIXED)
"""Methods that shall never be worse than the input. "fast" is counted beside them: it says so where it is."""
COUNTED = ("fast", *PROMISED)
HELD_OUT, TRAIN = "held out", "tuned on"
MOST_ENERGY = 0.005
"""Largest share of the frame's light that a method may take away or add."""
UNKNOWN = 0.001
"""Share of the pixels that count for no method: those at which the references differ most from each other."""
MOST_DOUBT = 0.25
"""Errors whose standard error is a larger share of them are left out of the means."""


class Row(NamedTuple):
    """The cells of one frame with one set of guides."""

    scene: str
    held_out: bool
    guides: str
    spp: int
    methods: Mapping[str, Mapping[str, float]]


def list_rows(scenes: Mapping[str, Any]) -> Iterator[Row]:
    """Yield what was measured, row by row."""
    for name, scene in scenes.items():
        for guides, by_spp in scene["guides"].items():
            for spp, row in by_spp.items():
                yield Row(name, scene["held_out"], guides, int(spp), row["methods"])


def summarise(scenes: Mapping[str, Any]) -> dict[str, Any]:
    """Return mean ratios by group of scenes, and the broken promises."""
    rows = list(list_rows(scenes))
    groups: dict[str, Callable[[Row], bool]] = {
        HELD_OUT: lambda row: row.held_out,
        **{name: lambda row, name=name: row.held_out and _get_group(row) == name for name in _list_groups(rows)},  # type: ignore[misc]
        TRAIN: lambda row: not row.held_out,
    }
    ratios = {
        name: {base: compute_ratios([row for row in rows if belongs(row)], base) for base in BASES}
        for name, belongs in groups.items()
        if any(belongs(row) for row in rows)
    }
    return {
        "ratios": ratios,
        "over noisy": list_broken(rows, NOISY, COUNTED, MOST_OVER_NOISY),
        "over oidn": list_broken(rows, PEER, (MIXED,), MOST_OVER_PEER),
        "energy": measure_lost_energy(rows),
    }


def _get_group(row: Row) -> str:
    return row.scene.partition("/")[0]


def _list_groups(rows: list[Row]) -> list[str]:
    return list(dict.fromkeys(_get_group(row) for row in rows if row.held_out))


def is_known(cell: Mapping[str, float]) -> bool:
    """Return whether the references tell the error of a cell."""
    return cell["doubt"] < MOST_DOUBT * cell["rel_mse"]


def compute_ratios(rows: list[Row], base: str) -> dict[str, dict[str, dict[str, dict[str, float]]]]:
    """Return by guides, method and sample count the geometric mean of the error over the base's, and of how many.

    A frame of which either error is not known to `MOST_DOUBT`, for the noise of the references, is left out.
    """
    logs: dict[tuple[str, str, int], list[float]] = {}
    for row in rows:
        below = row.methods.get(base)
        for method, cell in row.methods.items():
            if method != base and below is not None and is_known(cell) and is_known(below):
                ratio = cell["rel_mse"] / below["rel_mse"]
                logs.setdefault((row.guides, method, row.spp), []).append(math.log(ratio))
    found: dict[str, dict[str, dict[str, dict[str, float]]]] = {}
    for (guides, method, spp), values in sorted(logs.items(), key=lambda item: item[0][2]):
        cell = {"ratio": round(math.exp(sum(values) / len(values)), 4), "scenes": len(values)}
        found.setdefault(guides, {}).setdefault(method, {})[str(spp)] = cell
    return found


def list_broken(rows: list[Row], base: str, methods: tuple[str, ...], most: float) -> list[dict[str, Any]]:
    """Return the cells whose error is more than ``most`` of the base's, the worst first.

    "sure" says whether the excess over the base is more than twice its standard error.
    """
    found = []
    for row in rows:
        below = row.methods.get(base, {}).get("rel_mse", 0.0)
        for method in methods:
            cell = row.methods.get(method)
            if cell is None or below <= 0.0 or cell["rel_mse"] <= most * below:
                continue
            doubt = cell["doubt over noisy"] if base == NOISY else cell["doubt"]
            sure = cell["rel_mse"] - most * below > 2.0 * doubt
            place = {"scene": row.scene, "held_out": row.held_out, "guides": row.guides, "spp": row.spp}
            found.append({**place, "method": method, "ratio": round(cell["rel_mse"] / below, 3), "sure": sure})
    return sorted(found, key=lambda one: -one["ratio"])


def measure_lost_energy(rows: list[Row]) -> dict[str, dict[str, Any]]:
    """Return by method the least and the most energy that it kept, where, and in how many cells it is off."""
    found: dict[str, dict[str, Any]] = {}
    for row in rows:
        for method, cell in row.methods.items():
            one = found.setdefault(method, {"cells": 0, "off": 0, "least": [math.inf, ""], "most": [-math.inf, ""]})
            place = f"{row.scene}, {row.guides}, {row.spp} spp"
            one["cells"] += 1
            one["off"] += abs(cell["energy"] - 1.0) > MOST_ENERGY
            one["least"] = min(one["least"], [cell["energy"], place])
            one["most"] = max(one["most"], [cell["energy"], place])
    return found
