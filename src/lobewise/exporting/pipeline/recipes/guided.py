"""The plan "balanced" as steps of a pipeline: two halves of the samples, filtered by the same weights.

Every function records what one of `lobewise.denoising` runs, whose docstring says what it computes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

from lobewise.denoising.layers import Layer, make_position_features
from lobewise.denoising.planning.layer_plans import AUTO_SIGMA
from lobewise.denoising.planning.steps import SAMPLES, FinishStep, GuideStep, PassStep, Step
from lobewise.engine.graph import Image
from lobewise.engine.numbers import Number, choose_larger
from lobewise.engine.recorder import give_feature_images, give_feature_numbers
from lobewise.exporting.pipeline.recipes.guides import PipelineGuides
from lobewise.exporting.pipeline.recipes.steps import PlannedRun
from lobewise.features import Feature
from lobewise.features.base import describe_structure
from lobewise.filters import glue
from lobewise.filters.compositing import define_composite
from lobewise.filters.dual_buffer import make_scheduled_dual_buffer
from lobewise.filters.dual_buffer_pass import DualBufferKey, Groups
from lobewise.filters.fireflies import make_fireflies
from lobewise.filters.highlights import Kinds, make_highlights
from lobewise.filters.noise_guides import LOG_OFFSET_SHARE, MIN_VARIANCE, make_light_sums, make_scheduled_noise_guide
from lobewise.guides.halves import define_marked
from lobewise.settings import DenoiseSettings, Similarity

KINDS = Kinds(shared=False, single=False, paired=True)
"""Halves of the samples are samples of every pixel, at least two, and independent of those of its neighbours."""
SIMPLE: Similarity = "sg"
"""Similarity of the pilot, which compares single lobes."""


@dataclass(frozen=True)
class HalfLayer(Layer):
    """A layer in two halves of its samples; see `lobewise.denoising.noisy.NoisyLayer`.

    Parameters
    ----------
    halves : pair of Image
        Fireflies bounded, without highlights.
    kept : Image, optional
        Light of highlights.
    pilot : tuple of Feature
        What the pilot compares.
    level : Number, optional
        Mean light over the albedo.
    """

    halves: tuple[Image, ...] = ()
    kept: Image | None = None
    pilot: tuple[Feature, ...] = ()
    level: Number | None = None


@dataclass(frozen=True)
class HalfOutput:
    """Two filtered halves, and what supports them: weight sum, effective samples, nothing."""

    a: Image
    b: Image
    support: Image
    image: Image | None = None


@dataclass
class GuidedRun(PlannedRun):
    """A layer in two halves on its way through its plan."""

    half: HalfLayer | None = None
    places: dict[float, list[Feature]] = field(default_factory=dict)

    @property
    def noisy(self) -> HalfLayer:
        """The layer in two halves."""
        assert self.half is not None
        return self.half

    def get_place(self, sigma: float) -> list[Feature]:
        """Return the features of place of a pass; see `make_pass_features`."""
        if sigma not in self.places:
            constants = self.guides.constants
            screen = choose_larger(sigma * constants.screen_sigma / AUTO_SIGMA, 0.5)
            name = f"sigma_{sigma:g}".replace(".", "_")
            screen = constants.derive(name, screen)
            position = screen * constants.get("position_sigma") / DenoiseSettings.position_sigma
            whole: Any = self.guides
            settings = replace(self.guides.resolved, screen_sigma=screen, position_sigma=position)
            self.places[sigma] = make_position_features(whole, settings)
        return self.places[sigma]


def prepare_halves(guides: PipelineGuides, layer: Any, pilot: tuple[Feature, ...]) -> HalfLayer:
    """Return a layer in two halves, fireflies bounded and highlights split off; see `make_noisy_layers`."""
    kernels, name, graph = guides.kernels, layer.name, guides.graph
    marked = [
        kernels.map_pixels(define_marked, {"image": half}, {}, names=[f"{name}_{letter}"], text="mark bad pixels")[0]
        for letter, half in zip("ab", guides.give_halves(name), strict=True)
    ]
    tinted = layer.albedo is not None
    beside = {"albedo": layer.albedo, "mask": layer.mask}
    bright = kernels.call(
        kernels.get(("fireflies", tinted), partial(make_fireflies, tinted)),
        {"a": marked[0], "b": marked[1], **beside},
        text="bound fireflies",
    )
    halves = bright["bounded_a"], bright["bounded_b"]
    sums = kernels.call(
        kernels.get(("light sums", tinted), partial(make_light_sums, tinted)),
        {"a": halves[0], "b": halves[1], **beside},
        text="light of every row",
    )["sums"]
    level = graph.add_real(f"level_{name}")
    graph.run("find_level", [sums, layer.mask], [f"&{level}"], "mean light of the layer")
    split = kernels.call(
        kernels.get(("highlights", tinted, KINDS), partial(make_highlights, tinted, KINDS)),
        {"a": halves[0], "b": halves[1], **beside},
        text="split off highlights",
    )
    return HalfLayer(
        **vars(layer),
        halves=(split["rest_a"], split["rest_b"]),
        kept=split["kept"],
        pilot=pilot,
        level=Number(1.0, level),
    )


def join_halves(guides: PipelineGuides, layer: HalfLayer) -> Image:
    """Return the samples of a layer without fireflies."""
    images = dict(zip("ab", layer.halves, strict=True)) | {"kept": layer.kept}
    name = f"{layer.name}_samples"
    (joined,) = guides.kernels.map_pixels(glue.define_joined_halves, images, {}, names=[name], text="bounded samples")
    return joined


def call_dual_buffer(
    run: GuidedRun,
    halves: Sequence[Image],
    step: PassStep | None,
    groups: Groups,
    *,
    albedo: Any,
    guide: Image | None,
) -> HalfOutput:
    """Add a dual-buffer pass; without a step it filters nothing, and divides by the albedo."""
    layer, kernels = run.noisy, run.kernels
    key = DualBufferKey(
        groups=tuple(tuple(describe_structure(feature) for feature in features) for features in groups),
        guided=guide is not None,
    )
    given: dict[str, Any] = {
        "half_a": halves[0],
        "half_b": halves[1],
        "mask": layer.mask,
        "albedo": halves[0] if albedo is None else albedo,
        "guide": guide,
        "divided": int(albedo is not None),
        "radius": step.radius if step is not None else 0,
        "step": step.step if step is not None else 1,
        "noise": step.noise if step is not None else 1.0,
        "exponent": step.exponent if step is not None else 1.0,
    }
    for name, features in groups._asdict().items():
        given |= give_feature_images(name, features) | give_feature_numbers(features, name)
    kernel = kernels.get(key, partial(make_scheduled_dual_buffer, key, groups))
    text = step.describe() if step is not None else "light over albedo"
    written = kernels.call(kernel, given, text=text)
    return HalfOutput(written["a"], written["b"], written["support"])


def add_guide(run: GuidedRun, step: GuideStep) -> list[Image]:
    """Add the guide of a pass, from the samples or from an earlier image."""
    layer, kernels = run.noisy, run.kernels
    (source,) = step.reads
    if source == SAMPLES:
        halves = call_dual_buffer(run, layer.halves, None, Groups((), ()), albedo=layer.albedo, guide=None)
    else:
        halves = run.images[source]
    assert layer.level is not None
    offset = choose_larger(LOG_OFFSET_SHARE * layer.level, 1e-30)
    given = {"a": halves.a, "b": halves.b, "offset": offset, "floor": MIN_VARIANCE}
    return [kernels.call(kernels.get(("noise guide",), make_scheduled_noise_guide), given, text="noise guide")["guide"]]


def add_pass(run: GuidedRun, step: PassStep) -> list[HalfOutput]:
    """Add a dual-buffer pass."""
    layer, dense = run.noisy, step.source == SAMPLES
    halves = layer.halves if dense else (run.images[step.source].a, run.images[step.source].b)
    lobes = layer.pilot if step.is_pilot else layer.features
    groups = Groups(tuple(run.get_place(step.sigma)), lobes)
    albedo = layer.albedo if dense else None
    return [call_dual_buffer(run, halves, step, groups, albedo=albedo, guide=run.images[step.guide])]


def add_finish(run: GuidedRun, step: FinishStep) -> list[HalfOutput]:
    """Add the radiance of the layer: light times albedo, and highlights."""
    layer, kernels = run.noisy, run.kernels
    light, support = run.images[step.reads[0]], run.images[step.support].support
    images = {"mask": layer.mask, "support": support}
    (lit,) = kernels.map_pixels(glue.define_lit, images, {}, names=[f"{layer.name}_lit"], text="pixels with light")
    images = {"light0": light.a, "light1": light.b, "lit": lit, "radiance": layer.radiance, "albedo": layer.albedo}
    (image,) = kernels.map_pixels(
        define_composite, images, {}, names=[f"{layer.name}_composite"], text="light times albedo"
    )
    images = {"image": image, "kept": layer.kept, "lit": lit}
    (image,) = kernels.map_pixels(
        glue.define_with_highlights, images, {}, names=[f"{layer.name}_part"], text="add highlights"
    )
    return [HalfOutput(light.a, light.b, support, image)]


GUIDED_STEPS: Mapping[type[Step], Callable[[Any, Any], Sequence[Any]]] = {
    GuideStep: add_guide,
    PassStep: add_pass,
    FinishStep: add_finish,
}
"""What adds each kind of step to a pipeline."""


def run_layer(guides: PipelineGuides, layer: HalfLayer) -> GuidedRun:
    """Return a layer before its first step."""
    return GuidedRun(guides, replace(layer), half=layer)
