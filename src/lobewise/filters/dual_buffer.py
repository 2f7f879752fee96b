"""Calls of the dual-buffer pass: buffers made and checked, kernels looked up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import Image, lend, make_output, returns_host_images, take_channel, take_image, take_mask
from lobewise.backend.jit import get_kernel
from lobewise.features.arrays import take_arrays, take_parameters
from lobewise.features.base import Feature
from lobewise.filters.cross_pass import describe_structure
from lobewise.filters.dual_buffer_pass import (
    COLORS,
    GUIDE_CHANNELS,
    OUTPUTS,
    DualBufferFuncs,
    DualBufferKey,
    make_dual_buffer_pass,
)
from lobewise.filters.schedules.dual_buffer import schedule_dual_buffer
from lobewise.filters.schedules.rows import count_lanes
from lobewise.frame import FloatArray


class Exponents(NamedTuple):
    """Powers to which a variant raises the similarities of place, of lobes, of the guides and of what is seen."""

    place: float
    lobes: float
    range: float = 0.0
    seen: float = 1.0


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
    height, width = mask.shape
    groups = (place, lobes, seen)
    key = DualBufferKey(
        radius=radius,
        place=tuple(describe_structure(feature) for feature in place),
        lobes=tuple(describe_structure(feature) for feature in lobes),
        seen=tuple(describe_structure(feature) for feature in seen),
        demodulate=albedo is not None,
        guided=guide is not None,
        joined=joined,
        variants=len(variants),
    )

    def make(target: hl.Target) -> DualBufferFuncs:
        funcs = make_dual_buffer_pass(key, groups, lanes=count_lanes(target))
        schedule_dual_buffer(funcs, target)
        return funcs

    kernel = get_kernel(device, key, make)
    # Every array is held in a local name until the call has returned: Halide keeps no reference.
    held: list[Image] = [take_image("half", half, (height, width, COLORS)) for half in halves]
    if albedo is not None:
        held.append(take_image("albedo", albedo, (height, width, COLORS)))
    held.append(take_mask(mask))
    if guide is not None:
        held.append(take_image("guide", guide, (height, width, GUIDE_CHANNELS)))
    held += [array for group in groups for array in take_arrays(group, (height, width))]
    buffers = [lend(array, device) for array in held]
    parameters = [value for group in groups for value in take_parameters(group)]
    powers = [float(power) for each in variants for power in each]
    count = OUTPUTS - 1 if joined else OUTPUTS
    outputs = [make_output((height, width, COLORS), device) for _ in range(len(variants) * count)]
    kernel(*buffers, step, float(noise), *parameters, *powers, *(buffer for buffer, _ in outputs))
    images = [image for _, image in outputs]
    parts = [images[count * k : count * (k + 1)] for k in range(len(variants))]
    return [DualBufferOutput(part[0], part[-2], *(take_channel(part[-1], k) for k in range(2))) for part in parts]
