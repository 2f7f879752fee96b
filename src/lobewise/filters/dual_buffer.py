"""The dual-buffer filter: two halves of the samples, filtered by the same weights."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import Image, returns_host_images, take_channel, take_image, take_mask
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.features.arrays import give_features, give_scalars
from lobewise.features.base import Feature, describe_structure
from lobewise.filters.cross_pass import COLORS
from lobewise.filters.dual_buffer_pass import (
    GUIDE_CHANNELS,
    DualBufferKey,
    Groups,
    make_dual_buffer_pass,
)
from lobewise.filters.schedules.dual_buffer import schedule_dual_buffer
from lobewise.filters.scheduling import count_lanes
from lobewise.frame import FloatArray


class DualBufferOutput(NamedTuple):
    """The images that a dual-buffer pass gives.

    Parameters
    ----------
    a, b : (height, width, 3)
        The filtered halves, divided by the albedo; 0 where no tap of either half had any weight.
    support : (height, width, 2)
        The weight sum and the effective samples of every pixel.
    """

    a: Image
    b: Image
    support: Image

    @property
    def weight_sum(self) -> Image:
        """Mean of both halves' weight sums, (height, width), in units of the pixel's own albedo."""
        return take_channel(self.support, 0)

    @property
    def effective_samples(self) -> Image:
        """Number of equally weighted samples with the variance of the mean of both halves, (height, width)."""
        return take_channel(self.support, 1)


@dataclass(frozen=True, kw_only=True)
class PassRequest:
    """Everything that one dual-buffer pass reads; see `lobewise.filters.dual_buffer_pass`.

    Parameters
    ----------
    halves : pair of arrays, shape (height, width, 3)
        Radiance of one half of the samples each. NaN, infinite and negative pixels of a half get weight 0 in that half.
    mask : bool array, shape (height, width)
        False where a pixel neither gives nor takes.
    place, lobes : sequence of Feature
        Two groups of features: those that count as they are, and those of lobes.
    exponent : float
        Exponent of the similarity of the lobes.
    radius, step : int
        Kernel radius in taps, >= 0, and pixels from tap to tap, >= 1.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance; its luminance is a weight.
    guide : array, shape (height, width, 4), optional
        Colours and their variance (`lobewise.filters.noise_guides`).
    noise : float
        Number of variances by which a squared difference of the guide is divided, > 0.
    """

    halves: tuple[Image, Image]
    mask: NDArray[np.bool_]
    place: Sequence[Feature] = ()
    lobes: Sequence[Feature] = ()
    exponent: float = 1.0
    radius: int
    step: int = 1
    albedo: FloatArray | None = None
    guide: Image | None = None
    noise: float = 1.0

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of every image."""
        return self.mask.shape[0], self.mask.shape[1]

    @property
    def groups(self) -> Groups:
        """The features by group."""
        return Groups(self.place, self.lobes)

    def make_key(self) -> DualBufferKey:
        """Return what the code of the pass depends on."""
        return DualBufferKey(
            groups=tuple(tuple(describe_structure(feature) for feature in features) for features in self.groups),
            guided=self.guide is not None,
        )

    def collect_images(self) -> dict[str, Image]:
        """Return the images of the pass by the names that its kernel declares."""
        images: dict[str, Image] = {"mask": take_mask(self.mask)}
        for name, half in zip(("half_a", "half_b"), self.halves, strict=True):
            images[name] = take_image("half", half, (*self.size, COLORS))
        # Without an albedo the kernel takes any image and does not use it.
        images["albedo"] = images["half_a"]
        if self.albedo is not None:
            images["albedo"] = take_image("albedo", self.albedo, (*self.size, COLORS))
        if self.guide is not None:
            images["guide"] = take_image("guide", self.guide, (*self.size, GUIDE_CHANNELS))
        for features in self.groups._asdict().items():
            images |= give_features(*features, self.size)
        return images

    def collect_numbers(self) -> dict[str, float]:
        """Return the numbers of the pass by the names that its kernel declares."""
        numbers = {
            "divided": int(self.albedo is not None),
            "radius": self.radius,
            "step": self.step,
            "noise": self.noise,
            "exponent": self.exponent,
        }
        for name, features in self.groups._asdict().items():
            numbers |= give_scalars(features, name)
        return numbers


@returns_host_images
def filter_dual_buffer(request: PassRequest, text: str = "") -> DualBufferOutput:
    """Filter two halves of the samples by the same weights; ``text`` says in recorded plans what the pass does."""
    key = request.make_key()
    make = partial(make_scheduled_dual_buffer, key, request.groups)
    written = engine.kernel(key, make, request.collect_images(), request.collect_numbers(), text=text)
    return DualBufferOutput(written["a"], written["b"], written["support"])


def make_scheduled_dual_buffer(key: DualBufferKey, groups: Groups, target: hl.Target) -> Scheduled:
    """Return a dual-buffer pass, ready to be compiled."""
    funcs = make_dual_buffer_pass(key, groups, lanes=count_lanes(target))
    schedule_dual_buffer(funcs, target)
    return Scheduled([funcs.out], funcs.signature)
