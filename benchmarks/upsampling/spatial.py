"""One sparse frame alone: bilinear, geometry-aware and lobe-aware weights, tuned and at their defaults."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

from benchmarks.upsampling.errors import (
    measure,
    select_bins,
)
from benchmarks.upsampling.shots import (
    ORBIT,
    SCALE,
    Cache,
)
from lobewise.metrics import rel_mse
from lobewise.sparse_frame import SparseFrame
from lobewise.upsampling import upsample

PLACE_GRID: dict[str, tuple[Any, ...]] = {
    "radius": (2, 3, 5, 7, 9, 12, 16),
    "screen_sigma": (3.0, 6.0, 10.0, 20.0, 40.0, 100.0),
    "position_sigma": (4.0, 8.0, 16.0, 24.0, 40.0, 64.0, 96.0),
}
GEOMETRY_GRID = {**PLACE_GRID, "normal_exponent": (1.0, 4.0, 16.0, 32.0, 64.0, 128.0, 256.0, 1024.0)}
LOBE_GRID = {
    **PLACE_GRID,
    "beta": (0.5, 1.0, 2.0, 4.0, 8.0),
    "diffuse_beta": (0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0),
    "tau": (0.03, 0.06, 0.09, 0.12, 0.16, 0.2),
}
STARTS: tuple[dict[str, Any], ...] = (
    {"radius": 5, "screen_sigma": 20.0, "position_sigma": 16.0, "tau": 0.12, "normal_exponent": 64.0},
    {"radius": 9, "screen_sigma": 40.0, "position_sigma": 24.0, "tau": 0.06, "normal_exponent": 16.0},
)


def tune(
    evaluate: Callable[[dict[str, Any]], float],
    grid: Mapping[str, Sequence[Any]],
    starts: Sequence[Mapping[str, Any]] = STARTS,
) -> tuple[dict[str, Any], int]:
    """Return the best settings that a search along one coordinate after the other finds, and how many it tried."""
    known: dict[tuple[Any, ...], float] = {}

    def look_up(point: dict[str, Any]) -> float:
        key = tuple(point[name] for name in grid)
        if key not in known:
            known[key] = evaluate(point)
        return known[key]

    best: dict[str, Any] = {}
    for start in starts:
        # A parameter that the start leaves open begins in the middle of its values.
        point = {name: start.get(name, values[len(values) // 2]) for name, values in grid.items()}
        before = float("inf")
        while look_up(point) < before:
            before = look_up(point)
            for name, values in grid.items():
                point = min(({**point, name: value} for value in values), key=look_up)
        if not best or look_up(point) < look_up(best):
            best = point
    return best, len(known)


def run_spatial(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """One sparse frame alone: bilinear, geometry-aware, lobe-aware."""
    row: dict[str, Any] = {}
    for light, shot in ORBIT.items():
        frame = cache.fetch_shot(shot, SCALE)[-1]
        assert isinstance(frame, SparseFrame)
        reference, cells = cache.fetch_mean(shot, shot.frames - 1)
        masks = select_bins(frame)
        share = {name: float(mask.mean()) for name, mask in masks.items()}

        def search(
            grid: Mapping[str, Sequence[Any]], starts: Sequence[Mapping[str, Any]] = STARTS, **fixed: Any
        ) -> dict[str, Any]:
            def evaluate(point: dict[str, Any]) -> float:
                return rel_mse(upsample(frame, **fixed, **point).image, reference)  # noqa: B023 - called at once

            point, tried = tune(evaluate, grid, starts)
            image = upsample(frame, **fixed, **point).image  # noqa: B023 - called at once
            return {**measure(image, reference, masks), "settings": point, "tried": tried}  # noqa: B023

        cells |= {"share": share, "bilinear": measure(upsample(frame, bilinear=True).image, reference, masks)}
        cells["normal (tuned)"] = search(GEOMETRY_GRID, similarity="normal")
        for similarity in ("ggx", "asg", "sg", "sg_mixture"):
            cells[similarity] = measure(upsample(frame, similarity=similarity).image, reference, masks)
            # The others begin where the first one ended.
            starts = [cells["ggx (tuned)"]["settings"]] if "ggx (tuned)" in cells else STARTS
            cells[f"{similarity} (tuned)"] = search(LOBE_GRID, starts, similarity=similarity)
        best = cells["ggx (tuned)"]["settings"]
        hits = upsample(frame, similarity="ggx", hit_distance=True, **best).image
        cells["ggx (tuned) with hits"] = measure(hits, reference, masks)
        default = upsample(frame)
        cells["default"] = {**measure(default.image, reference, masks), "settings": default.settings}
        geometry = cells["normal (tuned)"]
        cells["tuned_over_normal"] = cells["ggx (tuned)"]["rel_mse"] / geometry["rel_mse"]
        cells["tuned_over_normal_specular"] = cells["ggx (tuned)"]["rel_mse, specular"] / geometry["rel_mse, specular"]
        cells["default_over_normal"] = cells["default"]["rel_mse"] / geometry["rel_mse"]
        for name, value in cells.items():
            if isinstance(value, dict) and "rel_mse" in value:
                print(f"spatial {light:8} {name:22} {value['rel_mse']:.5f}  specular {value['rel_mse, specular']:.5f}")
        print(
            f"spatial {light:8} tuned ggx / tuned normal {cells['tuned_over_normal']:.3f}, specular "
            f"{cells['tuned_over_normal_specular']:.3f}; default / tuned normal {cells['default_over_normal']:.3f}",
            flush=True,
        )
        row[light] = cells
    return row


def list_spatial_settings(rows: Mapping[str, Any], light: str) -> dict[str, dict[str, Any]]:
    """Return the settings to run: the defaults, and those that `run_spatial` found if it ran."""
    settings: dict[str, dict[str, Any]] = {"default": {}}
    if "spatial" in rows:
        settings["tuned"] = rows["spatial"][light]["ggx (tuned)"]["settings"]
    return settings
