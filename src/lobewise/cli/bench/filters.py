"""`lobewise bench`: times of filters and whole frames on this machine, as a flat list."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from lobewise import engine
from lobewise.backend.devices import choose_device, list_devices
from lobewise.cli.bench.machine import describe_machine
from lobewise.cli.bench.plane import make_features, make_frame
from lobewise.cli.bench.timing import time_best
from lobewise.denoising import denoise
from lobewise.errors import LobewiseError
from lobewise.features import Feature
from lobewise.filters.cross_filter import FilterOutput, run_filter
from lobewise.peers import denoise_oidn, has_oidn
from lobewise.recipes.upsampling import upsample
from lobewise.records.frame import Frame, Radiance
from lobewise.records.sparse_frame import make_sparse

Calls = dict[str, Callable[[], Any]]
Progress = Callable[[int, int], None]

FULL_SIZE, QUICK_SIZE = (1920, 1080), (512, 512)
RADIUS = 8
"""Filter radius, pixels, except of upsampling, which has its default."""
KERNEL_ROUNDS, RECIPE_ROUNDS = 8, 2
"""How often a kernel and a recipe are timed, after a run that compiles kernels."""
OIDN = {"fast": "OIDN, fast", "high": "OIDN, default"}
"""Names of the rows of Open Image Denoise, by its quality."""
PARTS = {
    "whole frames": "lobewise.denoise, diffuse and specular apart, radius 8; Open Image Denoise in the same turns",
    "one kernel, separable": "one run over one image of three channels, radius 8",
    "one kernel, full": "one run over one image of three channels, radius 8",
    "upsampling": "lobewise.upsample, one of 4x4 pixels shaded",
}
"""Parts of a measurement, in order, and the work that one time of each covers."""


def measure_filters(
    devices: Sequence[str] | None = None, *, size: tuple[int, int] = FULL_SIZE, progress: Progress | None = None
) -> dict[str, Any]:
    """Return the times of whole frames, kernels and upsampling on this machine, and of Open Image Denoise.

    Parameters
    ----------
    devices : sequence of str, optional
        Names from `lobewise.backend.devices.list_devices`; by default every device that runs here in hardware.
    size : (int, int)
        Width and height of the images.
    progress : callable, optional
        Called with (done, total) calls.

    Returns
    -------
    dict
        ``machine``, ``devices`` (descriptions), ``what`` (meaning of the times, by part), ``skipped`` (sentences) and
        ``rows``. A row has ``part``, ``device``, ``name``, ``width``, ``height`` and ``milliseconds`` (the shortest
        time).

    Raises
    ------
    InputError, DeviceError
        If a device is unknown or cannot run here.
    """
    known_devices = {device.name: device for device in list_devices()}
    if devices:
        names = [choose_device(name) for name in dict.fromkeys(devices)]
    else:
        names = [name for name, device in known_devices.items() if device.available and not device.is_software]
    skipped = [] if has_oidn() else ["Open Image Denoise is not installed: pip install 'lobewise[best]'."]
    frame = add_halves(make_frame(*size))
    jobs = [(name, *job) for name in names for job in list_jobs(frame, name, peers=name == names[0])]
    total = sum(len(calls) * (1 + rounds) for _, _, calls, rounds in jobs)
    done = itertools.count()

    def count(call: Callable[[], Any]) -> None:
        if progress is not None:
            progress(next(done), total)
        call()

    rows = []
    for device, part, calls, rounds in jobs:
        try:
            times = time_best({name: partial(count, call) for name, call in calls.items()}, 0.0, rounds=rounds)
        except LobewiseError as problem:
            # The device may be able to run the other jobs.
            skipped.append(f"{part} on {device}: {problem}")
            continue
        facts = {"part": part, "device": device, "width": size[0], "height": size[1]}
        rows += [{**facts, "name": name, "milliseconds": round(1e3 * value, 3)} for name, value in times.items()]
    if progress is not None:
        progress(total, total)
    return {
        "machine": describe_machine(),
        "devices": {name: known_devices[name].reason for name in names},
        "what": PARTS,
        "skipped": skipped,
        "rows": rows,
    }


def list_jobs(frame: Frame, device: str, *, peers: bool = True) -> Iterator[tuple[str, Calls, int]]:
    """Yield part, calls that are timed in turn, and rounds; ``peers`` adds Open Image Denoise where it is installed."""
    run = partial(denoise, frame, radius=RADIUS, device=device)
    recipes: Calls = {
        f"fast, {similarity}, {form}": partial(run, quality="fast", similarity=similarity, form=form)
        for similarity in ("sg", "ggx")
        for form in ("separable", "full")
    }
    recipes |= {quality: partial(run, quality=quality) for quality in ("balanced", "high")}
    if peers and has_oidn():
        # The guides of this frame have no noise, and need no filter.
        call = partial(denoise_oidn, frame, guides="centre")
        recipes |= {name: partial(call, quality=quality) for quality, name in OIDN.items()}
    yield "whole frames", recipes, RECIPE_ROUNDS
    features = make_features(frame)
    for form in ("separable", "full"):
        yield f"one kernel, {form}", make_kernel_calls(frame, features, RADIUS, form, device), KERNEL_ROUNDS
    fill = partial(upsample, make_sparse(frame, 4), device=device)
    by_lobes = {name: partial(fill, similarity=name) for name in ("normal", "sg", "ggx")}
    yield "upsampling", {"bilinear": partial(fill, bilinear=True), **by_lobes}, RECIPE_ROUNDS


def make_kernel_calls(
    frame: Frame, features: Mapping[str, list[Feature]], radius: int, form: str, device: str = "cpu"
) -> Calls:
    """Return functions that filter one image with each list of features; Open Image Denoise also gets one image."""

    def run(chosen: list[Feature]) -> FilterOutput:
        with engine.on(device):
            return run_filter(frame.radiance.color, np.ones(frame.shape, dtype=bool), chosen, form=form, radius=radius)

    return {name: partial(run, chosen) for name, chosen in features.items()}


def add_halves(frame: Frame) -> Frame:
    """Return the frame with two halves of its samples, which the qualities above "fast" use."""
    share = np.random.default_rng(1).random(frame.shape, dtype=np.float32)[..., None]

    def scale(weight: Any) -> Radiance:
        parts = {name: getattr(frame.radiance, name) for name in ("color", "diffuse", "specular")}
        return Radiance(**{name: 2.0 * weight * image for name, image in parts.items()})

    return frame.with_changes(half_a=scale(share), half_b=scale(1.0 - share))


def make_tables(measured: Mapping[str, Any]) -> dict[str, tuple[list[str], list[list[str]]]]:
    """Return header and rows of a table for each part of a measurement, by its title.

    Ratios are to "normal" on the same device. Whole frames have no such row, and are compared with Open Image Denoise.
    """
    tables = {}
    rows = measured["rows"]
    for part in dict.fromkeys(row["part"] for row in rows):
        chosen = [row for row in rows if row["part"] == part]
        normal = {row["device"]: row["milliseconds"] for row in chosen if row["name"] == "normal"}
        peers = {row["name"]: row["milliseconds"] for row in chosen if row["name"] in OIDN.values()}
        lines = []
        for row in chosen:
            time = row["milliseconds"]
            ratios = [time / normal[row["device"]]] if normal else [peer / time for peer in peers.values()]
            # Open Image Denoise chooses its device itself.
            device = "" if row["name"] in peers else row["device"]
            lines.append([row["name"], device, f"{time:.1f}", *(f"{ratio:.2f}" for ratio in ratios)])
        compared = ["over normal"] if normal else [f"{name}, over it" for name in peers]
        title = f"{part}, {chosen[0]['width']}x{chosen[0]['height']}"
        tables[title[0].upper() + title[1:]] = ["what", "device", "ms", *compared], lines
    return tables
