"""The steps of a layer's plan as calls of kernels: for each kind of step what `lobewise.denoising.running` runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from typing import Any, cast

from lobewise.denoising.planning.steps import HISTORY, AccumulateStep, LayerPlan, Step
from lobewise.engine.graph import Image
from lobewise.engine.recorder import Recorder, give_feature_images, give_feature_numbers
from lobewise.exporting.pipeline.recipes.guides import PipelineGuides
from lobewise.filters.cross_filter import run_filter
from lobewise.filters.cross_pass import describe_structure
from lobewise.filters.history.accumulation import TRUST_RADIUS, make_scheduled_accumulation
from lobewise.filters.history.accumulation_pass import (
    ACCUMULATED,
    NARROWED,
    make_filtered_accumulation,
    make_narrowing,
    make_trust,
)
from lobewise.filters.history.sums import HISTORY_CHANNELS, Sums


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
    layer: Any
    images: dict[str, Any] = field(default_factory=dict)

    @property
    def kernels(self) -> Recorder:
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
class SampleCalls:
    """The kernels that join the samples of a layer with a history; see `lobewise.filters.history.accumulation`."""

    run: PlannedRun
    scale: int = 1

    @property
    def images(self) -> dict[str, Any]:
        """The images of the layer at all pixels and at the samples, by the names of kernels."""
        layer = self.run.layer
        whole = {"mask": layer.mask, "albedo": layer.albedo}
        given = {f"own_{name}": image for name, image in whole.items() if image is not None}
        given |= give_feature_images("own", layer.features)
        return {**given, **{name.replace("own", "tap", 1): image for name, image in given.items()}}

    def place(self, factor: int, row: str = "0", column: str = "0") -> dict[str, Any]:
        """Return the numbers that place samples among pixels, and those of the features."""
        where = {"factor": factor, "row": row, "column": column, "spacing": float(self.scale)}
        return {**where, **give_feature_numbers(self.run.layer.features)}

    def call(
        self,
        make: Callable[..., Any],
        options: tuple[Any, ...],
        given: Mapping[str, Any],
        names: Mapping[str, str],
        into: Mapping[str, Image] | None = None,
        *,
        text: str,
        strict: bool = False,
    ) -> dict[str, Image]:
        """Add a call of the pass ``make(*options)``."""
        told = (tuple(map(describe_structure, each)) if isinstance(each, tuple) else each for each in options)
        kernels = self.run.kernels
        kernel = kernels.get((make, *told), partial(make_scheduled_accumulation, make, options), strict=strict)
        return dict(kernels.call(kernel, given, names=names, into=into, text=text))


def split_accumulated(name: str, sums: Image, run: PlannedRun) -> tuple[dict[str, Image], PlannedOutput]:
    """Return the images that an accumulation writes, by parameter, and its result."""
    size = sums.shape[1:]
    rest = run.guides.graph.make(f"{name}_joined", len(ACCUMULATED) - HISTORY_CHANNELS, *size)
    planes = [*sums.list_planes(), *rest.list_planes()]
    written = dict(zip(ACCUMULATED, planes, strict=True))
    means = [written[f"mean_{color}"] for color in ("red", "green", "blue")]
    effective, variance = written["effective_samples"], written["variance"]
    return written, PlannedOutput(means, written["weight_sum"], effective, sums=sums, variance=variance)


def add_accumulation(run: PlannedRun, step: AccumulateStep) -> list[PlannedOutput]:
    """Add the filter of a whole frame and join it with the history of the layer."""
    layer, constants, calls = run.layer, run.guides.constants, SampleCalls(run)
    history, kept = run.images[HISTORY], run.images["sums"]
    own, growth, features, tinted = (
        constants.own_weight,
        constants.get("strictness"),
        layer.features,
        layer.albedo is not None,
    )
    given = {"samples": layer.radiance, "history": history, "own": own, "trust_radius": TRUST_RADIUS, **calls.images}
    trust = calls.call(
        make_trust,
        (features, tinted, False),
        given | calls.place(1),
        {"trust": f"{layer.name}_trust"},
        text="how far samples confirm the history",
    )["trust"]
    given = {"frames": history.take_plane(Sums._fields.index("frames")), "trust": trust, **calls.images}
    given |= {"trust_radius": TRUST_RADIUS, "growth": growth, **calls.place(1)}
    names = {name: f"{layer.name}_{name}" for name in NARROWED}
    narrowed = calls.call(make_narrowing, (features,), given, names, text="how much the kernel narrows")
    found: Any = run_filter(
        layer.radiance,
        layer.mask,
        features,
        form=step.form,
        radius=step.radius,
        albedo=layer.albedo,
        modulate=False,
        moment=True,
        strictness=cast(Any, narrowed["unit"]),
        name=f"{layer.name}_filtered",
    )
    given = {"samples": layer.radiance, "mean": found.image, "total": found.weight_sum, "history": history}
    given |= {"effective": found.effective_samples, "mean_square": found.moment, **narrowed, **calls.images}
    given |= {"own": own, "bonus": own - 1.0}
    written, output = split_accumulated(layer.name, kept, run)
    text = "add the frame to the history"
    calls.call(make_filtered_accumulation, (tinted,), given, {}, written, text=text, strict=True)
    return [output]
