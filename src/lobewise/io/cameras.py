"""The camera that an object in JSON describes, in files of cameras and of camera paths."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from lobewise.errors import InputError, require_choice
from lobewise.io.documents import describe_kind, require_number, require_numbers, show_value
from lobewise.records.camera import Camera


def make_camera(what: str, entry: Any, keys: Sequence[str], fov_y: float | None = None) -> Camera:
    """Return the camera of an object in JSON.

    It has ``position`` and either ``target``, a point, or ``forward``, a direction, as lists of three numbers. It may
    have ``up``, by default (0, 1, 0), the full angles of view ``fov_y`` and ``fov_x`` in degrees, and ``shift``.

    Parameters
    ----------
    what : str
        The object in messages.
    entry : object
        What the JSON holds.
    keys : sequence of str
        Those that the object may have.
    fov_y : float, optional
        Vertical angle of view of an object that tells none, radians. By default it must tell one.

    Raises
    ------
    InputError
        If it is no object, or describes no camera.
    """
    if not isinstance(entry, dict):
        raise InputError(what, expected="an object", got=describe_kind(entry), action="write position and target")
    for key in entry:
        require_choice(f"{what}, key", key, keys)
    if "position" not in entry or ("target" in entry) == ("forward" in entry):
        expected, got = "position, and either target or forward", ", ".join(entry) or "nothing"
        raise InputError(what, expected=expected, got=got, action="say where the camera is and where it looks")
    vectors = {
        name: require_numbers(f"{what}, {name}", entry[name], 3)
        for name in ("position", "target", "forward", "up")
        if name in entry
    }
    angles = {name: _read_angle(f"{what}, {name}", entry[name]) for name in ("fov_y", "fov_x") if name in entry}
    angle = angles.get("fov_y", fov_y)
    if angle is None:
        got = "fov_x alone" if angles else "neither fov_y nor fov_x"
        action = "add fov_y: the vertical angle of view, or both"
        raise InputError(what, expected="fov_y, in degrees", got=got, action=action)
    across, down = require_numbers(f"{what}, shift", entry.get("shift", [0.0, 0.0]), 2)
    position, up = vectors["position"], vectors.get("up", np.array([0.0, 1.0, 0.0]))
    with np.errstate(over="ignore"):  # `Camera` refuses numbers that are not finite
        forward = vectors["forward"] if "forward" in vectors else vectors["target"] - position
    if "target" in vectors and not forward.any():
        expected, got = "another point than position", f"{show_value(entry['target'])} for both"
        raise InputError(f"{what}, target", expected=expected, got=got, action="write the point that the camera sees")
    try:
        return Camera(position, forward, up, angle, angles.get("fov_x"), (float(across), float(down)))
    except InputError as problem:
        raise problem.place_in(what, InputError) from None


def _read_angle(what: str, value: Any) -> float:
    """Return an angle of view in radians, from degrees."""
    known = "an angle between 0 and 180 degrees"
    angle = require_number(what, value, expected=known, action="40 is usual")
    if not 0.0 < angle < 180.0:
        raise InputError(what, expected=known, got=f"{angle:g}", action="40 is usual")
    return math.radians(angle)
