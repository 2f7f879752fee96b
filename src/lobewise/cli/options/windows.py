"""The options ``--window`` and ``--temporal``: every file of a sequence is denoised with the files around it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lobewise.cli.options.common import require_pattern
from lobewise.cli.terminal.help import sequence_option
from lobewise.errors import InputError

if TYPE_CHECKING:
    from lobewise.interchange import Imported
    from lobewise.records.frame import Frame

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

    @property
    def reach(self) -> int:
        """Frames before every frame, and after it unless ``temporal`` is set; 0 for none."""
        return self.window or (USUAL_REACH if self.temporal else 0)

    @property
    def option(self) -> str:
        """The option that was given; empty for none."""
        return "--window" if self.window is not None else "--temporal" if self.temporal else ""

    def require(self, source: Path) -> None:
        """Raise InputError unless the window can be used."""
        from lobewise.recipes.windows import MAX_REACH

        if self.window is not None and not 1 <= self.window <= MAX_REACH:
            got = str(self.window)
            raise InputError("--window", expected=f"1 to {MAX_REACH} frames", got=got, action="2 is usual")
        if self.option:
            require_pattern(self.option, source)

    def list_files(self, source: Path, number: int) -> list[tuple[int, Path]]:
        """Return the existing files that a frame depends on with their numbers, in order; a missing number ends them.

        Neighbours have windows of their own, and one frame more tells the motion of the camera at the ends.
        """
        from lobewise.io.sequence import FramePattern

        pattern = FramePattern.parse(source)
        most = 2 * self.reach + 1 if self.reach else 0
        first = last = number
        while number - first < most and first > 0 and pattern.name(first - 1).is_file():
            first -= 1
        while not self.temporal and last - number < most and pattern.name(last + 1).is_file():
            last += 1
        return [(each, pattern.name(each)) for each in range(first, last + 1)]


@dataclass(frozen=True)
class FileInWindow:
    """A file, and the frames around it.

    Parameters
    ----------
    imported : Imported
        The file.
    frames : tuple of Frame
        Consecutive frames of the sequence.
    index : int
        Which of them is that of the file.
    """

    imported: Imported
    frames: tuple[Frame, ...]
    index: int


class WindowReader:
    """Reads each file of a sequence with the files around it, and keeps files as long as windows need them.

    Parameters
    ----------
    source : Path
        The pattern of the sequence.
    window : Window
    read : callable
        Reads one file.
    """

    def __init__(self, source: Path, window: Window, read: Callable[[Path], Imported]) -> None:
        self._source = source
        self._window = window
        self._read = read
        self._kept: dict[Path, Imported] = {}

    def read(self, path: Path) -> FileInWindow:
        """Return a file with the files around it. A missing number, or a frame of another size, ends the window."""
        from lobewise.io.sequence import FramePattern

        middle = FramePattern.parse(self._source).read_number(path)
        files = self._window.list_files(self._source, middle)
        first, paths = files[0][0], [each for _, each in files]
        known, self._kept = self._kept, {}
        for each in paths:
            self._kept[each] = known.pop(each) if each in known else self._read(each)
        return FileInWindow(self._kept[path], tuple(self._kept[each].frame for each in paths), middle - first)
