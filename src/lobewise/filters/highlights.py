"""Highlights kept: small, bright spots that neighbouring pixels agree on are no noise, and no filter spreads them.

A lamp in a mirror, or in the coat of a lacquer whose guide tells of the rough base alone, is a few pixels wide and far
brighter than its surroundings. A filter whose guides see one surface spreads it as wide as its kernel, and the noise
that the image itself tells of is large there, because a spot and a firefly look alike to a difference of pixels. What
tells them apart is that noise strikes single pixels: that all pixels of a block are so bright by chance is improbable.
The least value of a block of pixels, and the largest of these least values over all blocks around a pixel, is the
morphological opening of the image: P. Soille 2003, "Morphological Image Analysis", chapter 4.

The light above the surroundings is taken off the samples before they are filtered, and added to the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import halide as hl
import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import Image, returns_host_images, take_image, take_mask
from lobewise.backend.jit import Scheduled, get_kernel, run_kernel
from lobewise.backend.pointwise import LARGEST_FLOAT
from lobewise.backend.signature import Signature
from lobewise.filters.fireflies import define_both, define_light, read_light
from lobewise.filters.planes import C, X, Y
from lobewise.filters.schedules.highlights import HighlightFuncs, schedule_highlights

RING_RADIUS, SPOT_RADIUS = 6, 2
"""The surroundings of a pixel are the square of the first radius without that of the second, pixels."""
FEWEST_NEIGHBOURS = 20
"""Pixels of the surroundings that must count."""
MIN_BLOCK_RATIO = 8.0
"""How many times as bright as the mean of the surroundings all pixels of a block are."""
MIN_CORNER_RATIO = 16.0
"""The same of three pixels of a block of four."""
MIN_SINGLE_RATIO = 12.0
"""The first, where a pixel has one sample; then a corner proves nothing, for a few such samples lie side by side."""
MIN_PAIR_RATIO, MAX_HALVES_RATIO = 10.0, 1.25
"""The same of two neighbours, if both halves of the samples of each agree: the brighter is at most so many times as
bright as the darker."""
MIN_EDGE_RATIO = 1.5
"""The same of a pixel beside such a block."""
BLOCK, SHARED_BLOCK = 2, 3
"""Pixels to each side of a block; where neighbours share their noise, a firefly fills the smaller one by itself."""
REACH = max(RING_RADIUS, SHARED_BLOCK - 1) + 1
"""Pixels to each side that tell on a pixel."""


class SplitHalves(NamedTuple):
    """What `split_highlights` gives.

    Parameters
    ----------
    a, b : (height, width, 3)
        The two halves without the light of highlights.
    kept : (height, width, 3)
        That light, the mean of both halves; 0 where there is none.
    """

    a: Image
    b: Image
    kept: Image


class Kinds(NamedTuple):
    """What is known of the samples; see `split_highlights`."""

    shared: bool
    single: bool
    paired: bool


@returns_host_images
def split_highlights(
    halves: tuple[Image, Image],
    albedo: NDArray[np.float32] | None,
    mask: NDArray[np.bool_],
    *,
    shared: bool = False,
    single: bool = False,
    paired: bool = False,
    device: str = "cpu",
) -> SplitHalves:
    """Return two halves of the samples without the light of small highlights, and that light.

    A pixel belongs to a highlight where a block of `BLOCK` x `BLOCK` pixels that holds it is nowhere less than
    `MIN_BLOCK_RATIO` times as bright as the mean of the surroundings, or three of its pixels are `MIN_CORNER_RATIO`
    times as bright; or where it is beside such a pixel and `MIN_EDGE_RATIO` times as bright. Pixels count by their
    luminance over albedo; of two halves the darker counts, so that what one half alone has seen is no highlight. Of a
    pixel of a highlight the light above the mean of the surroundings is split off.

    Parameters
    ----------
    halves : pair of array, shape (height, width, 3)
        Linear radiance from two independent halves of the samples, >= 0. NaN where a half has no sample; such pixels,
        infinite and negative ones neither count nor change.
    albedo : array, shape (height, width, 3) or None
        What luminance is compared over; pixels with next to none do not count.
    mask : bool array, shape (height, width)
        False where a pixel is no part of the layer: it neither counts nor changes.
    shared : bool
        Whether neighbouring pixels share their noise: then blocks are `SHARED_BLOCK` pixels wide, and all of a block
        must be bright.
    single : bool
        Whether pixels have a single sample: then all of a block must be `MIN_SINGLE_RATIO` times as bright.
    paired : bool
        Whether every pixel has samples in both halves: then two neighbours are a highlight as well, each of which is
        `MIN_PAIR_RATIO` times as bright in both halves, and these agree.
    device : str
        A name from `lobewise.backend.devices.list_devices`.

    Raises
    ------
    InputError
        If an image is not real numbers of the mask's size.
    """
    shape = (*mask.shape, 3)
    images: dict[str, Image] = {
        name: take_image(f"half {name}", half, shape) for name, half in zip("ab", halves, strict=True)
    }
    if albedo is not None:
        images["albedo"] = take_image("albedo", albedo, shape)
    images["mask"] = take_mask(mask)
    tinted = albedo is not None
    kinds = Kinds(shared, single, paired)
    kernel = get_kernel(device, ("highlights", tinted, kinds), partial(_make_highlights, tinted, kinds))
    return SplitHalves(*run_kernel(kernel, device, images).values())


def _make_highlights(tinted: bool, kinds: Kinds, target: hl.Target) -> Scheduled:
    """Return both halves without highlights, and their light, to be compiled."""
    signature, size = Signature("highlights"), ("height", "width")
    halves = [signature.image(name, *size, 3) for name in "ab"]
    albedo = signature.image("albedo", *size, 3) if tinted else None
    mask = signature.image("mask", *size, type=hl.UInt(8))
    for image in (*halves, *([albedo] if albedo is not None else [])):
        image.dim(0).set_bounds(0, 3)
    for name in ("rest_a", "rest_b", "kept"):
        signature.output(name, *size, 3)
    light = define_light(halves, albedo, mask)
    both, least, agreed = define_both(light), _define_least(light), _define_agreed(light)
    rows = _define_rows(both)
    level = _define_level(rows)
    blocks = _define_blocks(least, kinds)
    core = _define_core(least, blocks, level, agreed, kinds)
    share = _define_share(both, level, core)
    out = _define_split(halves, light, share)
    funcs = HighlightFuncs(light, both, least, rows, level, agreed, blocks, core, share, out)
    schedule_highlights(funcs, target)
    return Scheduled([out], signature)


def _define_least(light: hl.Func) -> hl.Func:
    here, zero, least = read_light(light, X, Y), hl.f32(0.0), hl.Func("least")
    least[X, Y] = hl.select(
        (here.first >= zero) & (here.second >= zero),
        hl.min(here.first, here.second),
        hl.max(here.first, here.second),
    )
    return least


def _define_agreed(light: hl.Func) -> hl.Func:
    here, agreed = read_light(light, X, Y), hl.Func("agreed")
    darker, brighter = hl.min(here.first, here.second), hl.max(here.first, here.second)
    agreed[X, Y] = hl.select(
        (darker >= hl.f32(0.0)) & (brighter <= hl.f32(MAX_HALVES_RATIO) * darker), darker, hl.f32(0.0)
    )
    return agreed


def _define_rows(both: hl.Func) -> hl.Func:
    zero, rows = hl.f32(0.0), hl.Func("ring_rows")
    beside = [k for k in range(-RING_RADIUS, RING_RADIUS + 1) if abs(k) > SPOT_RADIUS]
    middle = range(-SPOT_RADIUS, SPOT_RADIUS + 1)

    def add(steps: Sequence[int]) -> tuple[hl.Expr, hl.Expr]:
        values = [both[X + k, Y] for k in steps]
        counts = [hl.f32(value >= zero) for value in values]
        return sum((hl.max(value, zero) for value in values), zero), sum(counts, zero)

    light, count = add(beside)
    more, others = add(middle)
    rows[X, Y] = hl.Tuple([light + more, count + others, light, count])
    return rows


def _define_level(rows: hl.Func) -> hl.Func:
    """Return the mean of the surroundings; so bright that nothing is brighter where too few of them count."""
    zero, level = hl.f32(0.0), hl.Func("level")
    light, count = zero, zero
    # Whole rows above and below the spot, and what is beside it: no difference of large sums.
    for k in range(-RING_RADIUS, RING_RADIUS + 1):
        first = 2 if abs(k) <= SPOT_RADIUS else 0
        there = rows[X, Y + k]
        light, count = light + there[first], count + there[first + 1]
    mean = light / hl.max(count, hl.f32(1.0))
    level[X, Y] = hl.select(count >= hl.f32(FEWEST_NEIGHBOURS), mean, hl.f32(LARGEST_FLOAT))
    return level


def _define_blocks(least: hl.Func, kinds: Kinds) -> hl.Func:
    side, blocks = SHARED_BLOCK if kinds.shared else BLOCK, hl.Func("blocks")
    values = [least[X + column, Y + row] for row in range(side) for column in range(side)]
    lowest, second = values[0], hl.f32(LARGEST_FLOAT)
    for value in values[1:]:
        lowest, second = hl.min(lowest, value), hl.min(second, hl.max(lowest, value))
    blocks[X, Y] = hl.Tuple([lowest, second])
    return blocks


def _define_core(least: hl.Func, blocks: hl.Func, level: hl.Func, agreed: hl.Func, kinds: Kinds) -> hl.Func:
    side, core = SHARED_BLOCK if kinds.shared else BLOCK, hl.Func("core")
    whole = three = hl.f32(0.0)
    for row in range(side):
        for column in range(side):
            there = blocks[X - column, Y - row]
            whole = hl.max(whole, there[0])
            # The dark pixel of a block is none of the three.
            three = hl.max(three, hl.select(least[X, Y] >= there[1], there[1], hl.f32(0.0)))
    around = level[X, Y]
    # A product could be infinite.
    bright = around < whole / hl.f32(MIN_SINGLE_RATIO if kinds.single else MIN_BLOCK_RATIO)
    if not kinds.shared and not kinds.single:
        bright = bright | (around < three / hl.f32(MIN_CORNER_RATIO))
    if kinds.paired:
        beside = hl.f32(0.0)
        for row in (-1, 0, 1):
            for column in (-1, 0, 1):
                if (row, column) != (0, 0):
                    beside = hl.max(beside, agreed[X + column, Y + row])
        bright = bright | (around < hl.min(agreed[X, Y], beside) / hl.f32(MIN_PAIR_RATIO))
    core[X, Y] = hl.select(bright & (least[X, Y] >= hl.f32(0.0)), hl.f32(1.0), hl.f32(0.0))
    return core


def _define_share(both: hl.Func, level: hl.Func, core: hl.Func) -> hl.Func:
    share, here, around = hl.Func("share"), both[X, Y], level[X, Y]
    near = core[X - 1, Y - 1]
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            near = hl.max(near, core[X + column, Y + row])
    edge = (near > hl.f32(0.0)) & (around < here / hl.f32(MIN_EDGE_RATIO))
    taken = (core[X, Y] > hl.f32(0.0)) | edge
    share[X, Y] = hl.select(taken & (here > around), hl.f32(1.0) - around / hl.max(here, hl.f32(1e-30)), hl.f32(0.0))
    return share


def _define_split(halves: Sequence[hl.ImageParam], light: hl.Func, share: hl.Func) -> hl.Func:
    """Return both halves, from bits to bits where nothing changes, so that NaN stays what it is; and what is kept."""
    out, part, here = hl.Func("split"), share[X, Y], read_light(light, X, Y)
    zero, half = hl.f32(0.0), hl.f32(0.5)
    counts = [here.first >= zero, here.second >= zero]
    rests: list[hl.Expr] = []
    for image, known in zip(halves, counts, strict=True):
        value = image[C, X, Y]
        bits = [hl.reinterpret(hl.UInt(32), each) for each in (value, value * (hl.f32(1.0) - part))]
        rests.append(hl.reinterpret(hl.Float(32), hl.select(known & (part > zero), bits[1], bits[0])))
    first, second = (hl.select(known, image[C, X, Y], zero) for image, known in zip(halves, counts, strict=True))
    mean = hl.select(counts[0] & counts[1], half * first + half * second, first + second)
    out[C, X, Y] = hl.Tuple([*rests, hl.select(part > zero, mean * part, zero)])
    return out
