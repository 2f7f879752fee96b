"""The option ``--bands``: a large file is denoised some rows at a time, from file to file."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from lobewise.cli.options.reading import refuse_results
from lobewise.cli.terminal.help import file_detail
from lobewise.errors import InputError, LobewiseError

if TYPE_CHECKING:
    from lobewise.interchange.checks import Finding
    from lobewise.recipes.streaming import DenoisedFile
    from lobewise.records.lobe_table import LobeTable

Bands = Annotated[
    str,
    file_detail(
        metavar="auto|off|ROWS",
        help="Filter this many rows at a time: less memory, the same bits. auto does so with a file that would take "
        "more than 4 GiB.",
    ),
]


def parse_bands(text: str) -> str | int:
    """Return the number of rows of a band, or ``auto`` or ``off`` unchanged."""
    if text in ("auto", "off"):
        return text
    if text.isdecimal() and int(text) > 0:
        return int(text)
    raise InputError("--bands", expected="auto, off or a number of rows", got=repr(text), action="leave it out")


def require_bands(text: str, whole: str) -> str | int:
    """Return the result of `parse_bands`; raise InputError if rows are given beside ``whole``, see `choose_bands`."""
    bands = parse_bands(text)
    if isinstance(bands, int) and whole:
        raise InputError(
            "--bands",
            expected=f"auto or off with {whole}, which takes whole frames",
            got=text,
            action="drop one of them",
        )
    return bands


def choose_bands(source: Path, text: str, settings: dict[str, Any], whole: str) -> bool:
    """Return whether to denoise a file in bands.

    ``whole`` names the first option on the command line that needs the whole frame, empty for none.

    Raises
    ------
    InputError
        If the user gives a number of rows for a file that must be read whole, or a file in bands is a result of
        lobewise.
    """
    bands = require_bands(text, whole)
    is_asked = isinstance(bands, int)
    if bands == "off" or whole:
        return False
    if is_asked or _is_large(source, settings):
        refuse_results(source, _check_mark(source))
        return True
    return False


def _check_mark(source: Path) -> Sequence[Finding]:
    """Return findings on the mark that a result of lobewise has."""
    from lobewise.interchange.checks import check_own_mark
    from lobewise.interchange.checks.denoised import check_mark
    from lobewise.interchange.mapping import map_channels
    from lobewise.interchange.reading import is_own
    from lobewise.io.exr.parsing import read_container

    container = read_container(source)
    return check_own_mark(container) if is_own(container) else check_mark(container, map_channels(container))


def _is_large(source: Path, settings: dict[str, Any]) -> bool:
    from lobewise.denoising.automatic import ask
    from lobewise.recipes.streaming import list_images, needs_bands
    from lobewise.recipes.streaming.checks import open_bands

    request = ask(None, settings, whole=False)
    try:
        reader = open_bands(source, wanted=list_images(request))
        # Normals that stand in for missing ones are found in the whole image; another renderer's file may need it too.
        return needs_bands(reader, request) and ("gbuffer", "normal") in reader.images
    except LobewiseError:
        # A whole frame may be readable nevertheless; if it is not, reading it raises the error again.
        return False


@dataclass(frozen=True)
class FileInBands:
    """A file that will be denoised in bands, and where its result goes."""

    source: Path
    target: Path
    bands: str
    """See `parse_bands`."""
    tables: Sequence[LobeTable] | None
    """Fitted materials that replace the materials in the file."""
    settings: dict[str, Any]
    """Settings of `lobewise.denoise`."""

    def denoise(self) -> DenoisedFile:
        """Denoise the file into its target; see `lobewise.recipes.streaming.denoise_file`."""
        from lobewise.recipes.streaming import denoise_file

        bands = parse_bands(self.bands)
        return denoise_file(
            self.source,
            self.target,
            lobe_tables=self.tables,
            rows=bands if isinstance(bands, int) else None,
            **self.settings,
        )
