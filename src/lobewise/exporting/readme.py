"""The README of an export: how to build and call it, and the meaning of every argument."""

from __future__ import annotations

from collections.abc import Sequence

import lobewise
from lobewise.backend.devices import VULKAN_BLOCK, VULKAN_MULTIPLE
from lobewise.exporting.arguments import Argument
from lobewise.exporting.contents import Contents
from lobewise.exporting.example import choose_bound
from lobewise.exporting.folder import fill_template
from lobewise.exporting.sample import Sample
from lobewise.exporting.targets import get_gpu_api

DOCS = "https://github.com/lobewise/lobewise/blob/main/docs/export.md"

_FORMS = {
    "full": "all (2r + 1)^2 pixels j within the radius {radius}",
    "separable": "a row and then a column of 2r + 1 pixels j, radius {radius}, inside one call",
    "atrous": "five 5x5 passes whose steps double, inside one call; they reach 62 pixels",
}

_ALLOCATION = ":".join(("0", str(VULKAN_BLOCK), "0", "0", str(VULKAN_MULTIPLE)))


def describe_build(contents: Contents) -> str:
    """Return the command that builds and runs the example, or a comment where there is no such command."""
    words = contents.target.split("-")
    # The library comes last: it has the runtime that the object file needs.
    library = " ".join(reversed(contents.binaries))
    if "webgpu" in words and "wasm" in words:
        files = " ".join(f"--preload-file {name}.raw" for name in ("frame", "expected"))
        return f"emcc example.c {library} -o example.html -sUSE_WEBGPU -sASYNCIFY {files}"
    if "wasm" in words:
        return f"zig cc -target wasm32-wasi example.c {library} -o example.wasm && wasmtime --dir=. example.wasm"
    if "windows" in words:
        return f"cl example.c {library} && example"
    if "ios" in words or "android" in words:
        return f"# {library} and {contents.name}.h belong into an app; example.c shows the calls"
    frameworks = " -framework Metal -framework Foundation" if "metal" in words else ""
    libraries = frameworks if "osx" in words else " -lpthread -ldl -lm"
    setting = f"HL_VK_ALLOC_CONFIG={_ALLOCATION} " if "vulkan" in words else ""
    return f"cc example.c {library} -o example{libraries} && {setting}./example"


def _make_table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join("| " + " | ".join(cells) + " |" for cells in lines)


def _list_images(arguments: Sequence[Argument]) -> str:
    rows = []
    for argument in arguments:
        if argument.role != "number":
            cells = [f"`{argument.name}`", argument.role, argument.type, argument.extents, argument.unit]
            rows.append([*cells, argument.text])
    return _make_table(["image", "role", "type", "extents", "unit", "meaning"], rows)


def _list_numbers(arguments: Sequence[Argument], sample: Sample) -> str:
    rows = []
    for argument in arguments:
        if argument.role == "number":
            value = f"{sample.numbers[argument.name]:.6g}"
            rows.append([f"`{argument.name}`", argument.unit, argument.text, argument.recipe, value])
    return _make_table(["number", "unit", "meaning", "value in Python", "in the example"], rows)


def make_readme(contents: Contents) -> str:
    """Return the README in Markdown."""
    plan, name, sample = contents.plan, contents.name, contents.sample
    height, width = sample.size
    tables = []
    for function in contents.functions:
        arguments = function.arguments
        call = f"`int {function.name}({', '.join(argument.name for argument in arguments)})`"
        parts = [f"## `{function.name}`", function.title, call]
        tables.append("\n\n".join([*parts, _list_images(arguments), _list_numbers(arguments, sample)]) + "\n")
    library, *objects = contents.binaries
    rows = [
        [f"`{name}.h`", "the functions, with helpers that describe images"],
        [f"`{library}`", f"`{name}_filter` and Halide's runtime"],
        *([f"`{binary}`", f"`{name}_lobes`"] for binary in objects),
        ["`HalideRuntime*.h`", "`halide_buffer_t` and the runtime (threads, errors, devices)"],
        ["`example.c`", "a program that filters the frame and compares with Python"],
        ["`frame.raw`, `expected.raw`", f"the frame, {width} x {height}, and Python's result"],
        ["`lobewise-export.json`", "the contents of this file, for programs"],
    ]
    api = get_gpu_api(contents.target)
    device = fill_template("device.md", api=api) if api else ""
    if api == "vulkan":
        device += fill_template("vulkan.md", allocation=_ALLOCATION, block=VULKAN_BLOCK, multiple=VULKAN_MULTIPLE)
    return fill_template(
        "readme.md",
        title=contents.title,
        target=contents.target,
        version=lobewise.__version__,
        docs=DOCS,
        files=_make_table(["file", "what it is"], rows),
        build=describe_build(contents),
        bound=f"{choose_bound(plan, contents.target):g}",
        reach=_FORMS[plan.form].format(radius=plan.radius),
        tables="\n".join(tables),
        name=name,
        least=fill_template("least_width.md", name=name) if plan.makes_lobes else "",
        device=device,
        held=", ".join(f"`{argument.name}`" for argument in contents.frame),
    )
