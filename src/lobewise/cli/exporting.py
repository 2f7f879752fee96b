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
        str, typer.Option(metavar="NAME", help="Where it is to run, or hlsl, glsl, wgsl; see above.")
    ] = "host",
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="What files and C functions begin with.", show_default="lobewise"),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an earlier export, with all that is in its folder.")
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
    print_line(f"Wrote {output}; README.md says what is there. In that folder: {command}")


# Options stand in narrow columns, which would cut these names off.
export.__doc__ = f"""{export.__doc__}

Targets, all compiled for in the tests: {", ".join(TARGETS)}. Others of these processors and systems are tried.

Shader languages, with the weights alone: {", ".join(SHADER_LANGUAGES)}.
"""
