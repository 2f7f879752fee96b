"""The frame of the images that a denoiser is given, and the memory of the frames before."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.errors import InputError
from lobewise.interchange.mapping import ORDERS
from lobewise.interchange.reading import import_planes
from lobewise.recipes.temporal import TemporalFilter
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import DenoiseSettings

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
    used = {name for image in imported.map.roles.values() for name in image.channels}
    idle = list(dict.fromkeys(name.rpartition(".")[0] or name for name in passed.others if name not in used))
    notes = [note.replace("given.", "") for note in imported.notes if "There are images of the same kind" not in note]
    if idle:
        notes.append(f"AOVs that lobewise does not use: {', '.join(idle)}.")
    return imported.frame, notes


def list_channels(layers: Mapping[str, tuple[FloatArray, tuple[str, ...]]]) -> dict[str, FloatArray]:
    """Return the channels of layers, (height, width) each, by the names that they have in a file."""
    return {
        f"{name}.{component}": np.ascontiguousarray(image[..., k])
        for name, (image, components) in layers.items()
        for k, component in enumerate(components)
    }


MAX_RELATIVE_DIFFERENCE = 2e-3
"""Largest relative difference of equal images. It allows for storage in 16-bit floats."""


class History:
    """Memory of a temporal denoiser.

    The history of a pixel holds more than the previous image, such as its number of samples and its surface. It is kept
    here. The previous image that the caller passes only shows whether the sequence goes on.

    Parameters
    ----------
    settings, changes
        Settings of `lobewise.TemporalFilter`.
    """

    def __init__(self, settings: DenoiseSettings | None, changes: Any) -> None:
        self._filter = TemporalFilter(settings, **changes)
        self._last: FloatArray | None = None

    def add(self, frame: Frame, previous: FloatArray, noisy: FloatArray) -> FloatArray:
        """Return the denoised image of the next frame, (height, width, 3).

        Parameters
        ----------
        frame : Frame
            The frame, with motion.
        previous : array, shape (height, width, 1 or 3)
            The last image passed to `remember`. The noisy image or black begins a new sequence.
        noisy : array, shape (height, width, 1 or 3)
            The noisy image of this frame.

        Raises
        ------
        InputError
            If ``previous`` is any other image.
        """
        goes_on = self._last is not None and _is_same(previous, self._last)
        if not goes_on and previous.any() and not _is_same(previous, noisy):
            raise InputError(
                "previous_denoised",
                expected="what this denoiser returned last, or the noisy image to begin anew",
                got="another image",
                action="pass one of them, and flow beside it: the history itself stays in the denoiser",
            )
        if not goes_on:
            self._filter.reset()
        return self._filter.add(frame).image

    def remember(self, image: FloatArray) -> None:
        """Store the image that was returned for a frame."""
        self._last = image.copy()


def _is_same(image: FloatArray, other: FloatArray) -> bool:
    return image.shape == other.shape and np.allclose(
        image, other, rtol=MAX_RELATIVE_DIFFERENCE, atol=1e-6, equal_nan=True
    )
