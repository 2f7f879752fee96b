"""What a verb prints about a result: remarks, the name of the picture, and on request the settings."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lobewise.errors import LobewiseError

if TYPE_CHECKING:
    from lobewise.recipes.files import FileResult
    from lobewise.recipes.files.remarks import Remarks
    from lobewise.recipes.sequence import SequenceReport
    from lobewise.reporting.picture import Pictures

MAX_FAILURES_NAMED = 20
"""Most failures that are told one by one."""


def make_remarks() -> Remarks:
    """Return remarks that are printed, each once."""
    from lobewise.cli.output import print_note
    from lobewise.recipes.files.remarks import Remarks

    return Remarks(print_note)


def tell_picture(output: Path, pictures: Pictures | None) -> None:
    """Print the name of the picture beside an output, if there is one."""
    from lobewise.cli.output import print_line

    if pictures is not None:
        print_line(f"Wrote {pictures.name(output)}.")


def tell_failures(sentences: Sequence[str], numbers: Sequence[int], frames: int) -> LobewiseError:
    """Print why frames of a sequence could not be filtered, and return the error that ends the run.

    Parameters
    ----------
    sentences : sequence of str
        A sentence for each failure.
    numbers : sequence of int
        The frames that failed.
    frames : int
        Frames of the sequence.
    """
    from lobewise.cli.output import print_note
    from lobewise.recipes.sequence import describe_failures

    for sentence in sentences[:MAX_FAILURES_NAMED]:
        print_note(sentence)
    return LobewiseError(describe_failures(numbers, frames))


def tell_settings(report: SequenceReport[FileResult], verbose: bool) -> None:
    """Print the settings of the filter by their names and the time of each stage, if ``verbose`` asks for them."""
    from lobewise.cli.output import describe_settings, print_note

    if verbose and report.last is not None:
        print_note(f"Settings: {describe_settings(report.last)}.")
        print_note(f"Seconds: {', '.join(f'{stage} {time:.2f}' for stage, time in report.stage_seconds.items())}.")
