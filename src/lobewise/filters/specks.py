"""Share out the light of specks, single bright pixels that lamps out of focus leave, among their neighbours.

Light that no surface scatters (emission, background) has hardly any noise in focus: a pixel shows what it covers. An
open lens blurs a lamp over a disc. Few of a pixel's samples meet the lamp then, and the disc becomes salt. No guide
distinguishes a pixel that met the lamp from its neighbours, so filters do not help. But the lens itself has blurred
what the pixel shows: over a part of its radius, neighbours show nearly the same.

Two steps follow from that. First neighbours out of focus exchange their light evenly, some times one after the other.
What is in focus takes no part. Nor does a dark pixel beside a disc: it has bright pixels on one side alone, while one
within the disc has them all around. Then a pixel at the rim of a disc that outshines its neighbours hands the excess to
those that are bright already, in proportion to their own light: there one sample too many met the lamp.

Both steps move light and lose none. Both are linear once it is known which pixels share, so images that sum to another
one do so afterwards.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from lobewise.filters.compositing import UNKNOWN_SPP
from lobewise.guides.squares import compute_square_maximum, sum_square
from lobewise.lobes.vectors import compute_image_luminance
from lobewise.records.frame import FloatArray
from lobewise.work.chunks import Chunk, run_chunks

MIN_BLUR_RADIUS = 1.5
"""Radius, pixels, from which a pixel counts as out of focus."""
TURNS = 6.0
"""How often pixels share where the lens blurs over one pixel for each sample. The noise that is left falls with the
area that light is spread over, and the softening of a disc's rim grows with the width of this area over the radius:
their sum is least at a width that goes with the cube root of radius over samples."""
MAX_TURNS = 10
BRIGHT_SHARE = 1.0 / 3.0
"""Luminance over the largest within `BRIGHT_RADIUS` pixels from which a pixel counts as bright."""
BRIGHT_RADIUS, VIEW_RADIUS = 2, 5
"""The latter is the distance within which a dark pixel looks for bright ones all around, rows or columns."""
DIRECTION_COUNT = 8
RANK = 4
"""Rank, from the brightest, of the neighbour that bounds a pixel's luminance."""
SPREAD_RADIUS, MAX_SHARE_GIVEN = 2, 0.25
"""Radius of the square that the excess is handed out over, pixels, and the largest share of its own luminance that a
pixel gets of one other: what is more stays where it was."""
RIM = 4
"""Distance from a pixel out of focus, rows or columns, within which a pixel may belong to the rim of a disc, unless it
is known to be in focus."""
SPECK_REACH = MAX_TURNS + VIEW_RADIUS + 2 * SPREAD_RADIUS + 1
"""Distance of the farthest pixel that affects a pixel, rows or columns."""


@dataclass(frozen=True)
class Sharing:
    """Which pixels share their light, and how.

    Parameters
    ----------
    turns : (height, width), int
        How often a pixel exchanges light with its neighbours.
    gain : (height, width)
        Factor of its light after that.
    """

    turns: NDArray[np.int64]
    gain: FloatArray

    def apply(self, light: FloatArray) -> FloatArray:
        """Return an image (height, width, 3), linear radiance, finite, after both steps."""
        return exchange(light, self.turns) * self.gain[..., None]


def choose_sharing(light: FloatArray, blur_radius: FloatArray, spp: int | None) -> Sharing:
    """Return how the light that no surface scatters is shared.

    Parameters
    ----------
    light : array, shape (height, width, 3)
        All of it: linear radiance, finite, >= 0.
    blur_radius : array, shape (height, width)
        As `lobewise.GBuffer.blur_radius`.
    spp : int or None
        Samples per pixel; None counts as `UNKNOWN_SPP`.
    """
    turns = count_turns(light, blur_radius, spp)
    blurred = np.isfinite(blur_radius) & (blur_radius >= MIN_BLUR_RADIUS)
    near = compute_square_maximum(blurred, RIM)
    near &= ~(blur_radius < MIN_BLUR_RADIUS)
    return Sharing(turns, _compute_gain(compute_image_luminance(exchange(light, turns)), near))


def exchange(light: FloatArray, turns: NDArray[np.int64]) -> FloatArray:
    """Return an image (height, width, 3) in which neighbours exchanged a ninth of their difference, turn by turn."""
    shared = light
    for turn in range(int(turns.max(initial=0))):
        shares = (turns > turn).astype(np.float32)[..., None]
        exchanged = sum_square(shares * shared, 1) - sum_square(shares, 1) * shared
        shared = shared + shares * exchanged * np.float32(1.0 / 9.0)
    return shared


def count_turns(light: FloatArray, blur_radius: FloatArray, spp: int | None) -> NDArray[np.int64]:
    """Return how often each pixel shares its light, (height, width); 0 for not at all.

    Parameters are those of `choose_sharing`.
    """
    known = np.isfinite(blur_radius) & (blur_radius >= MIN_BLUR_RADIUS)
    radius = np.where(known, blur_radius, np.float32(0.0)).astype(np.float64)
    turns = np.minimum(TURNS * np.cbrt(radius / (spp or UNKNOWN_SPP)) ** 2, MAX_TURNS).astype(np.int64)
    if turns.any():
        bright = np.where(turns > 0, compute_image_luminance(light), np.float32(0.0))
        turns[~_mark_sharing(bright)] = 0
    return turns


def _mark_sharing(bright: FloatArray) -> NDArray[np.bool_]:
    """Return which pixels share, (height, width), by their luminance: those that are bright, or amid bright ones."""
    height, width = bright.shape
    padded, least = np.pad(bright, VIEW_RADIUS), BRIGHT_SHARE * compute_square_maximum(bright, BRIGHT_RADIUS)
    sharing, views = np.empty((height, width), np.bool_), _list_views()

    def find(chunk: Chunk) -> None:
        rows, columns = chunk
        floor, seen = least[chunk], np.zeros(least[chunk].shape, np.uint8)
        for (y, x), sides in views.items():
            there = padded[rows.start + y : rows.stop + y, columns.start + x : columns.stop + x]
            seen |= (there >= floor).view(np.uint8) * sides
        sharing[chunk] = (floor > 0.0) & ((bright[chunk] >= floor) | (seen == np.uint8((1 << DIRECTION_COUNT) - 1)))

    run_chunks(find, height, width)
    return sharing


def _list_views() -> dict[tuple[int, int], np.uint8]:
    """Return by step from the corner of the view the directions, a bit for each, that a pixel there lies ahead of."""
    turns = [2.0 * math.pi * number / DIRECTION_COUNT for number in range(DIRECTION_COUNT)]
    views = {}
    for y in range(-VIEW_RADIUS, VIEW_RADIUS + 1):
        for x in range(-VIEW_RADIUS, VIEW_RADIUS + 1):
            ahead = [x * math.cos(turn) + y * math.sin(turn) > 1e-6 for turn in turns]
            views[y + VIEW_RADIUS, x + VIEW_RADIUS] = np.uint8(
                sum(1 << k for k, is_ahead in enumerate(ahead) if is_ahead)
            )
    return views


def _compute_gain(bright: FloatArray, near: NDArray[np.bool_]) -> FloatArray:
    """Return the factors by which pixels hand out what is above their bound, (height, width), by their luminance."""
    gain = np.ones_like(bright)
    if not near.any():
        return gain
    bound = _compute_bound(bright)
    bounded = np.where(near, np.minimum(bright, bound), bright)
    takes = np.where(near, bounded, np.float32(0.0))
    taken = sum_square(takes, SPREAD_RADIUS)
    share = np.minimum(
        np.divide(bright - bounded, taken, out=np.zeros_like(bright), where=taken > 0.0), MAX_SHARE_GIVEN
    )
    total = bright - share * taken + takes * sum_square(share, SPREAD_RADIUS)
    return np.asarray(np.divide(total, bright, out=gain, where=bright > 0.0))


def _compute_bound(bright: FloatArray) -> FloatArray:
    """Return the luminance of the neighbour of rank `RANK`, of the eight around each pixel; borders are repeated."""
    height, width = bright.shape
    padded = np.pad(bright, 1, mode="edge")
    best = [np.zeros_like(bright) for _ in range(RANK)]
    for y, x in ((y, x) for y in range(3) for x in range(3) if (y, x) != (1, 1)):
        value = padded[y : y + height, x : x + width]
        for place in range(RANK):
            best[place], value = np.maximum(best[place], value), np.minimum(best[place], value)
    return best[-1]
