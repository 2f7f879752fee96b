"""Cameras of USD files, through OpenUSD's own library."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from lobewise.camera import Camera
from lobewise.errors import FileError, InputError, MissingDependencyError
from lobewise.io.files import require_readable


def read_usd_camera(path: Path) -> Camera:
    """Return the first camera of a stage, at the first time of the stage.

    Raises
    ------
    FileError
        If the file cannot be read.
    InputError
        If the file has no camera, or its first camera is no pinhole.
    MissingDependencyError
        If OpenUSD is not installed.
    """
    try:
        from pxr import Gf, Tf, Usd, UsdGeom
    except ImportError as problem:
        raise MissingDependencyError(
            "Cameras of USD files need OpenUSD: pip install 'lobewise[usd]', or write the camera as JSON."
        ) from problem
    what = f"camera {str(path)!r}"
    require_readable(path, what="camera", holds="a USD stage")
    try:
        stage = Usd.Stage.Open(str(path))
        prims = [prim for prim in stage.Traverse() if prim.IsA(UsdGeom.Camera)]
        if not prims:
            raise InputError(what, expected="a camera", got="none", action="export cameras as well")
        # OpenUSD reads values, and raises errors about them, only on access.
        time = stage.GetStartTimeCode() if stage.HasAuthoredTimeCodeRange() else Usd.TimeCode.Default()
        camera: Any = UsdGeom.Camera(prims[0]).GetCamera(time)
    except Tf.ErrorException as problem:
        raise FileError(
            what, expected="a USD stage", got="none that can be read", action="export it again"
        ) from problem
    if camera.projection != Gf.Camera.Perspective:
        raise InputError(what, expected="a perspective camera", got="an orthographic one", action="render with one")
    frustum = camera.frustum
    # The window lies on the plane at distance 1.
    low, high = (np.array(corner) for corner in (frustum.window.min, frustum.window.max))
    if not np.isfinite([low, high]).all():
        raise InputError(
            what, expected="a finite aperture and focal length", got=f"a window from {low} to {high}", action="check it"
        )
    half, middle = 0.5 * (high - low), 0.5 * (high + low)
    return Camera(
        np.array(frustum.position),
        np.array(frustum.ComputeViewDirection()),
        np.array(frustum.ComputeUpVector()),
        2.0 * math.atan(half[1]),
        2.0 * math.atan(half[0]),
        (float(middle[0]), float(middle[1])),
    )
