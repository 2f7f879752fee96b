"""Share out the light of specks, single bright pixels that lamps out of focus leave, among their neighbours.

Light that no surface scatters (emission, background) has hardly any noise in focus: a pixel shows what it covers. An
open lens blurs a lamp over a disc. Few of a pixel's samples meet the lamp then, and the disc becomes salt. No guide
distinguishes a pixel that met the lamp from its neighbours, so filters do not help. But the lens itself has blurred
what the pixel shows: over a part of its radius, neighbours show nearly the same.

So neighbours out of focus share their light evenly, some times one after the other. What is in focus takes no part. Nor
does a dark pixel beside a disc: it has bright pixels on one side alone, while one within the disc has them all around.
The sum of the light stays, and no pixel becomes brighter than the brightest one near it.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from lobewise.chunks import Chunk, run_chunks
from lobewise.filters.compositing import UNKNOWN_SPP
from lobewise.frame import FloatArray
from lobewise.lobes.vectors import LUMINANCE

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
DIRECTIONS = 8
REACH = MAX_TURNS + VIEW_RADIUS
"""Distance of the farthest pixel that affects a pixel, rows or columns."""


def share_out_specks(light: FloatArray, turns: NDArray[np.int64]) -> FloatArray:
    """Return light of which each pixel out of focus shared its own with its neighbours out of focus.

    It is linear in the light: images that sum to another one do so afterwards.

    Parameters
    ----------
    light : array, shape (height, width, 3)
        Linear radiance, finite.
    turns : array, shape (height, width)
        Result of `count_turns`.
    """
    shared = light
    for turn in range(int(turns.max(initial=0))):
        shares = (turns > turn).astype(np.float32)[..., None]
        given = _sum_around(shares * shared) - _sum_around(shares) * shared
        shared = shared + shares * given * np.float32(1.0 / 9.0)
    return shared


def count_turns(light: FloatArray, blur_radius: FloatArray, spp: int | None) -> NDArray[np.int64]:
    """Return how often each pixel shares its light, (height, width); 0 for not at all.

    Parameters
    ----------
    light : array, shape (height, width, 3)
        All that no surface scatters: linear radiance, finite, >= 0.
    blur_radius : array, shape (height, width)
        As `lobewise.GBuffer.blur_radius`; infinite and NaN count as 0.
    spp : int or None
        Samples per pixel; None counts as `UNKNOWN_SPP`.
    """
    known = np.isfinite(blur_radius) & (blur_radius >= MIN_BLUR_RADIUS)
    radius = np.where(known, blur_radius, np.float32(0.0)).astype(np.float64)
    turns = np.minimum(TURNS * np.cbrt(radius / (spp or UNKNOWN_SPP)) ** 2, MAX_TURNS).astype(np.int64)
    if turns.any():
        bright = np.where(turns > 0, light @ np.array(LUMINANCE, np.float32), np.float32(0.0))
        turns[~_find_sharing(bright)] = 0
    return turns


def _find_sharing(bright: FloatArray) -> NDArray[np.bool_]:
    """Return which pixels share, (height, width), by their luminance: those that are bright, or amid bright ones."""
    height, width = bright.shape
    padded, least = np.pad(bright, VIEW_RADIUS), BRIGHT_SHARE * _find_largest(bright)
    found, views = np.empty((height, width), np.bool_), _list_views()

    def find(chunk: Chunk) -> None:
        rows, columns = chunk
        floor, seen = least[chunk], np.zeros(least[chunk].shape, np.uint8)
        for (y, x), sides in views.items():
            there = padded[rows.start + y : rows.stop + y, columns.start + x : columns.stop + x]
            seen |= (there >= floor).view(np.uint8) * sides
        found[chunk] = (floor > 0.0) & ((bright[chunk] >= floor) | (seen == np.uint8((1 << DIRECTIONS) - 1)))

    run_chunks(find, height, width)
    return found


def _list_views() -> dict[tuple[int, int], np.uint8]:
    """Return by step from the corner of the view the directions, a bit for each, that a pixel there lies ahead of."""
    turns = [2.0 * math.pi * number / DIRECTIONS for number in range(DIRECTIONS)]
    views = {}
    for y in range(-VIEW_RADIUS, VIEW_RADIUS + 1):
        for x in range(-VIEW_RADIUS, VIEW_RADIUS + 1):
            ahead = [x * math.cos(turn) + y * math.sin(turn) > 1e-6 for turn in turns]
            views[y + VIEW_RADIUS, x + VIEW_RADIUS] = np.uint8(
                sum(1 << k for k, is_ahead in enumerate(ahead) if is_ahead)
            )
    return views


def _find_largest(image: FloatArray) -> FloatArray:
    """Return the largest value within `BRIGHT_RADIUS` rows and columns."""
    for axis in (0, 1):
        padded = np.pad(image, [(BRIGHT_RADIUS, BRIGHT_RADIUS) if each == axis else (0, 0) for each in (0, 1)])
        image = np.lib.stride_tricks.sliding_window_view(padded, 2 * BRIGHT_RADIUS + 1, axis=axis).max(axis=-1)
    return image


def _sum_around(image: FloatArray) -> FloatArray:
    """Return the sums over 3x3 pixels, 0 beyond the borders."""
    padded = np.pad(image, ((1, 1), (1, 1), (0, 0)))
    rows = padded[:-2] + padded[1:-1] + padded[2:]
    return np.asarray(rows[:, :-2] + rows[:, 1:-1] + rows[:, 2:])
