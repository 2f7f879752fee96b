"""The help of every verb: options in groups with titles, examples that are never cut, and rare options on request.

An option names its group by ``rich_help_panel``, one of the titles below, or is made by the function of its group; any
other option belongs to `OPTIONS`.
``--help`` leaves out the groups of `RARE` and shows the first sentence of each option; ``--help-all`` shows everything.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from pathlib import Path
from textwrap import fill
from typing import Annotated, Any, TypeVar

import typer
from typer.core import TyperCommand, TyperGroup

import lobewise
from lobewise.cli.terminal.values import Converter
from lobewise.errors import InputError, require_choice

OPTIONS, FILES, RESULT, SEQUENCES = "Options", "What the file holds", "What is written", "Sequences"
FILTERING, PAGE = "What the sliders begin with", "The page"
FILTER_DETAILS, SEQUENCE_DETAILS = "Details of the filter", "Details of sequences"
FILE_DETAILS, SHADING = "Details of files and machine", "Shading pixels again"
SCENE_DETAILS = "Details of the scene"
RARE = (FILTER_DETAILS, SEQUENCE_DETAILS, FILE_DETAILS, SHADING, SCENE_DETAILS)
"""Groups that ``--help`` leaves out. ``--help-all`` shows them after all others."""
file_option = partial(typer.Option, rich_help_panel=FILES)
file_detail = partial(typer.Option, rich_help_panel=FILE_DETAILS)
page_option = partial(typer.Option, rich_help_panel=PAGE)
result_option = partial(typer.Option, rich_help_panel=RESULT)
scene_detail = partial(typer.Option, rich_help_panel=SCENE_DETAILS)
sequence_detail = partial(typer.Option, rich_help_panel=SEQUENCE_DETAILS)
sequence_option = partial(typer.Option, rich_help_panel=SEQUENCES)
shading_option = partial(typer.Option, rich_help_panel=SHADING)
Verb = TypeVar("Verb", bound=Callable[..., Any])
HELP_NAMES = ("-h", "--help", "--help-all")
MAX_COLUMNS = 100
"""Widest help, in letters, also on a wider terminal."""
NAME_COLUMNS = 26
"""Width of the column of names, in letters. Longer names have a line of their own."""
INDENT = "  "
EXAMPLES = {
    "demo": "lobewise demo -o page",
    "render": "lobewise render kitchen -o kitchen.exr --spp 8\n"
    "lobewise render scene.xml -o 'out.####.exr' --frames 24 --camera-path still",
    "view": "lobewise view kitchen\nlobewise view shot.exr",
    "denoise": "lobewise denoise frame.exr -o clean.exr\n"
    "lobewise denoise frame.exr -o clean.exr --quality fast --png\n"
    "lobewise denoise 'shot.####.exr' -o 'clean.####.exr' --frames 1001-1050\n"
    "lobewise denoise frame.exr -o clean.exr --map normal=N.X,N.Y,N.Z",
    "upsample": "lobewise upsample sparse.exr -o full.exr",
    "fit": "lobewise fit brass.binary -o brass.lobes\nlobewise fit -o pot.lobes --mitsuba 'scene.xml#pot'",
    "compare": "lobewise compare noisy.exr clean.exr -r reference.exr",
    "export pipeline": "lobewise export pipeline -o denoiser --history\nlobewise export pipeline --list",
    "export filter": "lobewise export filter -o ggx8 --similarity ggx",
    "export functions": "lobewise export functions wgsl -o weights",
    "export passes": "lobewise export passes history wgsl -o passes",
    "doctor": "lobewise doctor\nlobewise doctor --json",
    "inspect": "lobewise inspect frame.exr\nlobewise inspect --all frame.exr",
}
"""Example commands of each verb, one per line."""


EXIT_USER_ERROR = 2
"""Exit code where input is refused; `inspect` has it for a file that `denoise` refuses."""


def asks_for_all(arguments: Sequence[str]) -> bool:
    """Return whether a command line asks for the help with the rare options."""
    return "--help-all" in arguments


class _Helpful:
    """A command whose help is made here instead of by typer, and whose values are converted by `Converter`."""

    def get_params(self: Any, ctx: Any) -> list[Any]:
        """Return the options and arguments of a command, the option of the help included."""
        params: list[Any] = super().get_params(ctx)  # type: ignore[misc]
        for one in params:
            # Typer makes its own here for the first value. Older versions of typer ask for none.
            one._runtime_param = Converter()
        return params

    def format_help(self: Any, ctx: Any, formatter: Any) -> None:
        """Write the help; ``ctx.obj`` is true where it includes the rare options."""
        width = min(shutil.get_terminal_size((80, 24)).columns, MAX_COLUMNS) - 1
        formatter.write("\n".join(_list_lines(self, ctx, width, everything=bool(ctx.obj))) + "\n")


class Command(_Helpful, TyperCommand):
    """A verb."""

    def invoke(self, ctx: Any) -> Any:
        """Run the verb, unless its options contradict each other."""
        from lobewise.cli.terminal.pairs import check_pairs

        check_pairs(ctx)
        return super().invoke(ctx)


class Group(_Helpful, TyperGroup):
    """A group of verbs. A command line without one of them is refused in one sentence."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """Return the verb that a command line names."""
        name, path = args[0], ctx.command_path
        # The program's name stands before every sentence.
        what = path if ctx.parent else "verb"
        if name not in self.commands and not name.startswith("-"):
            if name.lower().endswith(".exr"):
                raise InputError(
                    what, expected="one before the file", got=repr(name), action=f"such as {path} denoise {name}"
                )
            require_choice(what, name, self.commands)
        return super().resolve_command(ctx, args)


class App(typer.Typer):
    """A program of typer whose help is made here."""

    def __init__(self, **settings: Any) -> None:
        super().__init__(**{"cls": Group, "rich_markup_mode": None, **settings})

    def command(self, name: str | None = None, **settings: Any) -> Callable[[Verb], Verb]:
        """Return the decorator of a verb, as typer does."""
        return super().command(name, cls=Command, **settings)


def make_app() -> App:
    """Return the program without verbs."""
    app = App(
        name="lobewise",
        help="Denoise renders of glossy things by comparing what each pixel reflects.",
        add_completion=True,
        pretty_exceptions_enable=False,
        context_settings={"help_option_names": list(HELP_NAMES)},
    )
    app.callback()(root)
    return app


def _print_version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"lobewise {lobewise.__version__}")
        raise typer.Exit


def root(
    version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", is_eager=True, callback=_print_version)
    ] = False,
    debug: Annotated[bool, typer.Option("--debug", help="Print a traceback when something fails.")] = False,
) -> None:
    """Denoise renders of glossy things by comparing what each pixel reflects."""


def _list_lines(command: Any, ctx: Any, width: int, *, everything: bool) -> Iterator[str]:
    """Yield the lines of a help: usage, purpose, examples, arguments, verbs, options by group."""
    options = [one for one in command.params if one.param_type_name == "option" and not one.hidden]
    arguments = [one for one in command.params if one.param_type_name == "argument"]
    verbs = getattr(command, "commands", {})
    words = [get_metavar(one) if one.required else f"[{get_metavar(one)}]" for one in arguments]
    usage = [*words, "VERB ..."] if verbs else words
    yield f"Usage: {' '.join([ctx.command_path, '[OPTIONS]', *usage])}"
    for paragraph in (command.help or "").split("\n\n"):
        yield ""
        yield fill(" ".join(paragraph.split()), width, break_long_words=False, break_on_hyphens=False)
    if command.epilog:
        yield from ["", _make_title("Examples"), *(INDENT + line for line in command.epilog.splitlines())]
    if arguments:
        rows = [(get_metavar(one), _describe(one, everything=True)) for one in arguments]
        yield from ["", _make_title("Arguments"), *_align(rows, width)]
    if verbs:
        rows = [(name, _shorten(verb.help or "")) for name, verb in verbs.items()]
        yield from ["", _make_title("Verbs"), *_align(rows, width)]
    groups: dict[str, list[Any]] = {OPTIONS: []}
    for one in options:
        groups.setdefault(one.rich_help_panel or OPTIONS, []).append(one)
    left_out = 0 if everything else sum(len(groups.pop(title, [])) for title in RARE)
    for title in sorted(groups, key=lambda title: (title != OPTIONS, title in RARE)):
        rows = [(_join_names(one), _describe(one, everything=everything)) for one in groups[title]]
        if title == OPTIONS:
            rows += _list_help_rows(left_out, everything=everything)
        yield from ["", _make_title(title), *_align(rows, width)]


def _list_help_rows(left_out: int, *, everything: bool) -> list[tuple[str, str]]:
    rare_options = f" and {left_out} rare option{'s' if left_out > 1 else ''}" if left_out else ""
    advice = (
        "Show every option with its whole explanation." if everything else f"Show longer explanations{rare_options}."
    )
    return [("-h, --help", "Show the usual options."), ("--help-all", advice)]


def _make_title(text: str) -> str:
    return typer.style(f"{text}:", bold=True)


def get_metavar(one: Any) -> str:
    """Return the word that stands for the value of an argument or option."""
    return str(one.metavar or one.name.upper())


def _join_names(one: Any) -> str:
    """Return the names of an option and its metavar, the word for its value."""
    names = sorted(one.opts, key=len)
    text = ", ".join(names) + (f" / {', '.join(one.secondary_opts)}" if one.secondary_opts else "")
    return text if one.is_flag else f"{text} {get_metavar(one)}"


def _describe(one: Any, *, everything: bool) -> str:
    """Return the explanation of an option with its default; unless ``everything``, only the first sentence."""
    text = " ".join((one.help or "").split())
    variable = [f"environment: {one.envvar}"] if getattr(one, "envvar", None) else []
    if one.required and one.param_type_name == "option":
        variable.append("required")
    elif default := _show_default(one):
        variable.append(f"default: {default}")
    return " ".join([text if everything else _shorten(text), *([f"[{'; '.join(variable)}]"] if variable else [])])


def _show_default(one: Any) -> str:
    if isinstance(one.show_default, str):
        return one.show_default
    value = one.default
    if not one.show_default or getattr(one, "is_flag", False) or not isinstance(value, (str, int, float, Path)):
        return ""
    return str(value)


def _shorten(text: str) -> str:
    """Return the first sentence of a text."""
    first, dot, _ = " ".join(text.split()).partition(". ")
    return first + dot.rstrip()


def _align(rows: Sequence[tuple[str, str]], width: int) -> Iterator[str]:
    """Yield the lines of rows of names and texts, in two columns without broken words."""
    indent = " " * (NAME_COLUMNS + len(INDENT))
    for name, text in rows:
        fits = len(name) + len(INDENT) <= NAME_COLUMNS
        head = f"{INDENT}{name}".ljust(len(indent)) if fits else indent
        if not fits:
            yield f"{INDENT}{name}"
        yield fill(
            text, width, initial_indent=head, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False
        )
