"""The oracle: cross filter and reprojection as slow float64 loops over taps, from the definition, without Halide.

It shares nothing with the kernels; the similarities are written a second time in `tests.features.oracles`.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lobewise.features import Feature, GgxLobe
from lobewise.records.frame import FloatArray
from tests.features.oracles import get_similarity

FloatImage = NDArray[np.float64]

B_SPLINE = np.array([1.0, 4.0, 6.0, 4.0, 1.0]) / 6.0
ATROUS_STEPS = (1, 2, 4, 8, 16)
ALBEDO_FLOOR = 1e-3
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])
SNAP_PIXELS = 2e-3


class ReferenceOutput(NamedTuple):
    """What a filter run gives, float64; see `engine.FilterOutput`."""

    image: FloatImage
    weight_sum: FloatImage
    effective_samples: FloatImage
    moment: FloatImage


def make_first_sums(radiance: FloatArray, mask: NDArray[np.bool_], albedo: FloatArray | None) -> FloatImage:
    """Return the image (height, width, 6) that the first pass sums.

    Radiance over albedo, twice its weight, its squared luminance.
    """
    colour = radiance.astype(np.float64)
    good = mask & np.isfinite(colour).all(axis=-1) & (colour >= 0.0).all(axis=-1)
    if albedo is not None:
        tint = albedo.astype(np.float64)
        good &= np.isfinite(tint).all(axis=-1) & (tint >= 0.0).all(axis=-1) & (tint.max(axis=-1) > ALBEDO_FLOOR)
        colour = colour / np.where(tint > ALBEDO_FLOOR, tint, ALBEDO_FLOOR)
    sums = np.ones((*mask.shape, 6))
    sums[..., :3] = colour
    with np.errstate(invalid="ignore"):
        sums[..., 5] = (colour @ LUMINANCE) ** 2
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
    sums: FloatImage,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    taps: list[tuple[int, int, float]],
    strictness: FloatArray | None,
) -> FloatImage:
    """Return one pass over ``sums`` (height, width, 6)."""
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
            similarity[both] = get_similarity(feature, pairs_i, pairs_j)
            weight = weight * similarity
        if not features:
            weight = np.where(both, weight, 0.0)
        if strictness is not None:
            weight = weight ** strictness[i].astype(np.float64)
        factors = np.repeat(weight[..., None], sums.shape[2], axis=-1)
        factors[..., 4] = weight**2
        out[i] += factors * sums[j]
    return out


def filter_reference(
    radiance: FloatArray,
    mask: NDArray[np.bool_],
    features: Sequence[Feature],
    *,
    form: str,
    radius: int,
    albedo: FloatArray | None = None,
    modulate: bool = True,
    strictness: FloatArray | None = None,
) -> ReferenceOutput:
    """Return the result of `run_filter`, computed in float64.

    Pixels outside the mask are 0.
    """
    sums = make_first_sums(radiance, mask, albedo)
    for taps in list_passes(form, radius):
        sums = sum_taps(sums, mask, features, taps, strictness)
    total, squares = sums[..., 3], sums[..., 4]
    with np.errstate(invalid="ignore", divide="ignore"):
        image = np.where(total[..., None] > 0.0, sums[..., :3] / total[..., None], 0.0)
        effective = np.where(squares > 0.0, total**2 / squares, np.where(total > 0.0, 1.0, 0.0))
        moment = np.where(total > 0.0, sums[..., 5] / total, 0.0)
    if albedo is not None and modulate:
        tint = albedo.astype(np.float64)
        image = image * np.where(np.isfinite(tint) & (tint >= 0.0), tint, 0.0)
    return ReferenceOutput(image, total, effective, moment)


def stack_frames(before: Feature, now: Feature) -> Feature:
    """Return a feature of one image with the rows of the frame before above the rows of this frame.

    Its parameters are those of this frame. A feature of the distance on the screen has no meaning between two frames.
    """
    both: dict[str, Any] = {}
    for name, value in vars(now).items():
        old = getattr(before, name)
        if isinstance(value, np.ndarray):
            both[name] = np.concatenate([old, value])
        elif isinstance(value, GgxLobe):
            both[name] = GgxLobe(*(np.concatenate(pair) for pair in zip(old, value, strict=True)))
    return replace(now, **both)  # type: ignore[type-var]


def reproject_reference(
    past: FloatArray,
    places: FloatArray,
    masks: tuple[NDArray[np.bool_], NDArray[np.bool_]],
    features: tuple[Sequence[Feature], Sequence[Feature]],
) -> FloatImage:
    """Return the result of `reproject`, (height, width, 8), computed in float64."""
    height, width = masks[1].shape
    pairs = [stack_frames(*pair) for pair in zip(*features, strict=True)]
    with np.errstate(invalid="ignore"):
        inside = (places > -1.0).all(axis=-1) & (places < np.array([width, height])).all(axis=-1)
    rows, columns = np.nonzero(inside & masks[1])
    where = places[rows, columns].astype(np.float64)
    where = np.where(np.abs(where - np.rint(where)) < SNAP_PIXELS, np.rint(where), where)
    first = np.floor(where).astype(np.intp)
    out = np.zeros((height, width, 8))
    for right, down in ((0, 0), (1, 0), (0, 1), (1, 1)):
        k_x, k_y = first[:, 0] + right, first[:, 1] + down
        taken = (k_x >= 0) & (k_x < width) & (k_y >= 0) & (k_y < height)
        taken[taken] &= masks[0][k_y[taken], k_x[taken]] & np.isfinite(past[k_y[taken], k_x[taken]]).all(axis=-1)
        if not taken.any():
            continue
        y, x, k_x, k_y = rows[taken], columns[taken], k_x[taken], k_y[taken]
        weight = (1.0 - np.abs(where[taken, 0] - k_x)) * (1.0 - np.abs(where[taken, 1] - k_y))
        agrees = np.ones(weight.shape)
        for feature in pairs:
            agrees = agrees * get_similarity(feature, (y + height, x), (k_y, k_x))
        values = np.concatenate([past[k_y, k_x].astype(np.float64), np.ones((*weight.shape, 1))], axis=-1)
        values[:, 4] *= agrees
        out[y, x] += (weight * agrees)[:, None] * values
    return out
