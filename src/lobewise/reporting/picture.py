"""Tone mapped PNG pictures beside EXR files, for programs that do not show EXR files."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lobewise.display.colors import Chromaticities, convert_light
from lobewise.display.tones import choose_exposure
from lobewise.display.views import View, paint_picture
from lobewise.errors import LobewiseError
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
MAX_EXPOSURE_FRAMES = 9
"""Most frames of a sequence that its exposure is measured on."""
SHOT_PERCENTILE = 75.0
"""Percentile of the brightness of a sequence's frames, by which they are exposed: a fade-in is not burnt to white, and
one flash does not darken the sequence."""
AVERAGED_PIXELS = 4
"""Sides of the squares over which noisy light is averaged before it is measured, pixels."""
EXR_ENDINGS = (".exr", ".sxr", ".mxr")


def name_picture(path: Path) -> Path:
    """Return the picture of an EXR file: its name with the ending ``.png``."""
    return path.with_suffix(".png") if path.suffix.lower() in EXR_ENDINGS else path.with_name(f"{path.name}.png")


class Pictures:
    """Writes pictures of one exposure, each beside its EXR file, whole or not at all.

    Parameters
    ----------
    exposure : float, optional
        Factor from radiance to display values; by default it is measured on the first image (see `choose_exposure`).
    view : View, optional
        What turns light into display values; by default `lobewise.display.tones.map_tones`.
    """

    def __init__(self, *, exposure: float | None = None, view: View | None = None) -> None:
        self.exposure, self._view = exposure, view

    name = staticmethod(name_picture)

    def write(self, path: Path, image: FloatArray) -> Path:
        """Write the picture of an image, linear radiance of shape (height, width, 3); return its path.

        Raises FileError if it cannot be written.
        """
        step = _choose_step(image.shape[0], image.shape[1])
        primaries = read_chromaticities(read_container(path))
        exposure = self._choose(primaries, lambda: image[::step, ::step])
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
            primaries,
            lambda: np.concatenate([rows[-top % step :: step, ::step] for top, rows in _read_rows(container, shown)]),
        )
        rows = _read_rows(container, shown)
        return _write(path, self._paint((window.height, window.width), rows, primaries, exposure), exposure)

    def _choose(self, primaries: Chromaticities | None, measure: Callable[[], FloatArray]) -> float:
        """Return the exposure of all pictures; ``measure`` returns the image that decides where none is given."""
        if self.exposure is None:
            self.exposure = choose_exposure(convert_light(_round_to_half(measure()), primaries))
        return self.exposure

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
            picture[top : top + len(some)] = paint_picture(_round_to_half(some), primaries, exposure, self._view)
        return picture


def measure_exposure(
    paths: Sequence[Path], *, preset: Any = None, mapping: Mapping[str, str] | None = None, sparse: bool = False
) -> float:
    """Return the exposure of a sequence, measured once on some of its noisy files; 1 where none has light.

    Parameters
    ----------
    paths : sequence of path
        The files, in their order.
    preset, mapping
        As of `lobewise.interchange.import_file`.
    sparse : bool
        Whether most pixels are 0, because they were not shaded.
    """
    count = min(len(paths), MAX_EXPOSURE_FRAMES)
    levels = []
    for place in np.linspace(0, len(paths) - 1, count).round().astype(int):
        # A frame that cannot be read does not decide; filtering it will say why.
        with suppress(LobewiseError):
            container = read_container(paths[place])
            shown = map_file(container, preset=preset, mapping=mapping).target
            light = np.concatenate([rows for _, rows in _read_rows(container, shown)]).astype(np.float32)
            even = convert_light(_average_squares(light, sparse=sparse), read_chromaticities(container))
            # A black frame has no exposure.
            if (even > 0.0).any():
                levels.append(1.0 / choose_exposure(even))
    return 1.0 / float(np.percentile(levels, SHOT_PERCENTILE)) if levels else 1.0


def _average_squares(light: FloatArray, *, sparse: bool) -> FloatArray:
    """Return the means of squares of pixels: noise would make the brightest of an image brighter than it is."""
    height, width = (size - size % AVERAGED_PIXELS if size > AVERAGED_PIXELS else size for size in light.shape[:2])
    side = 1 if min(height, width) < AVERAGED_PIXELS else AVERAGED_PIXELS
    squares = light[:height, :width].reshape(height // side, side, width // side, side, -1)
    counts = np.isfinite(squares).all(axis=-1, keepdims=True)
    if sparse:
        counts &= (squares != 0.0).any(axis=-1, keepdims=True)
    total = np.sum(squares, axis=(1, 3), where=counts, dtype=np.float64)
    number = np.sum(counts, axis=(1, 3))
    mean = np.divide(total, number, out=np.full_like(total, np.nan), where=number > 0)
    return np.asarray(mean, np.float32)


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


def read_exposure(path: Path) -> float | None:
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
