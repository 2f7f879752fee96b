"""The executor of layer plans: it runs their steps, and keeps images on the device between them.

The noise of an image shows in two halves of its samples. A narrow pass over both halves gives a pilot, and the distance
of the halves gives the pilot's noise. The wide pass that follows averages pixels whose lobes are alike *and* whose
pilots are no further apart than their noise.
Sources: Rousselle, Knaus and Zwicker 2012, "Adaptive Rendering with Non-Local Means Filtering" (two buffers); Schied et
al. 2017, "Spatiotemporal Variance-Guided Filtering" (colour weights that follow the filtered variance); Tokuyoshi 2015
(lobe weights).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple, cast

import numpy as np

from lobewise import engine
from lobewise.backend.buffers import Image, download
from lobewise.denoising.layers import Layer
from lobewise.denoising.noisy import NoisyLayer, make_pass_features
from lobewise.denoising.planning.steps import (
    SAMPLES,
    FinishStep,
    GuideStep,
    LayerPlan,
    PassStep,
    Step,
)
from lobewise.features import Feature
from lobewise.filters.compositing import composite_light
from lobewise.filters.dual_buffer import DualBufferOutput, PassRequest, filter_dual_buffer
from lobewise.filters.glue import define_lit, define_with_highlights
from lobewise.filters.noise.residuals import split_by_noise, split_samples
from lobewise.filters.noise_guides import MIN_VARIANCE, MIN_VARIANCE_WITHOUT_HALVES, find_log_offset, make_noise_guide
from lobewise.frame import FloatArray, Frame
from lobewise.settings import ResolvedSettings
from lobewise.sparse_frame import AnyFrame


class Halves(NamedTuple):
    """Two images (height, width, 3) that are as far apart as their noise; one image twice where nothing reads it."""

    a: Image
    b: Image


@dataclass(frozen=True)
class CleanLayer:
    """The result of a layer.

    Parameters
    ----------
    image : (height, width, 3)
        Filtered radiance, albedo included; the noisy radiance where nothing was gathered.
    support : (height, width, 2)
        See `lobewise.filters.dual_buffer.DualBufferOutput`.
    """

    image: FloatArray
    support: FloatArray

    @property
    def weight_sum(self) -> FloatArray:
        """Sum of the weights of every pixel, (height, width)."""
        return self.support[..., 0]

    @property
    def effective_samples(self) -> FloatArray:
        """Number of equally weighted samples with the same variance, (height, width)."""
        return self.support[..., 1]


@dataclass(frozen=True)
class LayerRun:
    """A layer and the images that the steps of its plan have written so far, by name.

    Parameters
    ----------
    frame : Frame or SparseFrame
    layer : Layer
    settings : ResolvedSettings
    found : NoisyLayer, optional
        The layer in two halves, which the steps of guided plans read.
    images : dict of str to images
        A plan with a history finds it here under "history".
    places : dict of float to list of Feature
        Features of place that were made, by their standard deviation.
    """

    frame: AnyFrame
    layer: Layer
    settings: ResolvedSettings
    found: NoisyLayer | None = None
    images: dict[str, Any] = field(default_factory=dict)
    places: dict[float, list[Feature]] = field(default_factory=dict)

    def run(self, plan: LayerPlan, keep: Sequence[str] = ()) -> None:
        """Run every step; let go of each image after the last step that reads it, unless it is to be kept."""
        for number, step in enumerate(plan.steps):
            with engine.part(f"{self.layer.name}: {step.describe()}"):
                outputs = RUNNERS[type(step)](self, step)
            self.images.update(zip(step.writes, outputs, strict=True))
            for name in plan.list_unused(number).difference(keep):
                del self.images[name]

    @property
    def noisy(self) -> NoisyLayer:
        """The layer in two halves."""
        assert self.found is not None, "a guided plan filters halves"
        return self.found

    def get_place(self, sigma: float) -> list[Feature]:
        """Return the features of place of a pass; passes of one sigma share them."""
        if sigma not in self.places:
            self.places[sigma] = make_pass_features(self.frame, self.settings, sigma)
        return self.places[sigma]


def run_guided(frame: Frame, noisy: NoisyLayer, settings: ResolvedSettings, plan: LayerPlan) -> CleanLayer:
    """Return the result of a layer in two halves."""
    state = LayerRun(frame, noisy.layer, settings, noisy)
    state.run(plan)
    clean: CleanLayer = state.images["image"]
    return clean


def make_guide(state: LayerRun, step: GuideStep) -> list[Image]:
    """Return the guide of a pass: that of an earlier image, or of the samples."""
    (source,) = step.reads
    if source == SAMPLES:
        return [make_first_guide(state.noisy)]
    return [compare_halves(state.noisy, state.images[source])]


def make_first_guide(noisy: NoisyLayer) -> Image:
    """Return the guide that the samples of a layer give."""
    layer = noisy.layer
    if noisy.is_whole:
        itself = PassRequest(
            halves=noisy.samples,
            mask=layer.mask,
            radius=0,
            albedo=layer.albedo,
        )
        found = filter_dual_buffer(itself, "light over albedo")
        return compare_halves(noisy, Halves(found.a, found.b))
    image, dark = download(noisy.samples[0]), find_log_offset(noisy.level)
    halves = split_samples(image, layer.albedo, layer.mask, dark, shared=noisy.noise_is_shared)
    return compare_halves(noisy, Halves(*halves))


def compare_halves(noisy: NoisyLayer, halves: Halves) -> Image:
    """Return the guide of a pass from two images that are as far apart as their noise."""
    floor = MIN_VARIANCE if noisy.is_whole else MIN_VARIANCE_WITHOUT_HALVES
    return make_noise_guide(halves.a, halves.b, noisy.level, floor=floor)


def run_pass(state: LayerRun, step: PassStep) -> list[Halves | DualBufferOutput]:
    """Return both filtered halves, with their weight sums where a later step reads them."""
    noisy, dense = state.noisy, step.source == SAMPLES
    source = noisy.samples if dense else (state.images[step.source].a, state.images[step.source].b)
    request = PassRequest(
        halves=source,
        mask=noisy.layer.mask,
        place=[*state.get_place(step.sigma), *(noisy.seen if step.reads_seen else ())],
        lobes=noisy.pilot_features if step.is_pilot else noisy.layer.features,
        exponent=step.exponent,
        radius=step.radius,
        step=step.step,
        # An earlier pass has divided by the albedo.
        albedo=noisy.layer.albedo if dense else None,
        guide=state.images[step.guide],
        noise=step.noise,
    )
    found = filter_dual_buffer(request, step.describe())
    if dense and not noisy.is_whole:
        found = split_lone(found, noisy.level)
    (name,) = step.writes
    return [found if name in step.supports else Halves(found.a, found.b)]


def split_lone(found: DualBufferOutput, level: float) -> DualBufferOutput:
    """Return two halves of the filtered image and squared residual of an image without halves."""
    mean = download(found.a)
    # The mean of two halves filtered by the same weights is worth twice as many samples as this one image.
    worth = np.float32(0.5) * download(found.effective_samples)
    halves = split_by_noise(mean, download(found.b), worth, find_log_offset(level))
    return DualBufferOutput(*halves, np.stack([download(found.weight_sum), worth], axis=-1))


def run_finish(state: LayerRun, step: FinishStep) -> list[CleanLayer]:
    """Return the radiance of the layer."""
    light, support = (state.images[name] for name in (step.reads[0], step.support))
    return [finish_layer(cast(Frame, state.frame), state.noisy, (light.a, light.b), support)]


def finish_layer(frame: Frame, noisy: NoisyLayer, light: Sequence[Image], support: DualBufferOutput) -> CleanLayer:
    """Return the radiance of a layer from the light at pixel centres, over the pixels' area where it is known.

    ``light`` is one image, or two halves.
    """
    layer, support_image = noisy.layer, download(support.support)
    images = {"mask": layer.mask, "support": support_image}
    (lit,) = engine.pixels(define_lit, images, {}, names=[f"{layer.name}_lit"], text="pixels with light")
    mean, coverage = layer.albedo, None if layer.albedo is None else frame.gbuffer.coverage
    if coverage is not None:
        means = {"diffuse": frame.gbuffer.mean_diffuse_albedo, "specular": frame.gbuffer.mean_specular_albedo}
        # A layer that the frame names itself has its own albedo alone.
        area = means.get(layer.name, mean if frame.layers else None)
        mean, coverage = (mean, None) if area is None else (area, coverage)
    image = composite_light(list(map(download, light)), lit, layer.radiance, mean, coverage)
    if noisy.kept is not None:
        images = {"image": image, "kept": noisy.kept, "lit": lit}
        (image,) = engine.pixels(
            define_with_highlights, images, {}, names=[f"{layer.name}_part"], text="add highlights"
        )
    return CleanLayer(image, support_image)


RUNNERS: Mapping[type[Step], Callable[[LayerRun, Any], Sequence[Any]]] = {
    GuideStep: make_guide,
    PassStep: run_pass,
    FinishStep: run_finish,
}
"""What runs each kind of step."""
