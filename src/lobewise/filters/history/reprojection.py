"""Reproject the history or the images of a frame; `reprojection_pass` describes the algorithm."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import HostImage, device_scope, download, take_image, take_mask
from lobewise.features.arrays import give_features, give_scalars
from lobewise.features.base import Feature, describe_structure
from lobewise.filters.history.reprojection_pass import make_preparation, make_reprojection
from lobewise.filters.history.sums import Sums, cut, join_channels, split_history, widen_to_vector
from lobewise.records.frame import FloatArray

IMAGES_AT_ONCE = 4
"""Images that one kernel gathers."""


@dataclass(frozen=True, repr=False)
class ComparedPixels:
    """The pixels of a frame as a reprojection compares them.

    Parameters
    ----------
    features : tuple of Feature
    mask : array, shape (height, columns), uint8
        Nonzero where a pixel has meaning; at least as wide as a vector.
    planes : array, shape (count, height, columns), optional
        What the features compare, computed once per pixel; None if no feature has arrays.
    shape : (int, int)
        Height and width of the frame.
    """

    features: tuple[Feature, ...]
    mask: NDArray[np.uint8]
    planes: FloatArray | None
    shape: tuple[int, int]

    def restrict(self, mask: NDArray[np.bool_]) -> ComparedPixels:
        """Return these pixels with a meaning only where ``mask``, (height, width), is True.

        The masks of recorded layers lie within those of their features.
        """
        within = self.mask & widen_to_vector(take_mask(mask)) if isinstance(mask, np.ndarray) else mask
        return replace(self, mask=within)


def prepare_pixels(mask: NDArray[np.bool_], features: Sequence[Feature], name: str = "light") -> ComparedPixels:
    """Return the pixels of a frame, ready to be compared with those of the frame before and after.

    ``name`` is that of the light in recorded plans.

    Raises
    ------
    InputError
        If an array of a feature has another size than the mask.
    """
    shape = (mask.shape[0], mask.shape[1])
    wide = widen_to_vector(take_mask(mask))
    if not any(feature.get_arrays() for feature in features):
        return ComparedPixels(tuple(features), wide, None, shape)
    held = {each: download(image) for each, image in give_features("own", features, shape).items()}
    arrays = {each: widen_to_vector(image) for each, image in held.items()}
    key = "preparation", *map(describe_structure, features)
    make = partial(make_preparation, features)
    images: dict[str, Any] = {"mask": wide, **arrays}
    planes: Any = engine.get_engine().host.planes(
        key,
        make,
        images,
        give_scalars(features),
        name,
        f"{name}_planes",
        f"planes that {name} light is recognised by",
    )
    return ComparedPixels(tuple(features), wide, planes, shape)


@device_scope()
def reproject(
    past: FloatArray,
    places: FloatArray,
    before: ComparedPixels,
    now: ComparedPixels,
    *,
    virtual: tuple[FloatArray, int] | None = None,
    memory: float = 1.0,
    name: str = "light",
) -> FloatArray:
    """Gather the history of every pixel from its place in the frame before.

    Parameters
    ----------
    past : array, shape (height, width, 7)
        Sums of the frame before; see `lobewise.filters.history.sums`.
    places : array, shape (height, width, 2)
        Column and row of each pixel in the frame before, pixel centres at whole numbers; NaN or outside the image if it
        was not visible.
    before, now : ComparedPixels
        Results of `prepare_pixels` for both frames, by features of one structure; their similarities weight the
        history.
    virtual : (array, int), optional
        Second places, those of each pixel's reflection, and the index of the first feature that is compared there.
    memory : float
        Factor of all weights, 0 to 1.
    name : str
        Name of the light in recorded plans.

    Returns
    -------
    array, shape (height, width, 8)
        The sums, and the agreement, 0 to 1 (up to the error of `exp2`).
    """
    held = split_history(past, before.shape)
    history: FloatArray = join_channels(_gather(held, Sums._fields, places, before, now, virtual, memory, name))
    return history


@device_scope()
def reproject_images(
    images: Sequence[FloatArray],
    places: FloatArray,
    before: ComparedPixels,
    now: ComparedPixels,
    *,
    virtual: tuple[FloatArray, int] | None = None,
) -> tuple[list[FloatArray], FloatArray]:
    """Gather images of another frame from the places of every pixel, and the agreement.

    Parameters
    ----------
    images : sequence of array, shape (height, width, 3)
        At least one; finite, >= 0.
    places, before, now, virtual
        As of `reproject`.

    Returns
    -------
    list of array, shape (height, width, 3)
        Sums over the pixels around the places, each times its weight.
    array, shape (height, width)
        The agreement, which is the sum of the weights, 0 to 1 (up to the error of `exp2`).
    """
    found: list[FloatArray] = []
    for start in range(0, len(images), IMAGES_AT_ONCE):
        some = [take_image("image", image, (*before.shape, 3)) for image in images[start : start + IMAGES_AT_ONCE]]
        names = [f"image{number}_{letter}" for number in range(len(some)) for letter in "rgb"]
        held = np.stack([widen_to_vector(image)[..., channel] for image in some for channel in range(3)])
        planes = _gather(held, names, places, before, now, virtual, 1.0, "images")
        found += [join_channels(planes[first : first + 3]) for first in range(0, len(names), 3)]
    return found, planes[-1]


def _gather(
    past: FloatArray,
    names: Sequence[str],
    places: FloatArray,
    before: ComparedPixels,
    now: ComparedPixels,
    virtual: tuple[FloatArray, int] | None,
    memory: float,
    name: str,
) -> Any:
    """Return planes of the frame before at the places of each pixel, and the agreement, planes first."""
    size = now.shape
    virtual_from = None if virtual is None else virtual[1]
    ways = {"places": places} if virtual is None else {"places": places, "virtual_places": virtual[0]}
    images: dict[str, HostImage] = {
        name: widen_to_vector(take_image(name, way, (*size, 2))) for name, way in ways.items()
    }
    images |= {"past": past, "mask": now.mask, "mask_before": before.mask}
    if now.planes is not None and before.planes is not None:
        images |= {"planes": now.planes, "planes_before": before.planes}
    numbers = {"memory": memory, "rows": before.shape[0], "columns": before.shape[1], **give_scalars(now.features)}
    key = "reprojection", virtual_from, tuple(names), *map(describe_structure, now.features)
    make = partial(make_reprojection, now.features, virtual_from, names)
    planes = engine.planes(key, make, images, numbers, name=name, text=f"history of {name} light")
    return cut(planes, size[1])
