"""How an image is cut into bands of rows: what of it is read, how much memory a row takes, how many rows fit."""

from __future__ import annotations

from itertools import pairwise

from lobewise.denoising.inputs import Images, list_images
from lobewise.denoising.planning.frame_plans import find_reach
from lobewise.filters.noise.evidence import REACH as EVIDENCE_REACH
from lobewise.io.exr.bands import BandReader
from lobewise.settings import DenoiseSettings, ResolvedSettings
from lobewise.settings.choices import get_quality

GIB = float(2**30)
DEFAULT_MEMORY = 3.0
"""GiB that the bands of an image may take; what the program and its kernels are comes on top of that."""
WHOLE = 4.0
"""GiB above which a file is not denoised as a whole where nobody says how."""
FEWEST_ROWS = 32
"""Rows that a band has at least: kernels work in strips of so many."""
MEASURED_ROWS = 256
"""Rows of a band in the pass that measures the whole frame."""
Bands = list[tuple[int, int]]
"""First row and the one behind the last of each."""

_PARTS = ("color", "diffuse", "specular")


def list_measured(settings: DenoiseSettings) -> Images:
    """Return which images the pass that measures a frame looks at."""
    if not get_quality(settings.quality).reads_halves:
        return frozenset({*(("radiance", part) for part in _PARTS), ("variance", "color")})
    return list_images(settings)


def estimate_bytes(reader: BandReader, settings: DenoiseSettings) -> int:
    """Return how many bytes a pixel takes while it is filtered."""
    stored, read = reader.count_bytes()
    return (0 if forgets(settings) else stored) + read + get_quality(settings.quality).work_bytes_per_pixel


def forgets(settings: DenoiseSettings) -> bool:
    """Return whether rows are let go as soon as a frame is made of them, and decoded again for the next and the copy.

    That is little beside what the quality "high" computes, and leaves room for taller bands.
    """
    return get_quality(settings.quality).mixes


def needs_bands(reader: BandReader, settings: DenoiseSettings) -> bool:
    """Return whether a file is so large that it is better denoised in bands; ``settings`` have their quality chosen."""
    height, width = reader.shape
    return height * width * estimate_bytes(reader, settings) > WHOLE * GIB


def choose_rows(reader: BandReader, settings: ResolvedSettings, memory: float) -> int:
    """Return how many rows a band can have so that it and the rows around it fit ``memory`` GiB, at least a few."""
    _, width = reader.shape
    fitting = int(memory * GIB / (width * estimate_bytes(reader, settings)))
    return max(fitting - 2 * find_band_reach(settings), FEWEST_ROWS)


def find_band_reach(settings: ResolvedSettings) -> int:
    """Return how many rows around a band are read: as far as anything tells on its pixels, or on what is told of them.

    The quality "fast" does not look at evidence; the sentence on what it blurs does.
    """
    return find_reach(settings) + (0 if get_quality(settings.quality).reads_halves else EVIDENCE_REACH)


def cut_bands(height: int, rows: int) -> Bands:
    """Return bands of at most ``rows`` rows, as equal as they can be."""
    count = -(-height // rows)
    return list(pairwise(height * number // count for number in range(count + 1)))


def widen(band: tuple[int, int], reach: int, height: int) -> tuple[int, int]:
    """Return a band with ``reach`` rows to each side, as far as there are such, from an even row on.

    Where a frame has no halves, its pixels are told apart by the colours of a checkerboard, which must not change.
    """
    return max(band[0] - reach, 0) // 2 * 2, min(band[1] + reach, height)
