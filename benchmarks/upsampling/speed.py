"""Time of a frame with its history, stage by stage."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.common import fetch_frame
from benchmarks.upsampling.shots import (
    SCALE,
    SCENE,
    SPP,
    Cache,
)
from lobewise import Camera, TemporalFilter
from lobewise.backend.jit import Kernel
from lobewise.bench.timing import time_best
from lobewise.chunks import count_cores
from lobewise.frame import Frame, Radiance
from lobewise.render import (
    find_orbit_centre,
    get_camera,
    load_scene,
    make_orbit,
    render_frame,
)
from lobewise.render.camera import set_camera
from lobewise.sparse_frame import SparseFrame, list_places, make_sparse
from lobewise.upsampling import upsample

WIDTH, HEIGHT = 1920, 1080
SWING, DEGREES = 4, 0.5
"""Frames from one end of the camera's swing to the other, and degrees from frame to frame."""
ROUNDS = 4
COPY_FLOATS = 1 << 26


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


@contextmanager
def count_bytes(moved: list[int]) -> Iterator[None]:
    """Add the bytes of all images that kernels read and write to ``moved``, each image once for each kernel."""
    original = Kernel.__call__

    def call(self: Kernel, **arguments: Any) -> None:
        images = [each.array for each in arguments.values() if hasattr(each, "array")]
        moved.append(sum(image.nbytes for image in images if 0 not in image.strides))
        original(self, **arguments)

    with patch.object(Kernel, "__call__", call):
        yield


def measure_copy() -> float:
    """Return the bytes per second that all cores read and write together while they copy arrays."""
    cores = count_cores()
    pairs = [(np.ones(COPY_FLOATS, np.float32), np.empty(COPY_FLOATS, np.float32)) for _ in range(cores)]

    def copy() -> None:
        with ThreadPoolExecutor(cores) as pool:
            list(pool.map(lambda pair: np.copyto(pair[1], pair[0]), pairs))

    return 2.0 * cores * 4 * COPY_FLOATS / time_best({"copy": copy}, 1.0)["copy"]


def make_frames(cache: Cache) -> list[SparseFrame]:
    """Return frames whose camera swings to and fro, every one with other samples."""
    scene = load_scene(SCENE, width=WIDTH, height=HEIGHT)
    cameras = make_orbit(get_camera(scene), find_orbit_centre(scene), frames=SWING, degrees_per_frame=DEGREES)
    rng = np.random.default_rng(0)

    def render(camera: Camera) -> Frame:
        set_camera(scene, camera)
        return render_frame(scene, spp=SPP, aov_only=True)

    frames = []
    for number, camera in enumerate(cameras):
        guides = fetch_frame(cache.folder / f"guides-{HEIGHT}-{number}.exr", lambda: render(camera))  # noqa: B023
        light = rng.exponential(1.0, (*guides.shape, 3)).astype(np.float32)
        assert guides.gbuffer.diffuse_albedo is not None
        assert guides.gbuffer.specular_albedo is not None
        parts = light * guides.gbuffer.diffuse_albedo, light * guides.gbuffer.specular_albedo
        radiance = Radiance(parts[0] + parts[1], diffuse=parts[0], specular=parts[1])
        place = list_places(SCALE)[number]
        frames.append(make_sparse(replace(guides, radiance=radiance, spp=SPP), SCALE, place))
    return [*frames, *frames[-2:0:-1]]


def run_speed(cache: Cache, rows: dict[str, Any]) -> dict[str, Any]:
    """1920x1080 from 480x270: time of a frame with history, by stage, beside upsampling without."""
    from lobewise.filters.history.accumulation import SampleGrid
    from lobewise.temporal import past, recipe, validation

    places = {
        "lobes": (recipe, "split_lobes"),
        "places": (past, "_find_all_places"),
        "planes": (validation, "prepare_pixels"),
        "reprojection": (past, "reproject"),
        "trust": (SampleGrid, "compute_trust"),
        "samples": (SampleGrid, "accumulate"),
        "join": (recipe, "join_layers"),
    }
    frames, speed = make_frames(cache), measure_copy()
    row: dict[str, Any] = {"copy_gigabytes_per_second": round(1e-9 * speed, 1)}
    for similarity in ("normal", "sg", "ggx"):
        for radius in (2, 5):
            options: dict[str, Any] = {"similarity": similarity, "radius": radius}
            temporal = TemporalFilter(**options)
            for frame in frames:
                temporal.add(frame)
            found: list[dict[str, float]] = []
            moved: list[int] = []
            for _ in range(ROUNDS):
                for frame in frames:
                    spent: dict[str, float] = {}
                    with watch(places, spent):
                        begin = time.perf_counter()
                        temporal.add(frame)
                        seconds = time.perf_counter() - begin
                    found.append({"all": seconds, **spent, "rest": seconds - sum(spent.values())})
            with count_bytes(moved):
                temporal.add(frames[0])
            # The machine has other work: the least time of a stage is the time that it needs.
            least = {stage: 1e3 * min(each[stage] for each in found) for stage in found[0]}
            alone = 1e3 * time_best({"alone": lambda: upsample(frames[0], **options)}, 2.0)["alone"]  # noqa: B023
            row[f"{similarity}, radius {radius}"] = {
                "alone_milliseconds": round(alone, 1),
                "temporal_milliseconds": round(least["all"], 1),
                "temporal_over_alone": round(least["all"] / alone, 2),
                "stages_milliseconds": {name: round(value, 1) for name, value in least.items() if name != "all"},
                "kernels": len(moved),
                "gigabytes": round(1e-9 * sum(moved), 2),
                "roofline_milliseconds": round(1e3 * sum(moved) / speed, 1),
            }
            print(f"speed {similarity}, radius {radius}: {row[f'{similarity}, radius {radius}']}", flush=True)
    return row
