"""The sums that make up a pixel's history, and conversions of images for the kernels that read and write them."""

from __future__ import annotations

from typing import Any, NamedTuple, cast

import numpy as np

from lobewise.backend.buffers import HostImage
from lobewise.backend.devices import count_host_lanes
from lobewise.errors import InputError
from lobewise.lobes.vectors import compute_image_luminance
from lobewise.records.frame import FloatArray


class Sums(NamedTuple):
    """Sums over the samples of a pixel, as expressions or images; in this order the channels of a history.

    Parameters
    ----------
    red, green, blue
        Sums of weight times radiance over albedo.
    weight, squared_weight
        Sums of weights, and of squared weights.
    moment
        Sum of weight times the squared luminance of radiance over albedo.
    frames
        Number of frames that were added.
    """

    red: Any
    green: Any
    blue: Any
    weight: Any
    squared_weight: Any
    moment: Any
    frames: Any

    @property
    def light(self) -> list[Any]:
        """The weighted radiance over albedo."""
        return [self.red, self.green, self.blue]

    def fade(self, share: Any) -> Sums:
        """Return the sums after multiplying every weight by ``share``."""
        faded = Sums(*(value * share for value in self))
        return faded._replace(squared_weight=faded.squared_weight * share)


HISTORY_CHANNELS = len(Sums._fields)


def split_sums(history: FloatArray) -> Sums:
    """Return views of the channels of a history (height, width, 7), by name."""
    return Sums(*np.moveaxis(history, -1, 0))


def add_to_sums(
    history: FloatArray, where: tuple[Any, Any], light: FloatArray, weight: FloatArray, growth: float
) -> None:
    """Add a mean of samples to each of some pixels of a history, in place.

    Parameters
    ----------
    history : array, shape (height, width, 7)
    where : (rows, columns)
    light : array, shape (count, 3)
        Mean radiance over albedo. Means that are not finite or negative add nothing.
    weight : array, shape (count,)
        How many samples, that match fully, each mean stands for.
    growth : float
        Power of the number of frames that the weight of a sample is; see `accumulation_pass`.
    """
    good: Any = np.isfinite(light).all(axis=-1) & (light >= 0.0).all(axis=-1)
    light = np.where(good[:, None], light, np.float32(0.0))
    weight = np.where(good, weight, np.float32(0.0))
    unit = np.maximum(history[(*where, Sums._fields.index("frames"))], np.float32(1.0)) ** np.float32(growth)
    luminance = compute_image_luminance(light)
    total = weight * unit
    added = [*(total * light[:, k] for k in range(3)), total, total * unit, total * luminance**2]
    for channel, value in enumerate(added):
        history[(*where, channel)] += value


def widen_to_vector(image: HostImage) -> HostImage:
    """Return an image that is at least as wide as a vector, by repeating its last column.

    Recorded images stay as they are: pipelines refuse narrow ones.
    """
    if not isinstance(image, np.ndarray) or image.shape[1] >= count_host_lanes():
        return image
    missing = count_host_lanes() - image.shape[1]
    return np.pad(image, [(0, 0), (0, missing), *[(0, 0)] * (image.ndim - 2)], mode="edge")


def cut(image: Any, width: int, axis: int = -1) -> Any:
    """Return an image, or a stack of planes, without the columns that `widen_to_vector` added."""
    if not isinstance(image, np.ndarray) or image.shape[axis] == width:
        return image
    return image[(slice(None),) * (axis % image.ndim) + (slice(width),)]


def join_channels(planes: Any) -> Any:
    """Return planes (count, height, width) as an image (height, width, count), a view; a list of planes stays one."""
    return np.moveaxis(planes, 0, -1) if isinstance(planes, np.ndarray) else planes


def get_channel(history: Any, number: int) -> Any:
    """Return a channel of a history (height, width, channels), or of a recorded one, whose planes come first."""
    return history[..., number] if isinstance(history, np.ndarray) else history[number]


def get_sums(history: Any) -> Any:
    """Return a history without what is not a sum."""
    return history[..., :HISTORY_CHANNELS] if isinstance(history, np.ndarray) else history[:HISTORY_CHANNELS]


def take_planes(history: Any) -> Any:
    """Return the sums of a history (height, width, 7 or more), planes first; a recorded history has them so."""
    return np.moveaxis(history, -1, 0) if isinstance(history, np.ndarray) else history


def split_history(history: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return a history channels first and at least as wide as a vector, without a copy if it is so in memory.

    Raises
    ------
    InputError
        If the history has another size.
    """
    if not isinstance(history, np.ndarray):  # recorded
        return cast(FloatArray, history)
    if history.shape[:2] != size or history.ndim != 3 or history.shape[2] < HISTORY_CHANNELS:
        raise InputError(
            "history",
            expected=f"sums of shape {(*size, HISTORY_CHANNELS)}",
            got=f"shape {history.shape}",
            action="give those of this image",
        )
    planes: FloatArray = take_planes(widen_to_vector(history[..., :HISTORY_CHANNELS]))
    if planes.dtype == np.float32 and planes.strides[2] == planes.itemsize:
        return planes
    return np.ascontiguousarray(planes, dtype=np.float32)
