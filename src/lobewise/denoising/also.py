"""Images that belong to a layer, or to the whole frame, filtered by the layer's weights, so that sums still hold.

The weights of a filter depend on the guides and on the noise of the layer, not on the image that is averaged. So the
passes of the layer run over each of these images. Other steps change the layer too: fireflies are bounded, and the
quality "high" mixes images. Each image is multiplied by the ratio of the layer's result to the layer's radiance after
the passes alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lobewise.backend.buffers import device_scope, download
from lobewise.chunks import Chunk, run_chunks
from lobewise.denoising.bad_pixels import blacken_bad
from lobewise.denoising.layers import Layer, filter_layer, make_layers
from lobewise.denoising.noisy import NoisyLayer, make_noisy_layers
from lobewise.denoising.planning.layer_plans import plan_balanced
from lobewise.denoising.running import LayerRun, finish_layer
from lobewise.features import Feature
from lobewise.frame import FloatArray, Frame, Radiance
from lobewise.guides.halves import mark_bad
from lobewise.settings import ResolvedSettings
from lobewise.settings.choices import get_quality


@device_scope()
def filter_also(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    clean: Mapping[str, FloatArray],
    image: FloatArray,
) -> dict[str, FloatArray]:
    """Return the images of ``frame.also`` and, as ``layer/part``, the parts of its layers, filtered.

    Parameters
    ----------
    frame, settings, features
        As they were filtered.
    clean : mapping of str to (height, width, 3)
        The filtered layers.
    image : (height, width, 3)
        The filtered total.
    """
    found: dict[str, FloatArray] = {}
    wanted = {layer.name: layer.parts for layer in frame.layers if layer.parts}
    if wanted:
        filters = make_filters(frame, settings, features)
        for name, parts in wanted.items():
            filtered = _filter_parts(*filters[name], parts, clean[name])
            found |= {f"{name}/{part}": each for part, each in filtered.items()}
    if frame.also:
        whole = frame.with_changes(layers=(), radiance=Radiance(frame.radiance.color))
        found |= _filter_parts(*make_filters(whole, settings, features)["color"], frame.also, image)
    return found


Filter = Callable[[Sequence[FloatArray]], list[FloatArray]]
"""Runs some images through the weights of a layer."""


def make_filters(
    frame: Frame, settings: ResolvedSettings, features: Sequence[Feature]
) -> dict[str, tuple[FloatArray, Filter]]:
    """Return for every layer of a frame its radiance and what filters images by its weights."""
    if not get_quality(settings.quality).reads_halves:
        plain = make_layers(frame, settings, features, finest=True)
        return {each.name: (each.radiance, partial(_run_plain, each, settings)) for each in plain}
    noisy = make_noisy_layers(frame, settings, features)
    return {each.name: (each.layer.radiance, partial(_run_guided, frame, each, settings)) for each in noisy}


def _filter_parts(
    radiance: FloatArray, run: Filter, parts: Mapping[str, FloatArray], clean: FloatArray
) -> dict[str, FloatArray]:
    """Return images that belong to a layer, filtered by its weights and brought to its result."""
    images = list(parts.values())
    whole = _is_sum(radiance, images)
    filtered = [blacken_bad(each) for each in run(images if whole else [*images, radiance])]
    base = np.asarray(np.sum(filtered, axis=0, dtype=np.float32)) if whole else filtered.pop()
    ratio = np.divide(clean, base, out=np.ones_like(base), where=base > 0.0)
    return {part: np.asarray(each * ratio) for part, each in zip(parts, filtered, strict=True)}


def _is_sum(image: FloatArray, parts: Sequence[FloatArray]) -> bool:
    """Return whether parts add up to an image, within the rounding of 16-bit floats."""
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(np.sum(parts, axis=0, dtype=np.float32) - image)
        return not bool((apart > np.float32(2e-3) * np.abs(image)).any())


def _run_plain(layer: Layer, settings: ResolvedSettings, images: Sequence[FloatArray]) -> list[FloatArray]:
    found = []
    for image in images:
        output = filter_layer(layer, settings, image)
        lost = (output.weight_sum <= 0.0)[..., None]
        found.append(np.where(lost, blacken_bad(image), output.image))
    return found


def _run_guided(
    frame: Frame, noisy: NoisyLayer, settings: ResolvedSettings, images: Sequence[FloatArray]
) -> list[FloatArray]:
    """Return images after the passes of a layer with its guides; two at a time take the places of its halves."""
    until_guides, passes = plan_balanced(noisy.traits, settings).split_guides()
    own = LayerRun(frame, noisy.layer, settings, noisy)
    own.run(until_guides, keep=until_guides.guides)
    bounded = _find_bounded_share(noisy)
    found: list[FloatArray] = []
    for start in range(0, len(images), 2):
        pair = [np.asarray(image * bounded) for image in images[start : start + 2]]
        halves = [mark_bad(image) for image in pair]
        # Both images are samples of every pixel, even where the layer itself has no halves.
        both = replace(noisy, samples=(halves[0], halves[-1]), is_whole=True)
        state = replace(own, found=both, images=dict(own.images))
        state.run(passes)
        (output,) = (state.images[name] for name in passes.steps[-1].writes)
        for image, light in zip(pair, (output.a, output.b), strict=False):
            mine = replace(both, layer=replace(noisy.layer, radiance=image))
            found.append(finish_layer(frame, mine, (light,), output).image)
    return found


def _find_bounded_share(noisy: NoisyLayer) -> FloatArray:
    """Return what the bounding of fireflies left of every pixel, (height, width, 3), in [0, 1]."""
    a, b = map(download, noisy.halves)
    radiance, share = noisy.layer.radiance, np.empty_like(noisy.layer.radiance)

    def find(chunk: Chunk) -> None:
        halves = a[chunk], b[chunk]
        there = [np.isfinite(half) for half in halves]
        total = sum(np.where(known, half, np.float32(0.0)) for known, half in zip(there, halves, strict=True))
        mean = total / np.maximum(there[0].astype(np.float32) + there[1], np.float32(1.0))
        # Settings of NumPy are a thread's own.
        with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
            left = np.where(radiance[chunk] > 0.0, mean / radiance[chunk], np.float32(1.0))
        share[chunk] = np.clip(np.nan_to_num(left, nan=0.0), 0.0, 1.0)

    run_chunks(find, *noisy.layer.mask.shape)
    return share
