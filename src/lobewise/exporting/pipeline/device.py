"""The parts of a pipeline's driver that keep images on a graphics processor, and copy them where a step needs them."""

from __future__ import annotations

from collections.abc import Iterable
from string import Template

from lobewise.backend.devices import VULKAN_BLOCK, VULKAN_MULTIPLE
from lobewise.engine.graph import GraphImage, Operation
from lobewise.exporting.folder import fill_template, read_sections
from lobewise.exporting.pipeline.pipeline import Pipeline


def write_device(pipeline: Pipeline) -> dict[str, str]:
    """Return the parts of the driver's template that a device needs; they are empty for a processor."""
    name, blocks, texts = pipeline.name, pipeline.blocks, read_sections("pipeline/device.c")
    if pipeline.api is None:
        return dict.fromkeys(texts, "")
    results = [each for each in pipeline.graph.results.values() if each.name in blocks]
    mark = ";" if "windows" in pipeline.target else ":"
    words = mark.join(map(str, (0, VULKAN_BLOCK, 0, 0, VULKAN_MULTIPLE)))
    is_vulkan = pipeline.api == "vulkan"
    parts = {
        "name": name,
        "api": pipeline.api,
        "planes": sum(each.startswith("PLACES") for each in set(blocks.values())),
        "image_blocks": "\n".join(
            f"    {blocks.get(image.name, '-1')}, /* {image.name} */" for image in pipeline.images
        ),
        "configure": f'    is_there = has_vulkan();\n    halide_vulkan_set_alloc_config("{words}");' * is_vulkan,
        "copies": "\n".join(
            f"    status = status == {name}_ok && copy_down(p, {pipeline.get_place(each)}) ? {name}_failed : status;"
            for each in results
        ),
    }
    filled = {key: Template(text.rstrip()).substitute(parts) for key, text in texts.items()}
    return {**filled, "device": fill_template("pipeline/vulkan.c") * is_vulkan + filled["device"] + "\n"}


def write_copies(pipeline: Pipeline, operation: Operation) -> tuple[list[str], list[str]]:
    """Return the lines that copy images before and after a step; none for a processor."""
    if pipeline.api is None:
        return [], []
    if operation.on_device:
        reads, writes = _list_images(operation.reads), _list_images(operation.writes)
        return _check(f"begin_on_device(p, {reads}, {writes})"), _check(f"end_on_device(p, {writes})")
    places = set(pipeline.blocks.values())
    # What a step writes in part keeps the rest.
    partly = [image for image in operation.writes if operation.in_box or image.whole is not None]
    needed, made = (
        [image for image in images if pipeline.get_place(image) in places]
        for images in ((*operation.reads, *partly), operation.writes)
    )
    return (
        _check(f"begin_on_host(p, {_list_images(needed)})") if needed else [],
        [f"end_on_host(p, {_list_images(made)});"] if made else [],
    )


def write_swapping_blocks(pipeline: Pipeline, written: str, before: str) -> list[str]:
    """Return the lines that follow a swap of the memory of two places on the device."""
    has = [place in pipeline.blocks.values() for place in (written, before)]
    if all(has):
        return [
            "        {",
            f"            const struct block written = p->blocks[{written}];",
            f"            p->blocks[{written}] = p->blocks[{before}];",
            f"            p->blocks[{before}] = written;",
            "        }",
        ]
    lines = [f"        status = copy_down(p, {written}) ? {pipeline.name}_failed : status;"] if has[0] else []
    return lines + ([f"        mark_host(p, {before});"] if has[1] else [])


def _check(call: str) -> list[str]:
    return [f"code = {call};", "if (code) {", '    return fail(p, "copying an image", code);', "}"]


def _list_images(images: Iterable[GraphImage]) -> str:
    """Return a list of images in C that ends with -1."""
    names = dict.fromkeys(f"IMAGE_{image.name}" for image in images)
    return f"(const int[]){{{', '.join([*names, '-1'])}}}"
