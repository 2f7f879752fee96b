"""The steps of a layer's plan as calls of kernels: for each kind of step what `lobewise.denoising.running` runs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from lobewise.denoising.planning.steps import LayerPlan, Step
from lobewise.engine.recorder import Recorder
from lobewise.exporting.pipeline.recipes.guides import PipelineGuides


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
