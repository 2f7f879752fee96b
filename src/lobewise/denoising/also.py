"""Images that belong to a layer, or to the whole frame, filtered by the layer's weights, so that sums still hold.

The weights of a filter depend on the guides and on the noise of the layer, not on the image that is averaged. So the
passes of the layer run over each of these images. What else happens to the layer happens to an image with the light of
the image itself: its own samples are bounded, its own highlights are kept, and its own samples are taken back where the
layer's are. Only factors of the layer's light (of the refining network, of light that is shared out, of the mixture)
are those of the layer. So an image stays black where it has no light, whatever the layer has there.

Planes of one channel come packed, three to an image (`lobewise.records.images.pack_planes`). Spectral bands are
filtered like gray light of the total; other planes are averaged by its weights, and nothing else happens to them.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial, reduce

import numpy as np
from numpy.typing import NDArray

from lobewise.backend.buffers import device_scope
from lobewise.denoising.bad_pixels import blacken_bad
from lobewise.denoising.combining import MAX_BLACK_RADIANCE, compute_shares_near, share_by_noise
from lobewise.denoising.evidence import mix_noisy
from lobewise.denoising.layers import Layer, compute_whole_albedo, filter_layer, make_layers
from lobewise.denoising.noisy import NoisyLayer, join_halves, make_noisy_layers
from lobewise.denoising.passes import FilteredOther, OtherImage, filter_layer_halves
from lobewise.engine.rows import compute_rows, list_rows
from lobewise.features import Feature
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.dual_buffer import MORE_AT_ONCE
from lobewise.guides.halves import mark_bad
from lobewise.lobes.vectors import compute_image_luminance
from lobewise.records.frame import FloatArray, Frame, Radiance
from lobewise.records.images import MAX_HALF_ROUNDING, is_band, list_packed
from lobewise.settings import ResolvedSettings
from lobewise.settings.choices import get_quality

HALF_STEP = 2.0**-24
"""Smallest 16-bit float above 0, and the step of those near it."""


@dataclass(frozen=True, kw_only=True)
class Passed:
    """What happened to a layer.

    Parameters
    ----------
    before : (height, width, 3), optional
        The layer before the noisy image was taken back; None where no network refined it.
    share : (height, width), optional
        The share of the noisy layer that was taken back; None for none.
    clean : (height, width, 3)
        The result.
    """

    clean: FloatArray
    before: FloatArray | None = None
    share: FloatArray | None = None


def list_alone(also: Mapping[str, FloatArray]) -> list[str]:
    """Return the names of the images of `Frame.also` that are denoised by themselves: those of three colours."""
    return [name for name, image in also.items() if image.ndim == 3 and len(list_packed(name)) == 1]


def has_passes(frame: Frame) -> bool:
    """Return whether a frame has images that are filtered by the weights of a layer or of the whole frame."""
    return len(frame.also) > len(list_alone(frame.also)) or any(layer.parts for layer in frame.layers)


@device_scope()
def finish_layer_parts(
    frame: Frame, others: Mapping[str, Sequence[FilteredOther]], layers: Mapping[str, Passed]
) -> dict[str, FloatArray]:
    """Return, as ``layer/part``, the parts of the layers of a frame, filtered.

    Parameters
    ----------
    frame : Frame
    others : mapping of str to sequence of FilteredOther
        The images of `list_parts`, filtered by the weights of their layer, by the layer's name.
    layers : mapping of str to Passed
        What happened to the layers that the frame names.
    """
    clean: dict[str, FloatArray] = {}
    for layer in frame.layers:
        if layer.parts:
            filtered = _finish_parts(layer.parts, others[layer.name], layers[layer.name])
            clean |= {f"{layer.name}/{part}": each for part, each in filtered.items()}
    return clean


@device_scope()
def filter_also(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    whole: Passed,
    rest: tuple[FloatArray, FloatArray],
) -> dict[str, FloatArray]:
    """Return the packed planes of ``frame.also``, filtered.

    Parameters
    ----------
    frame, settings, features
        As they were filtered.
    whole : Passed
        What happened to the light that surfaces scatter, in total.
    rest : pair of (height, width, 3)
        The other light of the total, emission and background, before and after.
    """
    before, after = rest
    share = _compute_part_share(before, frame.radiance.color)
    total = frame.with_changes(layers=(), radiance=Radiance(frame.radiance.color - before))
    bands = {name: image for name, image in frame.also.items() if is_band(name)}
    values = {name: image for name, image in frame.also.items() if name not in bands}
    with np.errstate(invalid="ignore"):  # bad pixels stay bad
        grays = {name: image - share * image for name, image in bands.items()}
    lights, averaged = _filter_planes(total, settings, features, grays, values)
    refined = None if whole.before is None else _make_gray(whole.before)
    gray = replace(whole, clean=_make_gray(whole.clean), before=refined)
    filtered = _finish_parts(grays, lights, gray) if bands else {}
    exact = share * _divide(_make_gray(after), _make_gray(before))
    clean = {name: image + exact * blacken_bad(bands[name]) for name, image in filtered.items()}
    return clean | {name: blacken_bad(each.image) for name, each in zip(values, averaged, strict=True)}


def keep_sum(
    clean: Mapping[str, FloatArray], noisy: Mapping[str, FloatArray], before: FloatArray, after: FloatArray
) -> dict[str, FloatArray]:
    """Return images so that those that summed to the noisy image do so to the clean one; see `share_by_noise`.

    Parameters
    ----------
    clean, noisy : mapping of str to (height, width, 3)
        Images, by the same names, light below 0 included. The first ones may be the parts of ``before``, up to one that
        completes the sum.
    before, after : (height, width, 3)
        The noisy and the clean image.
    """
    parts: list[str] = []
    total = np.zeros_like(before)
    for count, image in enumerate(noisy.values(), 1):
        with np.errstate(invalid="ignore", over="ignore"):
            total = total + image
        if _is_close(before, total, count):
            parts = list(noisy)[:count]
    if not parts:
        return dict(clean)
    shared = share_by_noise(after, [clean[name] for name in parts], [noisy[name] for name in parts])
    return {**clean, **dict(zip(parts, shared, strict=True))}


def _filter_planes(
    total: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    bands: Mapping[str, FloatArray],
    values: Mapping[str, FloatArray],
) -> tuple[list[FilteredOther], list[FilteredOther]]:
    """Return packed bands with the gray light of the frame as the last, and packed values, filtered as one layer.

    The filter divides by the albedo of each colour, which no plane belongs to. So bands are brought to gray albedo
    first, and values to none.
    """
    albedo = compute_whole_albedo(total.gbuffer)
    one = np.ones_like(total.radiance.color) if albedo is None else albedo
    lights = [*bands.values(), _make_gray(total.radiance.color)] if bands else []
    scales = [one / _make_gray(one)] * len(lights) + [one] * len(values)
    scaled = [image * scale for image, scale in zip([*lights, *values.values()], scales, strict=True)]
    filtered = _filter_by_total(total, settings, features, scaled, lights=len(lights))
    planes = [
        FilteredOther(each.image / by, partial(np.divide, each.compute_samples(), by))
        for each, by in zip(filtered, scales, strict=True)
    ]
    return planes[: len(lights)], planes[len(lights) :]


def _make_gray(image: FloatArray) -> FloatArray:
    """Return an image, (height, width, 3), with the mean of its channels in each."""
    return np.repeat(image.mean(axis=-1, keepdims=True), 3, axis=-1)


def list_layer_parts(frame: Frame) -> dict[str, list[FloatArray]]:
    """Return the images of `list_parts` by the names of the frame's layers."""
    return {layer.name: list_parts(layer.radiance, layer.parts) for layer in frame.layers if layer.parts}


def list_parts(radiance: FloatArray, parts: Mapping[str, FloatArray]) -> list[FloatArray]:
    """Return the images that are filtered for the parts of a layer: with the layer where they do not sum to it."""
    images = list(parts.values())
    return images if _is_sum(radiance, images) else [*images, radiance]


def filter_plain_layer(
    layer: Layer, settings: ResolvedSettings, images: Sequence[FloatArray]
) -> tuple[FilterOutput, list[FilteredOther]]:
    """Return a layer after the filter by its guides alone, and further images after the same filter."""
    output = filter_layer(layer, settings, images[:MORE_AT_ONCE])
    if not images:
        return output, []
    filtered, lost = list(output.more), (output.weight_sum <= 0.0)[..., None]
    if remaining := images[MORE_AT_ONCE:]:
        further, others = filter_plain_layer(replace(layer, radiance=remaining[0]), settings, remaining[1:])
        filtered += [further.image, *(each.image for each in others)]

    def keep_lost(lost: NDArray[np.bool_], own: FloatArray, image: FloatArray) -> FloatArray:
        return np.where(lost, blacken_bad(own), image)

    pairs = [(own, compute_rows(keep_lost, lost, own, image)) for image, own in zip(filtered, images, strict=True)]
    return output, [FilteredOther(image, partial(np.asarray, own)) for own, image in pairs]


def _bound_planes(
    noisy: NoisyLayer, joined: FloatArray, lights: Sequence[FloatArray], values: Sequence[FloatArray]
) -> list[OtherImage]:
    """Return packed planes as the passes over a layer take them.

    Planes of light have other units than the layer. They lose the share of light that the layer's fireflies lost, and
    keep the share that its highlights hold. Planes of values have neither.
    """
    share = None if noisy.highlights is None else _compute_part_share(noisy.highlights, joined)
    others = []
    # A pixel that is not finite stays so, and is marked as bad.
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        kept = compute_image_luminance(joined) / compute_image_luminance(noisy.layer.radiance)
        kept = np.where(np.isnan(kept), np.float32(1.0), np.minimum(kept, np.float32(1.0)))[..., None]
        for image in (light * kept for light in lights):
            highlights = None if share is None else image * share
            others.append(OtherImage(image, mark_bad(image if highlights is None else image - highlights), highlights))
    return [*others, *(OtherImage(image, mark_bad(image)) for image in values)]


def bound_parts(noisy: NoisyLayer, joined: FloatArray, images: Sequence[FloatArray]) -> list[OtherImage]:
    """Return images as the passes over a layer take them, without fireflies; ``joined`` is that of `join_halves`."""
    share = None if noisy.highlights is None or not images else _compute_part_share(noisy.highlights, joined)
    others = []
    for image in images:
        bound = partial(compute_rows, _bound_part, image, joined)
        bounded, highlights = bound(), None
        if share is not None:
            highlights = compute_rows(np.multiply, bounded, share)
        marked = mark_bad(bounded if highlights is None else compute_rows(np.subtract, bounded, highlights))
        others.append(OtherImage(bounded, marked, highlights, bound))
    return others


def _filter_by_total(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    planes: Sequence[FloatArray],
    lights: int,
) -> Sequence[FilteredOther]:
    """Return packed planes after the filter of a frame whose light is one layer; the first ``lights`` are light."""
    if not get_quality(settings.quality).reads_halves:
        (layer,) = make_layers(frame, settings, features, finest=True)
        return filter_plain_layer(layer, settings, planes)[1]
    (noisy,) = make_noisy_layers(frame, settings, features)
    others = _bound_planes(noisy, join_halves(noisy), planes[:lights], planes[lights:])
    return filter_layer_halves(frame, noisy, settings, others).others


def _finish_parts(
    parts: Mapping[str, FloatArray], filtered: Sequence[FilteredOther], layer: Passed
) -> dict[str, FloatArray]:
    """Return filtered parts of a layer, brought to the layer's result; the last of more images is the layer itself."""
    refined = refine_parts(filtered, layer, are_parts=len(filtered) == len(parts))
    return bring_parts(parts, refined, layer.clean)


def refine_parts(filtered: Sequence[FilteredOther], layer: Passed, *, are_parts: bool = True) -> list[FloatArray]:
    """Return filtered images of a layer after its network, and with its noisy image taken back; see `_sum_whole`."""
    refined = [blacken_bad(each.image) for each in filtered]
    if layer.before is not None:
        refined = _scale(refined, layer.before, are_parts=are_parts)
    if layer.share is None:
        return refined
    return [mix_noisy(each, own.compute_samples(), layer.share) for each, own in zip(refined, filtered, strict=True)]


def bring_parts(names: Collection[str], refined: Sequence[FloatArray], clean: FloatArray) -> dict[str, FloatArray]:
    """Return images of a layer by the names of its parts, brought to the layer's result ``clean``."""
    brought = _scale(refined, clean, are_parts=(are_parts := len(refined) == len(names)))
    # The mixture lights black pixels as well.
    if are_parts and any(_compute_light(*rows).any() for rows in list_rows(clean, *refined)):
        light = _compute_light(clean, *refined)
        brought = [each + light * share for each, share in zip(brought, compute_shares_near(refined), strict=True)]
    return {name: np.asarray(each) for name, each in zip(names, brought, strict=False)}


def _scale(images: Sequence[FloatArray], layer: FloatArray, *, are_parts: bool) -> list[FloatArray]:
    """Return images of a layer times the factor that brings them to ``layer``."""

    def compute_factor(layer: FloatArray, *images: FloatArray) -> FloatArray:
        return _divide(layer, _sum_whole(images, are_parts))

    factor = compute_rows(compute_factor, layer, *images)
    return [compute_rows(np.multiply, each, factor) for each in images]


def _compute_light(clean: FloatArray, *parts: FloatArray) -> FloatArray:
    """Return the light of a layer where its parts are black."""
    return np.where(_sum_whole(parts, True) > MAX_BLACK_RADIANCE, np.float32(0.0), clean)


def _sum_whole(images: Sequence[FloatArray], are_parts: bool) -> FloatArray:
    """Return the layer from its parts; of images that do not sum to the layer the last is the layer itself."""
    return reduce(np.add, images) if are_parts else images[-1]


def _divide(image: FloatArray, by: FloatArray) -> FloatArray:
    return np.divide(image, by, out=np.ones_like(by), where=(by > MAX_BLACK_RADIANCE) & np.isfinite(image))


def _is_sum(image: FloatArray, parts: Sequence[FloatArray]) -> bool:
    """Return whether parts add up to an image, within the rounding of 16-bit floats."""
    with np.errstate(invalid="ignore", over="ignore"):
        rows = list_rows(image, *parts)
        return all(_is_close(whole, reduce(np.add, some), len(parts)) for whole, *some in rows)


def _is_close(image: FloatArray, total: FloatArray, count: int) -> bool:
    """Return whether an image is the sum of so many parts, where all are 16-bit floats."""
    with np.errstate(invalid="ignore", over="ignore"):
        rounding = np.float32(MAX_HALF_ROUNDING) * np.abs(image) + np.float32((count + 1) * HALF_STEP)
        return not bool((np.abs(total - image) > rounding).any())


def _bound_part(image: FloatArray, bounded: FloatArray) -> FloatArray:
    """Return a part of a layer, nowhere brighter than the layer after its fireflies were bounded.

    A part without a firefly keeps its light where the layer has one: the share that was cut off belongs to others.
    """
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        scale = np.minimum(compute_image_luminance(bounded) / compute_image_luminance(image), np.float32(1.0))
    return np.asarray(image * np.where(np.isnan(scale), np.float32(1.0), scale)[..., None])


def _compute_part_share(part: FloatArray, image: FloatArray) -> FloatArray:
    """Return the share of each pixel's light that a part of an image holds, (height, width, 1), in [0, 1]."""

    def compute(*images: FloatArray) -> FloatArray:
        some, light = (blacken_bad(each).sum(axis=-1, keepdims=True) for each in images)
        share = np.divide(some, light, out=np.zeros_like(some), where=light > 0.0)
        return np.asarray(np.clip(share, 0.0, 1.0))

    return compute_rows(compute, part, image, channels=1)
