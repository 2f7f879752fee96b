"""The option ``--window``: every file of a sequence is denoised with the files before and after it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from lobewise.cli.options.common import OverTime, require_pattern
from lobewise.cli.terminal.help import sequence_option
from lobewise.errors import InputError

if TYPE_CHECKING:
    from lobewise.frame import Frame
    from lobewise.interchange import Imported

Window = Annotated[
    int,
    sequence_option(
        "--window",
        metavar="N",
        help="Use N frames before and N after every frame. 2 is usual.",
        show_default=False,
    ),
]


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
    reach : int
        Files before and after.
    read : callable
        Reads one file.
    """

    def __init__(self, source: Path, reach: int, read: Callable[[Path], Imported]) -> None:
        self._source = source
        self._reach = reach
        self._read = read
        self._kept: dict[Path, Imported] = {}

    def read(self, path: Path) -> FileInWindow:
        """Return a file with the files around it. A missing number, or a frame of another size, ends the window."""
        from lobewise.io.sequence import FramePattern

        middle = FramePattern.parse(self._source).read_number(path)
        window = list_window(self._source, middle, self._reach)
        first, paths = window[0][0], [each for _, each in window]
        known, self._kept = self._kept, {}
        for each in paths:
            self._kept[each] = known.pop(each) if each in known else self._read(each)
        return FileInWindow(self._kept[path], tuple(self._kept[each].frame for each in paths), middle - first)


def list_window(source: Path, number: int, reach: int) -> list[tuple[int, Path]]:
    """Return the existing files around a frame with their numbers, in order; a missing number ends the window.

    One frame more to each side tells the motion of the camera at the ends of the window.
    """
    from lobewise.io.sequence import FramePattern

    pattern = FramePattern.parse(source)
    first = last = number
    while number - first < reach + 1 and first > 0 and pattern.name(first - 1).is_file():
        first -= 1
    while last - number < reach + 1 and pattern.name(last + 1).is_file():
        last += 1
    return [(each, pattern.name(each)) for each in range(first, last + 1)]


def require_window(window: int, source: Path, over_time: OverTime) -> None:
    """Raise InputError unless ``--window``, or ``--temporal``, can be used."""
    from lobewise.windows import MAX_REACH

    over_time.require_sequence(source)
    if window == 0:
        return
    if not 0 < window <= MAX_REACH:
        raise InputError("--window", expected=f"1 to {MAX_REACH} frames", got=str(window), action="2 is usual")
    if over_time.temporal:
        raise InputError(
            "--window",
            expected="no --temporal beside it",
            got="both",
            action="use --window for files on disk, --temporal for frames as they come",
        )
    require_pattern("--window", source)
