"""Upsampling of sparsely shaded frames, alone and over time; see `SampleGrid` and `lobewise.upsampling`."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from lobewise.backend.expressions import LOG2_E
from lobewise.denoising.planning.steps import HISTORY, AccumulateStep, UpsampleStep
from lobewise.engine.graph import Image
from lobewise.engine.numbers import Number, round_single, write_number
from lobewise.exporting.pipeline.recipes.guides import SAMPLES, SIZE, PipelineGuides
from lobewise.exporting.pipeline.recipes.steps import PlannedOutput, PlannedRun, SampleCalls, split_accumulated
from lobewise.filters.cross_pass import ALBEDO_FLOOR
from lobewise.filters.glue import define_any
from lobewise.filters.history.accumulation import TRUST_RADIUS
from lobewise.filters.history.accumulation_pass import make_accumulation, make_trust
from lobewise.filters.history.joining import define_joined, define_reflecting
from lobewise.filters.history.sums import HISTORY_CHANNELS

ROW, COLUMN = "p->frame->row", "p->frame->column"
SPARSE_TRUST_RADIUS = 1
"""Radius of the window over which a pixel averages the trust of sparse samples."""


class SparseCalls(SampleCalls):
    """The kernels of a layer whose samples are sparse. Images at the samples are picked from those of all pixels."""

    def pick(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the images at all pixels, and those at the samples, by the names of kernels."""
        whole = {name: image for name, image in self.images.items() if name.startswith("own_")}
        return whole, {name.replace("own", "tap", 1): self.pick_image(image) for name, image in whole.items()}

    def pick_image(self, image: Image) -> Image:
        """Return an image (height, width, ...) or a stack (count, height, width) at the shaded pixels."""
        graph, guides = self.run.guides.graph, self.run.guides
        known = guides.picked.get(image.name)
        if known is None:
            is_stack = image.shape[0] not in SIZE
            shape = [image.shape[0], *SAMPLES] if is_stack else [*SAMPLES, *image.shape[2:]]
            known = graph.make(f"{image.name}_picked", *shape, type=image.type)
            numbers = [ROW, COLUMN, str(int(is_stack))]
            graph.run("pick_samples", [image, known], numbers, f"{image.name} at shaded pixels", writes=[known])
            guides.picked[image.name] = known
        return known


def reflect_enough(guides: PipelineGuides, layer: Any) -> Any:
    """Return a layer without the pixels that reflect almost nothing; see `find_reflecting`."""
    assert layer.albedo is not None
    floor = round_single(ALBEDO_FLOOR / guides.constants.own_weight)
    images = {"mask": layer.mask, "albedo": layer.albedo}
    name = f"{layer.name}_mask"
    (mask,) = guides.kernels.map_pixels(
        define_reflecting, images, {"floor": floor}, names=[name], text=f"pixels that reflect {layer.name} light"
    )
    return replace(layer, mask=mask)


def add_upsampling(run: PlannedRun, step: UpsampleStep) -> list[PlannedOutput]:
    """Add the pass that brings the samples of a layer to every pixel."""
    graph, calls = run.guides.graph, SparseCalls(run, step.scale)
    nothing = graph.make_flat("no_sums", 0.0, HISTORY_CHANNELS, *SIZE)
    sums = graph.make(f"{run.layer.name}_sums", HISTORY_CHANNELS, *SIZE)
    numbers = {"radius": step.radius, "known_radius": step.radius, "known_precision": 0.0, "trust_radius": 0}
    trust = graph.make_flat("full_trust", 1.0, *SAMPLES)
    given = {"history": nothing, "trust": trust, "growth": 0.0, "own": 1.0, **numbers}
    return [accumulate(calls, given, sums)]


def accumulate(calls: SparseCalls, given: Mapping[str, Any], sums: Image) -> PlannedOutput:
    """Add the pass that gathers sparse samples and adds them to a history."""
    run, layer = calls.run, calls.run.layer
    whole, taps = calls.pick()
    written, output = split_accumulated(layer.name, sums, run)
    placed = calls.place(calls.scale, ROW, COLUMN)
    text = f"{layer.name} light at every pixel"
    calls.call(
        make_accumulation,
        (layer.features, layer.albedo is not None, False),
        {"samples": layer.radiance, **whole, **taps, **given, **placed},
        {},
        written,
        text=text,
    )
    return output


def add_sparse_accumulation(run: PlannedRun, step: AccumulateStep) -> list[PlannedOutput]:
    """Add the pass that joins sparse samples with the history of their layer."""
    layer, constants = run.layer, run.guides.constants
    calls, history = SparseCalls(run, constants.scale), run.images[HISTORY]
    own = constants.own_weight
    _, taps = calls.pick()
    pixels = {name.replace("tap", "own", 1): image for name, image in taps.items() if name != "tap_albedo"}
    given = {"samples": layer.radiance, "history": calls.pick_image(history), "own": own, **taps, **pixels}
    trust = calls.call(
        make_trust,
        (layer.features, layer.albedo is not None, False),
        {**given, "trust_radius": TRUST_RADIUS, **calls.place(1)},
        {"trust": f"{layer.name}_trust"},
        text="how far samples confirm the history",
    )["trust"]
    known = step.known_radius if step.known_radius is not None else step.radius
    numbers: dict[str, float] = {"radius": step.radius, "known_radius": min(known, step.radius)}
    numbers |= {
        "trust_radius": SPARSE_TRUST_RADIUS,
        "known_precision": find_known_precision(run.guides, known) if known < step.radius else 0.0,
    }
    given = {"history": history, "trust": trust, "growth": constants.get("strictness"), "own": own, **numbers}
    return [accumulate(calls, given, run.images["sums"])]


def find_known_precision(guides: PipelineGuides, known: int) -> float:
    """Return what pixels with a history subtract from logarithms of weights; see `KnownKernel.precision`.

    Their standard deviation on the screen follows their radius, unless the user sets that of all pixels.
    """
    constants = guides.constants
    if known == 0:
        return 0.0
    sigma = constants.screen_sigma
    narrow = sigma * float(known) / float(constants.radius)
    precision = (0.5 * LOG2_E) * (1.0 / (narrow * narrow) - 1.0 / (sigma * sigma))
    code = f"({constants.get('screen_sigma').code} > 0.0 ? 0.0 : {write_number(precision)})"
    return constants.derive("known_precision", Number(float(precision), code))


def join_sparse(
    guides: PipelineGuides, layers: list[Any], outputs: list[PlannedOutput]
) -> tuple[Image, Image, list[Image]]:
    """Return the sum of all light, its holes, and the light of each layer; see `lobewise.upsampling.join_sparse`."""
    masks = {f"mask{k}": layer.mask for k, layer in enumerate(layers)}
    (reflecting,) = guides.kernels.map_pixels(
        define_any, masks, {}, names=["reflecting"], text="pixels that reflect any light"
    )
    images: dict[str, Image | None] = {"exact": guides.emission, "reflecting": reflecting}
    for number, output in enumerate(outputs):
        images |= {**output.give_image(f"mean{number}"), f"weight{number}": output.weight_sum}
    for number, (layer, output) in enumerate(zip(layers, outputs, strict=True)):
        images |= {f"effective{number}": output.effective_samples}
        images |= {f"mask{number}": layer.mask, f"albedo{number}": layer.albedo}
    result = guides.graph.take("image", *SIZE, 3, text="the denoised frame", unit="any")
    count = len(layers)
    names = ["", "holes", "weight_sum", "effective_samples", *(f"{layer.name}_part" for layer in layers)]
    total, holes, _, _, *parts = guides.kernels.map_pixels(
        define_joined, images, {}, count, count, names=names, into=[result], text="the sum of all light, and its holes"
    )
    return total, holes, parts
