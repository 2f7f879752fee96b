"""What a verb prints about a result: remarks, the name of the picture, and on request the settings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from lobewise.frame import Result
    from lobewise.io.sequence import FramePattern
    from lobewise.reporting.picture import Pictures
    from lobewise.streaming import DenoisedFile


class Remarks:
    """Prints remarks, each once and with its frame: a sequence has the same remarks for many frames.

    Parameters
    ----------
    silent : bool
        Whether to collect remarks without printing them.
    """

    def __init__(self, *, silent: bool = False) -> None:
        self._is_silent = silent
        self.told: dict[str, str] = {}
        """Remarks by key."""

    def tell(self, note: str, key: str = "", frame: int | None = None) -> None:
        """Print a note, unless a note with its key was printed before; by default the note is its own key.

        ``frame`` is the number of the note's frame in a sequence.
        """
        from lobewise.cli.output import print_note

        if (key or note) in self.told:
            return
        told = note if frame is None else f"Frame {frame}: {note}"
        self.told[key or note] = told
        if not self._is_silent:
            print_note(told)

    def tell_result(self, result: Result | DenoisedFile, frame: int | None = None) -> None:
        """Print the method, what is wrong with the guides, and which images of the frame were not used."""
        unused = f"Not used with these settings: {', '.join(result.unused)}."
        used = [f"Used: {result.method}."] if result.method else []
        for note in (*used, *result.notes, *([unused] if result.unused else [])):
            self.tell(note, hide_numbers(note), frame)


def hide_numbers(note: str) -> str:
    """Return a remark without its figures, which differ from frame to frame: only the first frame's are printed."""
    return re.sub(r"\d+(\.\d+)?", "#", note)


def tell_gaps(source: FramePattern) -> None:
    """Print which frames of a sequence are missing between its first and its last, if any is."""
    from lobewise.cli.output import print_note
    from lobewise.io.sequence import describe_gaps

    if gaps := describe_gaps([number for number, _ in source.find()]):
        print_note(gaps)


def tell_picture(output: Path, pictures: Pictures | None) -> None:
    """Print the name of the picture beside an output, if there is one."""
    from lobewise.cli.output import print_line

    if pictures is not None:
        print_line(f"Wrote {pictures.name(output)}.")


def tell_settings(result: Result | DenoisedFile | None, verbose: bool) -> None:
    """Print the settings of the filter by their names, if ``verbose`` asks for them."""
    from lobewise.cli.output import describe_settings, print_note

    if verbose and result is not None:
        print_note(f"Settings: {describe_settings(result)}.")
