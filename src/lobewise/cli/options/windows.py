"""The options ``--window`` and ``--temporal``: every file of a sequence is denoised with the files around it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

from lobewise.cli.options.common import require_pattern
from lobewise.cli.terminal.help import sequence_option
from lobewise.errors import InputError
from lobewise.settings import MAX_WINDOW

USUAL_REACH = 2
"""Frames to each side that ``--temporal`` uses without ``--window``."""


@dataclass(frozen=True)
class Window:
    """Options that let a frame of a sequence use the frames around it."""

    window: Annotated[
        int | None,
        sequence_option(
            "--window",
            metavar="N",
            help="Use N frames before and N after every frame. 2 is usual.",
            show_default=False,
        ),
    ] = None
    temporal: Annotated[
        bool,
        sequence_option("--temporal", help="Use only frames before every frame: 2, or N."),
    ] = False

    def list_fields(self) -> dict[str, Any]:
        """Return the options as fields of `lobewise.recipes.files.FileRequest`."""
        if self.window is not None and not 1 <= self.window <= MAX_WINDOW:
            got = str(self.window)
            raise InputError("--window", expected=f"1 to {MAX_WINDOW} frames", got=got, action="2 is usual")
        return {"window": self.window or (USUAL_REACH if self.temporal else 0), "past_only": self.temporal}

    def require_sequence(self, source: Path) -> None:
        """Raise InputError if an option is given and ``source`` is a single file."""
        if self.window is not None or self.temporal:
            require_pattern("--window" if self.window is not None else "--temporal", source)
