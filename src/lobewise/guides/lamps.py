"""Finds lamps that the camera sees, and their mirror images: light without noise, far brighter than its surroundings.

If a frame has no separate emission, a lamp looks like any other surface. A lamp fifty times as bright as the ceiling
around it spoils every pixel within the filter's radius. Light of a lamp has no noise: its neighbouring pixels are
alike, while neighbouring pixels of noisy light differ. So lamps are found in the image and not filtered.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from lobewise.guides.squares import compute_square_maximum, sum_square
from lobewise.records.frame import FloatArray, Frame
from lobewise.records.images import crop_columns

MAX_DIFFERENCE = 0.03
"""Largest difference between alike neighbours, in every colour, relative to the brighter one."""
MIN_ALIKE_NEIGHBOURS = 3
"""Smallest number of alike neighbours, of eight, that a pixel of a lamp has."""
MIN_CONTRAST = 10.0
"""Smallest ratio of a lamp's brightness to the mean brightness around other pixels."""
MIN_EDGE_CONTRAST = 2.0
"""Smallest ratio for pixels at the edge of a lamp: the lamp covers them in part, or a pixel filter spreads it there."""
EDGE_WIDTH = 2
"""Width of the edge of a lamp, pixels."""
MAX_EDGE_EXCESS = 1.5
"""Largest ratio of an edge's radiance to that of the brightest pixel inside the lamp within `EDGE_WIDTH`.

A lamp covers its edge in part, so the edge is no brighter than the lamp. But windows have gradients, and few samples
count a lamp in steps: pixels that two of three samples hit are alike too, and their lamp is half as bright again. A
firefly beside pixels that are alike by chance is far brighter. (19 scenes, 1 to 64 samples, `balanced` and `high`: with
1.5 no error grows by more than 1 %; with 1.03 errors grow by up to 16 %, because windows and bright lamps are cut up.)
"""
MEAN_RADIUS = 3
"""Radius of the square over which noisy light is averaged, pixels."""
COMPARED_RADIUS = 32
"""Radius of the square in which a lamp is compared with other pixels, pixels. It is larger than the radius of every
filter: within a smaller one the inside of a large lamp would see only the lamp."""
LAMP_REACH = MEAN_RADIUS + COMPARED_RADIUS + EDGE_WIDTH
"""Rows around a pixel on which it depends whether it shows a lamp."""
MIN_DARKER_SHARE = 0.15
"""Smallest share of the compared pixels that a lamp must outshine."""
LEVEL_RATIO = 1.5
"""Ratio of successive levels of brightness. All pixels of one level are compared in one step."""

MIN_DIVISOR_ALBEDO = 0.01
"""Smallest albedo by which light is divided."""

Mask = NDArray[np.bool_]


def keep_lamps(frame: Frame) -> tuple[Frame, int]:
    """Return a frame with a zero normal at lamps, and the number of lamp pixels.

    Filters keep pixels without a surface, so lamps stay sharp. A frame without normals, or whose light is split, does
    not change.
    """
    guides = frame.gbuffer
    if frame.radiance.parts is not None or guides.normal is None:
        return frame, 0
    around = frame.surround()
    seen = (around.gbuffer.diffuse_albedo, around.gbuffer.specular_albedo)
    known = [albedo for albedo in seen if albedo is not None]
    albedo = lift_albedo(np.sum(known, axis=0, dtype=np.float32)) if known else None
    lamps = crop_columns(mark_lamps(around.radiance.color, albedo), frame.width)
    if not lamps.any():
        return frame, 0
    normal = np.where(lamps[..., None], np.float32(0.0), guides.normal)
    return frame.with_changes(gbuffer=replace(guides, normal=normal)), int(np.count_nonzero(lamps))


def describe_lamps(count: int) -> tuple[str, ...]:
    """Return the sentence on the pixels that `keep_lamps` found, if there are any."""
    sentence = f"{count} pixels show lamps, or something as bright and without noise, and pass as they are."
    return (sentence,) if count else ()


def lift_albedo(albedo: FloatArray) -> FloatArray:
    """Return an albedo, shape (height, width, 3), by which light can be divided without loss.

    Raise each channel to `MIN_DIVISOR_ALBEDO`. Pixels where no channel exceeds this value become 1.
    """
    black = albedo.max(axis=-1, keepdims=True) <= MIN_DIVISOR_ALBEDO
    return np.where(black, np.float32(1.0), np.maximum(albedo, np.float32(MIN_DIVISOR_ALBEDO)))


@np.errstate(invalid="ignore", over="ignore")
def mark_lamps(color: FloatArray, albedo: FloatArray | None = None) -> Mask:
    """Return which pixels show lamps or their edges, (height, width).

    Parameters
    ----------
    color : array, shape (height, width, 3)
        Linear radiance. Pixels that are NaN, infinite or negative show no lamp.
    albedo : array, shape (height, width, 3), optional
        Positive albedo. Lamps are compared with their surroundings after division by it, so that textures are no noise.
    """
    light = color if albedo is None else color / albedo
    good: Mask = np.asarray((np.isfinite(light) & (light >= 0.0)).all(axis=-1))
    light, color = (np.where(good[..., None], image, np.float32(0.0)) for image in (light, color))
    bright = light.mean(axis=-1)
    # Sums in one order, so that a band of rows has the bits of the whole image.
    around = sum_square(bright.astype(np.float64), MEAN_RADIUS) / sum_square(np.ones_like(bright), MEAN_RADIUS)
    around = around.astype(np.float32)
    lamps = _outshine(bright, around, _mark_smooth(light) & (bright > 0.0), MIN_CONTRAST)
    if not lamps.any():
        return lamps
    # The mean around an edge contains the lamp itself, so edges are compared with means further away.
    return lamps | _outshine(bright, around, _mark_edges(color, lamps), MIN_EDGE_CONTRAST)


def _mark_edges(color: FloatArray, lamps: Mask) -> Mask:
    """Return which pixels are near enough to a lamp for its edge, and not too bright.

    Radiance is compared, without division: coverage mixes radiance, and the albedo of a lamp says nothing of its light.
    """
    radiance = color.mean(axis=-1)
    brightest = compute_square_maximum(np.where(lamps, radiance, np.float32(0.0)), EDGE_WIDTH)
    return np.asarray((brightest > 0.0) & (radiance <= MAX_EDGE_EXCESS * brightest) & ~lamps)


def _mark_smooth(light: FloatArray) -> Mask:
    """Return which pixels have enough alike neighbours."""
    count = np.zeros(light.shape[:2], dtype=np.int8)
    padded = np.pad(light, ((1, 1), (1, 1), (0, 0)), constant_values=-1.0)
    height, width = light.shape[:2]
    for row, column in ((r, c) for r in range(3) for c in range(3) if (r, c) != (1, 1)):
        other = padded[row : row + height, column : column + width]
        count += (np.abs(other - light) <= MAX_DIFFERENCE * np.maximum(other, light)).all(axis=-1)
    return np.asarray(count >= MIN_ALIKE_NEIGHBOURS)


def _outshine(bright: FloatArray, around: FloatArray, candidates: Mask, factor: float) -> Mask:
    """Return which candidates are ``factor`` times as bright as enough of the means around them."""
    outshining = np.zeros_like(candidates)
    rows, columns = np.nonzero(candidates)
    if not len(rows):
        return outshining
    levels = np.floor(np.log(np.maximum(bright[rows, columns], 1e-30)) / np.log(LEVEL_RATIO)).astype(int)
    order = np.argsort(levels, kind="stable")
    found, firsts = np.unique(levels[order], return_index=True)
    for level, some in zip(found, np.split(order, firsts[1:]), strict=True):
        places = rows[some], columns[some]
        darker, area = _count_around(around, LEVEL_RATIO**level / factor, *places)
        outshining[places] = darker >= MIN_DARKER_SHARE * area
    return outshining


def _count_around(
    around: FloatArray, most: float, rows: NDArray[np.intp], columns: NDArray[np.intp]
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return how many means below ``most`` lie in the square of `COMPARED_RADIUS` around some pixels, and its area."""
    sides = []
    for places, length in ((rows, around.shape[0]), (columns, around.shape[1])):
        low = np.maximum(places - COMPARED_RADIUS, 0)
        sides.append((low, np.minimum(places + COMPARED_RADIUS + 1, length)))
    (top, bottom), (left, right) = sides
    # A table of sums over the part of the image that the squares cover.
    first, start = top.min(), left.min()
    part = around[first : bottom.max(), start : right.max()] < most
    sums = np.zeros((part.shape[0] + 1, part.shape[1] + 1), np.int32)
    np.cumsum(part, axis=0, out=sums[1:, 1:])
    np.cumsum(sums[1:, 1:], axis=1, out=sums[1:, 1:])
    above, below, before, after = top - first, bottom - first, left - start, right - start
    count = sums[below, after] - sums[above, after] - sums[below, before] + sums[above, before]
    return count, (bottom - top) * (right - left)
