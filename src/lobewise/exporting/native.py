"""A filter as a static library, with everything that a C program needs beside it."""

from __future__ import annotations

import json
import re
import shutil
import tempfile
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

import lobewise
from lobewise.errors import InputError
from lobewise.exporting.arguments import Argument
from lobewise.exporting.compiling import compile_filter, compile_lobes
from lobewise.exporting.example import choose_bound, list_frame_images, make_example
from lobewise.exporting.folder import MARK, open_folder, require_folder
from lobewise.exporting.header import make_header
from lobewise.exporting.plan import FilterPlan
from lobewise.exporting.readme import describe_build, describe_plan, make_readme
from lobewise.exporting.sample import make_sample
from lobewise.exporting.targets import get_runtime_headers, parse_target
from lobewise.io.files import PathLike

Function = tuple[str, str, Sequence[Argument]]


def export_library(
    output: PathLike, plan: FilterPlan, *, target: str = "host", name: str = "lobewise", force: bool = False
) -> str:
    """Write a folder with a filter compiled ahead of time; return the command that builds its example.

    Parameters
    ----------
    output : path
        The folder, new or empty.
    plan : FilterPlan
        The filter.
    target : str
        A name from `lobewise.exporting.names.TARGETS`, or another one that Halide knows.
    name : str
        What files and functions begin with: an identifier of C.
    force : bool
        Replace an earlier export, with all that is in its folder.

    Raises
    ------
    InputError, DeviceError
        If name or target cannot be used.
    FileError
        If the folder is not empty or cannot be written.
    """
    if not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]{0,63}", name):
        raise InputError("--name", expected="an identifier of C", got=repr(name), action="such as my_filter")
    require_folder(output, force=force)
    chosen = parse_target(target).to_string()
    filter_arguments, lobe_arguments = plan.filter_arguments, plan.lobe_arguments
    functions: list[Function] = [(f"{name}_filter", "Filters a frame.", filter_arguments)]
    if lobe_arguments:
        made = "Makes the lobes that the filter compares, and its mask, from what a G-buffer holds."
        functions.append((f"{name}_lobes", made, lobe_arguments))
    windows = "windows" in chosen
    binaries = [f"{name}.lib" if windows else f"lib{name}.a"]
    binaries += [f"{name}_lobes.{'obj' if windows else 'o'}"] if lobe_arguments else []
    sample = make_sample(plan)
    with open_folder(output, force=force) as place:
        with tempfile.TemporaryDirectory() as aside:
            headers = [Path(aside) / f"{function}.h" for function, _, _ in functions]
            parts = zip((compile_filter, compile_lobes), functions, binaries, headers, strict=False)
            for compile_part, (function, _, _), binary, header in parts:
                compile_part(plan, target, name=function, library=place(binary), header=header)
            originals = "".join(header.read_text() for header in headers)
            text = make_header(name, describe_plan(plan), chosen, originals, functions)
        place(f"{name}.h").write_text(text, encoding="utf-8")
        for header in get_runtime_headers(chosen):
            shutil.copyfile(header, place(header.name))
        bound = choose_bound(plan, chosen)
        program = make_example(name, sample, filter_arguments, lobe_arguments, bound)
        place("example.c").write_text(program, encoding="utf-8")
        held = list_frame_images(filter_arguments, lobe_arguments)
        place("frame.raw").write_bytes(b"".join(sample.images[argument.name].tobytes() for argument in held))
        place("expected.raw").write_bytes(sample.expected.tobytes())
        version = lobewise.__version__
        readme = make_readme(plan, name, binaries, chosen, version, sample, functions, bound)
        place("README.md").write_text(readme, encoding="utf-8")
        place(MARK).write_text(_describe(plan, binaries, chosen, functions), encoding="utf-8")
    return describe_build(name, binaries, chosen)


def _describe(plan: FilterPlan, binaries: Sequence[str], target: str, functions: Sequence[Function]) -> str:
    """Return the JSON that says what is in the folder."""

    def describe(argument: Argument) -> dict[str, object]:
        told = {"name": argument.name, "role": argument.role, "type": argument.type}
        shape = {} if argument.role == "number" else {"extents": argument.extents}
        return {**told, **shape, "unit": argument.unit, "meaning": argument.text}

    content = {
        "lobewise": lobewise.__version__,
        "target": target,
        "binaries": list(binaries),
        "filter": asdict(plan),
        "functions": {function: [describe(argument) for argument in given] for function, _, given in functions},
    }
    return json.dumps(content, indent=2) + "\n"
