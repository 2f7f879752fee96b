"""Images that belong to a layer, or to the whole: filtered by its weights, so that sums still hold.

The weights of a filter hang on the guides and on the noise of the layer, not on what is averaged: the same passes
are run over each image. What the layer's own image gained besides (fireflies bounded, the mixture of the quality
"high") comes in as the ratio of its result to what the same passes make of it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial

import numpy as np

from lobewise.backend.buffers import Image, device_scope, download
from lobewise.denoising.bad_pixels import blacken_bad
from lobewise.denoising.guided import NoisyLayer, finish_layer, make_noisy_layers, make_pass_guide, run_pass
from lobewise.denoising.layers import Layer, make_layers
from lobewise.features import Feature
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.dual_buffer import DualBufferOutput
from lobewise.frame import FloatArray, Frame, Radiance
from lobewise.guides.halves import mark_bad, split_checkerboard
from lobewise.settings import ResolvedSettings


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
    wanted = {layer.name: dict(layer.parts) for layer in frame.layers if layer.parts}
    for name, parts in wanted.items():
        filtered = _filter_parts(frame, settings, features, name, parts, clean[name])
        found |= {f"{name}/{part}": each for part, each in filtered.items()}
    if frame.also:
        whole = frame.with_changes(layers=(), radiance=Radiance(frame.radiance.color))
        found |= _filter_parts(whole, settings, features, "color", frame.also, image)
    return found


def _filter_parts(
    frame: Frame,
    settings: ResolvedSettings,
    features: Sequence[Feature],
    name: str,
    parts: Mapping[str, FloatArray],
    clean: FloatArray,
) -> dict[str, FloatArray]:
    """Return images that belong to a layer of a frame, filtered by its weights and brought to its result."""
    run: Callable[[FloatArray], FloatArray]
    if settings.quality == "fast":
        layer = next(each for each in make_layers(frame, settings, features, finest=True) if each.name == name)
        run = partial(_run_plain, layer, settings)
    else:
        noisy = next(each for each in make_noisy_layers(frame, settings, features) if each.name == name)
        layer = noisy.layer
        run = partial(
            _run_guided, frame, noisy, settings, _find_guides(frame, noisy, settings), _find_bounded_share(noisy)
        )
    filtered = [blacken_bad(run(image)) for image in parts.values()]
    whole = _is_sum(layer.radiance, list(parts.values()))
    base = np.asarray(np.sum(filtered, axis=0, dtype=np.float32)) if whole else run(layer.radiance)
    ratio = np.divide(clean, base, out=np.ones_like(base), where=base > 0.0)
    return {part: np.asarray(each * ratio) for part, each in zip(parts, filtered, strict=True)}


def _is_sum(image: FloatArray, parts: Sequence[FloatArray]) -> bool:
    """Return whether parts add up to an image, within the rounding of 16-bit floats."""
    with np.errstate(invalid="ignore", over="ignore"):
        apart = np.abs(np.sum(parts, axis=0, dtype=np.float32) - image)
        return not bool((apart > np.float32(2e-3) * np.abs(image)).any())


def _run_plain(layer: Layer, settings: ResolvedSettings, image: FloatArray) -> FloatArray:
    output = run_filter(
        image,
        layer.mask,
        layer.features,
        form=settings.form,
        radius=settings.radius,
        albedo=layer.albedo,
        device=settings.device,
    )
    lost = (output.weight_sum <= 0.0)[..., None]
    return np.where(lost, blacken_bad(image), output.image)


def _find_guides(frame: Frame, noisy: NoisyLayer, settings: ResolvedSettings) -> list[Image | None]:
    """Return what each pass of a layer is guided by."""
    before: DualBufferOutput | None = None
    guides = [make_pass_guide(noisy, before, settings.device)]
    for number in range(len(noisy.plan.passes) - 1):
        before = run_pass(frame, noisy, number, before, settings, guides[-1])
        guides.append(make_pass_guide(noisy, before, settings.device))
    return guides


def _find_bounded_share(noisy: NoisyLayer) -> FloatArray:
    """Return what the bounding of fireflies left of every pixel, (height, width, 3), in [0, 1]."""
    halves = np.stack([download(half) for half in noisy.halves])
    there = np.isfinite(halves)
    bounded = np.sum(halves, axis=0, where=there) / np.maximum(there.sum(axis=0), 1)
    radiance = noisy.layer.radiance
    with np.errstate(invalid="ignore", divide="ignore", over="ignore"):
        share = np.where(radiance > 0.0, bounded / radiance, np.float32(1.0))
    return np.asarray(np.clip(np.nan_to_num(share, nan=0.0), 0.0, 1.0), dtype=np.float32)


def _run_guided(
    frame: Frame,
    noisy: NoisyLayer,
    settings: ResolvedSettings,
    guides: Sequence[Image | None],
    bounded: FloatArray,
    image: FloatArray,
) -> FloatArray:
    """Return an image, of which fireflies' bounds leave a share, after the passes of a layer with its guides."""
    image = image * bounded
    halves = (mark_bad(image),) * 2 if noisy.is_whole else split_checkerboard(image)
    own = replace(
        noisy,
        layer=replace(noisy.layer, radiance=image),
        bounded=noisy.bounded._replace(a=halves[0], b=halves[1]),
    )
    found: DualBufferOutput | None = None
    for number, guide in enumerate(guides):
        found = run_pass(frame, own, number, found, settings, guide)
    assert found is not None, "a plan has passes"
    return finish_layer(frame, own, (found.a,), found).image
