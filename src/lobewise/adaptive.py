"""Adaptive re-computation: pixels that few neighbours support are shaded again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from lobewise.denoising import denoise, find_bad_pixels
from lobewise.denoising.layers import find_exact_light, find_surface
from lobewise.errors import InputError
from lobewise.filters.noise.expected import expect_error
from lobewise.frame import FloatArray, Frame, Radiance, Result
from lobewise.sparse_frame import AnyFrame

Shade = Callable[[NDArray[np.intp], NDArray[np.intp]], Radiance]
"""Takes rows and columns of pixels and returns their radiance, of shape (count, 1), as `render_pixels` does."""


class History(Protocol):
    """What new radiance can be added to: a `lobewise.TemporalFilter`."""

    def add_samples(
        self, rows: NDArray[np.intp], columns: NDArray[np.intp], radiance: Radiance, weights: FloatArray
    ) -> None:
        """Add radiance to the history of single pixels."""


def find_unsupported(
    result: Result,
    *,
    budget: float = 0.05,
    least: float = 0.05,
    quality: float = 0.5,
    frame: AnyFrame | None = None,
) -> NDArray[np.bool_]:
    """Return which pixels to shade again, shape (height, width).

    With ``frame`` the pixels of weight below ``least`` come first, then those whose expected error is largest: their
    noise times the contrast around them. The noise is the variance of the result over its squared light, or the
    inverse of the effective samples where the result tells no variance. Blurred edges and small highlights have
    contrast. Pixels without a surface are never taken.

    Parameters
    ----------
    result : Result
        A result of `lobewise.upsample`, `lobewise.denoise` or `lobewise.TemporalFilter.add`.
    budget : float
        Largest share of the pixels, 0 to 1; without ``frame``, the pixels of lowest weight sum are taken.
    least : float
        Weight sum below which a pixel is shaded again; a sample that matches fully has the weight 1.
    quality : float
        Share of the median weight sum below which a pixel is shaded again, >= 0; without ``frame``.
    frame : Frame or SparseFrame, optional
        The frame of the result.

    Raises
    ------
    InputError
        If a number is out of range.
    """
    limits = (("budget", budget, 1.0), ("least", least, np.inf), ("quality", quality, np.inf))
    for name, value, highest in limits:
        if not 0.0 <= value <= highest:
            raise InputError(
                name,
                expected="a number from 0 to 1" if highest == 1.0 else "a number of at least 0",
                got=str(value),
                action="0.05 is usual",
            )
    weight = result.weight_sum
    count = int(budget * weight.size)
    if frame is not None:
        return _find_uncertain(result, frame, count, least)
    median = float(np.median(weight))
    wanted = (weight < least) | (weight < quality * median)
    if np.count_nonzero(wanted) > count:
        # Order pixels of equal weight by place, so that every machine chooses the same pixels.
        limit = np.partition(weight[wanted], count)[count]
        less = wanted & (weight < limit)
        equal = np.flatnonzero(wanted & (weight == limit))
        wanted = less
        wanted.flat[equal[: count - np.count_nonzero(less)]] = True
    return np.asarray(wanted)


def _find_uncertain(result: Result, frame: AnyFrame, count: int, least: float) -> NDArray[np.bool_]:
    """Return the pixels of surfaces that have no support, then those of the largest expected error."""
    noise = {"variance": result.variance, "effective_samples": result.effective_samples}
    expected = expect_error(result.image, exact=find_exact_light(frame), **noise)
    # Pixels without support come first, those of the lowest weight before others.
    lacking = result.weight_sum < least
    order = np.where(lacking, expected.max(initial=0.0) * (2.0 - result.weight_sum / max(least, 1e-30)) + 1.0, expected)
    order[~find_surface(frame)] = -1.0
    order = np.where(order > 0.0, order, 0.0).ravel()
    if count < np.count_nonzero(order):
        limit = np.partition(order, order.size - count)[order.size - count] if count else np.inf
        # Pixels of equal rank are taken by place, so that every machine chooses the same pixels.
        equal = np.flatnonzero(order == limit)
        chosen = order > limit
        chosen[equal[: count - np.count_nonzero(chosen)]] = True
    else:
        chosen = order > 0.0
    return chosen.reshape(expected.shape)


def recompute(
    result: Result,
    shade: Shade,
    *,
    samples: float,
    frame: AnyFrame | None = None,
    budget: float = 0.05,
    least: float = 0.05,
    quality: float = 0.5,
    filter_new: bool = True,
    history: History | None = None,
) -> Result:
    """Shade the least supported pixels again, and merge the new radiance with the result.

    A pixel's estimate F of weight sum W becomes ``(W F + n I) / (W + n)``, with the new radiance I of weight n.
    Source: Tokuyoshi 2015, slide "Adaptive Sampling": re-computation for low-weight pixels. Departs: with ``frame`` the
    new radiance is filtered among the new pixels first. Unsupported pixels come in rows along edges, and new neighbours
    often resemble each other where no old sample does. n is then multiplied by the weight sum of this filter.

    Parameters
    ----------
    result : Result
        A result of `lobewise.upsample` or `lobewise.denoise`.
    shade : callable
        Takes rows and columns, returns a `Radiance` of shape (count, 1); called once, or never where every pixel is
        supported.
    samples : float
        Samples per pixel of the new radiance, over the samples per pixel of the frame, > 0.
    frame : Frame or SparseFrame, optional
        The frame of the result: its guides tell which new pixels are alike.
    budget, least, quality
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
        If a number is out of range, or ``shade`` returns another count or no finite radiance.
    """
    if not (samples > 0.0 and np.isfinite(samples)):
        raise InputError(
            "samples", expected="a finite number above 0", got=str(samples), action="pass new spp / old spp"
        )
    rules = {"budget": budget, "least": least, "quality": quality}
    where = np.nonzero(find_unsupported(result, **rules, frame=frame))
    count = where[0].size
    settings = {**result.settings, "recomputed": int(count)}
    if count == 0:
        return replace(result, settings=settings)
    new = shade(where[0], where[1])
    if new.color.shape[:2] != (count, 1):
        raise InputError(
            "re-computed radiance",
            expected=f"{count} pixels, shape ({count}, 1, 3)",
            got=f"shape {new.color.shape}",
            action="return one for each pixel",
        )
    worth = np.full((count, 1), samples, np.float32)
    if frame is not None and filter_new:
        new, gathered = _filter_among(new, frame, where, samples)
        worth = worth * np.maximum(gathered, np.float32(1.0))[:, None]
    if history is not None:
        history.add_samples(where[0], where[1], new, worth[:, 0])
    exact = None if frame is None else find_exact_light(frame)
    if exact is not None and new.parts is not None:
        # The emission of new samples is noisy at the edges of lamps, and that of the frame is not.
        new = replace(new, color=new.parts[0] + new.parts[1] + exact[where][:, None])
    weight = result.weight_sum[where][:, None]
    image = _merge(result.image, new.color, where, weight, worth)
    diffuse, specular = (
        old if old is None or fresh is None else _merge(old, fresh, where, weight, worth)
        for old, fresh in ((result.diffuse, new.diffuse), (result.specular, new.specular))
    )
    total, effective = result.weight_sum.copy(), result.effective_samples.copy()
    total[where] += worth[:, 0]
    effective[where] += worth[:, 0]
    return replace(
        result,
        image=image,
        diffuse=diffuse,
        specular=specular,
        weight_sum=total,
        effective_samples=effective,
        settings=settings,
    )


def _filter_among(
    new: Radiance, frame: AnyFrame, where: tuple[NDArray[np.intp], ...], samples: float
) -> tuple[Radiance, FloatArray]:
    """Return the new radiance, filtered among the new pixels only, and the weight sums; shapes (count, ...)."""
    shape = frame.gbuffer.shape
    if shape is None:
        return new, np.ones(where[0].size, np.float32)

    def spread(part: FloatArray) -> FloatArray:
        # NaN marks pixels without a new sample: the filter ignores them.
        image = np.full((*shape, 3), np.nan, np.float32)
        image[where] = part[:, 0]
        return image

    names = [name for name in ("color", "diffuse", "specular") if name in new.names]
    radiance = Radiance(**{name: spread(getattr(new, name)) for name in names})
    if find_bad_pixels(Frame(radiance)).all():
        return new, np.ones(where[0].size, np.float32)
    spp = max(1, round(samples * (frame.spp or 1)))
    whole = Frame(radiance, frame.gbuffer, frame.camera, spp=spp, lobe_tables=frame.lobe_tables)
    clean = denoise(whole, quality="fast")
    parts = [None if part is None else part[where][:, None] for part in (clean.diffuse, clean.specular)]
    return Radiance(clean.image[where][:, None], *parts), clean.weight_sum[where]


def _merge(
    old: FloatArray, new: FloatArray, where: tuple[NDArray[np.intp], ...], weight: FloatArray, worth: FloatArray
) -> FloatArray:
    """Return an image whose pixels ``where`` are averaged with new ones, with weights ``weight`` and ``worth``."""
    fresh = new[:, 0]
    good = np.isfinite(fresh).all(axis=-1, keepdims=True) & (fresh >= 0.0).all(axis=-1, keepdims=True)
    n = np.where(good, worth, np.float32(0.0))
    image = old.copy()
    blend = (weight * old[where] + n * np.where(good, fresh, np.float32(0.0))) / np.maximum(weight + n, 1e-12)
    # A pixel without weight whose new sample is bad keeps its old value.
    image[where] = np.where(weight + n > 0.0, blend, old[where])
    return image
