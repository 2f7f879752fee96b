"""Pixels that hold no light as nothing was sampled there: a pattern that was left out, and the gutters of a bake."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from lobewise.guides.squares import sum_square
from lobewise.records.frame import FloatArray

NOT_RENDERED = "pixels not rendered"
"""Name of the finding of a pattern of pixels that were left out."""
PERIOD = 4
"""Pixels after which a pattern of pixels that were left out repeats: rows, a checkerboard, one of 2x2 or of 4x4."""
MIN_LIT = 64
"""Pixels with light that each sampled place of the pattern has. By chance none has as many where another has none."""
MIN_GUTTER_SHARE = 0.001
"""Share of the pixels from which on those without opacity are the gutters of a bake."""
REACH = 2
"""Pixels around a pixel whose light continues into a gutter."""

Mask = NDArray[np.bool_]


def mark_pattern(color: FloatArray) -> Mask | None:
    """Return which pixels, (height, width), were left out in a regular pattern, None if there is no such pattern.

    They hold no light at all, and of the pixels at any other place of the pattern many do.
    """
    height, width = color.shape[:2]
    lit = color[..., 0] != 0.0
    for k in range(1, color.shape[-1]):
        lit |= color[..., k] != 0.0
    count = np.array(
        [[np.count_nonzero(lit[row::PERIOD, column::PERIOD]) for column in range(PERIOD)] for row in range(PERIOD)]
    )
    left_out = count == 0
    if left_out.all() or not left_out.any() or count[~left_out].min() < MIN_LIT:
        return None
    return np.tile(left_out, (-(-height // PERIOD), -(-width // PERIOD)))[:height, :width]


def mark_gutters(color: FloatArray, alpha: FloatArray) -> Mask | None:
    """Return which pixels, (height, width), are the gutters between the charts of a bake, None if there are none.

    There alpha and light are 0, and alpha is 1 anywhere else: what a camera sees has fractions at its silhouettes.
    """
    gutters = alpha == 0.0
    if not ((alpha == 1.0) | gutters).all() or gutters.all() or gutters.mean() < MIN_GUTTER_SHARE:
        return None
    return None if color[gutters].any() else gutters


def fill_gutters(image: FloatArray, known: Mask) -> FloatArray:
    """Return an image, (height, width, 3), whose known pixels continue into the others: in steps that double."""
    if known.all():
        return image
    light = np.where(known[..., None], image, np.float32(0.0))
    sums, count = sum_square(light, REACH), sum_square(known.astype(np.float32), REACH)
    near = count > 0.0
    means = sums / np.maximum(count, np.float32(1.0))[..., None]
    light = np.where(known[..., None], image, means).astype(np.float32)
    if near.all() or not near.any():
        return light
    height, width = near.shape
    odd = ((0, height % 2), (0, width % 2))
    quads = np.pad(light, (*odd, (0, 0))).reshape((height + 1) // 2, 2, (width + 1) // 2, 2, 3).sum(axis=(1, 3))
    full = np.pad(near, odd).reshape((height + 1) // 2, 2, (width + 1) // 2, 2).sum(axis=(1, 3))
    coarse = fill_gutters((quads / np.maximum(full, 1)[..., None]).astype(np.float32), full > 0)
    far = coarse.repeat(2, axis=0).repeat(2, axis=1)[:height, :width]
    return np.where(near[..., None], light, far)


def repeat(image: FloatArray, known: Mask) -> FloatArray:
    """Return an image, (height, width) or with channels, whose other pixels have the values of known neighbours."""
    image, known = image.copy(), known.copy()
    while not known.all():
        for axis, step in ((1, 1), (1, -1), (0, 1), (0, -1)):
            near = np.roll(known, step, axis) & ~known
            image[near] = np.roll(image, step, axis)[near]
            known |= near
    return image
