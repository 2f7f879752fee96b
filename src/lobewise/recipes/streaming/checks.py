"""Checks before a file is denoised in bands."""

from __future__ import annotations

from collections.abc import Sequence

from lobewise.denoising.inputs import Images
from lobewise.errors import InputError, MissingChannelError, name_value
from lobewise.guides.survey import GuideSurvey
from lobewise.interchange.importing.bands import ImportedBands
from lobewise.interchange.mapping import is_own
from lobewise.interchange.reading import import_file, require_no_tables
from lobewise.io.exr.bands import BandReader
from lobewise.io.exr.header import wraps_around
from lobewise.io.exr.parsing import read_container
from lobewise.io.files import PathLike
from lobewise.recipes.streaming.plan import MEASURED_ROWS, cut_bands
from lobewise.records.lobe_table import LobeTable
from lobewise.settings import DenoiseSettings


def require_bands(source: PathLike, settings: DenoiseSettings, rows: int | None, memory: float | None) -> None:
    """Raise InputError if a file cannot be denoised in bands with these arguments of `denoise_file`."""
    if settings.asks_for_oidn:
        raise InputError(
            "with_oidn",
            expected="False for bands, because Open Image Denoise sees whole images",
            got="True",
            action="leave it out, or denoise the frame as a whole",
        )
    if rows is not None and (isinstance(rows, bool) or not isinstance(rows, int) or rows < 1):
        raise InputError("rows", expected="an integer of at least 1", got=name_value(rows), action="leave it out")
    if memory is not None and not 0.0 < memory < float("inf"):
        raise InputError(
            "memory", expected="a finite number of GiB above 0", got=name_value(memory), action="leave it out"
        )


def open_bands(
    source: PathLike, lobe_tables: Sequence[LobeTable] | None = None, wanted: Images | None = None
) -> BandReader:
    """Return a reader of a file in bands, whichever renderer wrote it; see `BandReader` and `ImportedBands`."""
    container = read_container(source)
    if wraps_around(container):
        raise InputError(
            f"input {str(source)!r}",
            expected="a file that can be read in bands",
            got="one that wraps around, as its header says (envmap)",
            action="denoise it as a whole (--bands off)",
        )
    if is_own(container):
        return BandReader(source, lobe_tables=lobe_tables, wanted=wanted)
    require_no_tables(source, lobe_tables)
    return ImportedBands(source)


def describe_file(reader: BandReader) -> tuple[str, ...]:
    """Return what is to be told of the whole of a file: how it was read, and what stays noisy."""
    if isinstance(reader, ImportedBands):
        return reader.judged.notes
    imported = import_file(reader.container.path, header_only=True)
    return (*imported.frame.notes, *(one.sentence for one in imported.findings))


def survey_guides(reader: BandReader) -> GuideSurvey:
    """Return what the guides of a file are worth. Most files are known after the first band.

    Raises
    ------
    MissingChannelError
        If the file has no normals: those that stand in for them are found in the whole image.
    """
    survey, height = GuideSurvey(), reader.shape[0]
    for band in cut_bands(height, MEASURED_ROWS):
        survey.look_at(reader.read_frame(*band))
        if survey.is_settled:
            break
        reader.forget(band[1])
    if ("gbuffer", "normal") not in reader.images or "normal" in survey.empty:
        raise MissingChannelError(
            "channel normal",
            expected="one for bands",
            got="none" if "normal" not in survey.empty else "one that is 0 everywhere",
            action="denoise the frame as a whole (--bands off)",
        )
    return survey
