"""The options ``--max-memory``, ``--max-seconds`` and ``--bands``: what filtering may take."""

from __future__ import annotations

import re
from contextlib import AbstractContextManager
from dataclasses import dataclass
from typing import Annotated

from lobewise.cli.terminal.help import file_detail
from lobewise.errors import InputError
from lobewise.work.limits import GIB, MIN_MEMORY_GIB, limit_call

UNITS = {"MB": 1e6, "MIB": 2.0**20, "GB": 1e9, "GIB": GIB, "TB": 1e12, "TIB": 2.0**40}

Bands = Annotated[
    str,
    file_detail(
        metavar="auto|off|ROWS",
        help="Filter this many rows at a time: less memory, and quality auto is high alone. auto does so with a file "
        "that would take more than 4 GiB.",
    ),
]


@dataclass(frozen=True)
class Bounds:
    """Options that limit the memory and the time of a run."""

    max_memory: Annotated[
        str | None,
        file_detail(
            "--max-memory",
            metavar="SIZE",
            help="Memory that the process may take, with --workers or --farm each worker, such as 8GB. Larger files "
            "are filtered in bands or in tiles where they can be, and refused where not.",
            show_default="no limit; with --workers the machine's memory divided by them",
        ),
    ] = None
    max_seconds: Annotated[
        float | None,
        file_detail(
            "--max-seconds",
            metavar="N",
            help="End with exit code 2 after N seconds. Outputs that are finished stay; the others are as before.",
            show_default="no limit",
        ),
    ] = None

    def limit(self) -> AbstractContextManager[None]:
        """Return a context in which these limits hold. Raises InputError if one is out of range."""
        if self.max_seconds is not None and not self.max_seconds > 0.0:
            raise InputError(
                "--max-seconds", expected="a number above 0", got=f"{self.max_seconds:g}", action="leave it out"
            )
        memory = None if self.max_memory is None else parse_memory(self.max_memory)
        return limit_call(max_memory=memory, max_seconds=self.max_seconds)


def parse_memory(text: str) -> float:
    """Return the GiB of a text such as 8GB, 8GiB or 4096MB."""
    match = re.fullmatch(r"(\d{1,9}(?:\.\d{1,6})?)\s*([MGT]I?B)", text.strip().upper())
    memory = float(match[1]) * UNITS[match[2]] / GIB if match else 0.0
    if memory < MIN_MEMORY_GIB:
        raise InputError(
            "--max-memory",
            expected="a size of at least 1GiB, such as 8GB",
            got=repr(text),
            action="give more, or leave it out",
        )
    return memory
