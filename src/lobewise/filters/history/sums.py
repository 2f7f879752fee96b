"""The sums that a pixel's history consists of, by name; and images as the kernels over time take and give them."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import halide as hl
import numpy as np

from lobewise.backend.buffers import HostImage, download, lend, make_output
from lobewise.backend.jit import Kernel
from lobewise.errors import InputError
from lobewise.frame import FloatArray


class Sums(NamedTuple):
    """What is known of a pixel: sums over its samples, as expressions or as images; the last axis of a history.

    Parameters
    ----------
    red, green, blue
        Of weight times radiance over albedo.
    weight, squared_weight
        Of weights, and of their squares.
    moment
        Of weight times the squared luminance over albedo.
    frames
        How many frames they stand for.
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
        """Return the sums when every weight is ``share`` times what it was."""
        faded = Sums(*(value * share for value in self))
        return faded._replace(squared_weight=faded.squared_weight * share)


HISTORY_CHANNELS = len(Sums._fields)


def split_sums(history: FloatArray) -> Sums:
    """Return views of the channels of a history (height, width, 7), by name."""
    return Sums(*np.moveaxis(history, -1, 0))


def count_lanes() -> int:
    """Return the pixels of this machine's vectors, which images of the kernels over time are at least as wide as."""
    return int(hl.get_host_target().natural_vector_size(hl.Float(32)))


def widen(image: HostImage) -> HostImage:
    """Return an image that is at least as wide as a vector; its last column is repeated."""
    missing = count_lanes() - image.shape[1]
    if missing <= 0:
        return image
    return np.pad(image, [(0, 0), (0, missing), *[(0, 0)] * (image.ndim - 2)], mode="edge")


def fill(value: float, shape: tuple[int, ...], axis: int = 0) -> FloatArray:
    """Return an image of one value whose entries along ``axis`` share their memory."""
    row = np.full([1 if k == axis else length for k, length in enumerate(shape)], value, np.float32)
    strides = [0 if k == axis else stride for k, stride in enumerate(row.strides)]
    return np.lib.stride_tricks.as_strided(row, shape, strides)


def split_history(history: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return the channels of sums one after the other, each wide enough; nothing is copied if they lie so already.

    Raises
    ------
    InputError
        If they are not of an image of this size.
    """
    if history.shape[:2] != size or history.ndim != 3 or history.shape[2] < HISTORY_CHANNELS:
        raise InputError(
            "history",
            expected=f"sums of shape {(*size, HISTORY_CHANNELS)}",
            got=f"shape {history.shape}",
            action="give those of this image",
        )
    planes = np.moveaxis(widen(history[..., :HISTORY_CHANNELS]), -1, 0)
    if planes.dtype == np.float32 and planes.strides[2] == planes.itemsize:
        return planes
    return np.ascontiguousarray(planes, dtype=np.float32)


def run_planes(
    kernel: Kernel, device: str, images: Mapping[str, HostImage], numbers: Mapping[str, float], size: tuple[int, int]
) -> FloatArray:
    """Run a kernel and return the planes that it writes as an image of that size, (height, width, count)."""
    # One memory for all of them: who reads the image finds its channels one after the other.
    memory = np.empty((len(kernel.outputs), size[0], max(size[1], count_lanes())), np.float32)
    planes = {
        each.name: make_output(plane.shape, device, plane) for each, plane in zip(kernel.outputs, memory, strict=True)
    }
    # Every buffer is held in a local name until the call has returned: Halide keeps no reference.
    lent = {name: lend(image, device) for name, image in images.items()}
    kernel(**lent, **numbers, **{name: buffer for name, (buffer, _) in planes.items()})
    for _, plane in planes.values():
        download(plane)
    return np.moveaxis(memory[..., : size[1]], 0, -1)
