"""The passes of the qualities "balanced" and "high": both halves of a layer, filtered by lobes and by their noise.

The noise of an image shows in two halves of its samples. A narrow pass over both halves gives a pilot, and the distance
of the halves gives the pilot's noise. The wide pass that follows averages pixels whose lobes are alike *and* whose
pilots are no further apart than their noise.
Sources: Rousselle, Knaus and Zwicker 2012, "Adaptive Rendering with Non-Local Means Filtering" (two buffers); Schied et
al. 2017, "Spatiotemporal Variance-Guided Filtering" (colour weights that follow the filtered variance); Tokuyoshi 2015
(lobe weights).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

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
    lobes_with_seen : float
        The same where the frame tells what reflections show, which says more than the lobes do.
    step : int
        Pixels from tap to tap.
    of_samples : bool
        Whether the pass averages the samples. Else it averages what the pass before has averaged, so that the weights
        that it gathers do not count samples.
    """

    radius: int
    sigma: float
    noise: float
    lobes: float = 1.0
    lobes_with_seen: float = 1.0
    step: int = 1
    of_samples: bool = True

    @property
    def reach(self) -> int:
        """Pixels to the last tap."""
        return self.radius * self.step

    @property
    def taps(self) -> int:
        """Neighbours that the kernel reads for a pixel."""
        return (2 * self.radius + 1) ** 2

    @property
    def text(self) -> str:
        """Kernel, exponent and noise, in a few words."""
        size = 2 * self.radius + 1
        apart = f", taps {self.step} pixels apart" if self.step > 1 else ""
        return f"{size}x{size} taps{apart}, lobes to the power {self.lobes:g}, {self.noise:g} variances"


DIFFUSE_PASSES = (
    LayerPass(3, 6.0, 40.0, lobes=4.0, lobes_with_seen=4.0),
    LayerPass(6, 30.0, 12.0),
    LayerPass(3, 30.0, 6.0, step=4, of_samples=False),
)
SPECULAR_PASSES = (
    LayerPass(4, 6.0, 40.0, lobes=4.0, lobes_with_seen=4.0),
    LayerPass(5, 22.0, 6.0, lobes_with_seen=0.5),
    LayerPass(3, 30.0, 6.0, lobes=64.0, lobes_with_seen=64.0, step=4, of_samples=False),
)
"""Passes at radius 8. Tuned on the scenes that ``benchmarks/quality/measure.py`` calls train
(docs/developers/research/quality_trials.md). Diffuse light varies slowly: a second, sparse pass over the image of the
first reaches as far as a dense kernel of three times the cost. Of reflections only the rough ones take part in the
sparse pass: 4 pixels apart, the axes of sharp lobes are too different for so high a power."""


def make_passes(radius: int, *, is_diffuse: bool, has_seen: bool = False) -> list[LayerPass]:
    """Return the passes over a layer; ``radius`` is that of the settings, pixels."""
    scale, passes = radius / 8.0, []
    for number, layer_pass in enumerate(DIFFUSE_PASSES if is_diffuse else SPECULAR_PASSES):
        # A sparse pass averages the image of the pass before, and keeps its taps.
        taps = round(layer_pass.radius * scale) if layer_pass.of_samples else min(layer_pass.radius, radius)
        step = 1 if layer_pass.of_samples else max(round(layer_pass.step * scale), 1)
        lobes = layer_pass.lobes_with_seen if has_seen and number > 0 else layer_pass.lobes
        passes.append(replace(layer_pass, radius=taps, step=step, lobes=lobes))
    return passes


class FilteredOther(NamedTuple):
    """An image that was filtered by the weights of a layer.

    Parameters
    ----------
    image : (height, width, 3)
    samples : (height, width, 3)
        Its samples, without fireflies.
    """

    image: FloatArray
    samples: FloatArray


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

    @property
    def weight_sum(self) -> FloatArray:
        """Sum of the weights of every pixel, (height, width)."""
        return self.support[..., 0]

    @property
    def effective_samples(self) -> FloatArray:
        """Number of equally weighted samples with the same variance, (height, width)."""
        return self.support[..., 1]


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
    """

    radiance: FloatArray
    samples: Image
    highlights: FloatArray | None = None


def filter_layer_halves(
    frame: Frame, noisy: NoisyLayer, settings: ResolvedSettings, others: Sequence[OtherImage] = ()
) -> CleanLayer:
    """Return a layer after its passes, each guided by what the pass before has found.

    ``others`` are averaged in the same passes: the last one that averages samples, and those after it. What does not
    fit is averaged in further passes by the same guides.
    """
    passes = make_passes(settings.radius, is_diffuse=noisy.layer.is_diffuse, has_seen=bool(noisy.seen))
    last = max(number for number, layer_pass in enumerate(passes) if layer_pass.of_samples)
    # As many images as registers hold take part in the layer's own passes.
    first_others, later_others = others[:MORE_AT_ONCE], others[MORE_AT_ONCE:]
    light, support, guides = None, None, []
    for number, layer_pass in enumerate(passes):
        with engine.part(f"{noisy.name}: {layer_pass.text}"):
            # The pilot is guided by the samples, every later pass by the image before it.
            guide = make_first_guide(noisy) if light is None else compare_halves(noisy, light.a, light.b)
            other_images = (
                [image.samples for image in first_others] if number == last else [] if light is None else light.others
            )
            light = run_pass(noisy, settings, layer_pass, guide, light, other_images, is_pilot=number == 0)
        # A pass over an image that was averaged counts no samples.
        if layer_pass.of_samples:
            support = light.support
        if later_others and number >= last:
            guides.append(guide)
    assert light is not None
    assert support is not None
    with engine.part(f"{noisy.name}: albedo and coverage"):
        image, supports = finish_layer(frame, noisy, (light.a, light.b), support)
    # The other images: those beside the layer, then those of further passes.
    filtered = [*light.others[: len(first_others)]]
    for start in range(0, len(later_others), 1 + MORE_AT_ONCE):
        filtered += filter_others(
            noisy, settings, later_others[start : start + 1 + MORE_AT_ONCE], passes[last:], guides
        )
    clean = []
    for other, mean in zip(others, filtered, strict=True):
        mine = replace(noisy, layer=replace(noisy.layer, radiance=other.radiance), highlights=other.highlights)
        clean.append(FilteredOther(finish_layer(frame, mine, [mean], support)[0], other.radiance))
    return CleanLayer(image, supports, clean)


def filter_others(
    noisy: NoisyLayer,
    settings: ResolvedSettings,
    others: Sequence[OtherImage],
    passes: Sequence[LayerPass],
    guides: Sequence[Image],
) -> list[Image]:
    """Return up to ``1 + MORE_AT_ONCE`` images after the last passes over a layer."""
    # One image takes the places of both halves: a half without a good tap takes the light of the other half.
    first, *other_images = (other.samples for other in others)
    both, light = replace(noisy, samples=(first, first), is_whole=True), None
    for layer_pass, guide in zip(passes, guides, strict=True):
        light = run_pass(both, settings, layer_pass, guide, light, other_images if light is None else light.others)
    assert light is not None
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
    before: DualBufferOutput | None,
    others: Sequence[Image] = (),
    *,
    is_pilot: bool = False,
) -> DualBufferOutput:
    """Return both filtered halves of a layer, their support, and ``others``, images filtered by the same weights.

    ``before`` is the output of the pass before.
    """
    of_samples = layer_pass.of_samples or before is None
    request = PassRequest(
        halves=noisy.samples if before is None or layer_pass.of_samples else (before.a, before.b),
        mask=noisy.layer.mask,
        place=[*scale_places(noisy.places, settings, layer_pass.sigma), *(() if is_pilot else noisy.seen)],
        lobes=noisy.layer.features,
        exponent=layer_pass.lobes,
        radius=layer_pass.radius,
        step=layer_pass.step,
        # An earlier pass has divided by the albedo.
        albedo=noisy.layer.albedo if of_samples else None,
        guide=guide,
        noise=layer_pass.noise,
        # One image more than needed saves users the time to compile a kernel for every number of images.
        others=[*others, *others[-1:]] if len(others) % 2 else others,
    )
    output = filter_dual_buffer(request, layer_pass.text)
    if of_samples and not noisy.is_whole:
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
