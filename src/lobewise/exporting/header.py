"""The C header of an export: both functions with what their arguments are, and helpers that describe images."""

from __future__ import annotations

import re
from collections.abc import Sequence

from lobewise.exporting.ahead_of_time import Argument
from lobewise.exporting.arguments import describe_shape, get_meaning

_HELPERS = """\
/* Describes an image of floats whose rows lie one after the other, and in a row the channels of each pixel; with 0
   channels there is no axis for them. dim is room for three axes and must live as long as the result. */
static inline halide_buffer_t {name}_floats(halide_dimension_t *dim, float *pixels, int channels, int width, int height)
{{
    const int sizes[3] = {{channels, width, height}};
    static halide_buffer_t empty; /* all zeros */
    halide_buffer_t image = empty;
    int stride = 1, axis;
    for (axis = channels ? 0 : 1; axis < 3; axis++) {{
        halide_dimension_t *d = &dim[image.dimensions++];
        d->min = 0;
        d->extent = sizes[axis];
        d->stride = stride;
        d->flags = 0;
        stride *= sizes[axis];
    }}
    image.host = (uint8_t *)pixels;
    image.type.code = halide_type_float;
    image.type.bits = 32;
    image.type.lanes = 1;
    image.dim = dim;
    image.flags = halide_buffer_flag_host_dirty; /* a device, if there is one, has no copy yet */
    return image;
}}

/* Describes a mask, one byte for each pixel. */
static inline halide_buffer_t {name}_bytes(halide_dimension_t *dim, uint8_t *pixels, int width, int height)
{{
    halide_buffer_t image = {name}_floats(dim, (float *)0, 0, width, height);
    image.host = pixels;
    image.type.code = halide_type_uint;
    image.type.bits = 8;
    return image;
}}
"""


def find_prototype(header: str, function: str) -> list[str]:
    """Return the C types of the arguments of a function that a header of Halide's declares."""
    found = re.search(rf"^int {function}\(([^)]*)\);", header, flags=re.M)
    assert found is not None
    return ["halide_buffer_t *" if "halide_buffer_t" in part else part.split()[0] for part in found[1].split(", ")]


def _declare(function: str, title: str, arguments: Sequence[Argument]) -> str:
    lines = []
    for place, argument in enumerate(arguments):
        meaning = get_meaning(argument)
        if argument.role == "number":
            word, kind = f"float {argument.name}", ""
        else:
            word = f"halide_buffer_t *{argument.name}"
            kind = f"{argument.role}, {argument.type} {describe_shape(argument)}: "
        unit = f" ({meaning.unit})" if meaning.unit else ""
        end = ");" if place == len(arguments) - 1 else ","
        lines.append(f"    {word}{end} /* {kind}{meaning.text}{unit} */")
    return "\n".join([f"/* {title} Returns 0, or an error code of Halide's. */", f"int {function}(", *lines])


def make_header(
    name: str, title: str, target: str, originals: str, functions: Sequence[tuple[str, str, Sequence[Argument]]]
) -> str:
    """Return the header of a library.

    Parameters
    ----------
    name, title, target : str
        Prefix of the functions; what they are, in a line; what they were compiled for.
    originals : str
        The headers that Halide wrote, whose types count.
    functions : sequence
        Name, description and arguments of each.
    """
    for function, _, arguments in functions:
        expected = ["float" if argument.role == "number" else "halide_buffer_t *" for argument in arguments]
        assert find_prototype(originals, function) == expected, f"{function} is declared otherwise"
    guard = f"{name.upper()}_H"
    declared = "\n\n".join(_declare(*function) for function in functions)
    return f"""\
/* {title}, compiled for {target}. Made by lobewise; README.md says how to call it. */
#ifndef {guard}
#define {guard}

#include "HalideRuntime.h"

#ifdef __cplusplus
extern "C" {{
#endif

{declared}

{_HELPERS.format(name=name)}
#ifdef __cplusplus
}}
#endif

#endif
"""
