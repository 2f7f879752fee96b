"""Time of a frame with its history, stage by stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

import numpy as np

from benchmarks.common import fetch_frame
from benchmarks.upsampling.shots import (
    SCALE,
    SCENE,
    SPP,
    Cache,
)
from lobewise import TemporalFilter
from lobewise.bench.timing import time_best
from lobewise.frame import Frame, Radiance
from lobewise.render import (
    get_camera,
    load_scene,
    render_frame,
)
from lobewise.sparse_frame import list_places, make_sparse
from lobewise.upsampling import upsample


@contextmanager
def watch(places: Mapping[str, tuple[Any, str]], spent: dict[str, float]) -> Iterator[None]:
    """Add up in ``spent`` the seconds within functions, given as module and name."""
    originals = {stage: getattr(*place) for stage, place in places.items()}

    def wrap(stage: str, function: Callable[..., Any]) -> Callable[..., Any]:
        def timed(*arguments: Any, **options: Any) -> Any:
            begin = time.perf_counter()
            try:
                return function(*arguments, **options)
            finally:
                spent[stage] = spent.get(stage, 0.0) + time.perf_counter() - begin

        return timed

    for stage, (module, name) in places.items():
        setattr(module, name, wrap(stage, originals[stage]))
    try:
        yield
    finally:
        for stage, (module, name) in places.items():
            setattr(module, name, originals[stage])


def run_speed(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """1920x1080 from 480x270: time of a frame with history, by stage, beside upsampling without."""
    from lobewise.filters.history.accumulation import SampleGrid
    from lobewise.temporal import past, recipe

    places = {
        "layers": (recipe, "make_layers"),
        "marks": (past, "make_validation_features"),
        "places": (past, "_find_all_places"),
        "reprojection": (past, "run_reprojection"),
        "trust": (SampleGrid, "find_trust"),
        "samples": (SampleGrid, "accumulate"),
    }

    def render() -> Frame:
        scene = load_scene(SCENE, width=1920, height=1080)
        return render_frame(scene, spp=SPP, aov_only=True, previous_camera=get_camera(scene))

    guides = fetch_frame(cache.folder / "guides-1080.exr", render)
    rng = np.random.default_rng(0)
    light = rng.exponential(1.0, (*guides.shape, 3)).astype(np.float32)
    assert guides.gbuffer.diffuse_albedo is not None
    assert guides.gbuffer.specular_albedo is not None
    parts = light * guides.gbuffer.diffuse_albedo, light * guides.gbuffer.specular_albedo
    whole = replace(guides, radiance=Radiance(parts[0] + parts[1], diffuse=parts[0], specular=parts[1]), spp=SPP)
    frames = [make_sparse(whole, SCALE, place) for place in list_places(SCALE)]
    row: dict[str, Any] = {}
    for similarity in ("normal", "sg", "ggx"):
        for radius in (2, 5):
            options: dict[str, Any] = {"similarity": similarity, "radius": radius}
            temporal = TemporalFilter(**options)
            for frame in frames[:3]:
                temporal.add(frame)
            best, best_spent = float("inf"), dict[str, float]()

            def add() -> None:
                nonlocal best, best_spent
                spent: dict[str, float] = {}
                with watch(places, spent):
                    begin = time.perf_counter()
                    temporal.add(frames[3])  # noqa: B023 - called at once
                    seconds = time.perf_counter() - begin
                if seconds < best:
                    best, best_spent = seconds, {**spent, "rest": seconds - sum(spent.values())}

            calls = {"alone": lambda: upsample(frames[3], **options), "temporal": add}  # noqa: B023 - called at once
            times = time_best(calls, 2.0)
            row[f"{similarity}, radius {radius}"] = {
                "alone_milliseconds": round(1e3 * times["alone"], 1),
                "temporal_milliseconds": round(1e3 * best, 1),
                "temporal_over_alone": round(best / times["alone"], 2),
                "stages_milliseconds": {stage: round(1e3 * value, 1) for stage, value in best_spent.items()},
            }
            print(f"speed {similarity}, radius {radius}: {row[f'{similarity}, radius {radius}']}", flush=True)
    return row
