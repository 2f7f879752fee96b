"""The C header of an export: both functions with what their arguments are, and helpers that describe images."""

from __future__ import annotations

import re

from lobewise.exporting.contents import Contents, Function
from lobewise.exporting.folder import fill_template


def find_prototype(header: str, function: str) -> list[str]:
    """Return the C types of the arguments of a function that a header of Halide's declares."""
    found = re.search(rf"^int {function}\(([^)]*)\);", header, flags=re.M)
    assert found is not None
    return ["halide_buffer_t *" if "halide_buffer_t" in part else part.split()[0] for part in found[1].split(", ")]


def _declare(function: Function) -> str:
    lines = []
    for place, argument in enumerate(function.arguments):
        if argument.role == "number":
            word, kind = f"float {argument.name}", ""
        else:
            word = f"halide_buffer_t *{argument.name}"
            kind = f"{argument.role}, {argument.type} {argument.extents}: "
        unit = f" ({argument.unit})" if argument.unit else ""
        end = ");" if place == len(function.arguments) - 1 else ","
        lines.append(f"    {word}{end} /* {kind}{argument.text}{unit} */")
    return "\n".join(
        [f"/* {function.title} Returns 0, or an error code of Halide's. */", f"int {function.name}(", *lines]
    )


def make_header(contents: Contents, originals: str) -> str:
    """Return the header of a library; ``originals`` are those that Halide wrote, whose types count."""
    for function in contents.functions:
        expected = ["float" if each.role == "number" else "halide_buffer_t *" for each in function.arguments]
        assert find_prototype(originals, function.name) == expected, f"{function.name} is declared otherwise"
    return fill_template(
        "header.h",
        name=contents.name,
        title=contents.title,
        target=contents.target,
        guard=f"{contents.name.upper()}_H",
        declared="\n\n".join(map(_declare, contents.functions)),
    )
