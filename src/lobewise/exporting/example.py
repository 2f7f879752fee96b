"""The C program of an export: it filters the small frame beside it and compares the result with Python's."""

from __future__ import annotations

from lobewise.exporting.arguments import Argument
from lobewise.exporting.contents import Contents, Function
from lobewise.exporting.folder import fill_template
from lobewise.exporting.plan import FilterPlan
from lobewise.exporting.sample import Sample
from lobewise.exporting.targets import get_gpu_api

MAX_DIFFERENCE = 1e-5
"""Largest relative difference between C and Python on processors with fused multiply-add."""
MAX_PLAIN_DIFFERENCE = 5e-5
"""Largest relative difference on processors without fused multiply-add, where products are rounded once more, and of
``asg`` with ``atrous``, whose rounding errors add up over five passes."""
MAX_DEVICE_DIFFERENCE = 1e-3
"""Largest relative difference where the filter runs on a graphics processor, which rounds in its own way."""


def choose_bound(plan: FilterPlan, target: str) -> float:
    """Return the largest relative difference to Python that the program accepts."""
    if get_gpu_api(target) is not None:
        return MAX_DEVICE_DIFFERENCE
    words = target.split("-")
    fused = words[0] == "arm" or "fma" in words
    is_long = plan.record is not None and plan.record.fits_gaussian and plan.form == "atrous"
    return MAX_DIFFERENCE if fused and not is_long else MAX_PLAIN_DIFFERENCE


def make_example(contents: Contents) -> str:
    """Return the program, in C99."""
    name, sample, given = contents.name, contents.sample, contents.frame
    height, width = sample.size
    main, *others = contents.functions
    made = [each for function in others for each in function.arguments if each.role == "output"]
    images = [*given, *made, main.arguments[-1]]
    declarations = [f"    halide_dimension_t dims[{len(images)}][3];"]
    declarations += [f"    halide_buffer_t {', '.join(argument.name for argument in images)};"]
    lines = [_describe(name, place, argument, given=True) for place, argument in enumerate(given)]
    rooms = [
        _describe(name, place, argument, given=False) for place, argument in enumerate(images[len(given) :], len(given))
    ]
    making = ["    /* Memory for the outputs. */", *rooms, ""]
    calls = []
    for function in others:
        calls += ["    /* Lobes from normal, roughness and position: once per frame. */", *_call(function, sample)]
    calls += _call(main, sample)
    calls += [
        "    /* Copy the result from the device, if the filter ran on one. */",
        '    check(halide_copy_to_host(0, &output), "copying");',
    ]
    return fill_template(
        "example.c",
        name=name,
        width=width,
        height=height,
        channels=main.arguments[-1].channels,
        declarations="\n".join(declarations),
        reading="\n".join(lines),
        making="\n".join(making) + "\n",
        calls="\n".join(calls) + "\n",
        bound=f"{choose_bound(contents.plan, contents.target):g}",
    )


def _describe(name: str, place: int, argument: Argument, *, given: bool) -> str:
    """Return the line that makes the buffer of an image. Images that are ``given`` are read from frame.raw."""
    channels = 0 if argument.planar else argument.channels
    if argument.type == "uint8":
        kind, size, function, extra = "uint8_t", "PIXELS", "bytes", ""
    else:
        kind, function, extra = "float", "floats", f"{channels}, "
        size = f"{argument.channels} * PIXELS * sizeof(float)" if argument.channels > 1 else "PIXELS * sizeof(float)"
    source = f"read_image(file, {size})" if given else f"allocate({size})"
    return f"    {argument.name} = {name}_{function}(dims[{place}], ({kind} *){source}, {extra}WIDTH, HEIGHT);"


def _call(function: Function, sample: Sample) -> list[str]:
    """Return a call in C, one argument per line; each number has a comment with its name."""
    lines = [f"    check({function.name}("]
    for place, argument in enumerate(function.arguments):
        comma = "" if place == len(function.arguments) - 1 else ","
        if argument.role == "number":
            value = f"{sample.numbers[argument.name]:.9g}"
            value += "" if any(mark in value for mark in ".e") else ".0"
            lines.append(f"        {value}f{comma} /* {argument.name} */")
        else:
            lines.append(f"        &{argument.name}{comma}")
    return [*lines, f'    ), "{function.name}");']
