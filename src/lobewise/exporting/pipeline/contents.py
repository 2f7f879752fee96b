"""What a pipeline contains, for programs (JSON), for its README, and for the option ``--list``."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import lobewise
from lobewise.backend.devices import VULKAN_BLOCK, VULKAN_MULTIPLE
from lobewise.engine.graph import GraphImage
from lobewise.exporting.folder import DOCS, fill_template
from lobewise.exporting.pipeline.driver import write_shape
from lobewise.exporting.pipeline.pipeline import Pipeline
from lobewise.exporting.pipeline.sample import FRAMES
from lobewise.exporting.pipeline.scene import HEIGHT, SPP, WIDTH
from lobewise.exporting.targets import GPU_APIS

UNGUIDED = """
Where guides are noise (out of focus, in fog, hair and grass), Python filters the color alone as well and mixes the
result in. This pipeline does not: give it guides in focus.
"""
"""What the README of the plan high says."""
REACHES = {
    "full": "all pixels j within the radius, in a square",
    "separable": "a row and then a column of pixels j within the radius",
    "atrous": "five 5x5 passes whose steps double; they reach 62 pixels",
}
"""The neighbours of each form."""
HELD = "lobewise pipeline"
"""Value of the key "kind" in the JSON of a pipeline."""


def describe_contents(pipeline: Pipeline) -> dict[str, Any]:
    """Return what a pipeline contains, for JSON."""
    graph, memory = pipeline.graph, pipeline.memory
    return {
        "lobewise": lobewise.__version__,
        "kind": HELD,
        "target": pipeline.target,
        "settings": {name: getattr(pipeline.settings, name) for name in vars(pipeline.settings)},
        "inputs": [_describe_image(each) for each in graph.inputs.values()],
        "results": [_describe_image(each) for each in graph.results.values()],
        "state": [_describe_image(written) for written, _ in graph.state_pairs],
        "numbers": [
            {"name": setting.name, "default": setting.default, "meaning": setting.text}
            for setting in pipeline.user_settings
        ],
        "bytes_per_pixel": {"between steps": memory.made_bytes, "state": memory.kept_bytes},
        "kernels": {kernel.symbol: kernel.name for kernel in pipeline.kernels},
        "stages": [
            {
                "name": stage,
                "steps": [
                    {
                        "what": operation.text,
                        "function": operation.function,
                        "reads": [image.name for image in operation.reads],
                        "writes": [image.name for image in operation.writes],
                        **({"only if": operation.when} if operation.when else {}),
                    }
                    for operation in operations
                ],
            }
            for stage, operations in pipeline.stages
        ],
    }


def _describe_image(image: GraphImage) -> dict[str, Any]:
    shape = [axis if isinstance(axis, int) else str(axis) for axis in image.shape]
    return {"name": image.name, "type": image.type, "shape": shape, "unit": image.unit, "meaning": image.text}


def list_contents(pipeline: Pipeline) -> Iterator[str]:
    """Yield the lines that the option ``--list`` prints."""
    graph, memory = pipeline.graph, pipeline.memory
    yield f"{pipeline.title}, for {pipeline.target}"
    for title, images in (("Inputs", graph.inputs), ("Results", graph.results)):
        yield f"{title}:"
        for image in images.values():
            yield f"  {image.name}: {write_shape(image)}, {image.text}"
    yield f"Memory: {memory.made_bytes:g} bytes for each pixel between steps, {memory.kept_bytes:g} of state."
    if graph.state_pairs:
        yield f"State: {', '.join(written.name for written, _ in graph.state_pairs)}."
    yield f"Kernels: {len(pipeline.kernels)}."
    for number, (stage, operations) in enumerate(pipeline.stages, 1):
        yield f"{number}. {stage}"
        for operation in operations:
            ways = (
                f"{_name(operation.reads)} -> {_name(operation.writes)}" if operation.writes else _name(operation.reads)
            )
            yield f"   {operation.text}: {ways}" + (" (only if needed)" if operation.when else "")


def _name(images: tuple[GraphImage, ...]) -> str:
    return ", ".join(dict.fromkeys(image.memory.name for image in images))


def write_readme(pipeline: Pipeline, build: str) -> str:
    """Return the README of a pipeline in Markdown."""
    graph, memory, name = pipeline.graph, pipeline.memory, pipeline.name
    images = [
        f"| `{image.name}` | {role} | {write_shape(image)} | {image.unit} | {image.text} |"
        for role, group in (("input", graph.inputs), ("result", graph.results))
        for image in group.values()
    ]
    numbers = [f"| `{each.name}` | {each.default:g} | {each.text} |" for each in pipeline.user_settings]
    held = ", ".join(f"`{each}`" for each in graph.inputs)
    return fill_template(
        "pipeline/readme.md",
        name=name,
        title=pipeline.title,
        target=pipeline.target,
        version=lobewise.__version__,
        build=build,
        images="\n".join(images),
        numbers="\n".join(numbers),
        made=f"{memory.made_bytes:g}",
        kept=f"{memory.kept_bytes:g}",
        kernels=len(pipeline.kernels),
        least=pipeline.least_width,
        frames=FRAMES,
        width=WIDTH,
        height=HEIGHT,
        spp=SPP,
        held=held,
        steps="\n".join(list_contents(pipeline)),
        history=fill_template("pipeline/history.md", name=name) if graph.state_pairs else "",
        device=describe_device(pipeline),
        limits=describe_limits(pipeline),
        docs=DOCS,
    )


def describe_limits(pipeline: Pipeline) -> str:
    """Return what a single filter computes, or what a plan leaves out."""
    if pipeline.settings.is_filter:
        return fill_template("pipeline/filter.md", reach=REACHES[pipeline.settings.form])
    return UNGUIDED if pipeline.settings.plan == "high" else ""


def describe_device(pipeline: Pipeline) -> str:
    """Return what the README of a pipeline says of the device of its target; nothing for a processor."""
    if pipeline.api is None:
        return ""
    text = fill_template("pipeline/device.md", name=pipeline.name, api=GPU_APIS[pipeline.api])
    if pipeline.api == "vulkan":
        text += fill_template("pipeline/vulkan.md", block=VULKAN_BLOCK, multiple=VULKAN_MULTIPLE)
    return text
