"""What a verb prints about a result: remarks, the name of the picture, and on request the settings."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from lobewise.errors import hide_numbers

if TYPE_CHECKING:
    from lobewise.cli.options.selections import DoneSeveral
    from lobewise.interchange.selections import Selection
    from lobewise.io.sequence import FramePattern
    from lobewise.recipes.streaming import DenoisedFile
    from lobewise.records.frame import Result
    from lobewise.reporting.picture import Pictures


class Remarks:
    """Prints remarks, each once and with its frame: a sequence has the same remarks for many frames.

    Parameters
    ----------
    silent : bool
        Whether to collect remarks without printing them.
    """

    def __init__(self, *, silent: bool = False) -> None:
        self._is_silent = silent
        self.sentences: dict[str, str] = {}
        """Remarks by key."""
        self._kinds: set[str] = set()

    def tell(self, note: str, key: str = "", frame: int | None = None) -> None:
        """Print a note, unless a note with its key was printed before; by default the note is its own key.

        ``frame`` is the number of the note's frame in a sequence.
        """
        from lobewise.cli.output import print_note

        if (key or note) in self.sentences:
            return
        sentence = note if frame is None else f"Frame {frame}: {note}"
        self.sentences[key or note] = sentence
        if not self._is_silent:
            print_note(sentence)

    def tell_of(self, selection: Selection, first: Selection, note: str, key: str, frame: int | None = None) -> None:
        """Print a note on one of the views of a file.

        For other views than the ``first``, print only notes of a new kind, with the name of the view.
        """
        kind = selection.name_kind(note)
        if selection == first:
            self.tell(note, key, frame)
        elif kind not in self._kinds:
            self.tell(selection.begin_note(note, first), key, frame)
        self._kinds.add(kind)

    def tell_result(self, result: Result | DenoisedFile | DoneSeveral, frame: int | None = None) -> None:
        """Print the method, what is wrong with the guides, and which images of the frame were not used."""
        from lobewise.cli.options.selections import DoneSeveral

        if isinstance(result, DoneSeveral):
            for selection, done in zip(result.selections, result.done, strict=True):
                for note in _list_notes(done.result):
                    self.tell_of(selection, result.selections[0], note, hide_numbers(note), frame)
            return
        for note in _list_notes(result):
            self.tell(note, hide_numbers(note), frame)


def _list_notes(result: Result | DenoisedFile) -> list[str]:
    unused = f"Not used with these settings: {', '.join(result.unused)}."
    used = [f"Used: {result.method}."] if result.method else []
    return [*used, *result.notes, *([unused] if result.unused else [])]


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


def tell_settings(result: Result | DenoisedFile | DoneSeveral | None, verbose: bool) -> None:
    """Print the settings of the filter by their names, if ``verbose`` asks for them."""
    from lobewise.cli.output import describe_settings, print_note

    if verbose and result is not None:
        print_note(f"Settings: {describe_settings(result)}.")
