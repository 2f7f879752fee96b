"""Keep highlights: split small, bright spots off the samples where several neighbouring pixels are bright.

A lamp seen in a mirror is a few pixels wide and far brighter than its surroundings. So is a lamp in the coat of a
lacquer whose guides describe the rough base only. A filter whose guides see one surface spreads the lamp over its
kernel. Differences of pixels cannot tell such a spot from a firefly, so the noise estimate is large there. But noise
strikes single pixels: it is improbable that all pixels of a block are bright by chance. The smallest value of each
block, and then the largest of these minima over all blocks that contain a pixel, is the morphological opening of the
image: P. Soille 2003, "Morphological Image Analysis", chapter 4.

The light above the surroundings is subtracted from the samples before they are filtered, and added to the result.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import Image, returns_host_images
from lobewise.backend.compiler import hl
from lobewise.backend.jit import Scheduled
from lobewise.backend.pointwise import LARGEST_FLOAT, select_bits
from lobewise.backend.signature import Signature
from lobewise.filters.fireflies import declare_halves, define_both, define_light, read_light, take_halves
from lobewise.filters.planes import C, X, Y
from lobewise.filters.scheduling import schedule_stencil

RING_RADIUS, SPOT_RADIUS = 6, 2
"""Radii in pixels: the surroundings of a pixel are the outer square without the inner one."""
MIN_RING_PIXELS = 20
"""Good pixels that the surroundings need. With fewer, nothing is a highlight."""
MIN_BLOCK_RATIO = 8.0
"""Smallest luminance of a highlight's block, over the mean of the surroundings."""
MIN_CORNER_RATIO = 16.0
"""Smallest luminance of the three brightest pixels of a block of four, over the mean of the surroundings."""
MIN_SINGLE_RATIO = 12.0
"""Takes the place of `MIN_BLOCK_RATIO` if pixels have one sample each. Three pixels of a block prove nothing then,
because a few bright samples lie side by side by chance."""
MIN_PAIR_RATIO, MAX_HALVES_RATIO = 10.0, 1.25
"""Smallest luminance of two neighbours over the mean of the surroundings, if the halves of each pixel agree; and the
largest luminance of the brighter half over that of the darker for which halves agree."""
MIN_HIGHLIGHT_EDGE_RATIO = 1.5
"""Smallest luminance of a highlight's edge, a pixel beside such a block, over the mean of the surroundings."""
BLOCK_WIDTH, SHARED_BLOCK_WIDTH = 2, 3
"""Width of a block, pixels. The second counts if pixels share their noise, because a firefly then fills 2x2 pixels."""
HIGHLIGHT_REACH = max(RING_RADIUS, SHARED_BLOCK_WIDTH - 1) + 1
"""Distance of the farthest pixel that affects a pixel, rows or columns."""


class SplitHalves(NamedTuple):
    """The result of `split_highlights`.

    Parameters
    ----------
    a, b : (height, width, 3)
        The two halves without the light of highlights.
    highlights : (height, width, 3)
        The light of highlights, the mean of both halves; 0 where there is none.
    """

    a: Image
    b: Image
    highlights: Image


class Kinds(NamedTuple):
    """The options of `split_highlights` that change the kernel."""

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
) -> SplitHalves:
    """Return two halves of the samples without the light of small highlights, and the light of the highlights.

    A pixel belongs to a highlight if one of these holds, all relative to the mean of the surroundings: it lies in a
    block of `BLOCK_WIDTH` x `BLOCK_WIDTH` pixels that are all `MIN_BLOCK_RATIO` times as bright; it is one of three
    pixels of a block that are `MIN_CORNER_RATIO` times as bright; it touches such a pixel and is
    `MIN_HIGHLIGHT_EDGE_RATIO` times as bright. Luminances over albedo are compared. The darker half of a pixel counts,
    so that light which one half alone has seen is no highlight. The light above the mean of the surroundings is split
    off.

    Parameters
    ----------
    halves : pair of array, shape (height, width, 3)
        Linear radiance from two independent halves of the samples, >= 0. NaN where a half has no sample. NaN, infinite
        and negative pixels neither count nor change.
    albedo : array, shape (height, width, 3) or None
        Divides the radiance before luminances are compared. Pixels whose albedo is almost 0 do not count.
    mask : bool array, shape (height, width)
        False where a pixel does not belong to the layer: it neither counts nor changes.
    shared : bool
        Neighbouring pixels share their noise: blocks are `SHARED_BLOCK_WIDTH` pixels wide, and all their pixels must be
        bright.
    single : bool
        Pixels have one sample each: all pixels of a block must be `MIN_SINGLE_RATIO` times as bright.
    paired : bool
        Every pixel has samples in both halves: two neighbours also are a highlight if each is `MIN_PAIR_RATIO` times as
        bright in both halves and its halves agree.

    Raises
    ------
    InputError
        If an image is not real numbers of the mask's size.
    """
    images, tinted = take_halves(halves, albedo, mask), albedo is not None
    kinds = Kinds(shared, single, paired)
    key = "highlights", tinted, kinds
    make = partial(make_highlights, tinted, kinds)
    return SplitHalves(*engine.kernel(key, make, images, text="split off highlights").values())


def make_highlights(tinted: bool, kinds: Kinds, target: hl.Target) -> Scheduled:
    """Return the kernel: it writes both halves without highlights, and the light of the highlights."""
    # Signature
    signature = Signature("highlights")
    halves, albedo, mask = declare_halves(signature, tinted)
    for name in ("rest_a", "rest_b", "kept"):
        signature.output(name, "height", "width", 3)

    # Algorithm
    light = define_light(halves, albedo, mask)
    both, least, agreed = define_both(light), _define_least(light), _define_agreed(light)
    rows = _define_rows(both)
    level = _define_level(rows)
    blocks = _define_blocks(least, kinds)
    core = _define_core(least, blocks, level, agreed, kinds)
    share = _define_share(both, level, core)
    out = _define_split(halves, light, share)

    # Schedule
    stored = light, agreed, rows, level, blocks, core
    schedule_stencil(out, 3, target, strips=[*stored, both, least], lines=[share], stored=[*stored, share])
    return Scheduled([out], signature)


def _define_least(light: hl.Func) -> hl.Func:
    """Return the luminance of a pixel for its block: the darker of its good halves."""
    here, zero, least = read_light(light, X, Y), hl.f32(0.0), hl.Func("least")
    least[X, Y] = hl.select(
        (here.first >= zero) & (here.second >= zero),
        hl.min(here.first, here.second),
        hl.max(here.first, here.second),
    )
    return least


def _define_agreed(light: hl.Func) -> hl.Func:
    """Return the luminance of the darker half if both halves agree, else 0."""
    here, agreed = read_light(light, X, Y), hl.Func("agreed")
    darker, brighter = hl.min(here.first, here.second), hl.max(here.first, here.second)
    agreed[X, Y] = hl.select(
        (darker >= hl.f32(0.0)) & (brighter <= hl.f32(MAX_HALVES_RATIO) * darker), darker, hl.f32(0.0)
    )
    return agreed


def _define_rows(both: hl.Func) -> hl.Func:
    """Return sum and count of a row of the surroundings: of all its pixels, and of those left and right of the spot."""
    zero, rows = hl.f32(0.0), hl.Func("ring_rows")
    beside = [k for k in range(-RING_RADIUS, RING_RADIUS + 1) if abs(k) > SPOT_RADIUS]
    middle = range(-SPOT_RADIUS, SPOT_RADIUS + 1)

    def add(steps: Sequence[int]) -> tuple[hl.Expr, hl.Expr]:
        values = [both[X + k, Y] for k in steps]
        counts = [hl.f32(value >= zero) for value in values]
        return sum((hl.max(value, zero) for value in values), zero), sum(counts, zero)

    light, count = add(beside)
    middle_light, middle_count = add(middle)
    rows[X, Y] = hl.Tuple([light + middle_light, count + middle_count, light, count])
    return rows


def _define_level(rows: hl.Func) -> hl.Func:
    """Return the mean of the surroundings; the largest float where too few of their pixels count."""
    zero, level = hl.f32(0.0), hl.Func("level")
    light, count = zero, zero
    # Add whole rows above and below the spot and parts of rows beside it: a difference of two sums would lose digits.
    for k in range(-RING_RADIUS, RING_RADIUS + 1):
        first = 2 if abs(k) <= SPOT_RADIUS else 0
        there = rows[X, Y + k]
        light, count = light + there[first], count + there[first + 1]
    mean = light / hl.max(count, hl.f32(1.0))
    level[X, Y] = hl.select(count >= hl.f32(MIN_RING_PIXELS), mean, hl.f32(LARGEST_FLOAT))
    return level


def _define_blocks(least: hl.Func, kinds: Kinds) -> hl.Func:
    """Return the smallest and second smallest luminance of the block whose first corner is a pixel."""
    side, blocks = SHARED_BLOCK_WIDTH if kinds.shared else BLOCK_WIDTH, hl.Func("blocks")
    values = [least[X + column, Y + row] for row in range(side) for column in range(side)]
    lowest, second = values[0], hl.f32(LARGEST_FLOAT)
    for value in values[1:]:
        lowest, second = hl.min(lowest, value), hl.min(second, hl.max(lowest, value))
    blocks[X, Y] = hl.Tuple([lowest, second])
    return blocks


def _define_core(least: hl.Func, blocks: hl.Func, level: hl.Func, agreed: hl.Func, kinds: Kinds) -> hl.Func:
    """Return whether a block or pair that contains the pixel is a highlight, 1 or 0."""
    side, core = SHARED_BLOCK_WIDTH if kinds.shared else BLOCK_WIDTH, hl.Func("core")
    whole = three = hl.f32(0.0)
    for row in range(side):
        for column in range(side):
            there = blocks[X - column, Y - row]
            whole = hl.max(whole, there[0])
            # The darkest pixel of a block is not one of the three bright ones.
            three = hl.max(three, hl.select(least[X, Y] >= there[1], there[1], hl.f32(0.0)))
    around = level[X, Y]
    # Divide instead of multiplying: the product could overflow.
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
    """Return the share of a pixel's light that is split off, in [0, 1)."""
    share, here, around = hl.Func("share"), both[X, Y], level[X, Y]
    near = core[X - 1, Y - 1]
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            near = hl.max(near, core[X + column, Y + row])
    edge = (near > hl.f32(0.0)) & (around < here / hl.f32(MIN_HIGHLIGHT_EDGE_RATIO))
    taken = (core[X, Y] > hl.f32(0.0)) | edge
    share[X, Y] = hl.select(taken & (here > around), hl.f32(1.0) - around / hl.max(here, hl.f32(1e-30)), hl.f32(0.0))
    return share


def _define_split(halves: Sequence[hl.ImageParam], light: hl.Func, share: hl.Func) -> hl.Func:
    """Return both halves without highlights, and the light split off. Unchanged pixels keep their bits, also NaN."""
    out, part, here = hl.Func("split"), share[X, Y], read_light(light, X, Y)
    zero, half = hl.f32(0.0), hl.f32(0.5)
    counts = [here.first >= zero, here.second >= zero]
    rests: list[hl.Expr] = []
    for image, known in zip(halves, counts, strict=True):
        value = image[C, X, Y]
        rests.append(select_bits(known & (part > zero), value * (hl.f32(1.0) - part), value))
    first, second = (hl.select(known, image[C, X, Y], zero) for image, known in zip(halves, counts, strict=True))
    mean = hl.select(counts[0] & counts[1], half * first + half * second, first + second)
    out[C, X, Y] = hl.Tuple([*rests, hl.select(part > zero, mean * part, zero)])
    return out
