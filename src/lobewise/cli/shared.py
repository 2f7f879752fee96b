"""What several verbs share: arguments and options, words that stand for numbers, the progress bar."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from lobewise.cli.terminal.help import SEQUENCE_DETAILS, SEQUENCES, SHADING
from lobewise.errors import InputError
from lobewise.settings import TemporalSettings, list_knobs

Input = Annotated[Path, typer.Argument(metavar="INPUT.exr", help="The EXR file to read.", show_default=False)]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The file to write.", show_default=False)]

Source = Annotated[
    Path,
    typer.Argument(metavar="INPUT.exr", help="The EXR file to read; in.####.exr for a sequence.", show_default=False),
]
Verbose = Annotated[bool, typer.Option("--verbose", help="Say with which settings of the filter it was done.")]
Adaptive = Annotated[
    str,
    typer.Option(
        metavar="PERCENT",
        help="Shade so many pixels again, the least supported; needs --scene.",
        rich_help_panel=SHADING,
    ),
]
Scene = Annotated[
    str | None,
    typer.Option(
        metavar="SCENE", help="With --adaptive: what was rendered.", show_default=False, rich_help_panel=SHADING
    ),
]
AdaptiveSpp = Annotated[
    int, typer.Option(metavar="N", help="With --adaptive: samples of each pixel.", rich_help_panel=SHADING)
]
Light = Annotated[
    str,
    typer.Option(metavar="all|indirect", help="With --adaptive: the light that was rendered.", rich_help_panel=SHADING),
]
Temporal = Annotated[
    bool,
    typer.Option(
        "--temporal", help="With a sequence: let every frame know the ones before.", rich_help_panel=SEQUENCES
    ),
]
Memory = Annotated[
    float,
    typer.Option(
        metavar="0-1",
        help=f"With --temporal: {list_knobs(TemporalSettings)['memory'].hint}",
        rich_help_panel=SEQUENCE_DETAILS,
    ),
]


@contextmanager
def show_progress() -> Iterator[Callable[[str, int, int], None]]:
    """Show a bar on standard error for work that reports (what, done, total)."""
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TaskID, TextColumn, TimeRemainingColumn

    columns = (TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.percentage:3.0f} %"))
    console = Console(stderr=True)
    # Without a terminal the bar would leave an empty line.
    hidden = not console.is_terminal
    with Progress(*columns, TimeRemainingColumn(), console=console, transient=True, disable=hidden) as bar:
        tasks: dict[str, TaskID] = {}

        def advance(what: str, done: int, total: int) -> None:
            if what not in tasks:
                tasks[what] = bar.add_task(what, total=total)
            bar.update(tasks[what], completed=done, total=total)

        yield advance


def parse_place(text: str) -> tuple[int, int]:
    """Return row and column of ``ROW,COLUMN``."""
    words = text.split(",")
    if len(words) == 2 and all(word.strip().isdecimal() for word in words):
        return int(words[0]), int(words[1])
    raise InputError("--place", expected="ROW,COLUMN, such as 1,2", got=repr(text), action="write two numbers")


def parse_size(text: str) -> tuple[int, int]:
    """Return columns and rows of ``WxH``.

    Raises
    ------
    InputError
        If it is none, or out of 8 to 8192.
    """
    found = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip().lower())
    if found and min(map(int, found.groups())) >= 8 and max(map(int, found.groups())) <= 8192:
        return int(found[1]), int(found[2])
    raise InputError(
        "--size",
        expected="columns x rows from 8 to 8192, such as 512x512",
        got=repr(text),
        action="write two numbers",
    )
