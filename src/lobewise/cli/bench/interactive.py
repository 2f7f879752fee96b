"""Times of the stages of the interactive renderer while the camera moves."""

from __future__ import annotations

import itertools
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, replace
from functools import partial
from multiprocessing import get_context
from statistics import median
from typing import TYPE_CHECKING, Any

from lobewise.cli.bench.machine import describe_machine
from lobewise.errors import InputError

if TYPE_CHECKING:
    from lobewise.interactive import InteractiveSettings, Session
    from lobewise.records.camera import Camera

DEGREES_PER_FRAME = 1.0
"""Turn of the camera on its orbit."""
WARM_UP_FRAMES = 4
"""First frames of each run that are not timed: they compile kernels."""

Progress = Callable[[int, int], None]


def measure_interactive(
    scene: str = "showroom",
    *,
    sizes: Sequence[tuple[int, int]] = ((512, 512), (1024, 1024)),
    methods: Sequence[str] | None = None,
    settings: InteractiveSettings | None = None,
    frames: int = 24,
    device: str = "auto",
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Return the stage times of a session whose camera moves along an orbit, one degree per frame.

    Parameters
    ----------
    scene : str
        A scene of `lobewise.render.load_scene`.
    sizes : sequence of (int, int)
        Width and height of the images.
    methods : sequence of str, optional
        Methods of indirect light; by default all.
    settings : InteractiveSettings, optional
        All settings but the method.
    frames : int
        Frames that are timed, >= 1.
    device : {"auto", "cpu", "cuda"}
        Device that traces rays; "auto" chooses as `lobewise.render.load_mitsuba` does.
    progress : callable, optional
        Called with ``(done, total)`` frames.

    Returns
    -------
    dict
        ``machine``, ``device``, ``scene``, ``settings`` and ``rows``. For each method and size a row has the median
        seconds of every stage and of the whole frame (``frame``, wall time), the frames per second, and the seconds
        before the first frame (``prepare``).

    Raises
    ------
    InputError, DeviceError, FileError, UnsupportedBsdfError, MissingDependencyError
        See `lobewise.interactive.Session` and `lobewise.render.load_mitsuba`.
    """
    from lobewise.interactive import InteractiveSettings, Session
    from lobewise.interactive.settings import METHODS
    from lobewise.render import find_orbit_centre, load_mitsuba, make_orbit

    if frames < 1:
        raise InputError("frames", expected="at least 1", got=str(frames), action="24 is usual")
    variant = load_mitsuba(device).variant()
    base_settings = settings or InteractiveSettings()
    names = list(methods or METHODS)
    frames_per_row = frames + WARM_UP_FRAMES
    total = frames_per_row * len(names) * len(sizes)
    done = itertools.count(1)

    def advance() -> None:
        if progress is not None:
            progress(next(done), total)

    rows = []
    session = Session(scene)
    cameras = make_orbit(session.camera, find_orbit_centre(session.scene), frames_per_row, DEGREES_PER_FRAME)
    for name in names:
        changes: dict[str, Any] = {"method": name}
        chosen = replace(base_settings, **changes)
        start = time.perf_counter()
        session.prepare(name)
        ready = time.perf_counter() - start
        for width, height in sizes:
            stream = session.make_sibling()
            stream.resize(width, height)
            row = _time_stages(stream, cameras, chosen, advance)
            facts = {"method": name, "width": width, "height": height, "seconds": row}
            rows.append({**facts, "frames_per_second": 1.0 / row["frame"], "prepare": ready})
    return {
        "machine": describe_machine(),
        "device": "cuda" if "cuda" in variant else "cpu",
        "scene": scene,
        "settings": {name: value for name, value in asdict(base_settings).items() if name != "method"},
        "frames": frames,
        "degrees_per_frame": DEGREES_PER_FRAME,
        "rows": rows,
    }


def _time_stages(
    stream: Session, cameras: Sequence[Camera], settings: InteractiveSettings, advance: Callable[[], None]
) -> dict[str, float]:
    """Return the median seconds of every stage, and of the whole frame, along a camera path."""
    seconds: list[dict[str, float]] = []
    for camera in cameras:
        start = time.perf_counter()
        stages = stream.render(camera, settings).seconds
        seconds.append({**stages, "frame": time.perf_counter() - start})
        advance()
    counted = seconds[WARM_UP_FRAMES:]
    return {stage: median(item[stage] for item in counted) for stage in counted[0]}


def measure_devices(devices: Sequence[str] | None = None, **arguments: Any) -> dict[str, Any]:
    """Return the measurements of `measure_interactive` on each device that can trace rays.

    Each device is measured in its own process, because Mitsuba cannot change the device of a process.

    Parameters
    ----------
    devices : sequence of str, optional
        By default "cpu", and "cuda" where there is an NVIDIA GPU.
    **arguments
        Parameters of `measure_interactive`; with several devices ``progress`` is not called.

    Returns
    -------
    dict
        ``machine``, ``scene``, ``settings``, ``frames``, ``degrees_per_frame``, and by device the ``rows``.

    Raises
    ------
    InputError, DeviceError, FileError, UnsupportedBsdfError, MissingDependencyError
        See `measure_interactive`.
    """
    names = list(devices or list_render_devices())
    if len(names) == 1:
        measurements = [measure_interactive(device=names[0], **arguments)]
    else:
        arguments.pop("progress", None)
        measurements = []
        for name in names:
            with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
                measurements.append(pool.submit(partial(measure_interactive, device=name, **arguments)).result())
    common = {name: value for name, value in measurements[0].items() if name not in ("device", "rows")}
    return {**common, "devices": {measured["device"]: measured["rows"] for measured in measurements}}


def list_render_devices() -> list[str]:
    """Return the devices that can trace rays: "cpu", and "cuda" where Dr.Jit finds an NVIDIA GPU.

    Another process asks Dr.Jit, because the first call to CUDA would bind this process to it.
    """
    code = "import drjit; print(drjit.has_backend(drjit.JitBackend.CUDA))"
    answer = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    return ["cpu", "cuda"] if answer.stdout.strip() == "True" else ["cpu"]
