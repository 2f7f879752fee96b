"""Arguments and options of several verbs, and the parsers of numbers on the command line."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from lobewise.cli.terminal.help import sequence_detail, sequence_option
from lobewise.cli.terminal.lines import choose_progress
from lobewise.errors import InputError, require_choice
from lobewise.settings import TemporalSettings, list_knobs

MIN_SIDE, MAX_SIDE = 8, 8192
"""Fewest and most pixels of a side of ``--size``."""
Input = Annotated[Path, typer.Argument(metavar="INPUT.exr", help="The EXR file to read.", show_default=False)]
Source = Annotated[
    Path,
    typer.Argument(metavar="INPUT.exr", help="The EXR file to read; in.####.exr for a sequence.", show_default=False),
]


def parse_output(text: str) -> Path:
    """Return the path of a file to write. Raises FileError if it ends with a slash."""
    from lobewise.io.files import require_file_name

    return require_file_name(text)


output_option = partial(typer.Option, parser=parse_output)
"""Declares an option that names a file to write."""


@dataclass(frozen=True)
class OverTime:
    """Options that let a frame of a sequence use the frames before it."""

    temporal: Annotated[
        bool,
        sequence_option("--temporal", help="Let every frame use the frames before it."),
    ] = False
    memory: Annotated[
        float, sequence_detail(metavar="0-1", help=f"With --temporal: {list_knobs(TemporalSettings)['memory'].hint}")
    ] = TemporalSettings.memory

    def require_sequence(self, source: Path) -> None:
        """Raise InputError if frames are to be filtered over time and ``source`` is a single file."""
        if self.temporal:
            require_pattern("--temporal", source)


@dataclass(frozen=True)
class Telling:
    """Options that tell how much to print."""

    verbose: Annotated[bool, typer.Option("--verbose", help="Print the settings of the filter.")] = False
    progress: Annotated[
        str,
        typer.Option(
            metavar="auto|json|off",
            callback=choose_progress,
            help="A bar, lines of JSON, or neither. All are on standard error.",
        ),
    ] = "auto"


def require_pattern(option: str, source: Path) -> None:
    """Raise InputError if ``source`` is a single file: the option is for sequences."""
    from lobewise.io.sequence import is_pattern, name_pattern

    if not is_pattern(source):
        near = name_pattern(source)
        action = "put # in place of the digits of the number, and quote the name"
        raise InputError(
            option,
            expected="a sequence such as 'in.####.exr'",
            got=repr(str(source)),
            action=f"name the sequence {str(near)!r}, in quotes" if near else action,
        )


def require_device(name: str, *, is_here: bool = True) -> None:
    """Raise LobewiseError unless a device has this name and, if filters run on this machine, can be used."""
    from lobewise.backend.devices import DEVICES, choose_device

    require_choice("device", name, ("auto", *DEVICES))
    # What "auto" stands for takes long to ask for.
    if is_here and name != "auto":
        choose_device(name)


def parse_place(text: str) -> tuple[int, int]:
    """Return row and column of ``ROW,COLUMN``."""
    words = text.split(",")
    if len(words) == 2 and all(word.strip().isdecimal() for word in words):
        return int(words[0]), int(words[1])
    raise InputError("--place", expected="ROW,COLUMN, such as 1,2", got=repr(text), action="write two numbers")


def parse_size(text: str) -> tuple[int, int]:
    """Return columns and rows of ``WxH``, each from `MIN_SIDE` to `MAX_SIDE`."""
    match = re.fullmatch(r"(\d{1,5})x(\d{1,5})", text.strip().lower())
    if match and min(map(int, match.groups())) >= MIN_SIDE and max(map(int, match.groups())) <= MAX_SIDE:
        return int(match[1]), int(match[2])
    raise InputError(
        "--size",
        expected=f"columns x rows from {MIN_SIDE} to {MAX_SIDE}, such as 512x512",
        got=repr(text),
        action="write two numbers",
    )
