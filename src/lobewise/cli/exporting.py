"""The verb `export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lobewise.cli.exporting_shaders import export_page, export_shaders, print_chain
from lobewise.cli.options.spreading import with_settings
from lobewise.errors import InputError
from lobewise.exporting.names import CHAINS, SHADER_LANGUAGES, TARGETS, WEB, ExportSettings
from lobewise.exporting.pipeline.settings import PipelineSettings
from lobewise.settings import list_knobs

OWN = ("similarity", "form", "radius", "lobes", "albedo", "anisotropic")
"""Settings of a single filter."""
SHARED = ("similarity", "form", "radius", "anisotropic")
"""Settings of a filter that a pipeline has, too."""
PIPELINE = ("plan", "history", "upsample", "motion", "hit_distance", "layers", "emission", "position", "lobe_kind")
"""Settings of a pipeline alone."""


@with_settings({**list_knobs(PipelineSettings), **list_knobs(ExportSettings)}, *OWN, *PIPELINE, only_given=True)
def export(
    settings: dict[str, Any],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="The folder to write.", show_default=False)
    ] = None,
    target: Annotated[
        str, typer.Option(metavar="NAME", help="Processor and system, or hlsl, glsl, wgsl, web; see above.")
    ] = "host",
    name: Annotated[
        str | None,
        typer.Option(metavar="NAME", help="Beginning of the names of files and C functions.", show_default="lobewise"),
    ] = None,
    chain: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Whole compute passes in a shader language.",
            show_default=False,
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an earlier export and everything in its folder.")
    ] = False,
    list_contents: Annotated[
        bool, typer.Option("--list", help="Print what the pipeline or chain contains, and write nothing.")
    ] = False,
) -> None:
    """Compile a filter, or with --plan a whole plan, into a C library with README and example; or write shaders."""
    from lobewise.cli.output import print_line

    if target in SHADER_LANGUAGES and chain is not None and list_contents:
        print_chain(target, chain, settings, name)
        return
    if list_contents and not any(each in settings for each in PIPELINE):
        settings["plan"] = "fast"
    if output is None and (target in (*SHADER_LANGUAGES, WEB) or not list_contents):
        raise InputError("--output", expected="the folder to write", got="nothing", action="add -o FOLDER")

    if target in SHADER_LANGUAGES:
        assert output is not None
        export_shaders(output, target, chain, settings, name, force)
        return
    if target == WEB:
        assert output is not None
        export_page(output, chain, settings, name, force)
        return
    if chain is not None:
        raise InputError(
            "--chain",
            expected=f"a target of {', '.join(SHADER_LANGUAGES)} beside it",
            got=f"the target {target}, whose library has one function",
            action="leave --chain out, or choose a shader language",
        )

    if any(each in settings for each in PIPELINE):
        _export_pipeline(output, settings, target=target, name=name or "lobewise", force=force)
        return

    assert output is not None
    from lobewise.exporting.native import export_library
    from lobewise.exporting.plan import FilterPlan

    command = export_library(output, FilterPlan(**settings), target=target, name=name or "lobewise", force=force)
    print_line(f"Wrote {output}; README.md describes the files. In that folder: {command}")


def _export_pipeline(output: Path | None, settings: dict[str, Any], *, target: str, name: str, force: bool) -> None:
    """Write a pipeline, or print what it contains where there is no folder to write."""
    from lobewise.cli.output import print_line

    if alone := [each for each in settings if each not in (*SHARED, *PIPELINE)]:
        raise InputError(
            f"--{alone[0]}", expected="settings of a pipeline", got="one of a single filter", action="leave it out"
        )
    if settings.get("upsample", 1) > 1:
        # The radius counts samples.
        from lobewise.upsampling import DEFAULT_RADIUS

        settings.setdefault("radius", DEFAULT_RADIUS)
    chosen = PipelineSettings(**settings)
    if output is None:
        from lobewise.exporting.pipeline.contents import list_contents
        from lobewise.exporting.pipeline.planning import make_pipeline

        for line in list_contents(make_pipeline(chosen, target=target, name=name)):
            print_line(line)
        return
    from lobewise.exporting.pipeline.writing import export_pipeline

    command = export_pipeline(output, chosen, target=target, name=name, force=force)
    print_line(f"Wrote {output}; README.md describes the files. In that folder: {command}")


# The narrow columns of the options would cut these names off.
export.__doc__ = f"""{export.__doc__}

Targets, all compiled in the tests: {", ".join(TARGETS)}. Other combinations of these processors and systems may work.

Shaders: --target {", ".join(SHADER_LANGUAGES)} writes the weights as functions, with --chain {", ".join(CHAINS)}
whole compute passes; --target {WEB} writes a page that runs such passes in the browser.
"""
