"""The oracle: the cross filter as slow float64 loops over taps, written from the definition, without Halide.

It shares nothing with the kernels but the features' NumPy similarities, which are themselves written a second time.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lobewise.frame import FloatArray
from lobewise.kernels.features import Feature

FloatImage = NDArray[np.float64]

B_SPLINE = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 6.0
ATROUS_STEPS = (1, 2, 4, 8, 16)
ALBEDO_FLOOR = 1e-3


def make_first_sums(radiance: FloatArray, mask: NDArray[np.bool_], albedo: FloatArray | None) -> FloatImage:
    """Return the image (height, width, 5) that the first pass sums: radiance over albedo, and twice its weight."""
    colour = radiance.astype(np.float64)
    good = mask & np.isfinite(colour).all(axis=-1) & (colour >= 0.0).all(axis=-1)
    if albedo is not None:
        tint = albedo.astype(np.float64)
        good &= np.isfinite(tint).all(axis=-1) & (tint >= 0.0).all(axis=-1) & (tint.max(axis=-1) > ALBEDO_FLOOR)
        colour = colour / np.where(tint > ALBEDO_FLOOR, tint, ALBEDO_FLOOR)
    sums = np.ones((*mask.shape, 5))
    sums[..., :3] = colour
    sums[~good] = 0.0
    return sums


def list_passes(form: str, radius: int) -> list[list[tuple[int, int, float]]]:
    """Return, for each pass, its taps as (rows down, columns right, weight)."""
    reach = range(-radius, radius + 1)
    if form == "full":
        return [[(dy, dx, 1.0) for dy in reach for dx in reach]]
    if form == "separable":
        return [[(0, dx, 1.0) for dx in reach], [(dy, 0, 1.0) for dy in reach]]
    if form == "atrous":
        five = range(5)
        return [
            [((a - 2) * step, (b - 2) * step, float(B_SPLINE[a] * B_SPLINE[b])) for a in five for b in five]
            for step in ATROUS_STEPS
        ]
    raise ValueError(form)


def sum_taps(
    sums: FloatImage, mask: NDArray[np.bool_], features: Sequence[Feature], taps: list[tuple[int, int, float]]
) -> FloatImage:
    """Return one pass over ``sums`` (height, width, 5)."""
    height, width = mask.shape
    out = np.zeros_like(sums)
    for dy, dx, profile in taps:
        rows = np.arange(max(0, -dy), min(height, height - dy))
        columns = np.arange(max(0, -dx), min(width, width - dx))
        if rows.size == 0 or columns.size == 0:
            continue
        i = tuple(np.meshgrid(rows, columns, indexing="ij"))
        j = (i[0] + dy, i[1] + dx)
        weight = np.full(i[0].shape, profile)
        both = mask[i] & mask[j]
        for feature in features:
            similarity = np.zeros(i[0].shape)
            pairs_i, pairs_j = (i[0][both], i[1][both]), (j[0][both], j[1][both])
            similarity[both] = feature.get_similarity(pairs_i, pairs_j)
            weight = weight * similarity
        if not features:
            weight = np.where(both, weight, 0.0)
        out[i] += np.concatenate([weight[..., None] * sums[j][..., :4], (weight**2)[..., None] * sums[j][..., 4:]], -1)
    return out


def filter_reference(
    radiance: FloatArray,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    *,
    form: str,
    radius: int,
    albedo: FloatArray | None = None,
) -> tuple[FloatImage, FloatImage, FloatImage]:
    """Return image (height, width, 3), weight sum and effective samples (height, width); see `engine.run_filter`.

    Pixels outside the mask are 0.
    """
    sums = make_first_sums(radiance, mask, albedo)
    for taps in list_passes(form, radius):
        sums = sum_taps(sums, mask, features, taps)
    total, squares = sums[..., 3], sums[..., 4]
    with np.errstate(invalid="ignore", divide="ignore"):
        image = np.where(total[..., None] > 0.0, sums[..., :3] / total[..., None], 0.0)
        effective = np.where(squares > 0.0, total**2 / squares, np.where(total > 0.0, 1.0, 0.0))
    if albedo is not None:
        tint = albedo.astype(np.float64)
        image = image * np.where(np.isfinite(tint) & (tint >= 0.0), tint, 0.0)
    return image, total, effective
