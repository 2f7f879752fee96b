"""The option ``--bands``: a large file is denoised some rows at a time, from file to file."""

from __future__ import annotations

from typing import Annotated

from lobewise.cli.terminal.help import file_detail
from lobewise.errors import InputError

Bands = Annotated[
    str,
    file_detail(
        metavar="auto|off|ROWS",
        help="Filter this many rows at a time: less memory, the same bits. auto does so with a file that would take "
        "more than 4 GiB.",
    ),
]


def parse_bands(text: str) -> str | int:
    """Return the number of rows of a band, or ``auto`` or ``off`` unchanged."""
    if text in ("auto", "off"):
        return text
    if text.isdecimal() and int(text) > 0:
        return int(text)
    raise InputError("--bands", expected="auto, off or a number of rows", got=repr(text), action="leave it out")
