"""The steps of a layer's plan as calls of kernels: for each kind of step what `lobewise.denoising.running` runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any

from lobewise.denoising.planning.steps import FilterStep, LayerPlan, Step
from lobewise.exporting.pipeline.program.graph import Image
from lobewise.exporting.pipeline.program.kernels import Kernels, give_feature_images, give_feature_numbers
from lobewise.exporting.pipeline.recipes.guides import PipelineGuides, PlannedLayer
from lobewise.features import Feature
from lobewise.filters.cross_filter import make_scheduled_pass
from lobewise.filters.cross_pass import PassKey, Reads, Writes, chain_passes, describe_structure
from lobewise.filters.forms import list_passes


@dataclass(frozen=True)
class PlannedOutput:
    """The result of a filter; see `lobewise.filters.cross_filter.FilterOutput`. An image may be a list of planes."""

    image: Image | Sequence[Image]
    weight_sum: Image
    effective_samples: Image
    moment: Image | None = None
    sums: Image | None = None
    variance: Image | None = None

    def give_image(self, name: str) -> dict[str, Image]:
        """Return the image by name, or its planes as `lobewise.backend.pointwise.give_channels` names them."""
        if isinstance(self.image, Image):
            return {name: self.image}
        return {f"{name}_channel{k}": plane for k, plane in enumerate(self.image)}


@dataclass
class PlannedRun:
    """A layer on its way through its plan; see `lobewise.denoising.running.LayerRun`."""

    guides: PipelineGuides
    layer: PlannedLayer
    images: dict[str, Any] = field(default_factory=dict)

    @property
    def kernels(self) -> Kernels:
        """The kernels of the pipeline."""
        return self.guides.kernels

    def run(self, plan: LayerPlan, emitters: Mapping[type[Step], Callable[[PlannedRun, Any], Sequence[Any]]]) -> Any:
        """Add every step to the pipeline; return the last image."""
        for step in plan.steps:
            with self.guides.graph.part(f"{self.layer.name}: {step.describe()}"):
                outputs = emitters[type(step)](self, step)
            self.images.update(zip(step.writes, outputs, strict=True))
        return self.images[plan.steps[-1].writes[0]]


@dataclass(frozen=True)
class FilterCall:
    """What `lobewise.filters.cross_filter.run_filter` is told."""

    source: Image
    mask: Image
    features: Sequence[Feature]
    form: str
    radius: int
    albedo: Image | None = None
    modulate: bool = True
    moment: bool = False
    strictness: Image | None = None
    name: str = "filtered"


def call_filter(kernels: Kernels, wanted: FilterCall) -> PlannedOutput:
    """Add the passes of the cross filter."""
    passes = list_passes(wanted.form, wanted.radius)
    whole = PassKey(
        *passes[0][:2],
        tuple(describe_structure(feature) for feature in wanted.features),
        reads=Reads.RADIANCE if wanted.albedo is None else Reads.DEMODULATED,
        writes=Writes.IMAGES,
        modulate=wanted.albedo is not None and wanted.modulate,
        moment=wanted.moment,
        strict=wanted.strictness is not None,
    )
    keys = chain_passes(whole, [taps for taps, _, _ in passes], mirror=True)
    beside = {"mask": wanted.mask, "albedo": wanted.albedo, "strictness": wanted.strictness}
    beside |= give_feature_images("tap", wanted.features) | give_feature_numbers(wanted.features)
    source, outputs = wanted.source, {}
    for number, (key, (taps, radius, step)) in enumerate(zip(keys, passes, strict=True)):
        kernel = kernels.get(key, partial(make_scheduled_pass, key, wanted.features))
        size = 2 * radius + 1 if radius else 5
        text = f"{taps.value} taps, {size} across" + (f", {step} pixels apart" if step > 1 else "")
        names = {each: f"{wanted.name}_{each}" for each in ("weight_sum", "effective_samples", "moment")}
        names |= {"image": wanted.name, "sums": f"{wanted.name}_sums{number}"}
        outputs = kernels.call(kernel, {"source": source, "step": step, **beside}, names=names, text=text)
        source = outputs.get("sums", source)
    return PlannedOutput(outputs["image"], outputs["weight_sum"], outputs["effective_samples"], outputs.get("moment"))


def add_filter(run: PlannedRun, step: FilterStep) -> list[PlannedOutput]:
    """Add one pass over a layer by its guides."""
    layer = run.layer
    wanted = FilterCall(
        layer.radiance, layer.mask, layer.features, step.form, step.radius, layer.albedo, name=f"{layer.name}_filtered"
    )
    return [call_filter(run.kernels, wanted)]
