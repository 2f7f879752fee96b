"""The verb `export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lobewise.errors import InputError
from lobewise.exporting.names import SHADER_LANGUAGES, TARGETS


def export(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="The folder to write.", show_default=False)
    ],
    target: Annotated[
        str, typer.Option(metavar="NAME", help="Where it is to run, or hlsl, glsl, wgsl; see above.")
    ] = "host",
    similarity: Annotated[
        str | None,
        typer.Option(
            metavar="normal|diffuse|sg|sg_mixture|asg|ggx", help="What makes two pixels similar.", show_default="ggx"
        ),
    ] = None,
    form: Annotated[
        str | None,
        typer.Option(metavar="full|separable|atrous", help="Which neighbours count.", show_default="separable"),
    ] = None,
    radius: Annotated[
        int | None,
        typer.Option(metavar="N", help="Pixels from the centre to the edge of the kernel.", show_default="8"),
    ] = None,
    lobes: Annotated[
        int | None, typer.Option(metavar="2-4", help="With sg_mixture: Gaussians of a pixel.", show_default="3")
    ] = None,
    albedo: Annotated[
        bool | None,
        typer.Option(
            "--albedo/--no-albedo", help="Whether radiance is divided by an albedo in between.", show_default="albedo"
        ),
    ] = None,
    anisotropic: Annotated[
        bool | None,
        typer.Option(
            "--anisotropic/--isotropic",
            help="With asg, ggx: lobes from two roughnesses and a tangent.",
            show_default="isotropic",
        ),
    ] = None,
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

    settings = {
        "similarity": similarity,
        "form": form,
        "radius": radius,
        "lobes": lobes,
        "albedo": albedo,
        "anisotropic": anisotropic,
    }
    given: dict[str, Any] = {key: value for key, value in settings.items() if value is not None}
    if target in SHADER_LANGUAGES:
        from lobewise.exporting.shader import export_shader

        unused = [*given, *(["name"] if name is not None else [])]
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

    command = export_library(output, FilterPlan(**given), target=target, name=name or "lobewise", force=force)
    print_line(f"Wrote {output}; README.md says what is there. In that folder: {command}")


# Options stand in narrow columns, which would cut these names off.
export.__doc__ = f"""{export.__doc__}

Targets, all compiled for in the tests: {", ".join(TARGETS)}. Others of these processors and systems are tried.

Shader languages, with the weights alone: {", ".join(SHADER_LANGUAGES)}.
"""
