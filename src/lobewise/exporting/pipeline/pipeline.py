"""The pipeline of an export: its recorded steps, its kernels, and where its images lie."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

from lobewise.engine.graph import Graph, GraphImage, Operation
from lobewise.engine.memory import MemoryPlan, plan_memory
from lobewise.engine.recorder import CompiledKernel
from lobewise.exporting.pipeline.constants import Constants, Setting, list_settings
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.exporting.targets import get_gpu_api


@dataclass(frozen=True)
class Pipeline:
    """Everything that the files of an exported pipeline are made from.

    Parameters
    ----------
    settings : PipelineSettings
    graph : Graph
    constants : Constants
    kernels : sequence of CompiledKernel
    lanes : int
        Pixels of a vector of the target.
    name : str
        Beginning of the names of files and functions.
    target : str
        Halide's full name of the target.
    """

    settings: PipelineSettings
    graph: Graph
    constants: Constants
    kernels: Sequence[CompiledKernel]
    lanes: int
    name: str
    target: str

    @cached_property
    def memory(self) -> MemoryPlan:
        """Where images lie."""
        return plan_memory(self.graph, 1.0 / self.settings.upsample**2)

    @cached_property
    def images(self) -> list[GraphImage]:
        """Every image, in the order of the table in C."""
        return self.graph.list_images()

    @cached_property
    def stages(self) -> list[tuple[str, list[Operation]]]:
        """Steps by the part of the plan that they belong to."""
        return [
            (name, list(operations))
            for name, operations in groupby(self.graph.operations, key=lambda operation: operation.stage)
        ]

    @property
    def least_width(self) -> int:
        """Smallest width of images, pixels: more than a vector of the target."""
        return (self.lanes + 1) * self.settings.upsample

    @property
    def title(self) -> str:
        """The pipeline in half a line."""
        settings = self.settings
        lobes = f" of {settings.lobes}" if settings.record.is_mixture else ""
        if settings.is_filter:
            reach = "" if settings.form == "atrous" else f", radius {settings.radius}"
            return f"lobewise filter, {settings.similarity}{lobes}, {settings.form}{reach}"
        words = [f"lobewise pipeline, plan {settings.plan}", f"{settings.similarity}{lobes}"]
        words += ["history"] if settings.history else []
        words += [f"one pixel of {settings.upsample}x{settings.upsample} shaded"] * (settings.upsample > 1)
        return ", ".join(words)

    @property
    def user_settings(self) -> Sequence[Setting]:
        """The numbers that a user sets."""
        return list_settings(history=self.settings.history)

    @cached_property
    def blocks(self) -> dict[str, str]:
        """Names in C of memory on the device, by the images that kernels of the device name.

        An image has the block of its place. A plane of a stack has a block of its own.
        """
        used = [
            image
            for operation in self.graph.operations
            if operation.on_device
            for image in (*operation.reads, *operation.writes)
        ]
        parts = dict.fromkeys(image.name for image in used if image.whole is not None)
        own = {name: f"PLACES + {number}" for number, name in enumerate(parts)}
        return {image.name: own.get(image.name, self.get_place(image)) for image in used}

    @property
    def api(self) -> str | None:
        """The graphics API of the target; None for a processor."""
        return get_gpu_api(self.target)

    def get_place(self, image: GraphImage) -> str:
        """Return the name in C of the memory of an image."""
        memory = image.memory
        if memory.source == "made":
            return f"PLACE_{self.memory.slots[memory.name]}"
        return f"{memory.source.upper()}_{memory.name}"
