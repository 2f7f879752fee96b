"""The stages of a frame's plan as steps of a pipeline; `lobewise.denoising.stages` runs them in this process."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from typing import Any

from lobewise.denoising.bad_pixels import SIGMAS
from lobewise.denoising.layers import MIN_HIT_DISTANCE
from lobewise.denoising.planning.frame_plans import (
    FILL_HOLES,
    FILTER_LAYERS,
    KEEP_LIGHT,
    TAKE_BACK_NOISY,
    FramePlan,
    Stage,
)
from lobewise.denoising.planning.steps import HISTORY, AccumulateStep, FilterStep, Step, UpsampleStep
from lobewise.engine.graph import Image
from lobewise.engine.numbers import Number
from lobewise.errors import InputError
from lobewise.exporting.pipeline.recipes import evidence, glue
from lobewise.exporting.pipeline.recipes.evidence import FoundFrame
from lobewise.exporting.pipeline.recipes.guided import (
    GUIDED_STEPS,
    SIMPLE,
    HalfLayer,
    HalfOutput,
    join_halves,
    prepare_halves,
    run_layer,
)
from lobewise.exporting.pipeline.recipes.guides import SIZE, PipelineGuides, PlannedLayer
from lobewise.exporting.pipeline.recipes.history import add_inverse_hits, make_history
from lobewise.exporting.pipeline.recipes.samples import (
    add_sparse_accumulation,
    add_upsampling,
    join_sparse,
    reflect_enough,
)
from lobewise.exporting.pipeline.recipes.steps import (
    FilterCall,
    PlannedOutput,
    PlannedRun,
    add_accumulation,
    add_filter,
    call_filter,
)
from lobewise.exporting.pipeline.settings import CONTENTS
from lobewise.features import Feature, ScreenFeature
from lobewise.filters.forms import ATROUS_REACH
from lobewise.lobes.hits import HitField

STEPS: Mapping[type[Step], Callable[[PlannedRun, Any], Sequence[Any]]] = {
    FilterStep: add_filter,
    AccumulateStep: add_accumulation,
}
"""What adds each kind of step to a pipeline."""
SPARSE_STEPS: Mapping[type[Step], Callable[[PlannedRun, Any], Sequence[Any]]] = {
    UpsampleStep: add_upsampling,
    AccumulateStep: add_sparse_accumulation,
}
"""The same where samples are sparse."""
NO_SIGMA = 1e15
"""Standard deviation of the screen distance, pixels, beside which no distance counts."""


@dataclass
class PlannedFrame:
    """A frame on its way through the stages of its plan."""

    guides: PipelineGuides
    plan: FramePlan
    layers: Sequence[PlannedLayer] = ()
    outputs: Sequence[PlannedOutput] = ()
    parts: list[Image] = field(default_factory=list)
    rest: Image | None = None
    bad: Image | None = None
    total: Image | None = None
    holes: Image | None = None
    halves: list[HalfLayer] = field(default_factory=list)
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


def find_bad(guides: PipelineGuides, layers: Sequence[PlannedLayer]) -> Image:
    """Return the pixels whose radiance is NaN, infinite or negative."""
    light = [guides.color, *(layer.radiance for layer in layers)]
    images = {f"light{number}": image for number, image in enumerate(dict.fromkeys(light))}
    (bad,) = guides.kernels.map_pixels(glue.define_bad, images, {}, names=["bad"], text="bad pixels")
    return bad


def find_rest(guides: PipelineGuides, layers: Sequence[PlannedLayer]) -> Image | None:
    """Return the light that is in none of the layers; None where light is not told apart."""
    if guides.settings.layers == "color":
        return None
    if guides.settings.emission:
        text = "emission and background, which are not filtered"
        (rest,) = guides.kernels.map_pixels(glue.define_good, {"image": guides.emission}, {}, names=["rest"], text=text)
        return rest
    images = {"color": guides.color, **{f"noisy{k}": layer.radiance for k, layer in enumerate(layers)}}
    (rest,) = guides.kernels.map_pixels(
        glue.define_rest, images, {}, names=["rest"], text="emission and background, which are not filtered"
    )
    return rest


def keep_unfiltered(guides: PipelineGuides, layer: PlannedLayer, output: PlannedOutput) -> Image:
    """Return the filtered radiance, and the noisy one where no tap had weight."""
    images = {"noisy": layer.radiance, "weight": output.weight_sum, **output.give_image("image")}
    name = f"{layer.name}_part"
    (part,) = guides.kernels.map_pixels(glue.define_kept, images, {}, names=[name], text="radiance of the layer")
    return part


def compose(frame: PlannedFrame) -> None:
    """Add up the parts of a frame and what is in none of them, and find the pixels without a value."""
    if frame.guides.settings.upsample > 1:
        frame.total, frame.holes, frame.parts = join_sparse(frame.guides, [*frame.layers], [*frame.outputs])
        give_parts(frame)
        return
    assert frame.bad is not None
    images: dict[str, Image | None] = {f"part{k}": part for k, part in enumerate(frame.parts)}
    images |= {f"weight{k}": output.weight_sum for k, output in enumerate(frame.outputs)}
    images |= {"rest": frame.rest, "bad": frame.bad}
    image = frame.guides.graph.take("image", *SIZE, 3, text="the denoised frame", unit="any")
    total, holes = frame.guides.kernels.map_pixels(
        glue.define_total, images, {}, names=["", "holes"], into=[image], text="the sum of all light, and its holes"
    )
    frame.total, frame.holes = total, holes
    give_parts(frame)


def give_parts(frame: PlannedFrame) -> None:
    """Give the light of each layer to callers that ask for it."""
    if len(frame.layers) == 1:
        return
    for layer, part in zip(frame.layers, frame.parts, strict=True):
        text = f"the {layer.name} light of the denoised frame, or NULL"
        result = frame.guides.graph.take(f"{layer.name}_image", *SIZE, 3, text=text, unit="any")
        with frame.guides.graph.only_when(f"p->frame->{result.name}"):
            text = f"{layer.name} light for the caller"
            frame.guides.kernels.map_pixels(glue.define_good, {"image": part}, {}, into=[result], text=text)


def filter_layers(frame: PlannedFrame) -> None:
    """Filter every layer by its plan."""
    (filter_halves if frame.guides.constants.guided else filter_plain)(frame)


def filter_plain(frame: PlannedFrame) -> None:
    """Filter every layer by its guides alone, and join it with its history where there is one."""
    guides, constants = frame.guides, frame.guides.constants
    place = guides.make_place_features(constants.screen_sigma, constants.get("position_sigma"))
    specular, alike = make_specular_features(guides)
    frame.layers = guides.make_layers(place, specular, constants.diffuse_beta)
    if guides.settings.upsample > 1:
        if alike is not None:
            frame.layers = [reflect_enough(guides, layer) for layer in frame.layers]
    else:
        frame.bad = find_bad(guides, frame.layers)
        frame.rest = find_rest(guides, frame.layers)
    history, found = None, {}
    if alike is not None:
        masks = {layer.name: layer.mask for layer in frame.layers}
        history = make_history(guides, [alike], specular[1], masks)
        found = history.find_all()
    outputs = []
    sparse = guides.settings.upsample > 1
    for layer in frame.layers:
        run = PlannedRun(guides, layer)
        if history is not None:
            run.images |= {HISTORY: found[layer.name], "sums": history.keep_sums(layer.name)}
        output = run.run(frame.plan.layers[layer.name], {**STEPS, **(SPARSE_STEPS if sparse else {})})
        outputs.append(output)
        if sparse:
            continue
        with guides.graph.part(f"{layer.name}: radiance"):
            frame.parts.append(keep_unfiltered(guides, layer, output))
    frame.outputs = outputs


def make_specular_features(guides: PipelineGuides) -> tuple[tuple[Feature, Image], Feature | None]:
    """Return what compares specular light within a frame, its pixels, and what compares it between frames.

    The last is None without a history.
    """
    constants, settings = guides.constants, guides.settings
    if not settings.history:
        return guides.make_specular_feature(settings.similarity, constants.beta, constants.noise), None
    beta, same = constants.get("history_beta"), constants.square_tau(constants.pixel_tau)
    hits = None
    if settings.hit_distance and settings.record.has_lobes:
        places: Any = guides.position, add_inverse_hits(guides, MIN_HIT_DISTANCE * constants.pixel_angle)
        hits = HitField(*places)
    if settings.record.has_covariance and not settings.record.fits_gaussian:
        valid, (own, other) = guides.split_lobes([constants.noise, same])
        mask = guides.join_masks(valid)
        feature = guides.make_split_feature(own, constants.beta)
        return (feature, mask), guides.make_split_feature(other, beta, hits)
    feature, mask = guides.make_specular_feature(settings.similarity, constants.beta, constants.noise)
    alike, _ = guides.make_specular_feature(settings.similarity, beta, same, hits=hits)
    return (feature, mask), alike


def filter_halves(frame: PlannedFrame) -> None:
    """Filter both halves of the samples of every layer by its plan."""
    guides, constants = frame.guides, frame.guides.constants
    settings = guides.settings
    specular = guides.make_specular_feature(settings.similarity, constants.beta, constants.noise, spread=True)
    pilot = specular[0]
    if settings.record.has_covariance:
        pilot, _ = guides.make_specular_feature(SIMPLE, constants.beta, constants.noise, spread=True)
    layers = guides.make_layers([], specular, constants.diffuse_beta)
    frame.bad, frame.rest = find_bad(guides, layers), find_rest(guides, layers)
    for layer in layers:
        with guides.graph.part(f"{layer.name}: samples"):
            half = prepare_halves(guides, layer, layer.features[0] if layer.is_diffuse else pilot)
            frame.noisy.append(join_halves(guides, half))
        output: HalfOutput = run_layer(guides, half).run(frame.plan.layers[layer.name], GUIDED_STEPS)
        assert output.image is not None
        frame.halves.append(half)
        frame.supports.append(output.support)
        frame.parts.append(output.image)
    frame.layers = frame.halves


def take_back(frame: PlannedFrame) -> None:
    """Take the noisy image back where it has less error than the filtered one."""
    found = FoundFrame(frame.halves, frame.noisy, frame.parts, frame.rest)
    with frame.guides.graph.part(TAKE_BACK_NOISY.name):
        mixed = evidence.take_back(frame.guides, found, frame.guides.color)
        frame.rest = mixed.pop() if frame.rest is not None else None
        frame.parts = mixed
        frame.total = evidence.compose(frame.guides, frame.parts, frame.rest)


def keep_light(frame: PlannedFrame) -> None:
    """Share the light that bounding took out over each layer."""
    assert frame.total is not None
    with frame.guides.graph.part(KEEP_LIGHT.name):
        found = evidence.keep_light(frame.guides, frame.halves, frame.parts, frame.total)
        frame.total, frame.parts = found


def check_total(frame: PlannedFrame) -> None:
    """Find the pixels without a value in a frame whose light is summed up already."""
    images: dict[str, Image | None] = {f"support{k}": support for k, support in enumerate(frame.supports)}
    images |= {"image": frame.total, "bad": frame.bad}
    image = frame.guides.graph.take("image", *SIZE, 3, text="the denoised frame", unit="any")
    frame.total, frame.holes = frame.guides.kernels.map_pixels(
        glue.define_checked, images, {}, names=["", "holes"], into=[image], text="the result, and its holes"
    )
    give_parts(frame)


def fill_holes(frame: PlannedFrame) -> None:
    """Fill the pixels without a value from their neighbours; see `lobewise.denoising.bad_pixels.refill`."""
    with frame.guides.graph.part("sum of the light"):
        (check_total if frame.supports else compose)(frame)
    assert frame.total is not None and frame.holes is not None
    with frame.guides.graph.part(FILL_HOLES.name):
        fill_image(frame.guides, frame.total, frame.holes)


def fill_image(guides: PipelineGuides, image: Image, holes: Image) -> None:
    """Fill the holes of an image in place, inside of the box around them."""
    graph, kernels = guides.graph, guides.kernels
    with ExitStack() as conditions:
        left = graph.add_flag("holes_left")
        graph.run("find_holes", [holes], [str(ATROUS_REACH), f"&{left}"], "find the holes, and the box around them")
        conditions.enter_context(graph.only_when(left))
        mean = [Number(0.0, f"p->mean_color[{k}]", is_single=True) for k in range(3)]
        graph.run("find_mean_color", [guides.color], [], "mean colour of the good pixels")
        # No hole depends on pixels outside of the box.
        conditions.enter_context(graph.only_in_box())
        everywhere = graph.make("everywhere", *SIZE, type="uint8")
        graph.run("fill_bytes", [everywhere], ["1"], "a mask of all pixels", writes=[everywhere])
        images = {"image": image, "holes": holes}
        (source,) = kernels.map_pixels(glue.define_emptied, images, {}, names=["emptied"], text="NaN in the holes")
        for sigma in SIGMAS:
            features = [ScreenFeature(NO_SIGMA if sigma is None else sigma)]
            found = call_filter(kernels, FilterCall(source, everywhere, features, "atrous", 0, name="around"))
            assert isinstance(found.image, Image)
            images = {"image": source, "holes": holes, "filled": found.image, "weight": found.weight_sum}
            source, holes = kernels.map_pixels(
                glue.define_refilled, images, {}, names=["refilled", "holes"], text="fill holes from neighbours"
            )
            kernels.map_pixels(
                glue.define_patched,
                {"image": source, "holes": holes},
                {"mean": mean},
                into=[image],
                text="the result, and the mean colour in the holes that are left",
            )
            conditions.enter_context(graph.only_when(_count(guides, holes)))


def _count(guides: PipelineGuides, holes: Image) -> str:
    """Return the expression of C that counts the holes of an image."""
    left = guides.graph.add_flag("holes_left")
    guides.graph.run("count_holes", [holes], [f"&{left}"], "count the holes")
    return left


STAGES: Mapping[Stage, Callable[[PlannedFrame], None]] = {
    FILTER_LAYERS: filter_layers,
    TAKE_BACK_NOISY: take_back,
    KEEP_LIGHT: keep_light,
    FILL_HOLES: fill_holes,
}
"""What adds each stage to a pipeline."""
