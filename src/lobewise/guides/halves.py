"""Two images of independent noise: both halves of the samples, or the colours of a checkerboard."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from lobewise import engine
from lobewise.backend.expressions import is_good
from lobewise.backend.pointwise import Grid, Vector, select_or_nan
from lobewise.records.frame import FloatArray, Frame


@dataclass(frozen=True)
class Halves:
    """Two images of a frame whose noise is independent.

    Parameters
    ----------
    images : mapping of str to pair of (height, width, 3)
        Both images of each of the frame's layers, by name. A pixel without a sample in an image is NaN; a filter gives
        it weight 0.
    origin : {"file", "neighbours"}
        "file" if each image holds half of the samples of every pixel, "neighbours" if each holds every other pixel.
    """

    images: Mapping[str, tuple[FloatArray, FloatArray]]
    origin: str


def choose_halves(frame: Frame, lights: Mapping[str, FloatArray]) -> Halves:
    """Return two independent images of a frame: the halves of its samples, or else the colours of a checkerboard.

    The halves of the samples are used only if the frame has them for all of the layers: then all layers of a half come
    from the same samples. Otherwise a pixel is in the image of its colour of the checkerboard, and NaN in the other. A
    checkerboard reveals fireflies, which are not in the neighbours; it measures noise badly
    (`lobewise.filters.noise.residuals`). A pixel that is NaN, infinite or negative in one image becomes NaN there.

    Parameters
    ----------
    frame : Frame
    lights : mapping of str to (height, width, 3)
        The radiance of layers by name: those that the frame names itself, or fields of `lobewise.Radiance`.
    """
    if frame.layers:
        pairs = {layer.name: (layer.half_a, layer.half_b) for layer in frame.layers}
    else:
        pairs = {name: (getattr(frame.half_a, name, None), getattr(frame.half_b, name, None)) for name in lights}
    if all(half is not None for pair in pairs.values() for half in pair):
        good = {
            name: (mark_bad(a, name=f"{name}_a"), mark_bad(b, name=f"{name}_b"))  # type: ignore[arg-type]
            for name, (a, b) in pairs.items()
        }
        return Halves(good, "file")
    return Halves({name: split_checkerboard(light, name=name) for name, light in lights.items()}, "neighbours")


def mark_bad(image: FloatArray, *, name: str = "marked") -> FloatArray:
    """Return an image (height, width, 3) with all channels of a pixel NaN if one is NaN, infinite or negative.

    ``name`` is that of the result in recorded plans.
    """
    (marked,) = engine.pixels(define_marked, {"image": image}, {}, names=[name], text="mark bad pixels")
    return marked


def split_checkerboard(image: FloatArray, *, name: str = "colour") -> tuple[FloatArray, FloatArray]:
    """Return the two colours of a checkerboard: an image (height, width, 3) where column plus row is even, and odd.

    All other pixels are NaN, and so are pixels that `mark_bad` marks. ``name`` begins the names of the results in
    recorded plans.
    """
    names, text = [f"{name}_even", f"{name}_odd"], "colours of a checkerboard"
    even, odd = engine.pixels(define_colours, {"image": image}, {}, names=names, text=text)
    return even, odd


def define_marked(grid: Grid) -> list[Vector]:
    """Return an image, NaN where a pixel is bad; see `mark_bad`."""
    colour = grid.read("image")
    good = is_good(colour)
    return [[select_or_nan(good, value) for value in colour]]


def define_colours(grid: Grid) -> list[Vector]:
    """Return both colours of a checkerboard; see `split_checkerboard`."""
    colour = grid.read("image")
    good, is_even = is_good(colour), (grid.x + grid.y) % 2 == 0
    return [[select_or_nan(good & mine, value) for value in colour] for mine in (is_even, ~is_even)]
