"""Calls of the crossed pass: buffers made and checked, kernels looked up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.kernels.cross_filter import describe_structure
from lobewise.kernels.crossed import COLORS, GUIDE_CHANNELS, OUTPUTS, CrossedFuncs, CrossedKey, make_crossed
from lobewise.kernels.engine import _borrow, get_kernel, take_arrays, take_image, take_parameters
from lobewise.kernels.features import Feature
from lobewise.kernels.schedules import schedule_crossed_cpu


class Exponents(NamedTuple):
    """Powers to which a variant raises the similarities of place, of lobes, of the guides and of what is seen."""

    place: float
    lobes: float
    range: float = 0.0
    seen: float = 1.0


class Crossed(NamedTuple):
    """What a variant of a crossed pass gives.

    Parameters
    ----------
    a, b : (height, width, 3)
        The filtered halves, over their albedo; 0 where no tap of either had any weight.
    weight_sum, effective_samples : (height, width)
        Mean of both halves' weight sums, in units of the pixel's own albedo; what the mean of both halves is worth.
    """

    a: FloatArray
    b: FloatArray
    weight_sum: FloatArray
    effective_samples: FloatArray

    @property
    def mean(self) -> FloatArray:
        """The mean of both halves, (height, width, 3)."""
        return np.float32(0.5) * (self.a + self.b)


def run_crossed(
    halves: tuple[FloatArray, FloatArray],
    mask: NDArray[np.bool_],
    place: Sequence[Feature],
    lobes: Sequence[Feature],
    variants: Sequence[Exponents],
    *,
    radius: int,
    seen: Sequence[Feature] = (),
    step: int = 1,
    albedo: FloatArray | None = None,
    guide: FloatArray | None = None,
    noise: float = 1.0,
    device: str = "cpu",
) -> list[Crossed]:
    """Filter two halves of the samples, each by weights of the other; see `lobewise.kernels.crossed`.

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
    guide : array, shape (height, width, 7), optional
        Colours of both halves and the variance that they share (`lobewise.kernels.noise_guides`). Without it both
        halves have the same weights.
    noise : float
        How many variances a squared difference is divided by, > 0.
    device : str
        A name from `list_devices`.

    Returns
    -------
    list of Crossed
        One for each variant.
    """
    height, width = mask.shape
    groups = (place, lobes, seen)
    key = CrossedKey(
        radius=radius,
        place=tuple(describe_structure(feature) for feature in place),
        lobes=tuple(describe_structure(feature) for feature in lobes),
        seen=tuple(describe_structure(feature) for feature in seen),
        demodulate=albedo is not None,
        guided=guide is not None,
        variants=len(variants),
    )

    def make(target: hl.Target) -> CrossedFuncs:
        funcs = make_crossed(key, groups)
        schedule_crossed_cpu(funcs, target)
        return funcs

    kernel = get_kernel(device, key, make)
    # Every array is held in a local name until the call has returned: Halide keeps no reference.
    held: list[NDArray[Any]] = [take_image("half", half, (height, width, COLORS)) for half in halves]
    if albedo is not None:
        held.append(take_image("albedo", albedo, (height, width, COLORS)))
    held.append(np.ascontiguousarray(mask).view(np.uint8))
    if guide is not None:
        held.append(take_image("guide", guide, (height, width, GUIDE_CHANNELS)))
    held += [array for group in groups for array in take_arrays(group, (height, width))]
    buffers = [hl.Buffer(_borrow(array)) for array in held]
    parameters = [value for group in groups for value in take_parameters(group)]
    powers = [float(power) for each in variants for power in each]
    target = np.empty((height, width, len(variants) * OUTPUTS), dtype=np.float32)
    kernel(*buffers, step, float(noise), *parameters, *powers, hl.Buffer(target))
    parts = target.reshape(height, width, len(variants), OUTPUTS)
    return [
        Crossed(
            *(np.ascontiguousarray(parts[:, :, k, first : first + COLORS]) for first in (0, COLORS)),
            *(np.ascontiguousarray(parts[:, :, k, channel]) for channel in (2 * COLORS, 2 * COLORS + 1)),
        )
        for k in range(len(variants))
    ]
