"""The C program of an export: it filters the small frame beside it and compares with what Python made of it."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.backend.targets import get_gpu_api
from lobewise.exporting.ahead_of_time import Argument, FilterPlan
from lobewise.exporting.sample import Sample

LARGEST_DIFFERENCE = 1e-5
"""Relative, between C and Python."""
LARGEST_PLAIN_DIFFERENCE = 5e-5
"""The same on processors without fused multiplication and addition, where products are rounded once more, and for
``asg`` with ``atrous``, whose five passes add up their rounding."""
LARGEST_DEVICE_DIFFERENCE = 1e-3
"""The same where the filter runs on a graphics processor, whose arithmetic is its own."""

_PROGRAM = """\
/* Filters frame.raw with {name}_filter, writes output.raw and compares it with expected.raw, which Python made.
   README.md says how to build it. Run it in this folder; it ends with 0 if both agree. */
#include <math.h>
#include <stdio.h>
#include <stdlib.h>

#include "{name}.h"

enum {{ WIDTH = {width}, HEIGHT = {height}, PIXELS = WIDTH * HEIGHT }};

/* Without a handler of its own a program is aborted by the first error. */
static void on_error(void *context, const char *message)
{{
    (void)context;
    fprintf(stderr, "%s\\n", message);
}}

static void *allocate(size_t bytes)
{{
    void *memory = malloc(bytes);
    if (!memory) {{
        fprintf(stderr, "out of memory\\n");
        exit(1);
    }}
    return memory;
}}

static FILE *open_file(const char *path, const char *mode)
{{
    FILE *file = fopen(path, mode);
    if (!file) {{
        fprintf(stderr, "%s: cannot be opened\\n", path);
        exit(1);
    }}
    return file;
}}

static void *read_image(FILE *file, size_t bytes)
{{
    void *memory = allocate(bytes);
    if (fread(memory, 1, bytes, file) != bytes) {{
        fprintf(stderr, "a file ends too early\\n");
        exit(1);
    }}
    return memory;
}}

static void check(int code, const char *what)
{{
    if (code) {{
        fprintf(stderr, "%s failed with code %d\\n", what, code);
        exit(1);
    }}
}}

int main(void)
{{
    FILE *file;
    float *found, *expected;
    double largest = 0.0;
    int k;
{declarations}
    halide_set_error_handler(on_error);

    /* The arrays of the frame, one after the other. */
    file = open_file("frame.raw", "rb");
{reading}
    fclose(file);

{making}{calls}
    found = (float *)output.host;
    file = open_file("output.raw", "wb");
    if (fwrite(found, sizeof(float), {channels} * PIXELS, file) != {channels} * PIXELS || fclose(file)) {{
        fprintf(stderr, "output.raw: cannot be written\\n");
        return 1;
    }}

    file = open_file("expected.raw", "rb");
    expected = (float *)read_image(file, {channels} * PIXELS * sizeof(float));
    fclose(file);
    for (k = 0; k < {channels} * PIXELS; k++) {{
        double difference = fabs((double)found[k] - expected[k]);
        if (difference > 0.0) {{
            difference /= fabs((double)expected[k]);
        }}
        if (!(difference <= largest)) {{
            largest = difference;
        }}
    }}
    printf("largest relative difference: %.2e\\n", largest);
    return largest <= {bound:g} ? 0 : 1;
}}
"""


def list_frame_images(filter_arguments: Sequence[Argument], lobe_arguments: Sequence[Argument]) -> list[Argument]:
    """Return the images that frame.raw holds, in order: those that neither function makes."""
    made = {argument.name for argument in lobe_arguments if argument.role == "output"}
    given: dict[str, Argument] = {}
    for argument in (*filter_arguments, *lobe_arguments):
        if argument.role == "input" and argument.name not in made:
            given.setdefault(argument.name, argument)
    return list(given.values())


def choose_bound(plan: FilterPlan, target: str) -> float:
    """Return the largest relative difference to Python with which the program is content."""
    if get_gpu_api(target) is not None:
        return LARGEST_DEVICE_DIFFERENCE
    words = target.split("-")
    fused = words[0] == "arm" or "fma" in words
    is_long = plan.similarity == "asg" and plan.form == "atrous"
    return LARGEST_DIFFERENCE if fused and not is_long else LARGEST_PLAIN_DIFFERENCE


def make_example(
    name: str,
    sample: Sample,
    filter_arguments: Sequence[Argument],
    lobe_arguments: Sequence[Argument],
    bound: float,
) -> str:
    """Return the program, in C99."""
    height, width = sample.size
    given = list_frame_images(filter_arguments, lobe_arguments)
    made = [argument for argument in lobe_arguments if argument.role == "output"]
    images = [*given, *made, filter_arguments[-1]]
    declarations = [f"    halide_dimension_t dims[{len(images)}][3];"]
    declarations += [f"    halide_buffer_t {', '.join(argument.name for argument in images)};"]
    lines = [_describe(name, place, argument, given=True) for place, argument in enumerate(given)]
    rooms = [
        _describe(name, place, argument, given=False) for place, argument in enumerate(images[len(given) :], len(given))
    ]
    making = ["    /* Room for what is computed. */", *rooms, ""]
    calls = []
    if lobe_arguments:
        calls += ["    /* Lobes from normal, roughness and position: once per frame. */"]
        calls += _call(f"{name}_lobes", lobe_arguments, sample)
    calls += _call(f"{name}_filter", filter_arguments, sample)
    calls += ["    /* From the device, if it ran on one. */", '    check(halide_copy_to_host(0, &output), "copying");']
    return _PROGRAM.format(
        name=name,
        width=width,
        height=height,
        channels=filter_arguments[-1].channels,
        declarations="\n".join(declarations),
        reading="\n".join(lines),
        making="\n".join(making) + "\n",
        calls="\n".join(calls) + "\n",
        bound=bound,
    )


def _describe(name: str, place: int, argument: Argument, *, given: bool) -> str:
    """Return the line that makes the buffer of an image; those of the frame are read."""
    channels = 0 if argument.planar else argument.channels
    if argument.type == "uint8":
        kind, size, function, extra = "uint8_t", "PIXELS", "bytes", ""
    else:
        kind, function, extra = "float", "floats", f"{channels}, "
        size = f"{argument.channels} * PIXELS * sizeof(float)" if argument.channels > 1 else "PIXELS * sizeof(float)"
    source = f"read_image(file, {size})" if given else f"allocate({size})"
    return f"    {argument.name} = {name}_{function}(dims[{place}], ({kind} *){source}, {extra}WIDTH, HEIGHT);"


def _call(function: str, arguments: Sequence[Argument], sample: Sample) -> list[str]:
    """Return a call, one argument in a line, constants with their names."""
    lines = [f"    check({function}("]
    for place, argument in enumerate(arguments):
        comma = "" if place == len(arguments) - 1 else ","
        if argument.role == "number":
            value = f"{sample.numbers[argument.name]:.9g}"
            value += "" if any(mark in value for mark in ".e") else ".0"
            lines.append(f"        {value}f{comma} /* {argument.name} */")
        else:
            lines.append(f"        &{argument.name}{comma}")
    return [*lines, f'    ), "{function}");']
