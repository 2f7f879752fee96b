"""Remarks on the files of a run, each told once: a sequence has the same remarks for many frames."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

from lobewise.errors import hide_numbers
from lobewise.interchange.selections import Selection
from lobewise.work.overlap import tell_in_turn

if TYPE_CHECKING:
    from lobewise.recipes.files.result import FileResult

NO_SETTING_USES = frozenset({"motion", "blur_radius", "variance", "radiance.direct", "radiance.indirect"})
"""Images that are not used where other images are missing or there is one frame alone: no setting would change it."""


class Remarks:
    """Collects remarks, and tells each once, with its frame.

    Parameters
    ----------
    tell : callable, optional
        Takes each sentence; by default the sentences are only collected.
    """

    def __init__(self, tell: Callable[[str], object] | None = None) -> None:
        self._tell = tell
        self.sentences: dict[str, str] = {}
        """Remarks by key."""
        self._kinds: set[str] = set()
        self.file = ""
        """Name of the file that is filtered, where several are; each note begins with it."""

    def add(self, note: str, key: str = "", frame: int | None = None) -> None:
        """Tell a note, unless a note with its key was told before; by default the note is its own key.

        ``frame`` is the number of the note's frame in a sequence. Notes on a file are told after those on the files
        before.
        """
        tell_in_turn(partial(self._add, note, key, frame))

    def _add(self, note: str, key: str, frame: int | None) -> None:
        if (key or note) in self.sentences:
            return
        where = self.file if frame is None else f"Frame {frame}"
        sentence = f"{where}: {note}" if where else note
        self.sentences[key or note] = sentence
        if self._tell is not None:
            self._tell(sentence)

    def add_of(self, selection: Selection, first: Selection, note: str, key: str, frame: int | None = None) -> None:
        """Tell a note on one of the views of a file.

        For other views than the ``first``, tell only notes of a new kind, with the name of the view.
        """
        tell_in_turn(partial(self._add_of, selection, first, note, key, frame))

    def _add_of(self, selection: Selection, first: Selection, note: str, key: str, frame: int | None) -> None:
        kind = selection.name_kind(note)
        if selection == first:
            self._add(note, key, frame)
        elif kind not in self._kinds:
            self._add(selection.begin_note(note, first), key, frame)
        self._kinds.add(kind)

    def add_result(self, result: FileResult, frame: int | None = None) -> None:
        """Tell the method, what is wrong with the guides, and which images of the frame other settings would use."""
        for selection, one in zip(result.selections, result.results, strict=True):
            names = [name for name in one.unused if name not in NO_SETTING_USES]
            unused = [f"Not used with these settings: {', '.join(names)}."] if names else []
            used = [f"Used: {one.method}."] if one.method else []
            for note in (*used, *one.notes, *unused):
                self.add_of(selection, result.selections[0], note, hide_numbers(note), frame)
