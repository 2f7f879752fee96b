"""The verb `export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from lobewise.cli.options.spreading import with_settings
from lobewise.errors import InputError
from lobewise.exporting.names import CHAINS, SHADER_LANGUAGES, TARGETS, WEB, ExportSettings


@with_settings(ExportSettings, "similarity", "form", "radius", "lobes", "albedo", "anisotropic", only_given=True)
def export(
    output: Annotated[
        Path, typer.Option("--output", "-o", metavar="FOLDER", help="The folder to write.", show_default=False)
    ],
    settings: dict[str, Any],
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
            help="With hlsl, glsl, wgsl: whole compute passes instead of single functions; see above.",
            show_default=False,
        ),
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace an earlier export and everything in its folder.")
    ] = False,
) -> None:
    """Compile a filter ahead of time: a library with C header, README and example; or shaders."""
    from lobewise.cli.output import print_line

    if target in SHADER_LANGUAGES:
        _export_shaders(output, target, chain, settings, name, force)
        return
    if target == WEB:
        _export_page(output, chain, settings, name, force)
        return
    if chain is not None:
        raise InputError(
            "--chain",
            expected=f"a target of {', '.join(SHADER_LANGUAGES)} beside it",
            got=f"the target {target}, whose library has one function",
            action="leave --chain out, or choose a shader language",
        )

    from lobewise.exporting.native import export_library
    from lobewise.exporting.plan import FilterPlan

    command = export_library(output, FilterPlan(**settings), target=target, name=name or "lobewise", force=force)
    print_line(f"Wrote {output}; README.md describes the files. In that folder: {command}")


def _export_page(output: Path, chain: str | None, settings: dict[str, Any], name: str | None, force: bool) -> None:
    """Write the page for browsers. Refuse options that it does not have."""
    from lobewise.cli.output import print_line
    from lobewise.exporting.shaders.web import export_web

    given = {"chain": chain, "name": name, **settings}
    unused = [each for each, value in given.items() if value is not None]
    if unused:
        raise InputError(
            f"--{unused[0]}",
            expected="another target beside it",
            got=f"the target {WEB}, whose page has its own settings",
            action="leave one of them out",
        )
    export_web(output, force=force)
    print_line(f"Wrote {output}: open {output / 'index.html'} in a browser with WebGPU.")


def _export_shaders(
    output: Path, language: str, chain: str | None, settings: dict[str, Any], name: str | None, force: bool
) -> None:
    """Write shader functions, or the passes of a chain. Refuse options that neither has."""
    from lobewise.cli.output import print_line

    known = {"form"} if chain is not None else set()
    unused = [*(each for each in settings if each not in known), *(["name"] if name is not None else [])]
    if unused:
        has = "whose chains compare specular lobes by 'ggx' and take the radius as a constant"
        raise InputError(
            f"--{unused[0]}",
            expected="a processor or device as target beside it",
            got=f"the shader language {language}, {has if chain is not None else 'whose file has all weights'}",
            action="leave one of them out",
        )
    if chain is None:
        from lobewise.exporting.shaders.functions import export_shader

        export_shader(output, language, force=force)
        print_line(f"Wrote {output}: lobewise.{language}, README.md.")
        return
    from lobewise.exporting.shaders.writing import DESCRIPTION, export_chain

    names = export_chain(output, language, chain, force=force, **settings)
    count = sum(each.endswith(f".{language}") for each in names)
    print_line(f"Wrote {output}: {count} passes, {DESCRIPTION}, README.md, which describes images and constants.")


# The narrow columns of the options would cut these names off.
export.__doc__ = f"""{export.__doc__}

Targets, all compiled in the tests: {", ".join(TARGETS)}. Other combinations of these processors and systems may work.

Shader languages: {", ".join(SHADER_LANGUAGES)}; the weights as functions, or with --chain whole compute passes.

With the target {WEB}: a page that denoises a short sequence in the browser by such passes.

Chains: {"; ".join(f"{name}, {what}" for name, what in CHAINS.items())}.
"""
