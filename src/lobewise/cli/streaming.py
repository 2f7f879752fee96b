"""How `denoise` works on a file in bands of rows: when it does, and what it shows meanwhile."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from lobewise.cli.shared import show_progress
from lobewise.errors import InputError, LobewiseError

if TYPE_CHECKING:
    from lobewise.lobe_table import LobeTable
    from lobewise.streaming import DenoisedFile

Bands = Annotated[
    str,
    typer.Option(
        metavar="auto|off|ROWS",
        help="Filter so many rows at a time, from file to file: little memory, the same bits. auto does so with a file "
        "that would take more than 4 GiB.",
    ),
]


def parse_bands(text: str) -> str | int:
    """Return the rows of a band, or ``auto`` or ``off`` as they are."""
    if text in ("auto", "off"):
        return text
    if text.isdecimal() and int(text) > 0:
        return int(text)
    raise InputError("--bands", expected="auto, off or a number of rows", got=repr(text), action="leave it out")


def choose_bands(source: Path, text: str, settings: dict[str, Any], whole: str) -> bool:
    """Return whether a file is denoised in bands; ``whole`` names the option that takes whole frames, empty for none.

    Raises
    ------
    InputError
        If bands are asked for by number where there are none.
    """
    bands = parse_bands(text)
    if isinstance(bands, int) and whole:
        raise InputError(
            "--bands",
            expected=f"auto or off with {whole}, which takes whole frames",
            got=text,
            action="drop one of them",
        )
    if bands == "off" or whole:
        return False
    if not _is_own(source):
        if isinstance(bands, int):
            raise InputError(
                "--bands",
                expected="auto or off for files of other renderers, which are read as a whole",
                got=text,
                action="leave it out",
            )
        return False
    return isinstance(bands, int) or _is_large(source, settings)


def _is_own(source: Path) -> bool:
    from lobewise.interchange.reading import is_own
    from lobewise.io.exr.parsing import read_container

    try:
        return is_own(read_container(source))
    except LobewiseError:
        return False


def _is_large(source: Path, settings: dict[str, Any]) -> bool:
    from lobewise.denoising.automatic import ask
    from lobewise.io.exr.bands import BandReader
    from lobewise.streaming import list_images, needs_bands

    asked = ask(None, settings)
    try:
        return needs_bands(BandReader(source, wanted=list_images(asked)), asked)
    except LobewiseError:
        # Whoever reads it as a whole says what is wrong, or reads it nevertheless.
        return False


class FileInBands:
    """A file that is denoised as it is written; until then it stands for its frame, and for the result.

    Parameters
    ----------
    text : str
        As it was given: see `parse_bands`.
    tables : sequence of LobeTable, optional
        In place of those in the file.
    settings : dict
        Of the filter.
    shows_bar : bool
        Whether a bar tells what is done, and the time that is left.
    """

    def __init__(
        self, text: str, tables: Sequence[LobeTable] | None, settings: dict[str, Any], *, shows_bar: bool
    ) -> None:
        bands = parse_bands(text)
        self._rows = bands if isinstance(bands, int) else None
        self._tables, self._settings, self._shows_bar = tables, settings, shows_bar
        self._done: DenoisedFile | None = None

    def write(self, source: Path, output: Path) -> None:
        """Denoise ``source`` into ``output``; mistakes in a file are told with its name."""
        from lobewise.streaming import denoise_file

        options: dict[str, Any] = {"lobe_tables": self._tables, "rows": self._rows, **self._settings}
        try:
            with show_progress() if self._shows_bar else nullcontext() as progress:
                self._done = denoise_file(source, output, progress=progress, **options)
        except LobewiseError as problem:
            if str(source) in str(problem) or str(output) in str(problem):
                raise
            raise type(problem)(f"{source}: {problem}") from problem

    def describe(self) -> str:
        """Return in one line what was done."""
        from lobewise.cli.output import describe_file_result

        assert self._done is not None, "it is written first"
        return describe_file_result(self._done)
