"""Cameras of USD files, through OpenUSD's own library."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import subprocess
import sys
from pathlib import Path

import numpy as np

import lobewise
from lobewise.errors import FileError, InputError, MissingDependencyError
from lobewise.interchange.cameras.usd_stage import MAX_BYTES, MAX_SECONDS, MAX_WALL_SECONDS
from lobewise.io.files import require_readable
from lobewise.records.camera import Camera

PROGRAM = "lobewise.interchange.cameras.usd_stage"


def read_usd_camera(path: Path) -> Camera:
    """Return the first camera of a stage, at the first time of the stage.

    A process of its own reads the stage, within `MAX_SECONDS` of processor time and `MAX_BYTES`. Every layer must be a
    plain file in the folder of the stage's root layer, or in a folder below it.

    Raises
    ------
    FileError
        If the file cannot be read.
    InputError
        If the file has no camera, its first camera is no pinhole, a layer lies elsewhere, or reading takes too long or
        too much memory.
    MissingDependencyError
        If OpenUSD is not installed.
    """
    if importlib.util.find_spec("pxr") is None:
        raise MissingDependencyError(
            "Cameras of USD files need OpenUSD", action="pip install 'lobewise[usd]', or write the camera as JSON"
        )
    what = f"camera {str(path)!r}"
    require_readable(path, what="camera", holds="a USD stage")
    answer = json.loads(_run_reader(path, what))
    if "error" in answer:
        raise {"FileError": FileError, "InputError": InputError}[answer["error"]](**answer["fields"])
    found = {name: np.array(values, dtype=np.float64) for name, values in answer["camera"].items()}
    low, high = found["low"], found["high"]
    if not np.isfinite([low, high]).all():
        raise InputError(
            what, expected="a finite aperture and focal length", got=f"a window from {low} to {high}", action="check it"
        )
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    return Camera(
        found["position"],
        found["forward"],
        found["up"],
        2.0 * math.atan(half[1]),
        2.0 * math.atan(half[0]),
        (float(middle[0]), float(middle[1])),
    )


def _run_reader(path: Path, what: str) -> bytes:
    """Return the last line that the reading process prints, a JSON document."""
    settings = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path)),
        # Each thread of OpenUSD takes 64 MiB of address space, which is limited.
        "PXR_WORK_THREAD_LIMIT": "1",
    }
    expected = f"a stage that OpenUSD reads within {MAX_SECONDS} s of processor time and {MAX_BYTES >> 30} GiB"
    got, action = "one that needs more, or that is damaged", "export the camera alone, into one file"
    try:
        done = subprocess.run(
            [sys.executable, "-m", PROGRAM, os.getcwd(), path],
            # "-m" imports from this folder first: it must not be one of the user's.
            cwd=Path(lobewise.__file__).parents[1],
            env=settings,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            timeout=MAX_WALL_SECONDS,
            check=False,
        )
        if done.returncode == 0:
            return done.stdout.splitlines()[-1]
    except subprocess.TimeoutExpired:
        expected, got = f"an answer of OpenUSD within {MAX_WALL_SECONDS} s", "none"
        action = "try again when the machine is less busy, or export the camera alone, into one file"
    raise InputError(what, expected=expected, got=got, action=action)
