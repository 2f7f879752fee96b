"""The C header of an export: both functions with what their arguments are, and helpers that describe images."""

from __future__ import annotations

import re
from collections.abc import Sequence

from lobewise.exporting.arguments import Argument
from lobewise.exporting.templating import fill_template


def find_prototype(header: str, function: str) -> list[str]:
    """Return the C types of the arguments of a function that a header of Halide's declares."""
    found = re.search(rf"^int {function}\(([^)]*)\);", header, flags=re.M)
    assert found is not None
    return ["halide_buffer_t *" if "halide_buffer_t" in part else part.split()[0] for part in found[1].split(", ")]


def _declare(function: str, title: str, arguments: Sequence[Argument]) -> str:
    lines = []
    for place, argument in enumerate(arguments):
        if argument.role == "number":
            word, kind = f"float {argument.name}", ""
        else:
            word = f"halide_buffer_t *{argument.name}"
            kind = f"{argument.role}, {argument.type} {argument.extents}: "
        unit = f" ({argument.unit})" if argument.unit else ""
        end = ");" if place == len(arguments) - 1 else ","
        lines.append(f"    {word}{end} /* {kind}{argument.text}{unit} */")
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
    declared = "\n\n".join(_declare(*function) for function in functions)
    return fill_template(
        "header.h", name=name, title=title, target=target, guard=f"{name.upper()}_H", declared=declared
    )
