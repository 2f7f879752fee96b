"""Bands of rows: the images that are read for them, the memory of a row, and the rows that fit."""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

from lobewise.denoising.evidence import NOTED_STRIP_ROWS
from lobewise.denoising.inputs import Images, list_images
from lobewise.denoising.plan import GIB, compute_steps_reach
from lobewise.filters.refinement.shape import MULTIPLE
from lobewise.guides.negative import NEGATIVE_REACH
from lobewise.guides.stand_ins import STAND_IN_REACH
from lobewise.io.exr.bands import BandReader
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import get_quality

DEFAULT_MEMORY = 3.0
"""Memory that a band may take, GiB; program and kernels take more."""
MAX_WHOLE_GIB = 4.0
"""Memory above which a file is denoised in bands by default, GiB."""
PROGRAM_GIB = 0.5
"""Memory that program, libraries and kernels take beside a band or frame, GiB; docs/streaming.md has measurements."""
MAX_SHARE_OF_MEMORY = 0.9
"""Share of its memory that a process with a limit plans to take: Dask ends a worker that takes 0.95."""
MIN_BAND_GIB = 0.1
MIN_ROWS = 32
"""Rows of the smallest band: kernels work in strips of this height."""
MEASURED_ROWS = 256
"""Rows of a band in the pass that measures the whole frame."""
CHECKED_REACH = max(NEGATIVE_REACH, STAND_IN_REACH)
"""Rows that the checks of a frame read around a pixel, before anything is filtered."""
Bands = list[tuple[int, int]]
"""First row of each band, and the row behind its last."""

_PARTS = ("color", "diffuse", "specular")


def list_measured(settings: DenoiseSettings) -> Images:
    """Return the images that the measuring pass reads."""
    if not get_quality(settings.quality).reads_halves:
        return frozenset({*(("radiance", part) for part in _PARTS), ("variance", "color")})
    return list_images(settings)


def estimate_bytes(reader: BandReader, settings: DenoiseSettings) -> int:
    """Return the bytes of a pixel while it is filtered."""
    stored, read = reader.count_bytes()
    return (0 if forgets(settings) else stored) + read + get_quality(settings.quality).work_bytes_per_pixel


def forgets(settings: DenoiseSettings) -> bool:
    """Return whether stored rows are freed as soon as their frame is made, and decoded again when they are needed.

    A quality that refines takes so long that decoding twice costs little, and the freed memory leaves room for taller
    bands.
    """
    return get_quality(settings.quality).refines


class Limits(NamedTuple):
    """Memory that filtering may take, GiB."""

    whole: float
    """Of a frame that is filtered as a whole."""
    band: float
    """Of a band."""


def choose_limits(memory: float | None) -> Limits:
    """Return what filtering may take in a process that may take ``memory`` GiB; None for no limit.

    More memory than the defaults need changes nothing, so that the choice between whole frames and bands stays the
    same.
    """
    if memory is None:
        return Limits(MAX_WHOLE_GIB, DEFAULT_MEMORY)
    left = max(MAX_SHARE_OF_MEMORY * memory - PROGRAM_GIB, MIN_BAND_GIB)
    return Limits(min(left, MAX_WHOLE_GIB), min(left, DEFAULT_MEMORY))


def needs_bands(reader: BandReader, settings: DenoiseSettings, max_whole: float | None = None) -> bool:
    """Return whether a file is so large that it is denoised in bands; the quality of ``settings`` is chosen.

    ``max_whole`` is the largest memory of a whole frame, GiB; by default `MAX_WHOLE_GIB`.
    """
    height, width = reader.shape
    return height * width * estimate_bytes(reader, settings) > (max_whole or MAX_WHOLE_GIB) * GIB


def choose_rows(reader: BandReader, settings: ResolvedSettings, memory: float) -> int:
    """Return the rows of a band that, with the rows around it, fits ``memory`` GiB; at least `MIN_ROWS`."""
    _, width = reader.shape
    fitting = int(memory * GIB / (width * estimate_bytes(reader, settings)))
    return max(fitting - 2 * compute_band_reach(settings), MIN_ROWS)


def compute_band_reach(settings: ResolvedSettings) -> int:
    """Return how many rows around a band are read: the reach of the filters and of the notes to the user.

    Filters without halves do not read the evidence, but the note on blurred detail does, in strips.
    """
    noted = 0 if get_quality(settings.quality).reads_halves else NOTED_STRIP_ROWS
    return compute_steps_reach(settings) + CHECKED_REACH + noted


def cut_bands(height: int, rows: int) -> Bands:
    """Return bands of at most ``rows`` rows, as equal as they can be."""
    count = -(-height // rows)
    return list(pairwise(height * number // count for number in range(count + 1)))


def widen_band(band: tuple[int, int], reach: int, height: int) -> tuple[int, int]:
    """Return a band with ``reach`` more rows to each side, within the image, from a multiple of `MULTIPLE` on.

    The levels of the refining network have blocks of so many rows. A frame without halves is split by the colours of a
    checkerboard, which an even first row keeps.
    """
    return max(band[0] - reach, 0) // MULTIPLE * MULTIPLE, min(band[1] + reach, height)
