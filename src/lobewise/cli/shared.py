"""What several verbs share: their first argument and their output, words that stand for numbers, the progress bar."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from lobewise.errors import InputError

Input = Annotated[Path, typer.Argument(metavar="INPUT.exr", help="The EXR file to read.", show_default=False)]
Output = Annotated[Path, typer.Option("--output", "-o", metavar="FILE", help="The file to write.", show_default=False)]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Let the output replace a file that is read.")]


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


def list_files(paths: Iterable[Path]) -> Iterator[Path]:
    """Yield every path that is a file's, and of every pattern the files that exist."""
    from lobewise.io.sequence import FramePattern, is_pattern

    for path in paths:
        if is_pattern(path):
            yield from (found for _, found in FramePattern.parse(path).find())
        else:
            yield path


def protect_inputs(source: Path, output: Path, others: Iterable[Path | str | None], *, overwrite: bool) -> None:
    """Raise InputError where a result would replace a file that is read: an input, or one of its passes beside it.

    Parameters
    ----------
    source, output : Path
        A file each, or a pattern each.
    others : iterable of path or None
        What is read besides, files or patterns.
    overwrite : bool
        Whether that is wanted, which it can be of files alone: a sequence that was stopped halfway would begin again
        with frames that are denoised already.
    """
    from lobewise.interchange.siblings import list_family
    from lobewise.io.files import require_other_files
    from lobewise.io.sequence import FramePattern, is_pattern

    besides = list_files(Path(path) for path in others if path is not None)
    if not is_pattern(source):
        if not overwrite:
            action = "choose another name, or add --overwrite to replace it"
            require_other_files([output], [*list_family(source), *besides], action=action)
        return
    if overwrite:
        raise InputError(
            "--overwrite",
            expected="a single file",
            got=f"the sequence {str(source)!r}, which could not go on after a stop",
            action="write to other names",
        )
    frames = FramePattern.parse(source).find()
    pattern = FramePattern.parse(output)
    require_other_files((pattern.name(number) for number, _ in frames), [*(path for _, path in frames), *besides])


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
