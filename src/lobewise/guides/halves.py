"""Two images of independent noise: both halves of the samples, or the colours of a checkerboard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from lobewise import engine
from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector, select_or_nan
from lobewise.frame import FloatArray, Frame

PARTS = ("color", "diffuse", "specular")
"""Radiance that is filtered, in total and by part."""


@dataclass(frozen=True)
class Halves:
    """Two images of a frame whose noise is independent.

    Parameters
    ----------
    images : mapping of str to pair of (height, width, 3)
        Both images of each of the frame's `PARTS`, or of each of its layers, by name. A pixel without a sample in an
        image is NaN; a filter gives it weight 0.
    origin : {"file", "neighbours"}
        "file" if each image holds half of the samples of every pixel, "neighbours" if each holds every other pixel.
    """

    images: Mapping[str, tuple[FloatArray, FloatArray]]
    origin: str


def find_halves(frame: Frame) -> Halves:
    """Return two independent images of a frame: the halves of its samples, or else the colours of a checkerboard.

    The halves of the samples are used only if the frame has them for all of its parts or layers: then all parts of a
    half come from the same samples. Otherwise a pixel is in the image of its colour of the checkerboard, and NaN in the
    other. A checkerboard reveals fireflies, which are not in the neighbours; it measures noise badly
    (`lobewise.filters.noise.residuals`). A pixel that is NaN, infinite or negative in one image becomes NaN there.
    """
    wanted = _list_layers(frame) if frame.layers else _list_parts(frame)
    if all(a is not None and b is not None for _, a, b in wanted.values()):
        return Halves({name: (mark_bad(a), mark_bad(b)) for name, (_, a, b) in wanted.items()}, "file")
    return Halves({name: split_checkerboard(image) for name, (image, _, _) in wanted.items()}, "neighbours")


def _list_layers(frame: Frame) -> dict[str, tuple[FloatArray, Any, Any]]:
    """Return the radiance and both halves of every layer, by name."""
    return {layer.name: (layer.radiance, layer.half_a, layer.half_b) for layer in frame.layers}


def _list_parts(frame: Frame) -> dict[str, tuple[FloatArray, Any, Any]]:
    """Return the radiance and both halves of every part, by name."""
    names = [name for name in PARTS if getattr(frame.radiance, name) is not None]
    return {
        name: (
            getattr(frame.radiance, name),
            getattr(frame.half_a, name, None),
            getattr(frame.half_b, name, None),
        )
        for name in names
    }


def mark_bad(image: FloatArray) -> FloatArray:
    """Return an image (height, width, 3) with all channels of a pixel NaN if one is NaN, infinite or negative.

    The result is the image itself if it has no such pixel.
    """
    # With a NaN both reductions return NaN, whose comparisons are False.
    if float(image.min()) >= 0.0 and float(image.max()) < np.inf:
        return image
    (marked,) = engine.pixels(define_marked, {"image": image}, {})
    return np.asarray(marked)


def split_checkerboard(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the two colours of a checkerboard: an image (height, width, 3) where column plus row is even, and odd.

    All other pixels are NaN, and so are pixels that `mark_bad` marks.
    """
    marked = mark_bad(image)
    even, odd = (np.array(marked, np.float32) for _ in range(2))
    for row in range(2):
        even[row::2, 1 - row :: 2] = np.nan
        odd[row::2, row::2] = np.nan
    return even, odd


def define_marked(grid: Grid) -> list[Vector]:
    colour = grid.read("image")
    good = is_good(colour)
    return [[select_or_nan(good, value) for value in colour]]
