"""Bands of rows: the images that are read for them, the memory of a row, and the rows that fit."""

from __future__ import annotations

from itertools import pairwise

from lobewise.denoising.inputs import Images, list_images
from lobewise.denoising.plan import compute_steps_reach
from lobewise.filters.refinement.shape import MULTIPLE
from lobewise.guides.negative import NEGATIVE_REACH
from lobewise.guides.stand_ins import STAND_IN_REACH
from lobewise.io.exr.bands import BandReader
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import get_quality
from lobewise.work.limits import GIB, get_limits, require_memory

DEFAULT_MEMORY = 3.0
"""Memory that a band may take, GiB; program and kernels take more."""
MAX_WHOLE_GIB = 4.0
"""Memory above which a file is denoised in bands by default, GiB."""
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


def needs_bands(reader: BandReader, settings: DenoiseSettings) -> bool:
    """Return whether a file is so large that it is denoised in bands; the quality of ``settings`` is chosen.

    More memory than the default needs changes nothing, so that the choice stays the same.
    """
    height, width = reader.shape
    left = get_limits().left_gib
    most = MAX_WHOLE_GIB if left is None else min(left, MAX_WHOLE_GIB)
    return height * width * estimate_bytes(reader, settings) > most * GIB


def choose_rows(reader: BandReader, settings: ResolvedSettings, rows: int | None, memory: float | None) -> int:
    """Return the rows of a band: those asked for, or as many as fit ``memory``, at least `MIN_ROWS`.

    ``memory`` is in GiB and counts the rows around the band; by default `DEFAULT_MEMORY`, or less where the call has a
    limit. Raises LimitError if a band would take more than this limit.
    """
    height, width = reader.shape
    row_bytes, reach = width * estimate_bytes(reader, settings), compute_band_reach(settings)
    if rows is None:
        left = get_limits().left_gib
        most = memory or (DEFAULT_MEMORY if left is None else min(left, DEFAULT_MEMORY))
        rows = max(int(most * GIB / row_bytes) - 2 * reach, MIN_ROWS)
    require_memory(min(rows + 2 * reach, height) * row_bytes)
    return rows


def compute_band_reach(settings: ResolvedSettings) -> int:
    """Return how many rows around a band are read: the reach of the filters and of the checks."""
    return compute_steps_reach(settings) + CHECKED_REACH


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
