"""What is said of a result: in one line what was done, remarks, and on request the settings."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING

from lobewise.cli.reading import FileInBands

if TYPE_CHECKING:
    from lobewise.frame import Result
    from lobewise.reporting.picture import Pictures


class Remarks:
    """What is said of results beside their figures, each sentence once; of its own figures those of the first frame."""

    def __init__(self) -> None:
        self._told: set[str] = set()

    def tell(self, result: Result | FileInBands) -> None:
        """Print what made the image, what is wrong with the guides, and which images of the frame were not used."""
        from lobewise.cli.output import print_note

        done = result.done if isinstance(result, FileInBands) else result
        unused = f"Not used with these settings: {', '.join(done.unused)}."
        used = [f"Used: {done.method}."] if done.method else []
        for note in (*used, *done.notes, *([unused] if done.unused else [])):
            key = re.sub(r"\d+(\.\d+)?", "#", note)
            if key not in self._told:
                print_note(note)
            self._told.add(key)


def describe(result: Result | FileInBands) -> str:
    """Return in one line what was done."""
    from lobewise.cli.output import describe_result

    return result.describe() if isinstance(result, FileInBands) else describe_result(result)


def tell_picture(output: Path, pictures: Pictures | None) -> None:
    """Print the name of the picture beside an output, if there is one."""
    from lobewise.cli.output import print_line

    if pictures is not None:
        print_line(f"Wrote {pictures.name(output)}.")


def tell_settings(result: Result | FileInBands | None, verbose: bool) -> None:
    """Print the settings of the filter by their names, if that is asked for."""
    from lobewise.cli.output import describe_settings, print_note

    if verbose and result is not None:
        done = result.done if isinstance(result, FileInBands) else result
        print_note(f"Settings: {describe_settings(done)}.")
