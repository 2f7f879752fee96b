"""Images that belong to a layer, or to the whole frame, filtered by the layer's weights, so that sums still hold.

The weights of a filter depend on the guides and on the noise of the layer, not on the image that is averaged. So the
passes of the layer run over each of these images. What else happens to the layer happens to an image with the light of
the image itself: its own samples are bounded, its own highlights are kept, and its own samples are taken back where the
layer's are. Only factors of the layer's light (of the refining network, of light that is shared out, of the mixture)
are those of the layer. So an image stays black where it has no light, whatever the layer has there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from lobewise.backend.buffers import Image, device_scope
from lobewise.denoising.bad_pixels import blacken_bad
from lobewise.denoising.evidence import mix_noisy
from lobewise.denoising.layers import Layer, filter_layer, make_layers
from lobewise.denoising.noisy import NoisyLayer, join_halves, make_noisy_layers
from lobewise.denoising.passes import find_guides, finish_layer, run_last_passes
from lobewise.features import Feature
from lobewise.frame import FloatArray, Frame, Radiance
from lobewise.guides.halves import mark_bad
from lobewise.lobes.vectors import LUMINANCE
from lobewise.settings import ResolvedSettings
from lobewise.settings.choices import get_quality


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


def has_passes(frame: Frame) -> bool:
    """Return whether a frame has images that belong to a layer or to the whole frame."""
    return bool(frame.also) or any(layer.parts for layer in frame.layers)


@device_scope()
def filter_also(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    filters: Mapping[str, Filter],
    layers: Mapping[str, Passed],
    whole: Passed,
    rest: tuple[FloatArray, FloatArray],
) -> dict[str, FloatArray]:
    """Return the images of ``frame.also`` and, as ``layer/part``, the parts of its layers, filtered.

    Parameters
    ----------
    frame, settings, features
        As they were filtered.
    filters : mapping of str to Filter
        What filters images by the weights of the layers that the frame names.
    layers : mapping of str to Passed
        What happened to these layers.
    whole : Passed
        What happened to the light that surfaces scatter, in total.
    rest : pair of (height, width, 3)
        The other light of the total, emission and background, before and after.
    """
    found: dict[str, FloatArray] = {}
    for layer in frame.layers:
        if layer.parts:
            filtered = _filter_parts(layer.radiance, filters[layer.name], layer.parts, layers[layer.name])
            found |= {f"{layer.name}/{part}": each for part, each in filtered.items()}
    if frame.also:
        before, after = rest
        share = _find_share(before, frame.radiance.color)
        with np.errstate(invalid="ignore"):  # bad pixels stay bad
            scattered = {name: image - share * image for name, image in frame.also.items()}
        total = frame.with_changes(layers=(), radiance=Radiance(frame.radiance.color - before))
        (run,) = _make_filters(total, settings, features)
        filtered = _filter_parts(total.radiance.color, run, scattered, whole)
        exact = share * _divide(after, before)
        found |= {name: image + exact * blacken_bad(frame.also[name]) for name, image in filtered.items()}
    return found


Filter = Callable[[Sequence[FloatArray]], list[tuple[FloatArray, FloatArray]]]
"""Runs images through the weights of a layer: returns each filtered, and its samples without fireflies."""


def _make_filters(frame: Frame, settings: ResolvedSettings, features: Sequence[Feature]) -> list[Filter]:
    """Return for every layer of a frame what filters images by its weights."""
    if not get_quality(settings.quality).reads_halves:
        layers = make_layers(frame, settings, features, finest=True)
        return [partial(filter_by_layer, each, settings) for each in layers]
    found: list[Filter] = []
    for each in make_noisy_layers(frame, settings, features):
        guides = find_guides(each, settings)
        found.append(partial(filter_by_halves, frame, each, settings, guides, join_halves(each)))
    return found


def _filter_parts(
    radiance: FloatArray, run: Filter, parts: Mapping[str, FloatArray], layer: Passed
) -> dict[str, FloatArray]:
    """Return images that belong to a layer, filtered by its weights and brought to its result."""
    images = list(parts.values())
    whole = _is_sum(radiance, images)
    filtered = [(blacken_bad(each), noisy) for each, noisy in run(images if whole else [*images, radiance])]
    base = _sum_whole([each for each, _ in filtered], whole)
    factor = np.float32(1.0) if layer.before is None else _divide(layer.before, base)
    refined = [each * factor for each, _ in filtered]
    if layer.share is not None:
        refined = [mix_noisy(each, own, layer.share) for each, (_, own) in zip(refined, filtered, strict=True)]
    ratio = _divide(layer.clean, _sum_whole(refined, whole))
    return {part: np.asarray(each * ratio) for part, each in zip(parts, refined, strict=False)}


def _sum_whole(images: Sequence[FloatArray], are_parts: bool) -> FloatArray:
    """Return the layer from its parts; of images that do not sum to the layer the last is the layer itself."""
    return np.asarray(np.sum(images, axis=0, dtype=np.float32)) if are_parts else images[-1]


def _divide(image: FloatArray, by: FloatArray) -> FloatArray:
    return np.divide(image, by, out=np.ones_like(by), where=(by > 0.0) & np.isfinite(image))


def _is_sum(image: FloatArray, parts: Sequence[FloatArray]) -> bool:
    """Return whether parts add up to an image, within the rounding of 16-bit floats."""
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(np.sum(parts, axis=0, dtype=np.float32) - image)
        return not bool((apart > np.float32(2e-3) * np.abs(image)).any())


def filter_by_layer(
    layer: Layer, settings: ResolvedSettings, images: Sequence[FloatArray]
) -> list[tuple[FloatArray, FloatArray]]:
    """Return images after the filter of a layer by its guides."""
    found = []
    for image in images:
        output = filter_layer(layer, settings, image)
        lost = (output.weight_sum <= 0.0)[..., None]
        found.append((np.where(lost, blacken_bad(image), output.image), image))
    return found


def filter_by_halves(
    frame: Frame,
    noisy: NoisyLayer,
    settings: ResolvedSettings,
    guides: Sequence[Image],
    joined: FloatArray,
    images: Sequence[FloatArray],
) -> list[tuple[FloatArray, FloatArray]]:
    """Return images after the passes of a layer with its guides; two at a time take the places of its halves.

    ``joined`` is the result of `join_halves`.
    """
    highlights = None if noisy.kept is None else _find_share(noisy.kept, joined)
    bounded = [_bound_part(image, joined) for image in images]
    found: list[tuple[FloatArray, FloatArray]] = []
    for start in range(0, len(images), 2):
        pair = bounded[start : start + 2]
        kept = [None if highlights is None else image * highlights for image in pair]
        rest = [image if light is None else image - light for image, light in zip(pair, kept, strict=True)]
        halves = [mark_bad(image) for image in rest]
        # Both images are samples of every pixel, even where the layer itself has no halves.
        both = replace(noisy, samples=(halves[0], halves[-1]), is_whole=True)
        output = run_last_passes(both, settings, guides)
        for image, highlight, light in zip(pair, kept, (output.a, output.b), strict=False):
            mine = replace(both, layer=replace(noisy.layer, radiance=image), kept=highlight)
            found.append((finish_layer(frame, mine, (light,), output.support)[0], image))
    return found


def _bound_part(image: FloatArray, bounded: FloatArray) -> FloatArray:
    """Return a part of a layer, nowhere brighter than the layer after its fireflies were bounded.

    A part without a firefly keeps its light where the layer has one: the share that was cut off belongs to others.
    """
    weights = np.array(LUMINANCE, np.float32)
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        scale = np.minimum((bounded @ weights) / (image @ weights), np.float32(1.0))
    return np.asarray(image * np.where(np.isnan(scale), np.float32(1.0), scale)[..., None])


def _find_share(part: FloatArray, image: FloatArray) -> FloatArray:
    """Return the share of each pixel's light that a part of an image holds, (height, width, 1), in [0, 1]."""
    some, light = (blacken_bad(each).sum(axis=-1, keepdims=True) for each in (part, image))
    share = np.divide(some, light, out=np.zeros_like(some), where=light > 0.0)
    return np.asarray(np.clip(share, 0.0, 1.0))
