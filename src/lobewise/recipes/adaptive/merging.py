"""New light of pixels that were shaded again: its noise, and its mix with the light that these pixels had before.

All light has the shape (count, parts, 3) or (count, 1, 3), with one row for each pixel.
"""

from __future__ import annotations

from functools import reduce

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising.bad_pixels import mark_good
from lobewise.lobes.vectors import compute_image_luminance
from lobewise.records.frame import FloatArray, Radiance

MIN_PRIOR_ERROR = 0.05
"""Relative squared error that the mean of the old and the filtered radiance of a pixel has at least."""
SINGLE_PRIOR_ERROR = 0.1
"""Relative squared error that the old radiance of a pixel has where new radiance is not filtered."""
DARK_LIGHT = 0.01
"""Light over the image's median, below which errors are no longer relative."""
FIRST_PART_RATIO, MAX_PART_RATIO = 2.0, 3.0
"""Light of one part of a pixel's samples over the mean of the pixel's other parts, before the light around the pixel is
known, and over the larger one of both. A firefly in one part is more."""
MAX_KEPT_RATIO = 2.0
"""Radiance that enters the history, over the filtered radiance: a firefly would stay for many frames."""


def merge_by_weight(old: Radiance, new: Radiance, weight: FloatArray, worth: FloatArray) -> Radiance:
    """Return the mean of old and new light of pixels (count, 1, 3), with weights ``weight`` and ``worth``, (count,)."""
    old_weight = weight[:, None, None]
    merged = {}
    for name in _list_shared(old, new):
        before, fresh = getattr(old, name), getattr(new, name)
        good = mark_good(fresh)[..., None]
        n = np.where(good, worth[:, None, None], np.float32(0.0))
        total = old_weight + n
        blend = (old_weight * before + n * np.where(good, fresh, np.float32(0.0))) / np.maximum(total, 1e-12)
        # A pixel without weight whose new sample is bad keeps its old value.
        merged[name] = np.where(total > 0.0, blend, before)
    return Radiance(**merged)


def bound_sample_parts(shaded: Radiance, dark: float, near: Radiance | None = None) -> Radiance:
    """Return parts (count, parts) without fireflies.

    ``near`` is the light around each pixel, (count, 1), if it is known. No part is bounded to less than ``dark``.
    """
    light, least = compute_image_luminance(shaded.color)[..., None], np.float32(0.0)
    good = np.isfinite(light) & (light >= least)
    light, count = np.where(good, light, least), good.sum(axis=1, keepdims=True)
    most = (light.sum(axis=1, keepdims=True) - light) / np.maximum(count - 1, 1).astype(np.float32)
    if near is None:
        most *= np.float32(FIRST_PART_RATIO)
    else:
        most = np.float32(MAX_PART_RATIO) * np.fmax(most, compute_image_luminance(near.color)[..., None])
    share = np.minimum((most + np.float32(dark)) / np.maximum(light, np.float32(1e-30)), np.float32(1.0))
    return Radiance(**{name: share * getattr(shaded, name) for name in _list_shared(shaded)})


def average_parts(shaded: Radiance) -> Radiance:
    """Return the mean over the parts of each pixel, (count, 1); NaN without a part that is finite and not negative."""
    good = _mark_good_parts(shaded)
    return Radiance(**{name: _average(getattr(shaded, name), good) for name in _list_shared(shaded)})


def compute_variance(shaded: Radiance) -> FloatArray:
    """Return the variance of `average_parts`, (count, 1, 1), the mean of those of the three channels.

    It is infinite where fewer than two parts are finite and not negative.
    """
    good = _mark_good_parts(shaded)
    count = _add_parts(good.astype(np.float32))
    spread = _average((shaded.color - _average(shaded.color, good)) ** 2, good).mean(axis=-1, keepdims=True)
    return np.asarray(np.where(count > 1.0, spread / np.maximum(count - 1.0, 1.0), np.float32(np.inf)))


def _mark_good_parts(shaded: Radiance) -> NDArray[np.bool_]:
    """Return which parts are finite and not negative, (count, parts, 1)."""
    good = [mark_good(getattr(shaded, name)) for name in _list_shared(shaded)]
    return np.asarray(np.logical_and.reduce(good))[..., None]


def _average(values: FloatArray, good: NDArray[np.bool_]) -> FloatArray:
    """Return the means over the good parts, (count, 1, 3)."""
    count = _add_parts(good.astype(np.float32))
    total = _add_parts(np.where(good, values, np.float32(0.0)))
    return np.asarray(np.where(count > 0.0, total / np.maximum(count, np.float32(1.0)), np.float32(np.nan)))


def _add_parts(values: FloatArray) -> FloatArray:
    """Return the sum over axis 1, which it keeps. For a few parts NumPy's ``sum`` takes several times as long."""
    return np.asarray(reduce(np.add, np.moveaxis(values, 1, 0)))[:, None]


def merge_by_variance(
    old: Radiance, support: FloatArray, mean: Radiance, variance: FloatArray, filtered: Radiance | None, dark: float
) -> Radiance:
    """Return new light of pixels, of less error than its mean over the parts; see `recompute`. Shapes (count, 1, 3).

    ``dark`` is the light below which errors are no longer relative.
    """
    names = _list_shared(old, mean)
    fills = old if filtered is None else filtered
    prior, apart = {}, {}
    old_share = (support / (np.float32(1.0) + support))[:, None, None]
    for name in names:
        first, second = getattr(old, name), getattr(fills, name)
        second = np.where(mark_good(second)[..., None], second, first)
        prior[name] = second + old_share * (first - second)
        apart[name] = np.float32(0.5) * (first - second)
    least = MIN_PRIOR_ERROR if filtered is not None else SINGLE_PRIOR_ERROR
    relative = np.float32(least) * compute_image_luminance(prior["color"])[..., None] ** 2
    error = np.maximum(relative, compute_image_luminance(apart["color"])[..., None] ** 2) + np.float32(dark**2 + 1e-30)
    share = error / (error + variance)
    known = mark_good(mean.color)[..., None]
    own = {name: np.where(known, getattr(mean, name), prior[name]) for name in names}
    return Radiance(**{name: prior[name] + share * (own[name] - prior[name]) for name in names})


def bound_light(light: Radiance, other: Radiance) -> Radiance:
    """Return light whose parts have at most `MAX_KEPT_RATIO` times the luminance of another estimate."""
    bounded = {}
    for name in _list_shared(light, other):
        value = getattr(light, name)
        own, most = (
            np.maximum(compute_image_luminance(each)[..., None], 0.0) for each in (value, getattr(other, name))
        )
        share = np.minimum(np.float32(MAX_KEPT_RATIO) * most / np.maximum(own, 1e-30), np.float32(1.0))
        bounded[name] = value * share
    return Radiance(**bounded)


def _list_shared(*lights: Radiance) -> list[str]:
    """Return the names of the images that all of some lights have, "color" first."""
    names = ("color", "diffuse", "specular")
    return [name for name in names if all(getattr(light, name) is not None for light in lights)]
