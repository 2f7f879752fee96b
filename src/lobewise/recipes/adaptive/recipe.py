"""Adaptive re-computation: pixels that few neighbours support are shaded again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising import mark_bad_pixels
from lobewise.denoising.layers import compute_exact_light
from lobewise.denoising.recipe import denoise_quietly
from lobewise.errors import InputError
from lobewise.recipes.adaptive.choosing import MIN_WEIGHT, find_unsupported
from lobewise.recipes.adaptive.merging import (
    DARK_LIGHT,
    average_parts,
    bound_light,
    bound_sample_parts,
    compute_variance,
    merge_by_variance,
    merge_by_weight,
)
from lobewise.records.frame import FloatArray, Frame, Radiance, Result
from lobewise.records.images import name_maker
from lobewise.records.sparse_frame import AnyFrame
from lobewise.settings import DenoiseSettings

Shade = Callable[[NDArray[np.intp], NDArray[np.intp]], Radiance]
"""Takes rows and columns of pixels and returns their radiance, of shape (count, parts), as `render_pixels` does. Each
part is the mean of as many samples."""

KEPT_WORTH = 2.0
"""Weight of a pixel's own samples in the history, over that of as many samples around it. With 2 the error of every
scene of docs/developers/upsampling.md is lower than with 1."""
MEDIAN_PIXELS = 128
"""About the rows and columns of the shorter side that tell the image's median."""

Around = Callable[[Radiance, float], tuple[Radiance, FloatArray]]
"""Takes new light of pixels and its samples, and returns the light of new pixels around each, and what it is worth."""


class History(Protocol):
    """What new radiance can be added to: a `lobewise.TemporalFilter`."""

    def add_samples(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], radiance: Radiance, weights: FloatArray
    ) -> None:
        """Add radiance to the history of single pixels."""


def recompute(
    result: Result,
    shade: Shade,
    *,
    samples: float,
    frame: AnyFrame | None = None,
    budget: float = 0.05,
    filter_new: bool = True,
    history: History | None = None,
) -> Result:
    """Shade the least supported pixels again, and merge the new radiance with the result.

    Where ``shade`` returns one part, a pixel's estimate F of weight sum W becomes ``(W F + n I) / (W + n)``, with the
    new radiance I of weight n. Source: Tokuyoshi 2015, slide "Adaptive Sampling": re-computation for low-weight pixels.
    Departs: with ``frame`` the new radiance is filtered among the new pixels first. Unsupported pixels come in rows
    along edges, and new neighbours often resemble each other where no old sample does. n is then multiplied by the
    weight sum of this filter.

    Where ``shade`` returns several parts, their differences tell the variance v of their mean I. The estimate is
    ``P + b / (b + v) (I - P)``, the mix of two independent estimates that has the least squared error. P is the mean of
    the filtered radiance N and of F, which counts ``W / (W + 0.05)`` times. b is the squared error of P: ``(F - N)^2 /
    4``, but at least 5 % of ``P^2``. Before, each part is bounded to three times the mean of the pixel's other parts,
    or to three times the filtered radiance if this is more: a firefly hardly counts. The bound darkens small lights
    that few samples hit.

    Parameters
    ----------
    result : Result
        A result of `lobewise.upsample` or `lobewise.denoise`.
    shade : callable
        Takes rows and columns, returns a `Radiance` of shape (count, parts); called once, or never where every pixel is
        supported. Eight parts of 8 samples have far less error than one of 64.
    samples : float
        Samples per pixel of the new radiance, of all parts, over the samples per pixel of the frame, > 0.
    frame : Frame or SparseFrame, optional
        The frame of the result: its guides tell which new pixels are alike.
    budget : float
        See `find_unsupported`.
    filter_new : bool
        Whether the new radiance is filtered among the new pixels, where there is a frame.
    history : TemporalFilter, optional
        What made the result. The new radiance enters its history, with its weight, so that the next frame need not
        shade these pixels again.

    Returns
    -------
    Result
        The result with new estimates and weight sums; ``settings["recomputed"]`` is the number of pixels.

    Raises
    ------
    InputError
        If a number is out of range, or ``shade`` returns another count.
    """
    if not (samples > 0.0 and np.isfinite(samples)):
        raise InputError(
            "samples", expected="a finite number above 0", got=str(samples), action="pass new spp / old spp"
        )
    maker, result = name_maker(result.image), result.convert()
    where = np.nonzero(find_unsupported(result, budget=budget, frame=frame))
    count = where[0].size
    settings = {**result.settings, "recomputed": int(count)}
    if count == 0:
        return replace(result, settings=settings).convert(maker)
    shaded = shade(where[0], where[1])
    if shaded.color.shape[0] != count:
        raise InputError(
            "re-computed radiance",
            expected=f"{count} pixels, shape ({count}, parts, 3)",
            got=f"shape {shaded.color.shape}",
            action="return one row for each pixel",
        )
    exact = None if frame is None or shaded.parts is None else compute_exact_light(frame)
    known = np.float32(0.0) if exact is None else exact[where][:, None]
    old = _take_pixels(result, where, known)
    around = None if frame is None or not filter_new else partial(_filter_among, frame=frame, where=where)
    if shaded.color.shape[1] == 1:
        added, worth = (shaded, np.full(count, samples, np.float32)) if around is None else around(shaded, samples)
        merged, added_worth = merge_by_weight(old, _drop_emission(added, exact), result.weight_sum[where], worth), worth
    else:
        # A median of some rows and columns is enough, and much faster.
        step = max(1, min(result.image.shape[:2]) // MEDIAN_PIXELS)
        dark = DARK_LIGHT * float(np.median(result.image[::step, ::step]))
        support = result.weight_sum[where] / (result.weight_sum[where] + np.float32(MIN_WEIGHT))
        merged, added, worth = _merge_parts((old, support), shaded, samples, around, exact, dark)
        added_worth = np.float32(KEPT_WORTH) * worth
    if history is not None:
        history.add_samples(where[0], where[1], added, added_worth)
    changes = {name: getattr(result, name).copy() for name in ("image", "weight_sum", "effective_samples")}
    changes["image"][where] = (merged.color + known)[:, 0]
    for name in ("weight_sum", "effective_samples"):
        changes[name][where] += worth
    for name in ("diffuse", "specular"):
        light = getattr(merged, name)
        if light is not None:
            changes[name] = getattr(result, name).copy()
            changes[name][where] = light[:, 0]
    return replace(result, **changes, settings=settings).convert(maker)


def _take_pixels(result: Result, where: tuple[NDArray[np.intp], ...], known: Any) -> Radiance:
    """Return the light of some pixels without the part that is known exactly; shapes (count, 1, 3)."""
    parts = [None if part is None else part[where][:, None] for part in (result.diffuse, result.specular)]
    return Radiance(np.maximum(result.image[where][:, None] - known, np.float32(0.0)), *parts)


def _drop_emission(light: Radiance, exact: FloatArray | None) -> Radiance:
    """Return light without its emission if this is known exactly.

    The emission of new samples is noisy at the edges of lamps, and that of the frame is not.
    """
    return light if exact is None or light.parts is None else replace(light, color=light.parts[0] + light.parts[1])


def _merge_parts(
    old: tuple[Radiance, FloatArray],
    shaded: Radiance,
    samples: float,
    around: Around | None,
    exact: FloatArray | None,
    dark: float,
) -> tuple[Radiance, Radiance, FloatArray]:
    """Return new light of pixels, what of it enters a history, and what it is worth; see `recompute`.

    ``old`` is the old light and its support, 0 to 1. ``around`` filters the new light. Errors of light below ``dark``
    are not relative.
    """
    filtered, worth, near = None, np.full(len(shaded.color), samples, np.float32), old[0]
    if around is not None:
        near, _ = around(average_parts(bound_sample_parts(shaded, dark)), samples)
    mean = average_parts(bound_sample_parts(shaded, dark, near))
    if around is not None:
        filtered, worth = around(mean, samples)
        filtered = _drop_emission(filtered, exact)
    merged = merge_by_variance(*old, _drop_emission(mean, exact), compute_variance(shaded), filtered, dark)
    return merged, bound_light(merged, filtered or old[0]), worth


def _filter_among(
    new: Radiance, samples: float, *, frame: AnyFrame, where: tuple[NDArray[np.intp], ...]
) -> tuple[Radiance, FloatArray]:
    """Return the new radiance, filtered among the new pixels only, and what it is worth; shapes (count, ...).

    It is worth ``samples`` times the weight sum of the filter, at least ``samples``.
    """
    shape, worth = frame.gbuffer.shape, np.full(where[0].size, samples, np.float32)
    if shape is None:
        return new, worth

    def spread(part: FloatArray) -> FloatArray:
        # NaN marks pixels without a new sample: the filter ignores them.
        image = np.full((*shape, 3), np.nan, np.float32)
        image[where] = part[:, 0]
        return image

    names = [name for name in ("color", "diffuse", "specular") if name in new.names]
    radiance = Radiance(**{name: spread(getattr(new, name)) for name in names})
    if mark_bad_pixels(Frame(radiance)).all():
        return new, worth
    spp = max(1, round(samples * (frame.spp or 1)))
    whole = Frame(radiance, frame.gbuffer, frame.camera, spp=spp, lobe_tables=frame.lobe_tables)
    clean = denoise_quietly(whole, DenoiseSettings(quality="fast"))
    parts = [None if part is None else part[where][:, None] for part in (clean.diffuse, clean.specular)]
    return Radiance(clean.image[where][:, None], *parts), worth * np.maximum(clean.weight_sum[where], np.float32(1.0))
