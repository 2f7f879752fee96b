"""The verb `export`."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Annotated, Any

import typer

from lobewise.cli.options.spreading import with_settings
from lobewise.cli.terminal.help import FILTER_DETAILS
from lobewise.errors import InputError
from lobewise.exporting.names import CHAINS, SHADER_LANGUAGES, TARGETS
from lobewise.exporting.pipeline.settings import PipelineSettings

PIPELINE = tuple(each.name for each in fields(PipelineSettings))
"""Settings of a pipeline, which a single filter is, too."""
DEFAULT_NAME = "lobewise"
USUAL = ("similarity", "form", "radius", "albedo", "plan", "history", "upsample")
"""Settings that the short help shows."""


@with_settings(PipelineSettings, *PIPELINE, only_given=True, group=FILTER_DETAILS, usual=USUAL, plan="filter")
def export(
    settings: dict[str, Any],
    output: Annotated[
        Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="The folder to write.", show_default=False)
    ] = None,
    target: Annotated[
        str, typer.Option(metavar="NAME", help="Processor and system, or hlsl, glsl, wgsl; see above.")
    ] = "host",
    name: Annotated[
        str | None,
        typer.Option(
            metavar="NAME", help="Beginning of the names of files and C functions.", show_default=DEFAULT_NAME
        ),
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
    is_shader = target in SHADER_LANGUAGES
    if chain is not None and not is_shader:
        raise InputError(
            "--chain",
            expected=f"a target of {', '.join(SHADER_LANGUAGES)} beside it",
            got=f"the target {target}, which has no passes",
            action="leave --chain out, or choose a shader language",
        )
    if list_contents:
        _print_contents(output, target, chain, settings, name)
        return
    if output is None:
        raise InputError("--output", expected="the folder to write", got="nothing", action="add -o FOLDER")
    if is_shader:
        _export_shaders(output, target, chain, settings, name, force)
    else:
        _export_pipeline(output, settings, target=target, name=name or DEFAULT_NAME, force=force)


def _print_contents(
    output: Path | None, target: str, chain: str | None, settings: dict[str, Any], name: str | None
) -> None:
    """Print what a pipeline or a chain contains. Refuse a folder, and targets without a list."""
    from lobewise.cli.output import print_line

    if output is not None:
        raise InputError(
            "--list",
            expected="no folder beside it: it writes nothing",
            got=f"-o {output}",
            action="leave one of them out",
        )
    if target in SHADER_LANGUAGES and chain is None:
        raise InputError(
            "--list",
            expected="a pipeline, or a shader language with --chain",
            got=f"the target {target} without --chain",
            action="leave --list out: the folder's README tells the contents",
        )
    if chain is not None:
        from lobewise.exporting.shaders.chains import make_chain
        from lobewise.exporting.shaders.listing import list_chain

        _refuse_unused(target, chain, settings, name)
        lines = list_chain(make_chain(chain, **settings), target)
    else:
        from lobewise.exporting.pipeline.contents import list_contents
        from lobewise.exporting.pipeline.recording import make_pipeline

        lines = list_contents(make_pipeline(_choose_pipeline(settings), target=target, name=name or DEFAULT_NAME))
    for line in lines:
        print_line(line)


def _export_shaders(
    output: Path, language: str, chain: str | None, settings: dict[str, Any], name: str | None, force: bool
) -> None:
    """Write shader functions, or the passes of a chain. Refuse options that neither has."""
    from lobewise.cli.output import print_line

    _refuse_unused(language, chain, settings, name)
    if chain is None:
        from lobewise.exporting.shaders.functions import export_shader

        export_shader(output, language, force=force)
        print_line(f"Wrote {output}: lobewise.{language}, README.md.")
        return
    from lobewise.exporting.shaders.writing import DESCRIPTION, export_chain

    names = export_chain(output, language, chain, force=force, **settings)
    count = sum(each.endswith(f".{language}") for each in names)
    print_line(f"Wrote {output}: {count} passes, {DESCRIPTION}, README.md, which describes images and constants.")


def _refuse_unused(language: str, chain: str | None, settings: dict[str, Any], name: str | None) -> None:
    """Raise an error if there is an option that shader functions, or the passes of a chain, do not have."""
    known = {"form", "similarity"} if chain is not None else set()
    unused = [*(each for each in settings if each not in known), *(["name"] if name is not None else [])]
    if unused:
        has = "whose chains have a form and a similarity, and take the radius as a constant"
        raise InputError(
            _name_option(unused[0]),
            expected="a processor or device as target beside it",
            got=f"the shader language {language}, {has if chain is not None else 'whose file has all weights'}",
            action="leave one of them out",
        )


def _name_option(setting: str) -> str:
    """Return the option of a setting, as users write it."""
    return "--" + setting.replace("_", "-")


def _choose_pipeline(settings: dict[str, Any]) -> PipelineSettings:
    """Return the settings of a pipeline."""
    settings = {"plan": "filter", **settings}
    if settings.get("upsample", 1) > 1:
        # The radius counts samples.
        from lobewise.upsampling import DEFAULT_RADIUS

        settings = {"radius": DEFAULT_RADIUS, **settings}
    return PipelineSettings(**settings)


def _export_pipeline(output: Path, settings: dict[str, Any], *, target: str, name: str, force: bool) -> None:
    """Write a single filter or a whole plan."""
    from lobewise.cli.output import print_line
    from lobewise.exporting.pipeline.writing import export_pipeline

    command = export_pipeline(output, _choose_pipeline(settings), target=target, name=name, force=force)
    print_line(f"Wrote {output}; README.md describes the files. In that folder: {command}")


# The narrow columns of the options would cut these names off.
export.__doc__ = f"""{export.__doc__}

Targets, all compiled in the tests: {", ".join(TARGETS)}. Other combinations of these processors and systems may work.

Shaders: --target {", ".join(SHADER_LANGUAGES)} writes the weights as functions, with --chain {", ".join(CHAINS)}
whole compute passes.
"""
