"""The layers of a frame in two halves of their samples, whose difference tells the noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from lobewise import engine
from lobewise.backend.buffers import Image, download
from lobewise.denoising.automatic import AUTO_SIGMA
from lobewise.denoising.layers import Layer, make_lobe_layers, make_position_features
from lobewise.engine.numbers import choose_larger
from lobewise.features import Feature, PositionFeature, ScreenFeature
from lobewise.filters.fireflies import BoundedHalves, bound_fireflies
from lobewise.filters.glue import define_joined_colours, define_joined_halves
from lobewise.filters.highlights import split_highlights
from lobewise.filters.noise.residuals import compute_squared_residual
from lobewise.filters.noise_guides import add_light, measure_level, measure_light
from lobewise.guides.halves import choose_halves
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import DenoiseSettings, ResolvedSettings

Places = Sequence[ScreenFeature | PositionFeature]
"""Features of place."""


@dataclass(frozen=True, kw_only=True)
class BoundedLayer:
    """One radiance in two halves, fireflies bounded.

    Parameters
    ----------
    layer : Layer
    bounded : BoundedHalves
    is_whole : bool
        Whether every pixel has samples in both halves. Else a pixel belongs to one of a checkerboard's colours, each of
        which stands for a half.
    noise_is_shared : bool
        As of `lobewise.Frame`.
    """

    layer: Layer
    bounded: BoundedHalves
    is_whole: bool
    noise_is_shared: bool

    @property
    def name(self) -> str:
        """Name of the layer."""
        return self.layer.name

    @property
    def halves(self) -> tuple[Image, Image]:
        """Both halves, (height, width, 3) each."""
        return self.bounded.a, self.bounded.b


@dataclass(frozen=True, kw_only=True)
class NoisyLayer(BoundedLayer):
    """A bounded layer and everything that its pixels are compared by.

    Parameters
    ----------
    places : sequence of Feature
        Where pixels are, on the screen and in the scene.
    level : float
        Mean luminance of radiance over albedo of the samples of the whole image. It says what is dark.
    samples : pair of arrays, shape (height, width, 3)
        What a dense pass averages: the halves; of an image without halves, the image and its squared residual.
    highlights : array, shape (height, width, 3), optional
        Light of highlights. No sample holds it; it is added to the result.
    """

    places: Places
    level: float
    samples: tuple[Image, Image]
    highlights: FloatArray | None = None


def make_bounded_layers(frame: Frame, settings: ResolvedSettings) -> list[BoundedLayer]:
    """Return the layers of a frame with both their halves."""
    bounded_layers = []
    layers = make_lobe_layers(frame, settings, finest=True, spread=True)
    halves = choose_halves(frame, {layer.name: layer.radiance for layer in layers})
    for layer in layers:
        bounded = bound_fireflies(halves.images[layer.name], layer.albedo, layer.mask)
        bounded_layers.append(
            BoundedLayer(
                layer=layer,
                bounded=bounded,
                is_whole=halves.origin == "file",
                noise_is_shared=frame.noise_is_shared,
            )
        )
    return bounded_layers


def measure_layer(layer: BoundedLayer) -> NDArray[np.float64]:
    """Return the light of each row of a layer, from which its level follows; see `measure_light`."""
    return measure_light(layer.halves, layer.layer.albedo, layer.layer.mask)


def compute_layer_level(layer: BoundedLayer) -> float:
    """Return the mean light of the samples of a layer, over the albedo."""
    sums = add_light(layer.halves, layer.layer.albedo, layer.layer.mask)
    level: float = engine.total(measure_level, [sums, layer.layer.mask], name=f"level_{layer.name}")
    return level


def make_noisy_layers(
    frame: Frame, settings: ResolvedSettings, extra: Sequence[Feature], levels: Sequence[float] | None = None
) -> list[NoisyLayer]:
    """Return the layers of a frame, with the features that compare their pixels.

    Parameters
    ----------
    frame : Frame
    settings : ResolvedSettings
    extra : sequence of Feature
        More features of every layer; they count like the lobes.
    levels : sequence of float, optional
        Levels of the layers of the whole image, where the frame is a part of it.
    """
    noisy_layers, places = [], make_position_features(frame, settings)
    bounded_layers = make_bounded_layers(frame, settings)
    for number, bounded in enumerate(bounded_layers):
        level = levels[number] if levels is not None else compute_layer_level(bounded)
        layer = bounded.layer
        # Highlights are no noise: the passes do not see them.
        a, b, highlights = split_highlights(bounded.halves, layer.albedo, layer.mask)
        without_highlights = replace(bounded, bounded=BoundedHalves(a, b, bounded.bounded.sums))
        noisy_layers.append(
            NoisyLayer(
                layer=replace(layer, features=(*layer.features, *extra)),
                bounded=without_highlights.bounded,
                is_whole=without_highlights.is_whole,
                noise_is_shared=without_highlights.noise_is_shared,
                places=places,
                level=level,
                samples=without_highlights.halves if without_highlights.is_whole else _join_samples(without_highlights),
                highlights=engine.some(download(highlights)),
            )
        )
    return noisy_layers


def join_halves(noisy: NoisyLayer) -> FloatArray:
    """Return the samples of a layer without fireflies, radiance, (height, width, 3); bad pixels are not finite."""
    a, b = map(download, noisy.halves)
    define = define_joined_halves if noisy.is_whole else define_joined_colours
    images, name = {"a": a, "b": b, "kept": noisy.highlights}, f"{noisy.name}_samples"
    (joined,) = engine.pixels(define, images, {}, names=[name], text="bounded samples")
    return joined


def _join_samples(bounded: BoundedLayer) -> tuple[Image, Image]:
    """Return a layer without halves, put together from the colours of its checkerboard, and its squared residual."""
    even, odd = map(download, bounded.halves)
    (image,) = engine.pixels(define_joined_colours, {"a": even, "b": odd}, {}, names=["whole"], text="samples")
    return image, compute_squared_residual(
        image, bounded.layer.albedo, bounded.layer.mask, shared=bounded.noise_is_shared
    )


def scale_places(places: Places, settings: ResolvedSettings, sigma: float) -> list[Feature]:
    """Return the features of place of a pass from those of `make_position_features`.

    ``sigma`` is the standard deviation of the distance at radius 8 of the settings, pixels and footprints.
    """
    screen = choose_larger(sigma * settings.screen_sigma / AUTO_SIGMA, 0.5)
    position = screen * settings.position_sigma / DenoiseSettings.position_sigma
    return [replace(place, sigma=screen if isinstance(place, ScreenFeature) else position) for place in places]
