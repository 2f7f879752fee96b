"""The images of a frame that are joined over time, by the light that they belong to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from lobewise.denoising.layers import compute_whole_albedo
from lobewise.records.frame import FloatArray, Frame, Radiance, Result
from lobewise.records.images import Images
from lobewise.records.radiance import RadianceLayer, sum_layers

RADIANCE, PILOT, HALVES = "radiance", "pilot", ("half_a", "half_b")
PART = "part/"
"""Beginning of the names of images that belong to a layer."""
MIN_DIVIDING_ALBEDO = 0.05
"""Smallest albedo that radiance is divided by. A pixel whose centre has no albedo may show light of its other part."""


@dataclass(frozen=True)
class LayerImages:
    """One kind of light of a frame.

    Parameters
    ----------
    name : str
    kind : {"diffuse", "specular", "rest", "color"}
        Which features recognise its pixels; see `lobewise.recipes.temporal.validation.make_validation_features`.
    albedo : array, shape (height, width, 3), or None
        Divides all images.
    images : mapping of str to array, shape (height, width, 3)
        "radiance", "pilot" (denoised), perhaps "half_a" and "half_b", and images that belong to the layer, as
        "part/NAME".
    """

    name: str
    kind: str
    albedo: FloatArray | None
    images: Mapping[str, FloatArray]

    @cached_property
    def even(self) -> dict[str, FloatArray]:
        """The images over the albedo, >= 0; 0 where they are not a number."""
        light = {slot: np.maximum(np.nan_to_num(image), np.float32(0.0)) for slot, image in self.images.items()}
        return {slot: divide(image, self.albedo) for slot, image in light.items()}


def list_layers(frame: Frame, pilot: Result) -> dict[str, LayerImages]:
    """Return the layers of a frame by name: those that it names, or diffuse and specular, or its color.

    ``pilot`` is the denoised frame.
    """
    if frame.layers:
        return {layer.name: _take_layer(layer, pilot.layers[layer.name]) for layer in frame.layers}
    parts = {"diffuse": frame.gbuffer.diffuse_albedo, "specular": frame.gbuffer.specular_albedo}
    if frame.radiance.parts is None:
        parts = {"color": compute_whole_albedo(frame.gbuffer)}
    layers = {}
    for name, albedo in parts.items():
        sources = {RADIANCE: frame.radiance, "half_a": frame.half_a, "half_b": frame.half_b}
        images = {slot: getattr(source, name, None) for slot, source in sources.items()}
        images[PILOT] = pilot.image if name == "color" else getattr(pilot, name)
        layers[name] = LayerImages(name, name, albedo, {s: image for s, image in images.items() if image is not None})
    return layers


def _take_layer(layer: RadianceLayer, pilot: FloatArray) -> LayerImages:
    kind = "diffuse" if layer.is_diffuse else "rest" if layer.is_transmitted else "specular"
    images = {RADIANCE: layer.radiance, PILOT: pilot, "half_a": layer.half_a, "half_b": layer.half_b}
    images |= {f"{PART}{name}": image for name, image in layer.parts.items()}
    return LayerImages(layer.name, kind, layer.albedo, {s: image for s, image in images.items() if image is not None})


def put_back(
    frame: Frame,
    own: Sequence[LayerImages],
    joined: Sequence[LayerImages],
    shares: Mapping[str, FloatArray],
) -> Frame:
    """Return a frame with joined layers.

    Light that no layer holds stays as it is.

    Parameters
    ----------
    frame : Frame
    own, joined : sequence of LayerImages
        The layers before and after.
    shares : mapping of str to array, shape (height, width)
        Factor of the variance of each layer, by name.
    """
    named = {layer.name: layer for layer in joined}
    layers = tuple(_put_layer(layer, named[layer.name]) for layer in frame.layers)
    slots = {RADIANCE: frame.radiance, "half_a": frame.half_a, "half_b": frame.half_b}
    sums = {slot: _put_radiance(light, slot, own, joined, layers) for slot, light in slots.items()}
    radiance = sums.pop(RADIANCE)
    assert radiance is not None
    return frame.with_changes(
        radiance=radiance,
        **sums,
        layers=layers,
        variance=_scale_variance(frame.variance, shares),
    )


def _put_layer(layer: RadianceLayer, joined: LayerImages) -> RadianceLayer:
    images = joined.images
    parts = {name: images[f"{PART}{name}"] for name in layer.parts if f"{PART}{name}" in images}
    halves: dict[str, Any] = {name: images.get(name) for name in HALVES}
    return replace(layer, radiance=images[RADIANCE], parts=parts, **halves)


def _put_radiance(
    light: Radiance | None,
    slot: str,
    own: Sequence[LayerImages],
    joined: Sequence[LayerImages],
    layers: tuple[RadianceLayer, ...],
) -> Radiance | None:
    """Return the radiance in total and by part, or None if a layer lacks it."""
    if light is None or any(slot not in layer.images for layer in joined):
        return None
    before = [np.nan_to_num(layer.images[slot]) for layer in own]
    after = [layer.images[slot] for layer in joined]
    if light.parts is None:
        return replace(light, color=after[0])
    with np.errstate(invalid="ignore", over="ignore"):  # bad pixels stay bad
        color = np.maximum(light.color - np.sum(before, axis=0) + np.sum(after, axis=0), np.float32(0.0))
    if not layers:
        return replace(light, color=color, diffuse=after[0], specular=after[1])
    zero = np.zeros_like(color)
    sums = [sum_layers(layers, slot, diffuse=diffuse) for diffuse in (True, False)]
    diffuse, specular = (zero if each is None else each for each in sums)
    return replace(light, color=color, diffuse=diffuse, specular=specular)


def _scale_variance(variance: Images | None, shares: Mapping[str, FloatArray]) -> Radiance | None:
    """Return the variance of the mean over several frames; ``shares`` are factors of the layers' variances."""
    if variance is None:
        return None
    assert isinstance(variance, Radiance)
    mean = np.asarray(np.mean(list(shares.values()), axis=0, dtype=np.float32))
    parts = {name: getattr(variance, name) for name in ("diffuse", "specular")}
    scaled = {
        name: None if image is None else image * shares.get(name, mean)[..., None] for name, image in parts.items()
    }
    return replace(variance, color=variance.color * mean[..., None], **scaled)


def divide(image: FloatArray, albedo: FloatArray | None) -> FloatArray:
    """Return radiance over albedo, (height, width, 3)."""
    if albedo is None:
        return image
    return np.asarray(image / np.maximum(np.nan_to_num(albedo), np.float32(MIN_DIVIDING_ALBEDO)), np.float32)


def multiply(image: FloatArray, albedo: FloatArray | None) -> FloatArray:
    """Return what `divide` took as radiance."""
    return image if albedo is None else image * np.maximum(np.nan_to_num(albedo), np.float32(MIN_DIVIDING_ALBEDO))
