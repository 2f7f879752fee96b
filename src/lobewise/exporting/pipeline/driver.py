"""Write the C program of a pipeline: memory, numbers, steps in order, and copies on a graphics processor."""

from __future__ import annotations

from collections.abc import Iterable
from string import Template

import numpy as np
from numpy.typing import NDArray

import lobewise
from lobewise.backend.devices import VULKAN_BLOCK, VULKAN_MULTIPLE
from lobewise.denoising import light_loss
from lobewise.denoising.refining import whole_image
from lobewise.engine.graph import Graph, GraphImage, Length, Operation, group_bands
from lobewise.engine.numbers import write_number
from lobewise.engine.recorder import CompiledKernel
from lobewise.exporting.folder import fill_template, read_sections, read_template
from lobewise.exporting.pipeline.pipeline import Pipeline
from lobewise.filters.noise.detail import FEATURE_ROWS

_AXES = {"height": "HEIGHT", "width": "WIDTH", "rows": "ROWS", "columns": "COLUMNS", "band": "BAND"}
_TYPES = {"float32": "float", "int32": "int32_t", "float64": "double"}


def write_header(pipeline: Pipeline) -> str:
    """Return the header in C."""
    graph, history = pipeline.graph, pipeline.settings.history
    return fill_template(
        "pipeline/header.h",
        name=pipeline.name,
        guard=f"{pipeline.name.upper()}_H",
        title=pipeline.title,
        target=pipeline.target,
        version=lobewise.__version__,
        least=pipeline.least_width,
        settings="\n".join(f"    double {each.name}; /* {each.text} */" for each in pipeline.user_settings),
        inputs="\n".join([_declare_image(each, "const float") for each in graph.inputs.values()])
        + _declare_place(pipeline),
        results="\n".join(_declare_image(each, "float") for each in graph.results.values()),
        history_word=", and the history from frame to frame" if history else "",
        reset_word="" if history else " (a pipeline without history has nothing to forget)",
        stage_count=len(pipeline.stages),
    )


def _declare_image(image: GraphImage, kind: str) -> str:
    unit = f" ({image.unit})" if image.unit else ""
    return f"    {kind} *{image.name}; /* {write_shape(image)}: {image.text}{unit} */"


def write_shape(image: GraphImage) -> str:
    """Return the shape of an image in words."""
    return " x ".join(map(str, image.shape))


def _declare_place(pipeline: Pipeline) -> str:
    scale = pipeline.settings.upsample
    return f"\n{fill_template('pipeline/place.h', scale=scale, last=scale - 1).rstrip()}" if scale > 1 else ""


def write_driver(pipeline: Pipeline) -> str:
    """Return the program in C."""
    graph, name = pipeline.graph, pipeline.name
    return fill_template(
        "pipeline/driver.c",
        name=name,
        title=pipeline.title,
        version=lobewise.__version__,
        least=pipeline.least_width,
        band_rows=FEATURE_ROWS,
        scale=pipeline.settings.upsample,
        places=_list_places(pipeline),
        images="\n".join(f"    IMAGE_{image.name}," for image in pipeline.images),
        infos="\n".join(_describe_image(pipeline, image) for image in pipeline.images),
        numbers="\n".join(f"        double {key};" for key in pipeline.constants.derived),
        reals="\n".join(f"    double {real};" for real in graph.reals),
        lengths="".join(f", {_name_axis(each)} = {-6 - number}" for number, each in enumerate(_list_lengths(pipeline))),
        cases="\n".join(f"    case {_name_axis(each)}: return {each.code};" for each in _list_lengths(pipeline)),
        held="\n".join(_write_held(*each) for each in graph.held.items()),
        prototypes="\n".join(map(_declare_kernel, pipeline.kernels)),
        routines=_list_routines(graph, name),
        flats="\n".join(
            f"    fill_floats(p, FLAT_{image.name}, {image.flat!r}f);"
            for image in graph.flats.values()
            if image.flat != 0.0
        ),
        **write_device(pipeline),
        crop=fill_template("pipeline/crop.c", name=name) if any(each.in_box for each in graph.operations) else "",
        fill_floats=fill_template("pipeline/fill_floats.c", name=name)
        if any(image.flat for image in graph.flats.values())
        else "",
        defaults="\n".join(
            f"    p->settings.{each.name} = {write_number(each.default)};" for each in pipeline.user_settings
        ),
        most=", ".join(write_number(each.most) for each in pipeline.user_settings),
        zero=", ".join(str(int(each.may_be_zero)) for each in pipeline.user_settings),
        setting_names=", ".join(f'"{each.name}"' for each in pipeline.user_settings),
        derived="\n".join(
            f"    p->numbers.{key} = {write_number(value)};" for key, value in pipeline.constants.derived.items()
        ),
        stages="\n\n".join(_write_stage(pipeline, *each) for each in enumerate(pipeline.stages)),
        stage_table="\n".join(f"        run_stage_{number}," for number in range(len(pipeline.stages))),
        stage_names="\n".join(f'    "{stage}",' for stage, _ in pipeline.stages),
        checks=_write_checks(pipeline),
        given=_write_given(pipeline),
        forgetting=_write_forgetting(pipeline),
        swapping=_write_swapping(pipeline),
        swap_places=read_template("pipeline/swap.c") if graph.state_pairs else "",
    )


def _name_axis(axis: int | str) -> str:
    """Return an axis as C knows it: a number, or the name of a length."""
    return f"LENGTH_{axis}" if isinstance(axis, Length) else _AXES.get(str(axis), str(axis))


def _list_lengths(pipeline: Pipeline) -> list[Length]:
    """Return the lengths of axes that follow from others."""
    return list(dict.fromkeys(axis for image in pipeline.images for axis in image.shape if isinstance(axis, Length)))


def _list_places(pipeline: Pipeline) -> str:
    frame_images = [*pipeline.graph.inputs, *pipeline.graph.results]
    state_images = [image.name for pair in pipeline.graph.state_pairs for image in pair]
    lines = [f"    PLACE_{number}," for number in range(pipeline.memory.count)]
    lines += [f"    KEPT_{each}," for each in state_images]
    lines += [f"    FLAT_{each}," for each in pipeline.graph.flats]
    outside = [f"HELD_{each}" for each in pipeline.graph.held] + [f"GIVEN_{each}" for each in frame_images]
    lines += [f"    {outside[0]}, FIRST_OUTSIDE = {outside[0]},", *(f"    {each}," for each in outside[1:])]
    return "\n".join(lines)


def _write_held(name: str, values: NDArray[np.float32]) -> str:
    """Return an array of C; nine digits tell a float32 from all others."""
    numbers = [f"{float(value):.9g}" for value in values.ravel()]
    words = [f"{word}f" if "." in word or "e" in word else f"{word}.0f" for word in numbers]
    lines = [", ".join(words[start : start + 12]) for start in range(0, len(words), 12)]
    return f"static const float HELD_VALUES_{name}[] = {{\n    " + ",\n    ".join(lines) + "\n};"


def _describe_image(pipeline: Pipeline, image: GraphImage) -> str:
    shape = ", ".join(map(_name_axis, image.shape))
    numbers = (
        pipeline.get_place(image),
        int(image.type == "uint8"),
        image.ndim,
        f"{{{shape}}}",
        image.plane,
        -1 if pipeline.api else image.still,
    )
    return f"    {{{', '.join(map(str, numbers))}}}, /* {image.name} */"


def _declare_kernel(kernel: CompiledKernel) -> str:
    words = [
        f"{_TYPES[parameter.type]} {parameter.name}"
        if parameter.role == "number"
        else f"struct halide_buffer_t *{parameter.name}"
        for parameter in kernel.parameters
    ]
    return f"int {kernel.symbol}({', '.join(words)});"


BAND_LOOP = (
    "    /* Rows in bands, so that the images of a band take little memory. */",
    "    p->box.left = 0;",
    "    p->box.width = p->width;",
    "    for (p->box.top = 0; p->box.top < p->height; p->box.top += BAND_ROWS) {",
    "        const int left = p->height - p->box.top;",
    "        p->box.height = left < BAND_ROWS ? left : BAND_ROWS;",
)


def _list_routines(graph: Graph, name: str) -> str:
    """Return the C functions that steps call, and those that these call."""
    texts = read_sections("pipeline/routines.c")
    called = {operation.function for operation in graph.operations if not operation.is_kernel}
    unknown = called - set(texts)
    assert not unknown, f"no C functions {unknown}"
    while more := {other for each in called for other in texts if f"{other}(" in texts[each]} - called:
        called |= more
    text = "\n".join(text.rstrip() + "\n" for key, text in texts.items() if key in called)
    return Template(text).substitute({**vars(light_loss), **vars(whole_image), "name": name})


def _write_stage(pipeline: Pipeline, number: int, stage: tuple[str, list[Operation]]) -> str:
    name, (title, operations) = pipeline.name, stage
    lines = [
        f"/* {title} */",
        f"static {name}_status run_stage_{number}({name}_pipeline *p)",
        "{",
        "    halide_buffer_t *const i = p->images;",
        "    int code = 0;",
    ]
    for group in group_bands(operations):
        written = [line for operation in group for line in _write_operation(pipeline, operation)]
        lines += [*BAND_LOOP, *(f"    {line}" for line in written), "    }"] if group[0].in_band else written
    return "\n".join([*lines, "    (void)i;", f"    return code ? {name}_failed : {name}_ok;", "}"])


def _write_operation(pipeline: Pipeline, operation: Operation) -> list[str]:
    cropped: list[str] = []
    arguments: list[str] = []
    for _, value in operation.arguments:
        if isinstance(value, GraphImage) and operation.in_box:
            number = len(cropped)
            cropped.append(f"parts[{number}] = crop(p, IMAGE_{value.name}, dims[{number}]);")
            arguments.append(f"&parts[{number}]")
        else:
            arguments.append(f"&i[IMAGE_{value.name}]" if isinstance(value, GraphImage) else value)
    lines = []
    if cropped:
        lines = [f"halide_dimension_t dims[{len(cropped)}][4];", f"halide_buffer_t parts[{len(cropped)}];", *cropped]
    opened = min(len(lines), 2)
    if operation.is_kernel:
        lines.append(f"code = {operation.function}({', '.join(arguments)});")
        lines += ["if (code) {", f'    return fail(p, "{operation.function}", code);', "}"]
    else:
        lines.append(f"{operation.function}({', '.join(['p', *arguments])});")
    before, after = write_copies(pipeline, operation)
    lines = [*lines[:opened], *before, *lines[opened:], *after]
    note = f"    /* {operation.text} */"
    if operation.when or cropped:
        opening = f"    if ({operation.when}) {{" if operation.when else "    {"
        return [note, opening, *(f"        {line}" for line in lines), "    }"]
    return [note, *(f"    {line}" for line in lines)]


def _write_checks(pipeline: Pipeline) -> str:
    name = pipeline.name
    conditional = {
        image.name
        for operation in pipeline.graph.operations
        if "p->frame->" in operation.when
        for image in operation.writes
    }
    lines = []
    for image in (*pipeline.graph.inputs.values(), *pipeline.graph.results.values()):
        if image.name not in conditional:
            lines += [
                f"    if (!frame->{image.name}) {{",
                f'        return refuse(p, {name}_no_image, "the image {image.name} of the frame is NULL");',
                "    }",
            ]
    if pipeline.settings.upsample > 1:
        lines += [
            "    if (frame->row < 0 || frame->column < 0 || frame->row >= SCALE || frame->column >= SCALE ||",
            "        frame->row >= p->height || frame->column >= p->width) {",
            f"        return refuse(p, {name}_bad_place, {name}_explain({name}_bad_place));",
            "    }",
        ]
    return "\n".join(lines)


def _write_given(pipeline: Pipeline) -> str:
    lines = []
    if pipeline.settings.upsample > 1:
        lines += [
            "    p->rows = (p->height - frame->row + SCALE - 1) / SCALE;",
            "    p->columns = (p->width - frame->column + SCALE - 1) / SCALE;",
        ]
    for name in pipeline.graph.inputs:
        # Kernels do not write to it; Halide's buffers have no other kind of pointer.
        lines.append(f"    memcpy(&p->memory[GIVEN_{name}], &frame->{name}, sizeof(void *));")
    lines += [f"    p->memory[GIVEN_{name}] = frame->{name};" for name in pipeline.graph.results]
    places = set(pipeline.blocks.values())
    lines += [f"    mark_host(p, GIVEN_{name});" for name in pipeline.graph.inputs if f"GIVEN_{name}" in places]
    for name in pipeline.graph.held:
        lines += [
            "    {",
            f"        const float *values = HELD_VALUES_{name};",
            f"        memcpy(&p->memory[HELD_{name}], &values, sizeof(void *));",
            "    }",
        ]
    return "\n".join(lines)


def _write_forgetting(pipeline: Pipeline) -> str:
    """Return the lines that make the state of the frame before 0."""
    lines = []
    for _, before in pipeline.graph.state_pairs:
        bytes_each = "1" if before.type == "uint8" else "4"
        sizes = " * ".join(f"(size_t)find_length(p, {_AXES.get(str(axis), str(axis))})" for axis in before.shape)
        lines.append(f"        memset(p->memory[KEPT_{before.name}], 0, {bytes_each} * {sizes});")
        if f"KEPT_{before.name}" in pipeline.blocks.values():
            lines.append(f"        mark_host(p, KEPT_{before.name});")
    return "\n".join(lines)


def _write_swapping(pipeline: Pipeline) -> str:
    """Return the lines that make the state of this frame the state of the frame before."""
    lines = []
    for written, before in pipeline.graph.state_pairs:
        lines += [f"        swap_places(p->memory, KEPT_{written.name}, KEPT_{before.name});"]
        lines += write_swapping_blocks(pipeline, f"KEPT_{written.name}", f"KEPT_{before.name}")
    return "\n".join(lines)


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
