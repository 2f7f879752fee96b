"""Reproject the history of a frame; `reprojection_pass` describes the algorithm."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import HostImage, device_scope, download, take_image, take_mask
from lobewise.backend.jit import Scheduled, get_kernel
from lobewise.features.arrays import give_features, give_scalars
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import describe_structure
from lobewise.filters.history.reprojection_pass import make_reprojection
from lobewise.filters.history.sums import HISTORY_CHANNELS, run_planes, widen
from lobewise.filters.schedules.reprojection import schedule_reprojection
from lobewise.frame import FloatArray


@device_scope()
def run_reprojection(
    past: FloatArray,
    places: FloatArray,
    masks: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    features: tuple[Sequence[Feature], Sequence[Feature]],
    *,
    virtual: tuple[FloatArray, int] | None = None,
    memory: float = 1.0,
    device: str = "cpu",
) -> FloatArray:
    """Gather the history of every pixel from its place in the frame before.

    Parameters
    ----------
    past : array, shape (height, width, 7)
        Sums of the frame before; see `lobewise.filters.history.sums`.
    places : array, shape (height, width, 2)
        Column and row of each pixel in the frame before, pixel centres at whole numbers; NaN or outside the image if it
        was not visible.
    masks : pair of bool arrays, shape (height, width)
        Where a pixel has meaning, in the frame before and in this frame.
    features : pair of sequences of Feature
        Features of the frame before and of this frame, of one structure; their similarities weight the history.
    virtual : (array, int), optional
        Second places, those of each pixel's reflection, and the index of the first feature that is compared there.
    memory : float
        Factor of all weights, 0 to 1.
    device : str
        A name from `list_devices`.

    Returns
    -------
    array, shape (height, width, 8)
        The sums, and the agreement, 0 to 1 (up to the error of `exp2`).
    """
    height, width = size = (masks[1].shape[0], masks[1].shape[1])
    virtual_from = None if virtual is None else virtual[1]
    before: dict[str, HostImage] = {"mask_before": take_mask(masks[0]), **_take("before", features[0], size)}
    ways = {"places": places} if virtual is None else {"places": places, "virtual_places": virtual[0]}
    now: dict[str, HostImage] = {name: take_image(name, way, (*size, 2)) for name, way in ways.items()}
    now |= {"mask": take_mask(masks[1]), **_take("own", features[1], size)}
    images = {name: image.reshape(height * width, *image.shape[2:]) for name, image in before.items()}
    images |= {"past": _flatten_history(past, size), **{name: widen(image) for name, image in now.items()}}
    numbers = {"memory": memory, "width_before": width, "height_before": height, **give_scalars(features[1])}
    key = "reprojection", virtual_from, *map(describe_structure, features[1])
    kernel = get_kernel(device, key, partial(_make_scheduled, features[1], virtual_from))
    return run_planes(kernel, device, images, numbers, size)


def _make_scheduled(features: Sequence[Feature], virtual_from: int | None, target: hl.Target) -> Scheduled:
    """Return a reprojection, ready to be compiled."""
    funcs = make_reprojection(features, virtual_from)
    schedule_reprojection(funcs, target)
    return Scheduled([funcs.out], funcs.signature)


def _take(prefix: str, features: Sequence[Feature], size: tuple[int, int]) -> dict[str, FloatArray]:
    return {name: download(image) for name, image in give_features(prefix, features, size).items()}


def _flatten_history(past: FloatArray, size: tuple[int, int]) -> FloatArray:
    """Return sums (height * width, 7) that lie channel by channel in memory, without a copy if they do already."""
    planes = np.moveaxis(past, -1, 0)
    if past.shape != (*size, HISTORY_CHANNELS) or past.dtype != np.float32 or not planes[0].flags.c_contiguous:
        planes = np.ascontiguousarray(np.moveaxis(take_image("past", past, (*size, HISTORY_CHANNELS)), -1, 0))
    return np.moveaxis(planes.reshape(HISTORY_CHANNELS, size[0] * size[1]), 0, -1)
