"""The dual-buffer filter: two halves of the samples, filtered by the same weights."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import Image, returns_host_images, take_channel, take_image, take_mask
from lobewise.backend.jit import Scheduled, get_kernel, run_kernel
from lobewise.features.arrays import give_features, give_scalars
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import COLORS, describe_structure
from lobewise.filters.dual_buffer_pass import (
    GUIDE_CHANNELS,
    DualBufferKey,
    Exponents,
    Groups,
    give_exponents,
    make_dual_buffer_pass,
    name_images,
)
from lobewise.filters.schedules.dual_buffer import schedule_dual_buffer
from lobewise.filters.schedules.rows import count_lanes
from lobewise.frame import FloatArray


class DualBufferOutput(NamedTuple):
    """What a variant of a dual-buffer pass gives.

    Parameters
    ----------
    a, b : (height, width, 3)
        The filtered halves, over their albedo; 0 where no tap of either had any weight.
    weight_sum, effective_samples : (height, width)
        Mean of both halves' weight sums, in units of the pixel's own albedo; what the mean of both halves is worth.
    """

    a: Image
    b: Image
    weight_sum: Image
    effective_samples: Image


@returns_host_images
def filter_dual_buffer(
    halves: tuple[Image, Image],
    mask: NDArray[np.bool_],
    place: Sequence[Feature],
    lobes: Sequence[Feature],
    variants: Sequence[Exponents],
    *,
    radius: int,
    seen: Sequence[Feature] = (),
    step: int = 1,
    albedo: FloatArray | None = None,
    guide: Image | None = None,
    noise: float = 1.0,
    joined: bool = False,
    device: str = "cpu",
) -> list[DualBufferOutput]:
    """Filter two halves of the samples, both by the same weights; see `lobewise.filters.dual_buffer_pass`.

    Parameters
    ----------
    halves : pair of arrays, shape (height, width, 3)
        Radiance of one half of the samples each. NaN, infinite and negative pixels of a half get weight 0 in it.
    mask : bool array, shape (height, width)
        False where a pixel neither gives nor takes.
    place, lobes, seen : sequence of Feature
        Three groups of features, each with an exponent of its own.
    variants : sequence of Exponents
        At least one.
    radius, step : int
        Kernel radius in taps, >= 0, and pixels from tap to tap, >= 1.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance; its luminance is a weight.
    guide : array, shape (height, width, 4), optional
        Colours and their variance (`lobewise.filters.noise_guides`).
    noise : float
        How many variances a squared difference is divided by, > 0.
    joined : bool
        Whether only the mean of both halves is wanted: ``a`` and ``b`` are then one image, the mean of all samples.
    device : str
        A name from `list_devices`.

    Returns
    -------
    list of DualBufferOutput
        One for each variant.
    """
    size = mask.shape[0], mask.shape[1]
    groups = Groups(place, lobes, seen)
    key = DualBufferKey(
        radius=radius,
        groups=tuple(tuple(describe_structure(feature) for feature in features) for features in groups),
        demodulate=albedo is not None,
        guided=guide is not None,
        joined=joined,
        variants=len(variants),
    )
    kernel = get_kernel(device, key, partial(_make_scheduled, key, groups))
    images: dict[str, Image] = {"mask": take_mask(mask)}
    for name, half in zip(("half_a", "half_b"), halves, strict=True):
        images[name] = take_image("half", half, (*size, COLORS))
    if albedo is not None:
        images["albedo"] = take_image("albedo", albedo, (*size, COLORS))
    if guide is not None:
        images["guide"] = take_image("guide", guide, (*size, GUIDE_CHANNELS))
    numbers = give_exponents(variants)
    for name, features in groups._asdict().items():
        images |= give_features(name, features, size)
        numbers |= give_scalars(features, name)
    written = run_kernel(kernel, device, images, **numbers, step=step, noise=float(noise))
    found: list[DualBufferOutput] = []
    for variant in range(len(variants)):
        *means, support = (written[name] for name in name_images(key, variant))
        found.append(DualBufferOutput(means[0], means[-1], *(take_channel(support, k) for k in range(2))))
    return found


def _make_scheduled(key: DualBufferKey, groups: Groups, target: hl.Target) -> Scheduled:
    """Return a dual-buffer pass, ready to be compiled."""
    funcs = make_dual_buffer_pass(key, groups, lanes=count_lanes(target))
    schedule_dual_buffer(funcs, target)
    return Scheduled([funcs.out], funcs.signature)
