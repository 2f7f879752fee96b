"""The dual-buffer filter: the cross-bilateral sum over two halves of the samples, both with the same weights.

For both halves X, ``out_X(i) = sum_j w(i, j) I_X(j) / sum_j w(i, j)``, ``w = a_j place lobes^p exp(-E)``. a_j is
the luminance of the albedo, so that the mean is the ratio of reflected radiance to albedo. ``place`` and ``lobes`` are
the products of the similarities of two groups of features. E is the distance of the two pixels in a guide, an image
that was filtered before. The difference of the filtered halves then shows their noise.

The distance in the guide is equation 2 of Rousselle, Knaus and Zwicker 2012, "Adaptive Rendering with Non-Local Means
Filtering": squared differences minus the part that noise explains, over the noise. Departs: compares pixels instead of
patches, because the guide is a filtered image; uses one guide for both halves instead of each half's for the other,
because a filtered pilot hardly depends on the noise of a single pixel, and one weight is less work than two
(docs/developers/research/quality_trials.md).
"""

from __future__ import annotations

from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend import expressions
from lobewise.backend.buffers import Image, returns_host_images, take_channel, take_image, take_mask
from lobewise.backend.compiler import hl
from lobewise.backend.expressions import LOG2_E
from lobewise.backend.jit import Scheduled
from lobewise.backend.signature import Signature
from lobewise.features.arrays import declare_features, declare_scalars, give_features, give_scalars
from lobewise.features.base import Feature, describe_structure
from lobewise.filters.cross_pass import ALBEDO_FLOOR, COLORS, compute_expression_luminance, demodulate
from lobewise.filters.forms import Taps
from lobewise.filters.planes import C, X, Y
from lobewise.filters.scheduling import count_lanes
from lobewise.filters.weigh import TapSums, U, V
from lobewise.records.frame import FloatArray
from lobewise.settings import LARGEST_RADIUS

HALF_COUNT = 2
GUIDE_CHANNELS = COLORS + 1
"""Channels of a guide: three colours and their variance."""
SUMS_OF_HALF = COLORS + 2
"""Sums of one half: weighted radiance, weight, squared weight."""
MORE_AT_ONCE = 4
"""Further images that a pass averages by the same weights: the sums of more do not fit a processor's registers."""
NOISE_FLOOR = 1e-4
"""Added to the variance that squared differences are divided by."""


@dataclass(frozen=True)
class DualBufferKey:
    """Everything that changes the code of a dual-buffer pass."""

    groups: tuple[tuple[Hashable, ...], ...]
    """Structures of the features of `PassRequest.groups`."""
    guided: bool
    other_count: int = 0


class DualBufferOutput(NamedTuple):
    """The images that a dual-buffer pass gives.

    Parameters
    ----------
    a, b : (height, width, 3)
        The filtered halves, divided by the albedo; 0 where no tap of either half had any weight.
    support : (height, width, 2)
        The weight sum and the effective samples of every pixel.
    others : sequence of (height, width, 3)
        The further images, filtered; 0 where no tap had any weight.
    """

    a: Image
    b: Image
    support: Image
    others: Sequence[Image] = ()

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
    """Everything that one dual-buffer pass reads; see this module.

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
    radius : int
        Kernel radius, pixels, >= 0.
    albedo : array, shape (height, width, 3), optional
        Divides the radiance; its luminance is a weight.
    guide : array, shape (height, width, 4), optional
        Colours and their variance (`lobewise.filters.noise_guides`).
    noise : float
        Number of variances by which a squared difference of the guide is divided, > 0.
    others : sequence of arrays, shape (height, width, 3)
        Up to `MORE_AT_ONCE` further images that are averaged by the same weights.
    """

    halves: tuple[Image, Image]
    mask: NDArray[np.bool_]
    place: Sequence[Feature] = ()
    lobes: Sequence[Feature] = ()
    exponent: float = 1.0
    radius: int
    albedo: FloatArray | None = None
    guide: Image | None = None
    noise: float = 1.0
    others: Sequence[Image] = ()

    @property
    def size(self) -> tuple[int, int]:
        """Rows and columns of every image."""
        return self.mask.shape[0], self.mask.shape[1]

    @property
    def groups(self) -> dict[str, Sequence[Feature]]:
        """The features by group. The similarity of the lobes alone has an exponent."""
        return {"place": self.place, "lobes": self.lobes}

    def make_key(self) -> DualBufferKey:
        """Return what the code of the pass depends on."""
        return DualBufferKey(
            groups=tuple(tuple(map(describe_structure, features)) for features in self.groups.values()),
            guided=self.guide is not None,
            other_count=len(self.others),
        )

    def collect_images(self) -> dict[str, Image]:
        """Return the images of the pass by the names that its kernel declares."""
        images: dict[str, Image] = {"mask": take_mask(self.mask)}
        for name, half in zip(("half_a", "half_b"), self.halves, strict=True):
            images[name] = take_image("half", half, (*self.size, COLORS))
        for number, image in enumerate(self.others):
            images[f"more{number}"] = take_image("image", image, (*self.size, COLORS))
        # Without an albedo the kernel takes any image and does not use it.
        images["albedo"] = images["half_a"]
        if self.albedo is not None:
            images["albedo"] = take_image("albedo", self.albedo, (*self.size, COLORS))
        if self.guide is not None:
            images["guide"] = take_image("guide", self.guide, (*self.size, GUIDE_CHANNELS))
        for features in self.groups.items():
            images |= give_features(*features, self.size)
        return images

    def collect_numbers(self) -> dict[str, float]:
        """Return the numbers of the pass by the names that its kernel declares."""
        numbers = {
            "divided": int(self.albedo is not None),
            "radius": self.radius,
            "noise": self.noise,
            "exponent": self.exponent,
        }
        for name, features in self.groups.items():
            numbers |= give_scalars(features, name)
        return numbers


@returns_host_images
def filter_dual_buffer(request: PassRequest, text: str = "") -> DualBufferOutput:
    """Filter two halves of the samples by the same weights; ``text`` says in recorded plans what the pass does."""
    key = request.make_key()
    make = partial(make_dual_buffer, key, request.groups)
    written = engine.kernel(key, make, request.collect_images(), request.collect_numbers(), text=text)
    others = [written[f"filtered{number}"] for number in range(key.other_count)]
    return DualBufferOutput(written["a"], written["b"], written["support"], others)


class HalfSums(NamedTuple):
    """The sums over the taps of a pixel, of one half."""

    red: hl.Expr
    green: hl.Expr
    blue: hl.Expr
    weight: hl.Expr
    squared_weight: hl.Expr


def make_dual_buffer(key: DualBufferKey, groups: Mapping[str, Sequence[Feature]], target: hl.Target) -> Scheduled:
    """Return a dual-buffer pass."""
    # Signature
    signature, size = Signature("dual buffer"), ("height", "width")
    tints, divided = signature.image("albedo", *size, COLORS), signature.count("divided", most=1)
    names = ["half_a", "half_b", *(f"more{number}" for number in range(key.other_count))]
    averaged = [signature.image(name, *size, COLORS) for name in names]
    mask = signature.image("mask", *size, type=hl.UInt(8))
    arrays = [declare_features(signature, name, features, *size) for name, features in groups.items()]
    scalars = [declare_scalars(signature, features, name) for name, features in groups.items()]
    radius = signature.count("radius", most=LARGEST_RADIUS)
    guide_image = signature.image("guide", *size, GUIDE_CHANNELS) if key.guided else None
    noise, exponent = signature.number("noise"), signature.number("exponent")
    for name in ("a", "b", "support", *(f"filtered{number}" for number in range(key.other_count))):
        signature.output(name, *size, COLORS)

    # Algorithm
    albedo, out = hl.Func("albedo_or_one"), hl.Func("out")
    albedo[C, X, Y] = hl.select(divided != 0, tints[C, X, Y], hl.f32(1.0))
    taps = TapSums(mask, Taps.SQUARE, radius, hl.i32(1), count_lanes(target))
    # The summands and the weight of each image.
    planes = len(averaged) * (COLORS + 1)
    images = taps.read("images", planes, lambda at, usable: hl.mux(C, _read_images(averaged, albedo, at, usable)))
    place, lobes = (taps.compare(*each) for each in zip(groups, groups.values(), scalars, arrays, strict=True))
    log_weight = place + exponent * lobes
    if guide_image is not None:
        guide = taps.read("guide", GUIDE_CHANNELS, lambda at, _: guide_image[C, at[0], at[1]])
        log_weight = log_weight - taps.stage(_compute_distance(guide, noise))

    def take(weight: hl.Expr, column: hl.Expr, line: hl.Expr) -> list[hl.Expr]:
        summands: list[hl.Expr] = []
        for first in range(0, planes, COLORS + 1):
            counted = weight * images[column, first + COLORS, line]
            summands += [*(weight * images[column, first + k, line] for k in range(COLORS)), counted]
            summands += [counted * counted] if first < HALF_COUNT * (COLORS + 1) else []
        return summands

    sums = taps.add(log_weight, take)
    outputs = _compute_means(
        [HalfSums(*sums[:SUMS_OF_HALF]), HalfSums(*sums[SUMS_OF_HALF : 2 * SUMS_OF_HALF])],
        _compute_albedo_luminance(albedo, (X, Y)),
    )
    for first in range(HALF_COUNT * SUMS_OF_HALF, len(sums), COLORS + 1):
        *colour, total = sums[first : first + COLORS + 1]
        outputs.append([hl.select(total > hl.f32(0.0), value / total, hl.f32(0.0)) for value in colour])
    out[C, X, Y] = hl.Tuple([hl.select(mask[X, Y] != 0, hl.mux(C, image), hl.f32(0.0)) for image in outputs])

    # Schedule
    taps.schedule(out, COLORS)
    return Scheduled([out], signature)


def _read_images(
    images: Sequence[hl.ImageParam], albedo: hl.Func, at: tuple[hl.Expr, hl.Expr], usable: hl.Expr
) -> list[hl.Expr]:
    """Return the planes of each image: radiance over albedo times the albedo's luminance, and the luminance as weight.

    All are 0 for a bad pixel.
    """
    values: list[hl.Expr] = []
    for image in images:
        radiance, good = demodulate(image, albedo, at, hl.f32(ALBEDO_FLOOR))
        share = _compute_albedo_luminance(albedo, at)
        radiance = _fill_unknown(radiance, [albedo[k, at[0], at[1]] for k in range(COLORS)])
        values += [hl.select(good & usable, value * share, hl.f32(0.0)) for value in (*radiance, hl.f32(1.0))]
    return values


def _compute_distance(guide: hl.Func, noise: hl.Expr) -> hl.Expr:
    """Return the distance of a pixel and a tap in the guide: beyond noise, in units of noise, times log2(e).

    ``noise`` is the factor of the variance.
    """
    there = X + U, Y + V
    own_noise, other_noise = (guide[at[0], COLORS, at[1]] for at in ((X, Y), there))
    explained = hl.f32(COLORS) * (own_noise + hl.min(own_noise, other_noise))
    scale = hl.f32(LOG2_E / COLORS) / (hl.f32(NOISE_FLOOR) + noise * (own_noise + other_noise))
    changes = [guide[X, k, Y] - guide[there[0], k, there[1]] for k in range(COLORS)]
    squares = sum((change * change for change in changes), hl.f32(0.0))
    return hl.max(squares - explained, hl.f32(0.0)) * scale


def _fill_unknown(light: Sequence[hl.Expr], tints: Sequence[hl.Expr]) -> list[hl.Expr]:
    """Return light whose channels with an albedo of almost 0 are replaced by the mean of the other channels."""
    known = [tint > hl.f32(ALBEDO_FLOOR) for tint in tints]
    count = sum((hl.f32(is_known) for is_known in known), hl.f32(0.0))
    known_light = [hl.select(is_known, value, hl.f32(0.0)) for is_known, value in zip(known, light, strict=True)]
    mean = sum(known_light, hl.f32(0.0)) / hl.max(count, hl.f32(1.0))
    return [hl.select(is_known, value, mean) for is_known, value in zip(known, light, strict=True)]


def _compute_albedo_luminance(albedo: hl.Func, at: tuple[hl.Expr, hl.Expr]) -> hl.Expr:
    """Return the luminance of the albedo at a pixel; bad channels count as 0."""
    tints = [albedo[k, at[0], at[1]] for k in range(COLORS)]
    return compute_expression_luminance([hl.select(expressions.is_bad(tint), hl.f32(0.0), tint) for tint in tints])


def _compute_means(halves: Sequence[HalfSums], share: hl.Expr) -> list[list[hl.Expr]]:
    """Return the output images. A half whose weights are all 0 takes the mean of the other half."""
    zero, one = hl.f32(0.0), hl.f32(1.0)
    totals = [half.weight for half in halves]
    means = [[hl.select(half.weight > zero, value / half.weight, zero) for value in half[:COLORS]] for half in halves]
    # If the squares underflow before the sum does, one far tap dominates, which is one sample.
    spreads = [
        hl.select(
            (half.weight > zero) & (half.squared_weight > zero),
            half.squared_weight / (half.weight * half.weight),
            one,
        )
        for half in halves
    ]
    filled = [
        [hl.select(totals[half] > zero, means[half][k], means[1 - half][k]) for k in range(COLORS)]
        for half in range(HALF_COUNT)
    ]
    weight = hl.f32(0.5) * (totals[0] + totals[1]) / hl.max(share, hl.f32(ALBEDO_FLOOR))
    # If one half is empty, both means are the other half's. The empty half has the larger spread.
    some, both = (totals[0] > zero) | (totals[1] > zero), (totals[0] > zero) & (totals[1] > zero)
    alone = hl.select(some, one / hl.min(spreads[0], spreads[1]), zero)
    worth = hl.select(both, hl.f32(4.0) / (spreads[0] + spreads[1]), alone)
    return [*filled, [weight, worth, zero]]
