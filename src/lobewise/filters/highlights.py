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
MIN_HIGHLIGHT_EDGE_RATIO = 1.5
"""Smallest luminance of a highlight's edge, a pixel beside such a block, over the mean of the surroundings."""
BLOCK_WIDTH = 2
"""Width of a block, pixels."""
HIGHLIGHT_REACH = RING_RADIUS + 1
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


@returns_host_images
def split_highlights(
    halves: tuple[Image, Image],
    albedo: NDArray[np.float32] | None,
    mask: NDArray[np.bool_],
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

    Raises
    ------
    InputError
        If an image is not real numbers of the mask's size.
    """
    images, tinted = take_halves(halves, albedo, mask), albedo is not None
    make = partial(make_highlights, tinted)
    return SplitHalves(*engine.kernel(("highlights", tinted), make, images, text="split off highlights").values())


def make_highlights(tinted: bool, target: hl.Target) -> Scheduled:
    """Return the kernel: it writes both halves without highlights, and the light of the highlights."""
    # Signature
    signature = Signature("highlights")
    halves, albedo, mask = declare_halves(signature, tinted)
    for name in ("rest_a", "rest_b", "kept"):
        signature.output(name, "height", "width", 3)

    # Algorithm
    light = define_light(halves, albedo, mask)
    both, least = define_both(light), _define_least(light)
    rows = _define_rows(both)
    level = _define_level(rows)
    blocks = _define_blocks(least)
    core = _define_core(least, blocks, level)
    share = _define_share(both, level, core)
    out = _define_split(halves, light, share)

    # Schedule
    stored = light, rows, level, blocks, core
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


def _define_blocks(least: hl.Func) -> hl.Func:
    """Return the smallest and second smallest luminance of the block whose first corner is a pixel."""
    blocks = hl.Func("blocks")
    values = [least[X + column, Y + row] for row in range(BLOCK_WIDTH) for column in range(BLOCK_WIDTH)]
    lowest, second = values[0], hl.f32(LARGEST_FLOAT)
    for value in values[1:]:
        lowest, second = hl.min(lowest, value), hl.min(second, hl.max(lowest, value))
    blocks[X, Y] = hl.Tuple([lowest, second])
    return blocks


def _define_core(least: hl.Func, blocks: hl.Func, level: hl.Func) -> hl.Func:
    """Return whether a block that contains the pixel is a highlight, 1 or 0."""
    core = hl.Func("core")
    whole = three = hl.f32(0.0)
    for row in range(BLOCK_WIDTH):
        for column in range(BLOCK_WIDTH):
            there = blocks[X - column, Y - row]
            whole = hl.max(whole, there[0])
            # The darkest pixel of a block is not one of the three bright ones.
            three = hl.max(three, hl.select(least[X, Y] >= there[1], there[1], hl.f32(0.0)))
    around = level[X, Y]
    # Divide instead of multiplying: the product could overflow.
    bright = (around < whole / hl.f32(MIN_BLOCK_RATIO)) | (around < three / hl.f32(MIN_CORNER_RATIO))
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
