"""The parts of a pipeline's driver that keep images on a graphics processor, and copy them where a step needs them."""

from __future__ import annotations

from collections.abc import Iterable

from lobewise.backend.devices import VULKAN_BLOCK, VULKAN_MULTIPLE
from lobewise.engine.graph import GraphImage, Operation
from lobewise.exporting.folder import fill_template
from lobewise.exporting.pipeline.pipeline import Pipeline


def write_device(pipeline: Pipeline) -> dict[str, str]:
    """Return the parts of the driver's template that a device needs; they are empty for a processor."""
    name, blocks = pipeline.name, pipeline.blocks
    if pipeline.api is None:
        return dict.fromkeys(("device", "blocks", "keep_size", "take_blocks", "free_blocks", "finish", "declare"), "")
    parts = sum(each.startswith("PLACES") for each in set(blocks.values()))
    configure = vulkan = ""
    if pipeline.api == "vulkan":
        mark = ";" if "windows" in pipeline.target else ":"
        words = mark.join(map(str, (0, VULKAN_BLOCK, 0, 0, VULKAN_MULTIPLE)))
        configure = f'    is_there = has_vulkan();\n    halide_vulkan_set_alloc_config("{words}");'
        vulkan = fill_template("pipeline/vulkan.c")
    device = fill_template(
        "pipeline/device.c",
        name=name,
        api=pipeline.api,
        image_blocks="\n".join(f"    {blocks.get(image.name, '-1')}, /* {image.name} */" for image in pipeline.images),
        configure=configure,
    )
    results = [each for each in pipeline.graph.results.values() if each.name in blocks]
    lines = [
        f"    status = status == {name}_ok && copy_down(p, {pipeline.get_place(each)}) ? {name}_failed : status;"
        for each in results
    ]
    return {
        "declare": "\n".join(
            [
                f"extern const struct halide_device_interface_t *halide_{pipeline.api}_device_interface(void);",
                f"enum {{ BLOCKS = PLACES + {parts} }};",
                "",
                "/* Memory on the device, as numbers of 32 bits. */",
                "struct block {",
                "    halide_buffer_t words;",
                "    halide_dimension_t dim;",
                "};",
            ]
        ),
        "device": vulkan + device,
        "blocks": "    size_t sizes[IMAGES];\n    struct block blocks[BLOCKS];",
        "keep_size": "        p->sizes[image] = bytes;",
        "take_blocks": "\n".join(
            [
                "    {",
                f"        const {name}_status status = take_blocks(p, most_bytes);",
                f"        if (status != {name}_ok) {{",
                f"            {name}_destroy(p);",
                "            return status;",
                "        }",
                "    }",
            ]
        ),
        "free_blocks": "    if (p) {\n        free_blocks(p);\n    }",
        "finish": "\n".join(lines),
    }


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
