"""Frames from the images given to a denoiser, by the preset for Mitsuba's own files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from lobewise.interchange.mapping import ORDERS
from lobewise.interchange.reading import import_planes
from lobewise.records.frame import FloatArray, Frame

PRESET = "mitsuba"
COMPONENTS = {"depth": "T", "motion": "XY"}
"""Components of the roles that are neither colors nor vectors."""


@dataclass
class Given:
    """Images that a denoiser is called with.

    Parameters
    ----------
    color : array, shape (height, width, 3)
        The noisy image.
    roles : dict of str to array, shape (height, width, channels)
        Guides by role, in the conventions of lobewise's presets.
    others : dict of str to array, shape (height, width)
        Other channels of a bitmap, by name.
    """

    color: FloatArray
    roles: dict[str, FloatArray] = field(default_factory=dict)
    others: dict[str, FloatArray] = field(default_factory=dict)


def to_camera_space(normal: FloatArray, to_sensor: NDArray[np.float64] | None) -> FloatArray:
    """Return normals with x to the right, y upwards and z away from the camera, (height, width, 3).

    Mitsuba's sensor has x to the left, y upwards and z away. ``to_sensor`` transforms normals to the space of the
    sensor, by its transposed inverse. Source: `mitsuba.OptixDenoiser`, which negates x and z and so gets x to the right
    and z towards the camera.
    """
    matrix = np.diag([-1.0, 1.0, 1.0])
    if to_sensor is not None:
        matrix = matrix @ np.linalg.inv(to_sensor[:3, :3]).T
    return np.asarray(normal @ matrix.T, dtype=np.float32)


def make_frame(passed: Given) -> tuple[Frame, list[str]]:
    """Return the frame of the images given to a denoiser, and notes on what was converted or is missing.

    Raises
    ------
    InputError
        If the channels make no frame.
    """
    planes: dict[str, FloatArray] = {}
    mapping = {}
    for role, image in {"color": passed.color, **passed.roles}.items():
        letters = COMPONENTS.get(role) or ORDERS.get(role, ("RGB",))[0].upper()
        names = [f"given.{role}.{letter}" for letter in letters]
        planes |= {name: np.ascontiguousarray(image[..., k]) for k, name in enumerate(names)}
        convert = {"normal": ":camera_space", "motion": ":negate"}.get(role, "")
        mapping[role] = ",".join(names) + convert
    planes |= passed.others
    imported = import_planes(planes, preset=PRESET, mapping=mapping)
    assert imported.map is not None
    used = {name for image in imported.map.roles.values() for name in image.channels}
    idle = list(dict.fromkeys(name.rpartition(".")[0] or name for name in passed.others if name not in used))
    notes = [note.replace("given.", "") for note in imported.notes if "There are images of the same kind" not in note]
    if idle:
        notes.append(f"Not used: {', '.join(idle)}.")
    return imported.frame, notes


def list_channels(layers: Mapping[str, tuple[FloatArray, tuple[str, ...]]]) -> dict[str, FloatArray]:
    """Return the channels of layers, (height, width) each, by the names that they have in a file."""
    return {
        f"{name}.{component}": np.ascontiguousarray(image[..., k])
        for name, (image, components) in layers.items()
        for k, component in enumerate(components)
    }
