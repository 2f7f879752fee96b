"""`lobewise bench`: times of filters and whole frames on this machine, as a flat list."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from typing import Any

from lobewise.backend.devices import choose_device, list_devices
from lobewise.bench.machine import describe_machine
from lobewise.bench.plan import (
    FULL,
    KERNEL_TURNS,
    MEANINGS_OF_TIMES,
    RADIUS,
    Extent,
    describe_size,
    list_jobs,
    list_threads,
    make_core_calls,
)
from lobewise.bench.timing import keep_best, open_pools, time_best
from lobewise.errors import LobewiseError
from lobewise.peers import has_oidn

Progress = Callable[[int, int], None]


def measure_filters(
    devices: Sequence[str] | None = None, *, extent: Extent = FULL, progress: Progress | None = None
) -> dict[str, Any]:
    """Return the times of kernels, upsampling and denoising on this machine, and of Open Image Denoise.

    Parameters
    ----------
    devices : sequence of str, optional
        Names from `lobewise.backend.devices.list_devices`; by default every device that runs here in hardware.
    extent : Extent
        The sizes and settings that are measured.
    progress : callable, optional
        Called with (done, total), in tenths of a second that the work takes on two cores.

    Returns
    -------
    dict
        ``machine``, ``devices`` (descriptions), ``what`` (meaning of the times, by part), ``skipped`` (sentences),
        ``seconds`` (in total) and ``rows``. A row has ``part``, ``device``, ``name``, ``milliseconds`` (the shortest
        time), and the settings of its part: some of ``width``, ``height``, ``form``, ``radius``, ``lobes``, ``scale``
        and ``threads``.

    Raises
    ------
    InputError, DeviceError
        If a device is unknown or cannot run here.
    """
    start = time.perf_counter()
    known_devices = {device.name: device for device in list_devices()}
    if devices:
        names = [choose_device(name) for name in dict.fromkeys(devices)]
    else:
        names = [name for name, device in known_devices.items() if device.available and not device.is_software]
    jobs = [job for name in names for job in list_jobs(extent, name, peers=name == names[0])]
    threads = list_threads() if "cpu" in names else []
    seconds_per_count = 4.0 + extent.seconds
    total = sum(job.effort for job in jobs) + seconds_per_count * len(threads)
    done = 0.0

    def advance(effort: float) -> None:
        nonlocal done
        done += effort
        if progress is not None:
            progress(round(10.0 * done), round(10.0 * total))

    advance(0.0)
    rows: list[dict[str, Any]] = []
    skipped = [] if has_oidn() else ["Open Image Denoise is not installed: pip install 'lobewise[best]'."]
    if threads:
        rows += _time_threads(threads, extent)
        advance(seconds_per_count * len(threads))
    best: dict[int, dict[str, float]] = {}
    for turn in range(max(job.turns for job in jobs)):
        for place, job in enumerate(jobs):
            # Do not repeat a job that failed in its first turn.
            if turn >= job.turns or (turn and place not in best):
                continue
            try:
                times = time_best(job.make(), extent.seconds / job.turns, rounds=math.ceil(job.rounds / job.turns))
                best[place] = keep_best(best.get(place), times)
            except LobewiseError as problem:
                # The device may be able to run the other jobs.
                skipped.append(f"{job.part} on {job.facts['device']}: {problem}")
            advance(job.effort / job.turns)
    for place, times in sorted(best.items()):
        job = jobs[place]
        rows += [_make_row(job.part, name, value, job.facts) for name, value in times.items()]
    if progress is not None:
        progress(round(10.0 * total), round(10.0 * total))
    order = list(MEANINGS_OF_TIMES)
    return {
        "machine": describe_machine(),
        "devices": {name: known_devices[name].reason for name in names},
        "what": MEANINGS_OF_TIMES,
        "skipped": skipped,
        "seconds": round(time.perf_counter() - start, 1),
        "rows": sorted(rows, key=lambda row: order.index(row["part"])),
    }


def _time_threads(counts: Sequence[int], extent: Extent) -> list[dict[str, Any]]:
    """Return the rows of times with each number of threads."""
    seconds = extent.seconds / KERNEL_TURNS
    best: dict[int, dict[str, float]] = {}
    with open_pools(counts) as pools:
        for _ in range(KERNEL_TURNS):
            for count, pool in pools.items():
                best[count] = keep_best(best.get(count), pool.submit(_time_core, extent, seconds).result())
    facts = {"device": "cpu", **describe_size(extent.size), "form": "separable", "radius": RADIUS}
    return [
        _make_row("threads", name, value, {**facts, "threads": count})
        for count, times in best.items()
        for name, value in times.items()
    ]


def _time_core(extent: Extent, seconds: float) -> dict[str, float]:
    return time_best(make_core_calls(extent), seconds, rounds=extent.rounds)


def _make_row(part: str, name: str, seconds: float, facts: dict[str, Any]) -> dict[str, Any]:
    return {"part": part, "name": name, **facts, "milliseconds": round(1e3 * seconds, 3)}
