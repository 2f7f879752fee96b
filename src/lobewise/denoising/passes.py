"""The passes of the qualities "balanced" and "high": both halves of a layer, filtered by lobes and by their noise.

The noise of an image shows in two halves of its samples. A narrow pass over both halves gives a pilot, and the distance
of the halves gives the pilot's noise. The wide pass that follows averages pixels whose lobes are alike *and* whose
pilots are no further apart than their noise.
Sources: Rousselle, Knaus and Zwicker 2012, "Adaptive Rendering with Non-Local Means Filtering" (two buffers); Schied et
al. 2017, "Spatiotemporal Variance-Guided Filtering" (colour weights that follow the filtered variance); Tokuyoshi 2015
(lobe weights).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from lobewise import engine
from lobewise.backend.buffers import Image, download
from lobewise.denoising.noisy import NoisyLayer, scale_places
from lobewise.filters.compositing import composite_light
from lobewise.filters.dual_buffer import MORE_AT_ONCE, DualBufferOutput, PassRequest, filter_dual_buffer
from lobewise.filters.glue import define_lit, define_with_highlights
from lobewise.filters.noise.residuals import split_by_noise, split_samples
from lobewise.filters.noise_guides import (
    MIN_LOG_VARIANCE,
    MIN_LOG_VARIANCE_WITHOUT_HALVES,
    compute_log_offset,
    make_noise_guide,
)
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import ResolvedSettings


@dataclass(frozen=True)
class LayerPass:
    """One pass over the halves of a layer.

    Parameters
    ----------
    radius : int
        Taps from the centre to the edge of the kernel.
    sigma : float
        Standard deviation of the distance on the screen, pixels, and in the scene, pixel footprints, at radius 8.
    noise : float
        Number of variances by which a squared difference of the guide is divided. The first pass is guided by the
        samples themselves. Its number is so large that noise is no difference, but a lamp in a mirror, which is far
        brighter in both halves, stays where it is.
    lobes : float
        Exponent of the similarity of the lobes over that of the settings.
    """

    radius: int
    sigma: float
    noise: float
    lobes: float = 1.0

    @property
    def taps(self) -> int:
        """Neighbours that the kernel reads for a pixel."""
        return (2 * self.radius + 1) ** 2

    @property
    def text(self) -> str:
        """Kernel, exponent and noise, in a few words."""
        size = 2 * self.radius + 1
        return f"{size}x{size} taps, lobes to the power {self.lobes:g}, {self.noise:g} variances"


DIFFUSE_PASSES = (
    LayerPass(3, 6.0, 40.0, lobes=4.0),
    LayerPass(6, 30.0, 12.0),
)
SPECULAR_PASSES = (
    LayerPass(4, 6.0, 40.0, lobes=4.0),
    LayerPass(5, 22.0, 6.0),
)
"""Pilot and wide pass at radius 8. Tuned on the scenes that ``benchmarks/quality/measure.py`` calls train
(docs/developers/research/quality_trials.md)."""


def make_passes(radius: int, *, is_diffuse: bool) -> list[LayerPass]:
    """Return the pilot and the wide pass over a layer; ``radius`` is that of the settings, pixels."""
    passes = DIFFUSE_PASSES if is_diffuse else SPECULAR_PASSES
    return [replace(each, radius=round(each.radius * radius / 8.0)) for each in passes]


class FilteredOther(NamedTuple):
    """An image that was filtered by the weights of a layer.

    Parameters
    ----------
    image : (height, width, 3)
    compute_samples : callable
        Returns its samples, without fireflies, (height, width, 3).
    """

    image: FloatArray
    compute_samples: Callable[[], FloatArray]


@dataclass(frozen=True)
class CleanLayer:
    """The result of a layer.

    Parameters
    ----------
    image : (height, width, 3)
        Filtered radiance, albedo included; the noisy radiance where nothing was gathered.
    support : (height, width, 2)
        See `lobewise.filters.dual_buffer.DualBufferOutput`.
    others : sequence of FilteredOther
        Other images, filtered by the same weights.
    """

    image: FloatArray
    support: FloatArray
    others: Sequence[FilteredOther] = ()


@dataclass(frozen=True)
class OtherImage:
    """An image that is filtered by the weights of a layer.

    Parameters
    ----------
    radiance : (height, width, 3)
        What stays where nothing is gathered.
    samples : (height, width, 3)
        What the passes average: without the light of highlights, and NaN where a pixel is bad.
    highlights : (height, width, 3), optional
        The light of highlights, which is added to the result.
    compute : callable, optional
        Returns ``radiance`` again, so that it takes no memory after the passes.
    """

    radiance: FloatArray
    samples: Image
    highlights: FloatArray | None = None
    compute: Callable[[], FloatArray] | None = None


def filter_layer_halves(
    frame: Frame, noisy: NoisyLayer, settings: ResolvedSettings, others: Sequence[OtherImage] = ()
) -> CleanLayer:
    """Return a layer after its passes: the pilot is guided by the samples, the wide pass by the pilot.

    ``others`` are averaged in the wide pass. What does not fit is averaged in further passes by the same guide.
    """
    pilot_pass, wide_pass = make_passes(settings.radius, is_diffuse=noisy.layer.is_diffuse)
    # As many images as registers hold take part in the layer's own pass.
    first_others, later_others = others[:MORE_AT_ONCE], others[MORE_AT_ONCE:]
    with engine.part(f"{noisy.name}: {pilot_pass.text}"):
        pilot = run_pass(noisy, settings, pilot_pass, make_first_guide(noisy))
    with engine.part(f"{noisy.name}: {wide_pass.text}"):
        guide = compare_halves(noisy, pilot.a, pilot.b)
        del pilot
        light = run_pass(noisy, settings, wide_pass, guide, [image.samples for image in first_others])
    with engine.part(f"{noisy.name}: albedo and coverage"):
        image, supports = finish_layer(frame, noisy, (light.a, light.b), light.support)
    # The other images: those beside the layer, then those of further passes.
    filtered = [*light.others[: len(first_others)]]
    for start in range(0, len(later_others), 1 + MORE_AT_ONCE):
        filtered += filter_others(noisy, settings, later_others[start : start + 1 + MORE_AT_ONCE], wide_pass, guide)
    clean = []
    for other, mean in zip(others, filtered, strict=True):
        mine = replace(noisy, layer=replace(noisy.layer, radiance=other.radiance), highlights=other.highlights)
        compute = other.compute or partial(np.asarray, other.radiance)
        clean.append(FilteredOther(finish_layer(frame, mine, [mean], light.support)[0], compute))
    return CleanLayer(image, supports, clean)


def filter_others(
    noisy: NoisyLayer,
    settings: ResolvedSettings,
    others: Sequence[OtherImage],
    layer_pass: LayerPass,
    guide: Image,
) -> list[Image]:
    """Return up to ``1 + MORE_AT_ONCE`` images after a pass over a layer."""
    # One image takes the places of both halves: a half without a good tap takes the light of the other half.
    first, *other_images = (other.samples for other in others)
    both = replace(noisy, samples=(first, first), is_whole=True)
    light = run_pass(both, settings, layer_pass, guide, other_images)
    return [light.a, *light.others][: len(others)]


def make_first_guide(noisy: NoisyLayer) -> Image:
    """Return the guide that the samples of a layer give."""
    layer = noisy.layer
    if noisy.is_whole:
        itself = PassRequest(halves=noisy.samples, mask=layer.mask, radius=0, albedo=layer.albedo)
        over_albedo = filter_dual_buffer(itself, "light over albedo")
        return compare_halves(noisy, over_albedo.a, over_albedo.b)
    image, dark = download(noisy.samples[0]), compute_log_offset(noisy.level)
    halves = split_samples(image, layer.albedo, layer.mask, dark, shared=noisy.noise_is_shared)
    return compare_halves(noisy, *halves)


def compare_halves(noisy: NoisyLayer, a: Image, b: Image) -> Image:
    """Return the guide of a pass from two images that are as far apart as their noise."""
    floor = MIN_LOG_VARIANCE if noisy.is_whole else MIN_LOG_VARIANCE_WITHOUT_HALVES
    return make_noise_guide(a, b, noisy.level, floor=floor)


def run_pass(
    noisy: NoisyLayer,
    settings: ResolvedSettings,
    layer_pass: LayerPass,
    guide: Image,
    others: Sequence[Image] = (),
) -> DualBufferOutput:
    """Return both filtered halves of a layer, their support, and ``others``, images filtered by the same weights."""
    request = PassRequest(
        halves=noisy.samples,
        mask=noisy.layer.mask,
        place=scale_places(noisy.places, settings, layer_pass.sigma),
        lobes=noisy.layer.features,
        exponent=layer_pass.lobes,
        radius=layer_pass.radius,
        albedo=noisy.layer.albedo,
        guide=guide,
        noise=layer_pass.noise,
        # One image more than needed saves users the time to compile a kernel for every number of images.
        others=[*others, *others[-1:]] if len(others) % 2 else others,
    )
    output = filter_dual_buffer(request, layer_pass.text)
    if not noisy.is_whole:
        # The samples of an image without halves are the image and its squared residual.
        images = download(output.a), download(output.b), download(output.support)
        return DualBufferOutput(*split_by_noise(*images, compute_log_offset(noisy.level)), output.others)
    return output


def finish_layer(
    frame: Frame, noisy: NoisyLayer, light: Sequence[Image], support: Image
) -> tuple[FloatArray, FloatArray]:
    """Return the radiance of a layer from the light at pixel centres, over the pixels' area where it is known.

    ``light`` is one image, or two halves. The support is returned as an array.
    """
    layer, supports = noisy.layer, download(support)
    # Lit: where the layer has light, and a tap gave any.
    images = {"mask": layer.mask, "support": supports}
    (lit,) = engine.pixels(define_lit, images, {}, names=[f"{layer.name}_lit"], text="pixels with light")
    # Albedo: that of the pixel's area where the frame tells it, and the one at the centre elsewhere.
    mean, coverage = layer.albedo, None if layer.albedo is None else frame.gbuffer.coverage
    if coverage is not None:
        means = {"diffuse": frame.gbuffer.mean_diffuse_albedo, "specular": frame.gbuffer.mean_specular_albedo}
        # A layer that the frame names itself has its own albedo alone.
        area = means.get(layer.name, mean if frame.layers else None)
        mean, coverage = (mean, None) if area is None else (area, coverage)
    image = composite_light(list(map(download, light)), lit, layer.radiance, mean, coverage)
    if noisy.highlights is not None:
        images = {"image": image, "kept": noisy.highlights, "lit": lit}
        (image,) = engine.pixels(
            define_with_highlights, images, {}, names=[f"{layer.name}_part"], text="add highlights"
        )
    return image, supports
