"""Tone mapped PNG pictures beside EXR files, for programs that do not show EXR files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lobewise.display.colors import Chromaticities, convert_light
from lobewise.display.tones import choose_exposure
from lobewise.display.views import View, paint_picture
from lobewise.interchange.mapping import Found, map_file
from lobewise.io.exr.bands import SLAB_ROWS, read_slabs
from lobewise.io.exr.container import Container
from lobewise.io.exr.header import read_chromaticities
from lobewise.io.exr.layout import join_planes
from lobewise.io.exr.parsing import read_container
from lobewise.io.files import open_atomic
from lobewise.io.png import encode_png, read_png_text
from lobewise.records.frame import FloatArray

EXPOSURE = "lobewise exposure"
"""Name of the text chunk in a picture that holds the factor from radiance to display values."""
MAX_EXPOSURE_PIXELS = 1 << 22
"""Most pixels that the exposure is measured on; of a larger image every n-th row and column is taken."""
EXR_ENDINGS = (".exr", ".sxr", ".mxr")


def name_picture(path: Path) -> Path:
    """Return the picture of an EXR file: its name with the ending ``.png``."""
    return path.with_suffix(".png") if path.suffix.lower() in EXR_ENDINGS else path.with_name(f"{path.name}.png")


class Pictures:
    """Writes pictures of one exposure, each beside its EXR file, whole or not at all.

    Parameters
    ----------
    stops : float, optional
        Base-2 logarithm of the exposure; by default it is measured on the first image (see `choose_exposure`).
    first : path, optional
        The first EXR file of a sequence. If an earlier run wrote its picture, the exposure of this picture is used.
    view : View, optional
        What turns light into display values; by default `lobewise.display.tones.map_tones`.
    """

    def __init__(self, *, stops: float | None = None, first: Path | None = None, view: View | None = None) -> None:
        self.stops, self.view = stops, view
        self._exposure = None if stops is None else 2.0**stops
        self._first = first

    name = staticmethod(name_picture)

    def write(self, path: Path, image: FloatArray) -> Path:
        """Write the picture of an image, linear radiance of shape (height, width, 3); return its path.

        Raises FileError if it cannot be written.
        """
        step = _choose_step(image.shape[0], image.shape[1])
        primaries = read_chromaticities(read_container(path))
        exposure = self._choose(path, primaries, lambda: image[::step, ::step])
        rows = ((top, image[top : top + SLAB_ROWS]) for top in range(0, image.shape[0], SLAB_ROWS))
        return _write(path, self._paint((image.shape[0], image.shape[1]), rows, primaries, exposure), exposure)

    def write_from_file(self, path: Path) -> Path:
        """Write the picture of a file, reading some rows of its image at a time; return its path.

        Raises FileError if it cannot be written, or ``path`` cannot be read.
        """
        container = read_container(path)
        shown = map_file(container).target
        window, primaries = shown.source.part.data_window, read_chromaticities(container)
        step = _choose_step(window.height, window.width)
        exposure = self._choose(
            path,
            primaries,
            lambda: np.concatenate([rows[-top % step :: step, ::step] for top, rows in _read_rows(container, shown)]),
        )
        rows = _read_rows(container, shown)
        return _write(path, self._paint((window.height, window.width), rows, primaries, exposure), exposure)

    def _choose(self, path: Path, primaries: Chromaticities | None, measure: Callable[[], FloatArray]) -> float:
        """Return the exposure of all pictures, which the first picture decides; ``measure`` returns its image."""
        if self._exposure is None and self._first is not None and self._first != path:
            self._exposure = _read_exposure(name_picture(self._first))
        if self._exposure is None:
            self._exposure = choose_exposure(convert_light(_round_to_half(measure()), primaries))
        return self._exposure

    def _paint(
        self,
        shape: tuple[int, int],
        rows: Iterable[tuple[int, FloatArray]],
        primaries: Chromaticities | None,
        exposure: float,
    ) -> NDArray[np.uint8]:
        """Return the picture of an image; painting some rows at a time saves several times the image's memory."""
        picture = np.empty((*shape, 3), np.uint8)
        for top, some in rows:
            picture[top : top + len(some)] = paint_picture(_round_to_half(some), primaries, exposure, self.view)
        return picture


def _choose_step(height: int, width: int) -> int:
    return max(math.ceil(math.sqrt(height * width / MAX_EXPOSURE_PIXELS)), 1)


def _round_to_half(image: FloatArray) -> FloatArray:
    """Round an image to the 16-bit floats of the file, so that its picture is the picture of the file."""
    with np.errstate(over="ignore"):
        return image.astype(np.float16).astype(np.float32)


def _read_rows(container: Container, shown: Found) -> Iterator[tuple[int, FloatArray]]:
    """Yield an image some rows at a time, each with the number of its first row."""
    for top, pixels in read_slabs(container, shown.source.part, shown.channels):
        yield top, join_planes([pixels[name] for name in shown.channels])


def _read_exposure(path: Path) -> float | None:
    """Return the exposure that a picture was made with, None where it holds no positive finite number."""
    try:
        exposure = float(read_png_text(path, EXPOSURE) or "nan")
    except ValueError:
        return None
    return exposure if 0.0 < exposure < math.inf else None


def _write(path: Path, picture: NDArray[np.uint8], exposure: float) -> Path:
    target = name_picture(path)
    with open_atomic(target, what="picture") as stream:
        stream.write(encode_png(picture, texts={EXPOSURE: repr(exposure)}))
    return target
