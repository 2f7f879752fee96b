"""The verb `export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lobewise.cli.options.spreading import with_settings
from lobewise.errors import InputError
from lobewise.exporting.names import SHADER_LANGUAGES, TARGETS, ExportSettings


@with_settings(ExportSettings, "similarity", "form", "radius", "lobes", "albedo", "anisotropic", only_given=True)
def export(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="The folder to write.", show_default=False)
    ],
    settings: dict[str, Any],
    target: Annotated[
        str, typer.Option(metavar="NAME", help="Processor and system, or hlsl, glsl, wgsl; see above.")
    ] = "host",
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Beginning of the names of files and C functions.", show_default="lobewise"),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an earlier export and everything in its folder.")
    ] = False,
) -> None:
    """Compile a filter ahead of time: a library with C header, README and example; or the weights as a shader."""
    from lobewise.cli.output import print_line

    if target in SHADER_LANGUAGES:
        from lobewise.exporting.shader import export_shader

        unused = [*settings, *(["name"] if name is not None else [])]
        if unused:
            raise InputError(
                f"--{unused[0]}",
                expected="a processor or device as target beside it",
                got=f"the shader language {target}, whose file has all weights",
                action="leave one of them out",
            )
        export_shader(output, target, force=force)
        print_line(f"Wrote {output}: lobewise.{target}, README.md.")
        return

    from lobewise.exporting.native import export_library
    from lobewise.exporting.plan import FilterPlan

    command = export_library(output, FilterPlan(**settings), target=target, name=name or "lobewise", force=force)
    print_line(f"Wrote {output}; README.md describes the files. In that folder: {command}")


# The narrow columns of the options would cut these names off.
export.__doc__ = f"""{export.__doc__}

Targets, all compiled in the tests: {", ".join(TARGETS)}. Other combinations of these processors and systems may work.

Shader languages, with the weights alone: {", ".join(SHADER_LANGUAGES)}.
"""
