"""The README of an export: how to build and call it, what every argument is."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.backend.devices import VULKAN_BLOCK, VULKAN_MULTIPLE
from lobewise.backend.targets import get_gpu_api
from lobewise.exporting.ahead_of_time import Argument, FilterPlan
from lobewise.exporting.arguments import describe_shape, get_meaning
from lobewise.exporting.example import list_frame_images
from lobewise.exporting.sample import Sample

DOCS = "https://github.com/lobewise/lobewise/blob/main/docs/export.md"

_FORMS = {
    "full": "all (2r + 1)^2 pixels j within the radius {radius}",
    "separable": "a row and then a column of 2r + 1 pixels j, radius {radius}, inside one call",
    "atrous": "five 5x5 passes whose steps double, inside one call; they reach 62 pixels",
}

_TEXT = """\
# {title}

Compiled for `{target}` by lobewise {version}. [How such a folder is made]({docs}).

{files}

## Build and run

```
{build}
```

The example prints the largest relative difference to Python's result and ends with 0 if that is at most {bound:g}. A
second export in the same program needs another `--name`; the runtime may be there twice.

## What it computes

`out_i = sum_j w(i, j) radiance_j / sum_j w(i, j)` over {reach}.
The weight is the product of Gaussians of the distances on the screen and in the scene, and of the overlap of what the
two pixels reflect to the power `beta` (Tokuyoshi 2015, "Specular Lobe-Aware Filtering and Upsampling for Interactive
Indirect Illumination").

{tables}
## Images

All images of a call have the same width and height, row 0 on top, the channels of a pixel together: extents (channels,
width, height) with strides (1, channels, channels * width), or (width, height) with strides (1, width). Rows may be
padded (a larger last stride). `radiance` may have a fourth channel, which nobody reads: extents (4, width, height).
`{name}_floats` and `{name}_bytes` fill in such a `halide_buffer_t`.
Outputs need memory and must not overlap inputs.{least}

A buffer of a wrong size, type or layout, and a constant that is not above 0, make a function return a code other than 0
before anything is written. First Halide calls an error handler, whose default prints and **aborts**: install your own
with `halide_set_error_handler`, as `example.c` does. In its messages `out0`, `out1`, ... are the outputs, in order.
A buffer without memory, on host and device, makes the call a question for sizes: it returns 0 and computes nothing.

Rows are shared out to as many threads as there are processors, or `HL_NUM_THREADS`, or `halide_set_num_threads`;
`halide_set_custom_do_par_for` hands them to a scheduler of your own. The functions keep no state and may be called from
several threads at once.
{device}
## frame.raw and expected.raw

Little-endian arrays without headers, one after the other: {held}; and `output`.
They are part of a frame that comes with lobewise, at 4 samples per pixel.

## Licences

What is not Halide's in this folder may be used under the BSD 3-clause licence of lobewise. The runtime in the library
and `HalideRuntime*.h` are [Halide](https://github.com/halide/Halide)'s, under the MIT licence.
"""

_LEAST_WIDTH = """
Those of `{name}_lobes` need at least as many columns as the processor has lanes, at most 16."""

_DEVICE = """
## On the device

The filter runs by way of {api}, the lobes are made by the processor. An input whose flag
`halide_buffer_flag_host_dirty` is set is copied to the device by the call, which clears the flag: later calls find it
there, until the flag is set again. What the filter writes stays on the device until `halide_copy_to_host`. Buffers that
are there already are wrapped by the functions of the second `HalideRuntime` header (`halide_..._wrap_...`; some of
these headers are C++). `halide_device_free` frees what a call put there.
"""

_ALLOCATION = ":".join(("0", str(VULKAN_BLOCK), "0", "0", str(VULKAN_MULTIPLE)))

_VULKAN = f"""
Halide 21 hands out overlapping Vulkan memory (its issues 8868, 9223 and 9224). Set
`HL_VK_ALLOC_CONFIG={_ALLOCATION}` in the environment before the first call (`;` instead of `:` on Windows); then
images below {VULKAN_BLOCK} MiB are safe, and larger ones whose bytes are a multiple of {VULKAN_MULTIPLE}.
"""


def describe_plan(plan: FilterPlan) -> str:
    """Return what a filter is, in half a line."""
    lobes = f" of {plan.lobes}" if plan.similarity == "sg_mixture" else ""
    reach = "" if plan.form == "atrous" else f", radius {plan.radius}"
    return f"lobewise filter, {plan.similarity}{lobes}, {plan.form}{reach}"


def describe_build(name: str, binaries: Sequence[str], target: str) -> str:
    """Return the command that builds and runs the example, or what to do where there is none."""
    words = target.split("-")
    # The library comes last: it has the runtime that the object file asks for.
    library = " ".join(reversed(binaries))
    if "webgpu" in words and "wasm" in words:
        files = " ".join(f"--preload-file {name}.raw" for name in ("frame", "expected"))
        return f"emcc example.c {library} -o example.html -sUSE_WEBGPU -sASYNCIFY {files}"
    if "wasm" in words:
        return f"zig cc -target wasm32-wasi example.c {library} -o example.wasm && wasmtime --dir=. example.wasm"
    if "windows" in words:
        return f"cl example.c {library} && example"
    if "ios" in words or "android" in words:
        return f"# {library} and {name}.h belong into an app; example.c shows the calls"
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
            meaning = get_meaning(argument)
            cells = [f"`{argument.name}`", argument.role, argument.type, describe_shape(argument), meaning.unit]
            rows.append([*cells, meaning.text])
    return _make_table(["image", "role", "type", "extents", "unit", "meaning"], rows)


def _list_numbers(arguments: Sequence[Argument], sample: Sample) -> str:
    rows = []
    for argument in arguments:
        if argument.role == "number":
            meaning = get_meaning(argument)
            value = f"{sample.numbers[argument.name]:.6g}"
            rows.append([f"`{argument.name}`", meaning.unit, meaning.text, meaning.recipe, value])
    return _make_table(["constant", "unit", "meaning", "what Python takes", "in the example"], rows)


def make_readme(
    plan: FilterPlan,
    name: str,
    binaries: Sequence[str],
    target: str,
    version: str,
    sample: Sample,
    functions: Sequence[tuple[str, str, Sequence[Argument]]],
    bound: float,
) -> str:
    """Return the text, in Markdown."""
    height, width = sample.size
    tables = []
    for function, title, arguments in functions:
        call = f"`int {function}({', '.join(argument.name for argument in arguments)})`"
        parts = [f"## `{function}`", title, call, _list_images(arguments), _list_numbers(arguments, sample)]
        tables.append("\n\n".join(parts) + "\n")
    of_both = [arguments for _, _, arguments in functions]
    held = list_frame_images(of_both[0], of_both[1] if len(of_both) > 1 else [])
    rows = [
        [f"`{name}.h`", "the functions, with helpers that describe images"],
        [f"`{binaries[0]}`", f"`{name}_filter` and Halide's runtime"],
        *([f"`{binary}`", f"`{name}_lobes`"] for binary in binaries[1:]),
        ["`HalideRuntime*.h`", "`halide_buffer_t` and the runtime (threads, errors, devices)"],
        ["`example.c`", "a program that filters the frame and compares with Python"],
        ["`frame.raw`, `expected.raw`", f"that frame, {width} x {height}, and what Python makes of it"],
        ["`lobewise-export.json`", "the same as this file, for programs"],
    ]
    api = get_gpu_api(target)
    return _TEXT.format(
        title=describe_plan(plan),
        target=target,
        version=version,
        docs=DOCS,
        files=_make_table(["file", "what it is"], rows),
        build=describe_build(name, binaries, target),
        bound=bound,
        reach=_FORMS[plan.form].format(radius=plan.radius),
        tables="\n".join(tables),
        name=name,
        least=_LEAST_WIDTH.format(name=name) if plan.makes_lobes else "",
        device=(_DEVICE.format(api=api) if api else "") + (_VULKAN if api == "vulkan" else ""),
        held=", ".join(f"`{argument.name}`" for argument in held),
    )
