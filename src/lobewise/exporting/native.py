"""Export a filter as a static library, with the files that a C program needs to call it."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from dataclasses import asdict
from pathlib import Path

import lobewise
from lobewise.exporting.arguments import Argument
from lobewise.exporting.compiling import compile_filter, compile_lobes
from lobewise.exporting.contents import Contents, Function
from lobewise.exporting.example import make_example
from lobewise.exporting.folder import MARK, fill_template, open_folder, require_folder
from lobewise.exporting.names import require_identifier
from lobewise.exporting.plan import FilterPlan
from lobewise.exporting.readme import describe_build, make_readme
from lobewise.exporting.sample import make_sample
from lobewise.exporting.targets import get_runtime_headers, parse_target
from lobewise.io.files import PathLike


def export_library(
    output: PathLike, plan: FilterPlan, *, target: str = "host", name: str = "lobewise", force: bool = False
) -> str:
    """Write a folder with a filter compiled ahead of time; return the command that builds its example.

    Parameters
    ----------
    output : path
        The folder, new or empty.
    plan : FilterPlan
    target : str
        A name from `lobewise.exporting.names.TARGETS`, or another target that Halide knows.
    name : str
        Prefix of files and functions: an identifier of C.
    force : bool
        Replace an earlier export and everything in its folder.

    Raises
    ------
    InputError, DeviceError
        If name or target cannot be used.
    FileError
        If the folder is not empty or cannot be written.
    """
    require_identifier(name, "my_filter")
    require_folder(output, force=force)
    contents = Contents(plan, name, parse_target(target).to_string(), make_sample(plan))
    sample = contents.sample
    with open_folder(output, force=force) as place:
        with tempfile.TemporaryDirectory() as aside:
            originals = ""
            compilers = (compile_filter, compile_lobes)
            for compile_part, function, binary in zip(compilers, contents.functions, contents.binaries, strict=False):
                header = Path(aside) / f"{function.name}.h"
                compile_part(plan, target, name=function.name, library=place(binary), header=header)
                originals += header.read_text()
        for header in get_runtime_headers(contents.target):
            shutil.copyfile(header, place(header.name))
        place("frame.raw").write_bytes(b"".join(sample.images[each.name].tobytes() for each in contents.frame))
        place("expected.raw").write_bytes(sample.expected.tobytes())
        texts = {
            f"{name}.h": make_header(contents, originals),
            "example.c": make_example(contents),
            "README.md": make_readme(contents),
            MARK: _describe(contents),
        }
        for file, text in texts.items():
            place(file).write_text(text, encoding="utf-8")
    return describe_build(contents)


def _describe(contents: Contents) -> str:
    """Return the JSON that lists the contents of the folder for programs."""

    def describe(argument: Argument) -> dict[str, object]:
        told = {"name": argument.name, "role": argument.role, "type": argument.type}
        shape = {} if argument.role == "number" else {"extents": argument.extents}
        return {**told, **shape, "unit": argument.unit, "meaning": argument.text}

    content = {
        "lobewise": lobewise.__version__,
        "target": contents.target,
        "binaries": contents.binaries,
        "filter": asdict(contents.plan),
        "functions": {each.name: list(map(describe, each.arguments)) for each in contents.functions},
    }
    return json.dumps(content, indent=2) + "\n"


def find_prototype(header: str, function: str) -> list[str]:
    """Return the C types of a function's arguments from a header that Halide wrote."""
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
    """Return the header of a library. ``originals`` are Halide's own headers, which its types are checked against."""
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
