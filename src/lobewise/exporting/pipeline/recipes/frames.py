"""The stages of a frame's plan as steps of a pipeline; `lobewise.denoising.stages` runs them in this process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import reduce
from types import SimpleNamespace
from typing import Any, cast

from lobewise import engine
from lobewise.denoising import bad_pixels
from lobewise.denoising.evidence import find_share_lost, mix_noisy
from lobewise.denoising.layers import compare_specular, make_lobe_layers, split_lobes
from lobewise.denoising.light_loss import Gain, find_takers, measure_gain, share_light
from lobewise.denoising.noisy import join_halves
from lobewise.denoising.plain import add_up, filter_by_guides
from lobewise.denoising.planning.frame_plans import (
    FILL_HOLES,
    FILTER_LAYERS,
    KEEP_LIGHT,
    TAKE_BACK_NOISY,
    FramePlan,
    Stage,
)
from lobewise.denoising.refining.totals import compose
from lobewise.denoising.running import run_guided
from lobewise.engine.graph import Image
from lobewise.engine.numbers import Number, choose_larger
from lobewise.errors import InputError
from lobewise.exporting.pipeline.recipes.guided import SIMPLE, prepare_halves
from lobewise.exporting.pipeline.recipes.guides import SIZE, PipelineGuides
from lobewise.exporting.pipeline.recipes.history import make_past
from lobewise.exporting.pipeline.settings import CONTENTS
from lobewise.filters import glue
from lobewise.filters.fireflies import cut_samples
from lobewise.filters.history.accumulation import KnownKernel
from lobewise.settings import TemporalSettings
from lobewise.temporal.past import HistoryReprojection
from lobewise.temporal.recipe import Growth, join_history, make_named_layers
from lobewise.temporal.validation import find_same_tau
from lobewise.upsampling import join_sparse, tint_samples, upsample_by_guides


@dataclass
class PlannedFrame:
    """A frame on its way through the stages of its plan."""

    guides: PipelineGuides
    plan: FramePlan
    layers: Sequence[Any] = ()
    parts: list[Image] = field(default_factory=list)
    rest: Image | None = None
    bad: Image | None = None
    total: Image | None = None
    holes: Image | None = None
    levels: list[float] = field(default_factory=list)
    noisy: list[Image] = field(default_factory=list)
    supports: list[Image] = field(default_factory=list)

    def run(self) -> None:
        """Add every stage of the plan; refuse stages that a pipeline cannot contain."""
        for stage in self.plan.stages:
            if stage not in STAGES:
                raise InputError(
                    "plan", expected=f"one that a pipeline contains ({CONTENTS})", got=stage.text, action="choose fast"
                )
            STAGES[stage](self)


def find_rest(guides: PipelineGuides, layers: Sequence[Any]) -> Any:
    """Return the light that is in none of the layers; None where light is not told apart."""
    if guides.settings.layers == "color":
        return None
    text = "emission and background, which are not filtered"
    if guides.settings.emission:
        return engine.pixels(glue.define_good, {"image": guides.emission}, {}, names=["rest"], text=text)[0]
    images = {"color": guides.color, **{f"noisy{k}": layer.radiance for k, layer in enumerate(layers)}}
    return engine.pixels(glue.define_rest, images, {}, names=["rest"], text=text)[0]


def give_parts(frame: PlannedFrame) -> None:
    """Give the light of each layer to callers that ask for it."""
    if len(frame.layers) == 1:
        return
    for layer, part in zip(frame.layers, frame.parts, strict=True):
        text = f"the {layer.name} light of the denoised frame, or NULL"
        result = frame.guides.graph.take(f"{layer.name}_image", *SIZE, 3, text=text, unit="any")
        with frame.guides.graph.only_when(f"p->frame->{result.name}"):
            text = f"{layer.name} light for the caller"
            engine.pixels(glue.define_good, {"image": part}, {}, into=[result], text=text)


def filter_layers(frame: PlannedFrame) -> None:
    """Filter every layer by its plan."""
    (filter_halves if frame.guides.constants.guided else filter_plain)(frame)


def filter_plain(frame: PlannedFrame) -> None:
    """Filter every layer by its guides alone; join it with its history where there is one."""
    guides, settings = frame.guides, frame.guides.settings
    if settings.history or settings.upsample > 1:
        filter_over_time(frame)
        return
    exact = guides.emission if settings.emission else None
    found: Any = filter_by_guides(guides, guides.resolved, guides.features, guides.bad, exact=exact)  # type: ignore[arg-type]
    frame.layers, frame.parts = found.layers, list(found.parts)
    frame.total, frame.holes = found.image, found.holes


def filter_over_time(frame: PlannedFrame) -> None:
    """Join every layer with its history where there is one, and bring sparse samples to all pixels."""
    guides, settings, whole = frame.guides, frame.guides.settings, cast(Any, frame.guides)
    resolved = guides.resolved
    if guides.is_sparse:
        whole = tint_samples(whole)
    if not settings.history:
        joined: Any = upsample_by_guides(whole, resolved, guides.features)
        frame.total, frame.holes, frame.parts = joined.image, joined.holes, [*joined.parts]
        frame.layers = [SimpleNamespace(name=name) for name in settings.layer_names]
        return
    how = find_growth(guides)
    lobes = split_lobes(whole, settings.similarity, resolved.tau, find_same_tau(whole, resolved))
    layers = make_named_layers(whole, resolved, guides.features, lobes, how.own)
    constants, past = guides.constants, cast(Any, make_past(guides))
    names = {"beta": "history_beta", **{name: name for name in ("memory", "plane_sigma", "strictness", "cut_share")}}
    numbers: Any = {name: constants.get(own) for name, own in names.items()}
    temporal = replace(TemporalSettings(), **numbers)
    masks = {name: layer.mask for name, layer in layers.items()}
    history = HistoryReprojection(whole, resolved, temporal, past, masks, lobes)
    outputs = []
    for name, layer in layers.items():
        sums = history.reproject(name)
        with guides.graph.part(f"{name}: join with its history"):
            outputs.append(join_history(whole, layer, resolved, sums, how))
    frame.layers = list(layers.values())
    with guides.graph.part("sum of the light"):
        if guides.is_sparse:
            joined = join_sparse(whole, frame.layers, outputs)
        else:
            joined = add_up(whole, frame.layers, outputs, cast(Any, guides.bad))
    frame.total, frame.holes, frame.parts = joined.image, joined.holes, [*joined.parts]


def find_growth(guides: PipelineGuides) -> Growth:
    """Return how samples join a history.

    The standard deviation on the screen of pixels that have a history follows their radius, unless the user sets that
    of all pixels.
    """
    constants, sigma = guides.constants, guides.constants.screen_sigma
    known = min(TemporalSettings.history_radius, constants.radius)
    narrow = sigma * float(known) / float(constants.radius)
    code = f"({constants.get('screen_sigma').code} > 0.0 || {known} == 0 ? {sigma.code} : {narrow.code})"
    kernel = KnownKernel(known, sigma, Number(float(narrow) if known else float(sigma), code))
    return Growth(constants.get("strictness"), constants.own_weight, kernel)


def filter_halves(frame: PlannedFrame) -> None:
    """Filter both halves of the samples of every layer by its plan."""
    guides, settings = frame.guides, frame.guides.settings
    whole: Any = guides
    layers: list[Any] = make_lobe_layers(whole, guides.resolved, spread=True)
    pilot = layers[-1].features
    if settings.record.has_covariance:
        simple = replace(guides.resolved, similarity=SIMPLE)
        pilot = compare_specular(whole, simple, settings.layers == "apart", spread=True).features
    frame.bad, frame.rest = guides.bad, find_rest(guides, layers)
    for layer in layers:
        with guides.graph.part(f"{layer.name}: samples"):
            half = prepare_halves(guides, layer, layer.features if layer.is_diffuse else pilot)
            frame.noisy.append(cast(Any, join_halves(half)))
        clean: Any = run_guided(whole, half, guides.resolved, frame.plan.layers[layer.name])
        frame.levels.append(half.level)
        frame.supports.append(clean.support)
        frame.parts.append(clean.image)
    frame.layers = layers


def take_back(frame: PlannedFrame) -> None:
    """Take the noisy image back where it has less error than the filtered one."""
    guides: Any = frame.guides
    parts, noisy, rest = cast(Any, (frame.parts, frame.noisy, frame.rest))
    with frame.guides.graph.part(TAKE_BACK_NOISY.name):
        image, samples = compose(parts, rest), cut_samples(guides.color, compose(noisy, rest))
        halves = tuple(guides.give_halves("color"))
        share = find_share_lost(samples, image, reduce(choose_larger, frame.levels), halves=halves, shared=False)
        mixed: list[Any] = [mix_noisy(*each, share) for each in zip(parts, noisy, strict=True)]
        if rest is not None:
            frame.rest = rest = cast(Any, mix_noisy(rest, rest, share))
        frame.parts, frame.total = mixed, cast(Any, compose(mixed, rest))


def keep_light(frame: PlannedFrame) -> None:
    """Share the light that bounding took out over each layer."""
    total, parts = cast(Any, (frame.total, frame.parts))
    with frame.guides.graph.part(KEEP_LIGHT.name):
        takers = [find_takers(*each) for each in zip(frame.layers, parts, frame.levels, strict=True)]
        gains = []
        for layer, part, taker in zip(frame.layers, parts, takers, strict=True):
            images = [layer.radiance, part, taker]
            gains.append(Gain(*engine.total(measure_gain, images, name=f"gain_{layer.name}", count=2)))
        frame.total, frame.parts = cast(Any, share_light(total, parts, takers, gains))


def check_total(frame: PlannedFrame) -> None:
    """Find the pixels without a value in a frame whose light is summed up already."""
    images: dict[str, Image | None] = {f"support{k}": support for k, support in enumerate(frame.supports)}
    images |= {"image": frame.total, "bad": frame.bad}
    image = frame.guides.graph.take("image", *SIZE, 3, text="the denoised frame", unit="any")
    text = "the result, and its holes"
    checked: Any = engine.pixels(glue.define_checked, images, {}, names=["", "holes"], into=[image], text=text)
    frame.total, frame.holes = checked


def fill_holes(frame: PlannedFrame) -> None:
    """Fill the pixels without a value from their neighbours; see `lobewise.denoising.bad_pixels.refill`."""
    with frame.guides.graph.part("sum of the light"):
        if frame.supports:
            check_total(frame)
        give_parts(frame)
    assert frame.total is not None and frame.holes is not None
    with frame.guides.graph.part(FILL_HOLES.name):
        bad_pixels.fill_holes(cast(Any, frame.total), cast(Any, frame.holes), cast(Any, frame.guides))


STAGES: Mapping[Stage, Callable[[PlannedFrame], None]] = {
    FILTER_LAYERS: filter_layers,
    TAKE_BACK_NOISY: take_back,
    KEEP_LIGHT: keep_light,
    FILL_HOLES: fill_holes,
}
"""What adds each stage to a pipeline."""
