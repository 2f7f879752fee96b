"""Light without noise that outshines what is around it: lamps that the camera sees, and mirror images of them.

Where a frame does not tell emission apart, a lamp lies on a surface like any other, and one that is fifty times as
bright as the ceiling around it spoils everything in the filter's reach. Its own light has no noise: pixels beside each
other are alike, which those of noisy light are not. So lamps are found in the image, and pass as they are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray

ALIKE = 0.03
"""Largest difference of neighbours in a lamp, in every colour, relative to the brighter one."""
FEWEST = 3
"""Neighbours, of eight, that are alike."""
OUTSHINES = 10.0
"""How many times as bright as the mean around other pixels a lamp is."""
EDGE_OUTSHINES = 2.0
"""The same of pixels that a lamp covers in part, or that a filter spread it over."""
EDGE = 2
"""How far from a lamp those are, pixels."""
MEAN_RADIUS, REACH = 3, 32
"""Radii, pixels, of the square over which noisy light is averaged, and of the one in which it is compared: further than
any filter reaches, or the inside of a large lamp would be none and reach past its edge."""
SHARE = 0.15
"""How much of that a lamp outshines, at least."""
STEP = 1.5
"""Ratio of the brightnesses that are looked at together."""

Mask = NDArray[np.bool_]


def find_lamps(light: FloatArray) -> Mask:
    """Return where pixels show lamps, or their edges, (height, width).

    Parameters
    ----------
    light : array, shape (height, width, 3)
        Linear radiance, over the albedo where that is known; what is NaN, infinite or negative shows none.
    """
    good: Mask = np.asarray((np.isfinite(light) & (light >= 0.0)).all(axis=-1))
    light = np.where(good[..., None], light, np.float32(0.0))
    bright = light.mean(axis=-1)
    around = _average(bright, MEAN_RADIUS)
    lamps = _outshine(bright, around, _find_smooth(light) & (bright > 0.0), OUTSHINES)
    if not lamps.any():
        return lamps
    near = lamps
    for _ in range(EDGE):
        near = _grow(near)
    # Around an edge the mean holds the lamp itself: what is compared is what lies further away.
    return lamps | _outshine(bright, around, near & ~lamps, EDGE_OUTSHINES)


def _find_smooth(light: FloatArray) -> Mask:
    """Return which pixels have neighbours like themselves."""
    count = np.zeros(light.shape[:2], dtype=np.int8)
    padded = np.pad(light, ((1, 1), (1, 1), (0, 0)), constant_values=-1.0)
    height, width = light.shape[:2]
    for row, column in ((r, c) for r in range(3) for c in range(3) if (r, c) != (1, 1)):
        other = padded[row : row + height, column : column + width]
        count += (np.abs(other - light) <= ALIKE * np.maximum(other, light)).all(axis=-1)
    return np.asarray(count >= FEWEST)


def _outshine(bright: FloatArray, around: FloatArray, candidates: Mask, factor: float) -> Mask:
    """Return which of some pixels are ``factor`` times as bright as enough of the means around them."""
    found = np.zeros_like(candidates)
    level = np.floor(np.log(np.maximum(bright, 1e-30)) / np.log(STEP)).astype(int)
    for each in np.unique(level[candidates]):
        share = _average((around < STEP**each / factor).astype(np.float32), REACH)
        found |= candidates & (level == each) & (share >= SHARE)
    return found


def _grow(mask: Mask) -> Mask:
    """Return a mask with the eight neighbours of all its pixels."""
    return np.asarray(_average(mask.astype(np.float32), 1) > 0.05)


def _average(image: FloatArray, radius: int) -> FloatArray:
    """Return the means over squares, at the borders over what of them lies inside."""
    result = image.astype(np.float64)
    for axis in (0, 1):
        length = result.shape[axis]
        sums = np.concatenate([np.zeros_like(np.take(result, [0], axis)), np.cumsum(result, axis=axis)], axis=axis)
        place = np.arange(length)
        low, high = np.maximum(place - radius, 0), np.minimum(place + radius + 1, length)
        count = (high - low).reshape((-1, 1) if axis == 0 else (1, -1))
        result = (np.take(sums, high, axis) - np.take(sums, low, axis)) / count
    return np.asarray(result, dtype=np.float32)
