"""How light changed, from samples that are taken a second time, and histories that follow the change.

Samples of the frame before are shaded again in the changed scene, from the same camera and with the same random
numbers. Their difference is free of the noise of the samples, apart from paths that the change led elsewhere.

Source: Schied et al. 2018, "Gradient Estimation for Real-Time Adaptive Temporal Filtering" (A-SVGF). Departs: the
camera of the frame before is used again, so that no sample must be projected; histories are multiplied by the ratio of
the light, and not only shortened.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.filters.history.sums import split_sums
from lobewise.lobes.vectors import LUMINANCE
from lobewise.recipes.temporal.recipe import TemporalFilter
from lobewise.records.camera import Camera
from lobewise.records.frame import FloatArray, Radiance

SAME_DEPTH = 1e-3
"""Largest relative difference of depths at which a pixel counts as showing the same surface point."""
WINDOW = 1
"""Samples on each side whose changes are averaged: with 1 a window of 3x3 samples."""
MIN_SHARE_OF_WINDOW = 0.5
"""Smallest share of a window's samples that tells a change. The error of the ratio of a few samples is not known: a
single sample does not differ from its own ratio."""
MAX_RATIO = 100.0
"""Largest factor by which a history is made brighter."""
LAYERS = ("diffuse", "specular")
"""Layers of a history whose radiance a frame holds one by one."""

Pixels = tuple[NDArray[np.intp], NDArray[np.intp]]
"""Rows and columns."""


@dataclass(frozen=True)
class Shaded:
    """The samples of one frame of sparse pixels, and how they were taken.

    ``seed`` and ``spp`` are those of the samples, ``scale`` and ``place`` those of a `SparseFrame`. ``depth``, (rows,
    columns), and ``shapes``, (2, rows, columns), are those of the samples' pixels; the latter are numbers of the shapes
    that a pixel shows and that its mirror ray hits.
    """

    camera: Camera
    pixels: Pixels
    scale: int
    place: tuple[int, int]
    spp: int
    seed: int
    radiance: Radiance
    depth: FloatArray
    shapes: FloatArray


@dataclass(frozen=True)
class Change:
    """How the light around every pixel changed.

    ``ratio`` (height, width, 3) is the light now over the light before, at most `MAX_RATIO`, and nearer to 1 the less
    certain it is. ``error`` (height, width) is the standard error of the ratio's luminance.
    """

    ratio: FloatArray
    error: FloatArray


def compute_changes(
    former: Shaded,
    radiance: Radiance,
    depth: FloatArray,
    shape: tuple[int, int],
    moved: NDArray[np.bool_] | None = None,
) -> dict[str, Change]:
    """Return the change of the light around every pixel, by the name of the layer.

    The ratio is 1 and its error 0 where less than half of the samples near the pixel show the same as before.

    Parameters
    ----------
    former : Shaded
        The samples of the frame before.
    radiance : Radiance
        The samples taken again, with diffuse and specular.
    depth : array, shape (rows, columns)
        Their depths now.
    shape : (height, width)
    moved : bool array, shape (4, rows, columns), optional
        Whether each sample's surface now, what it reflects now, and both in the frame before are shapes that have
        moved. Specular histories follow reflections: the change at one point of a mirror is not that of a history.
    """
    same = np.abs(depth - former.depth) <= SAME_DEPTH * former.depth
    changes = {}
    for name in LAYERS:
        old, new = getattr(former.radiance, name), getattr(radiance, name)
        known = same if name != "specular" or moved is None else same & ~moved.any(axis=0)
        good = (known & np.isfinite(old).all(axis=-1) & np.isfinite(new).all(axis=-1))[..., None]
        old, new = np.where(good, old, 0.0), np.where(good, new, 0.0)
        dim, bright = (light @ np.array(LUMINANCE) for light in (old, new))
        moments = np.stack([dim * dim, dim * bright, bright * bright], axis=-1)
        *sums, count = np.moveaxis(_sum_windows(np.concatenate([old, new, moments, good], axis=-1)), -1, 0)
        ratio, error = _compare_sums(np.stack(sums, axis=-1))
        few = count < MIN_SHARE_OF_WINDOW * _sum_windows(np.ones((*same.shape, 1)))[..., 0]
        ratio[few], error[few] = 1.0, 0.0
        both = np.concatenate([ratio, error[..., None]], axis=-1)
        spread = _spread(both.astype(np.float32), former.scale, former.place, shape)
        changes[name] = Change(spread[..., :3], spread[..., 3])
    return changes


def _compare_sums(sums: Any) -> tuple[Any, Any]:
    """Return ratio and error from sums over samples: light before, light now, three products of both luminances.

    The ratio of sums ``r`` with the standard error ``s`` is moved towards 1: ``1 + k (r - 1)`` with
    ``k = max(0, 1 - s^2 / (r - 1)^2)``, which has an expected squared error of about ``k s^2`` (the estimator of James
    and Stein, 1961, its positive part).
    """
    old, new, (oo, on, nn) = sums[..., :3], sums[..., 3:6], np.moveaxis(sums[..., 6:], -1, 0)
    dim, bright = (light @ np.array(LUMINANCE) for light in (old, new))
    one = np.minimum(_divide(bright, dim), MAX_RATIO)
    differences = np.maximum(nn - 2.0 * one * on + one * one * oo, 0.0)
    # If few samples hold most of the light, their differences from a common ratio say little about its error.
    count = np.minimum(
        *(np.where(mean > 0.0, _divide(mean**2, square), np.inf) for mean, square in ((dim, oo), (bright, nn)))
    )
    squared = _divide(differences, np.maximum(dim, bright / MAX_RATIO) ** 2) / np.maximum(1.0 - 1.0 / count, 1e-6)
    certain = np.where(squared > 0.0, np.maximum(1.0 - _divide(squared, (one - 1.0) ** 2), 0.0), 1.0)
    known = (old > 0.0) | (new > 0.0)
    ratio = 1.0 + certain[..., None] * np.where(known, np.minimum(_divide(new, old), MAX_RATIO) - 1.0, 0.0)
    # What a bounded ratio leaves out.
    missing = _divide(bright - one * dim, dim)
    return ratio, np.sqrt(certain * squared) + missing


def relight(temporal: TemporalFilter, changes: dict[str, Change]) -> None:
    """Multiply each history by the ratio of its light now and before, and let it count less for the ratio's error."""
    temporal.change_sums({name: partial(relight_sums, change=change) for name, change in changes.items()})


def relight_sums(sums: FloatArray, change: Change) -> FloatArray:
    """Return a history (height, width, 7) that follows a change of the light.

    If its mean was ``m``, the new mean has the variance ``v`` and the ratio the error ``e``, it counts as the mean of
    fewer samples that has the variance ``v + (e m)^2``. So all its sums are multiplied by ``v / (v + (e m)^2)``.
    """
    old = split_sums(sums)
    light = [value * change.ratio[..., k] for k, value in enumerate(old.light)]
    squared = _compute_luminance([change.ratio[..., k] for k in range(3)]) ** 2
    lit = old._replace(red=light[0], green=light[1], blue=light[2], moment=old.moment * squared)
    inverse = np.float32(1.0) / np.maximum(old.weight, np.float32(1e-30))
    before, now = (_compute_luminance(part.light) * inverse for part in (old, lit))
    effective = np.maximum(old.weight / np.maximum(old.squared_weight, np.float32(1e-30)) * old.weight, np.float32(1.0))
    variance = np.maximum(lit.moment * inverse - now**2, np.float32(0.0)) / effective
    added = (change.error * before) ** 2
    share = np.where(added > 0.0, _divide(variance, variance + added), np.float32(1.0)).astype(np.float32)
    # Channel by channel, as the kernels read histories.
    return np.moveaxis(np.stack([value * share for value in lit]), 0, -1)


def _compute_luminance(light: Sequence[Any]) -> Any:
    """Return the luminance of three images of colours."""
    return sum(np.float32(part) * value for part, value in zip(LUMINANCE, light, strict=True))


def _divide(above: Any, below: Any) -> FloatArray:
    """Return a ratio of numbers >= 0; 0 over 0 is 0, and other numbers over 0 are a large one."""
    return np.asarray(np.where(above > 0.0, above / np.maximum(below, 1e-12), 0.0), dtype=np.float32)


def _sum_windows(image: Any) -> Any:
    """Return the sums over windows of an image (rows, columns, channels)."""
    padded = np.pad(image, [(WINDOW, WINDOW), (WINDOW, WINDOW), (0, 0)])
    rows, columns = image.shape[:2]
    steps = range(2 * WINDOW + 1)
    return np.sum([padded[i : i + rows, j : j + columns] for i in steps for j in steps], axis=0)


def _spread(values: Any, scale: int, place: tuple[int, int], shape: tuple[int, int]) -> FloatArray:
    """Return values of samples (rows, columns) at all pixels (height, width), by linear interpolation."""
    for axis in (0, 1):
        at = np.clip((np.arange(shape[axis]) - place[axis]) / scale, 0.0, values.shape[axis] - 1.0)
        first = np.minimum(at.astype(np.intp), max(values.shape[axis] - 2, 0))
        second = np.minimum(first + 1, values.shape[axis] - 1)
        share = (at - first).astype(np.float32).reshape([-1 if k == axis else 1 for k in range(values.ndim)])
        near = values.take(first, axis)
        values = near + share * (values.take(second, axis) - near)
    return np.asarray(values)
