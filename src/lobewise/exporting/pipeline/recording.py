"""Make the pipeline of some settings: call the library's recipe with a frame that has no values, and record it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import nullcontext
from dataclasses import dataclass, replace
from typing import Any, cast

from lobewise import engine
from lobewise.denoising.bad_pixels import fill_holes
from lobewise.denoising.chain import filter_whole
from lobewise.denoising.layers import (
    Compared,
    Layer,
    compare_specular,
    filter_layer,
    make_ggx_lobes,
    make_position_features,
    mark_surface,
)
from lobewise.denoising.plain import add_up
from lobewise.engine.graph import Graph, GraphImage
from lobewise.engine.numbers import Condition, Number
from lobewise.engine.recorder import Recorder
from lobewise.exporting.pipeline.constants import Constants
from lobewise.exporting.pipeline.frame import SIZE, Features, PipelineGuides, no_features
from lobewise.exporting.pipeline.pipeline import Pipeline
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.targets import get_gpu_api, parse_target
from lobewise.features import DiffuseFeature, Feature
from lobewise.filters import glue
from lobewise.filters.cross_filter import FilterOutput
from lobewise.filters.forms import describe_form
from lobewise.filters.history.accumulation import KnownKernel
from lobewise.filters.history.reprojection import ComparedPixels
from lobewise.filters.history.sums import HISTORY_CHANNELS
from lobewise.recipes.temporal.past import HistoryReprojection
from lobewise.recipes.temporal.recipe import Growth, join_history, make_named_layers
from lobewise.recipes.temporal.validation import ValidationFeatures, compute_same_tau
from lobewise.recipes.upsampling import join_sparse, tint_samples, upsample_by_guides
from lobewise.records.frame import FloatArray, Frame
from lobewise.settings import ResolvedSettings, TemporalSettings


def make_pipeline(
    settings: PipelineSettings,
    *,
    target: str = "host",
    name: str = "lobewise",
    constants: Constants | None = None,
    features: Features = no_features,
) -> Pipeline:
    """Return the pipeline of some settings; nothing is compiled yet.

    Parameters
    ----------
    settings : PipelineSettings
    target : str
        See `lobewise.exporting.targets.parse_target`.
    name : str
        Beginning of the names of files and functions.
    constants : Constants, optional
        Others than those of the usual example values. The program does not depend on them.
    features : callable
        As of `lobewise.exporting.pipeline.writing.export_pipeline`.

    Raises
    ------
    InputError, DeviceError
        If the target cannot be used.
    """
    chosen, on = parse_target(target), get_gpu_api(target) or "cpu"
    constants = constants or Constants(settings.upsample, settings.radius, settings.is_guided)
    graph = Graph(stage="guides")
    guides = PipelineGuides(settings, graph, Recorder(graph, chosen, name, on), constants, features)
    with engine.use(guides.kernels):
        record_frame(guides)
    read = {image.memory.name for operation in graph.operations for image in operation.reads}
    unread = [before.name for _, before in graph.state_pairs if before.name not in read]
    assert not unread, f"no step reads what the frame before has left: {unread}"
    kernels = guides.kernels
    lanes = kernels.host.lanes
    return Pipeline(settings, graph, constants, list(kernels.compiled.values()), lanes, name, chosen.to_string())


def record_frame(guides: PipelineGuides) -> None:
    """Call the recipe of a pipeline with its frame."""
    settings, frame = guides.settings, cast(Any, guides)
    if settings.is_filter:
        record_filter(guides)
        return
    if settings.history:
        filtered = filter_over_time(guides)
    elif guides.is_sparse:
        filtered = upsample_by_guides(tint_samples(frame), guides.resolved, guides.features)
    else:
        exact = guides.emission if settings.emission else None
        _, clean = filter_whole(frame, guides.resolved, guides.features, cast(Any, guides.bad), exact=cast(Any, exact))
        give_parts(guides, clean.parts)
        return
    give_parts(guides, filtered.parts)
    with engine.part("fill holes"):
        fill_holes(filtered.image, filtered.holes, frame)


def record_filter(guides: PipelineGuides) -> None:
    """Call the recipe of a single filter, and give its caller what it finds."""
    settings, graph = guides.settings, guides.graph
    text = "noisy linear radiance"
    light: Any = graph.give("radiance", *SIZE, 3, text=text, unit="any")
    text = "albedo of the radiance: it is divided by it, and multiplied afterwards; a black pixel has no weight"
    albedo: Any = graph.give("albedo", *SIZE, 3, text=text, unit="0 to 1") if settings.albedo else None
    filtered = filter_alone(cast(Any, guides), settings, guides.resolved, guides.features, light, albedo)
    made: Any = {
        "image": (filtered.image, "the filtered radiance; 0 where no pixel counts"),
        "weight_sum": (filtered.weight_sum, "the sum of the weights, or NULL"),
        "effective_samples": (filtered.effective_samples, "(sum w)^2 / sum w^2 of the weights w, or NULL"),
    }
    with engine.part("results"):
        for name, (image, text) in made.items():
            result = graph.take(name, *image.shape, text=text, unit="any" if name == "image" else "")
            with nullcontext() if name == "image" else graph.only_when(f"p->frame->{name}"):
                graph.run("copy_image", [image, result], [], f"{name.replace('_', ' ')} for the caller", [result])


def give_parts(guides: PipelineGuides, parts: Sequence[Any]) -> None:
    """Give the light of each layer to callers that ask for it."""
    names = guides.settings.layer_names
    if len(names) == 1:
        return
    for name, part in zip(names, parts, strict=True):
        text = f"the {name} light of the denoised frame, or NULL"
        result = guides.graph.take(f"{name}_image", *SIZE, 3, text=text, unit="any")
        with guides.graph.only_when(f"p->frame->{result.name}"), engine.part("results"):
            text = f"{name} light for the caller"
            engine.pixels(glue.define_good, {"image": part}, {}, into=[result], text=text)


def filter_over_time(guides: PipelineGuides) -> Any:
    """Return the layers of a frame, joined with their history, and their sum."""
    resolved, whole = guides.resolved, cast(Any, guides)
    if guides.is_sparse:
        whole = tint_samples(whole)
    how = compute_growth(guides)
    lobes = make_ggx_lobes(whole, guides.settings.similarity, resolved.tau, compute_same_tau(whole, resolved))
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
    with guides.graph.part("sum of the light"):
        if guides.is_sparse:
            return join_sparse(whole, list(layers.values()), outputs)
        return add_up(whole, list(layers.values()), outputs, cast(Any, guides.bad))


def compute_growth(guides: PipelineGuides) -> Growth:
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


@dataclass(frozen=True)
class GivenPast:
    """The frame before.

    Parameters
    ----------
    guides : PipelineGuides
        Of the frame before only the camera is known.
    similarity : str
    sums : mapping of str to GraphImage
        Sums of each layer, by its name.
    frame : PipelineGuides
        The frame itself.
    """

    guides: Any
    similarity: str
    sums: Mapping[str, GraphImage]
    frame: PipelineGuides
    validation = True
    exists = Condition("p->has_past")

    def get_pixels(self, name: str, features: ValidationFeatures) -> Any:
        """Return the pixels of a layer."""
        recorder = self.frame.kernels
        mask = recorder.declare(f"{name}_mask", *SIZE, type="uint8")
        planes = recorder.before.get(f"{name}_planes")
        size: Any = "p->height", "p->width"
        return ComparedPixels((), mask, planes, size)  # type: ignore[arg-type]  # recorded images stand for arrays


def make_past(guides: PipelineGuides) -> GivenPast:
    """Return the frame before of a pipeline's frame."""
    declare = guides.kernels.declare
    sums = {name: declare(f"{name}_sums", HISTORY_CHANNELS, *SIZE) for name in guides.settings.layer_names}
    return GivenPast(guides.before, guides.settings.similarity, sums, guides)


def filter_alone(
    frame: Frame,
    settings: PipelineSettings,
    resolved: ResolvedSettings,
    features: Sequence[Feature],
    light: FloatArray,
    albedo: FloatArray | None,
) -> FilterOutput:
    """Return a light after one pass.

    Parameters
    ----------
    frame : Frame
        Its guides and its camera.
    settings, resolved
        What is fixed when the filter is compiled, and its numbers.
    features : sequence of Feature
        More features.
    light : (height, width, 3)
        Linear radiance.
    albedo : (height, width, 3), optional
        Divides the light before the filter and multiplies it after.
    """
    if settings.similarity == "diffuse":
        surface = mark_surface(frame)
        normal = frame.gbuffer.require("normal", "similarity 'diffuse'")
        compared = Compared((DiffuseFeature(normal, resolved.diffuse_beta),), surface, surface)
    else:
        compared = compare_specular(frame, resolved, True)
    every = *make_position_features(frame, resolved), *features, *compared.features
    with engine.part(describe_form(settings.form, settings.radius)):
        return filter_layer(Layer(light, albedo, compared.mask, every, "light"), resolved)
