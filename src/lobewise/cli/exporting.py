"""The verbs of `export`, one for each kind of program that is written."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import typer

from lobewise.cli.options.spreading import with_groups, with_settings
from lobewise.cli.terminal.help import EXAMPLES, FILTER_DETAILS, App
from lobewise.errors import InputError, require_choice
from lobewise.exporting.names import CHAINS, SHADER_LANGUAGES, TARGETS
from lobewise.exporting.pipeline.settings import FILTER, PipelineSettings
from lobewise.settings import FORM_NAMES, list_knobs

KNOBS = list_knobs(PipelineSettings)
PIPELINE = tuple(name for name in KNOBS if name != "albedo")
"""Settings of a pipeline."""
USUAL = ("similarity", "form", "radius", "albedo", "plan", "history", "upsample")
"""Settings that the short help shows."""
LANGUAGES = "|".join(SHADER_LANGUAGES)
output_option = typer.Option("--output", "-o", metavar="FOLDER", help="The folder to write.", show_default=False)
Force = Annotated[bool, typer.Option("--force", help="Replace an earlier export and everything in its folder.")]
Listing = Annotated[bool, typer.Option("--list", help="Print what the folder would contain, and write nothing.")]
Language = Annotated[str, typer.Argument(metavar=LANGUAGES, help="The shader language.", show_default=False)]


export = App(
    help=f"""Write a filter as a C library with README and example, or as shaders.

Targets of pipeline and filter, all compiled in the tests: {", ".join(TARGETS)}. Other combinations of these processors
and systems may work.""",
)


@dataclass(frozen=True)
class Compiled:
    """Options of what is compiled into a C library."""

    output: Annotated[Path | None, output_option] = None
    target: Annotated[
        str, typer.Option(metavar="NAME", help="Processor and system; `lobewise export --help` lists them.")
    ] = "host"
    name: Annotated[str, typer.Option(metavar="NAME", help="Beginning of the names of files and C functions.")] = (
        "lobewise"
    )
    force: Force = False
    list_contents: Listing = False

    def write(self, settings: PipelineSettings) -> None:
        """Write the folder, or print what it would contain."""
        from lobewise.cli.output import print_line

        require_one(self.output, self.list_contents)
        if self.output is None:
            from lobewise.exporting.pipeline.contents import list_contents
            from lobewise.exporting.pipeline.recording import make_pipeline

            for line in list_contents(make_pipeline(settings, target=self.target, name=self.name)):
                print_line(line)
            return
        from lobewise.exporting.pipeline.writing import export_pipeline

        command = export_pipeline(self.output, settings, target=self.target, name=self.name, force=self.force)
        print_line(f"Wrote {self.output}; README.md describes the files. In that folder: {command}")


@export.command(epilog=EXAMPLES["export pipeline"])
@with_settings(PipelineSettings, *PIPELINE, only_given=True, group=FILTER_DETAILS, usual=USUAL)
@with_groups
def pipeline(settings: dict[str, Any], *, compiled: Compiled) -> None:
    """Compile a whole plan into a C library with a wrapper for C++, README and example."""
    if settings.get("upsample", 1) > 1:
        # The radius counts samples.
        from lobewise.recipes.upsampling import DEFAULT_RADIUS

        settings = {"radius": DEFAULT_RADIUS, **settings}
    compiled.write(PipelineSettings(**settings))


@export.command("filter", epilog=EXAMPLES["export filter"])
@with_settings(PipelineSettings, *FILTER, only_given=True, group=FILTER_DETAILS, usual=USUAL)
@with_groups
def single_filter(settings: dict[str, Any], *, compiled: Compiled) -> None:
    """Compile a filter for one light, a pipeline of one step, into such a library."""
    compiled.write(PipelineSettings(plan="filter", **settings))


@export.command(epilog=EXAMPLES["export functions"])
def functions(language: Language, output: Annotated[Path, output_option], force: Force = False) -> None:
    """Write the weights as functions of a shader language."""
    from lobewise.cli.output import print_line
    from lobewise.exporting.shaders.writing import export_shader

    export_shader(output, language, force=force)
    print_line(f"Wrote {output}: lobewise.{language}, README.md.")


@export.command(epilog=EXAMPLES["export passes"])
def passes(
    chain: Annotated[str, typer.Argument(metavar="|".join(CHAINS), help="What they do.", show_default=False)],
    language: Language,
    form: Annotated[
        str | None,
        typer.Option(metavar="|".join(FORM_NAMES), help=KNOBS["form"].text, show_default="separable; full of upsample"),
    ] = None,
    similarity: Annotated[
        str, typer.Option(metavar="ggx|sg", help="How specular lobes are compared; sg reads one image less.")
    ] = "ggx",
    output: Annotated[Path | None, output_option] = None,
    force: Force = False,
    list_contents: Listing = False,
) -> None:
    """Write whole compute passes in a shader language."""
    from lobewise.cli.output import print_line

    require_one(output, list_contents)
    if output is None:
        from lobewise.exporting.shaders.chains import make_chain
        from lobewise.exporting.shaders.writing import list_chain

        require_choice("shader language", language, SHADER_LANGUAGES)
        for line in list_chain(make_chain(chain, form=form, similarity=similarity), language):
            print_line(line)
        return
    from lobewise.exporting.shaders.writing import DESCRIPTION, export_chain

    names = export_chain(output, language, chain, form=form, similarity=similarity, force=force)
    count = sum(each.endswith(f".{language}") for each in names)
    print_line(f"Wrote {output}: {count} passes, {DESCRIPTION}, README.md, which describes images and constants.")


def require_one(output: Path | None, list_contents: bool) -> None:
    """Raise InputError unless there is either a folder to write or ``--list``, which writes nothing."""
    if (output is None) != list_contents:
        raise InputError(
            "--output",
            expected="a folder to write, or --list, which writes nothing",
            got="both" if list_contents else "neither",
            action="give one of them",
        )
