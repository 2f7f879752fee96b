"""Two images of independent noise: both halves of the samples, or the colours of a checkerboard."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.pointwise import Grid, Vector, run_pointwise, select_or_nan
from lobewise.frame import FloatArray, Frame, Radiance

PARTS = ("color", "diffuse", "specular")
"""Radiance that is filtered, in total and by part."""


@dataclass(frozen=True)
class Halves:
    """Two images of a frame whose noise is independent.

    Parameters
    ----------
    a, b : Radiance
        The parts of `PARTS` that the frame has. NaN where a half has no sample: a filter gives it weight 0.
    origin : {"file", "neighbours"}
        Whether every pixel has a half of its samples in each, or each has every other pixel.
    """

    a: Radiance
    b: Radiance
    origin: str


def find_halves(frame: Frame) -> Halves:
    """Return two independent images of a frame: the halves of its samples, or else the colours of a checkerboard.

    The halves of the samples serve only where they tell apart whatever the frame does, so that all parts of a half
    come from the same samples. Without them a pixel is in the half of its colour and NaN in the other. A pixel that is
    NaN, infinite or negative in a half becomes NaN there, and stays what it is in the other.
    """
    names = [name for name in PARTS if getattr(frame.radiance, name) is not None]
    a, b = frame.half_a, frame.half_b
    if a is not None and b is not None and all(getattr(half, name) is not None for half in (a, b) for name in names):
        return Halves(_map_parts(names, mark_bad, a), _map_parts(names, mark_bad, b), "file")
    boards = {name: split_checkerboard(getattr(frame.radiance, name)) for name in names}
    even, odd = (Radiance(**{name: both[k] for name, both in boards.items()}) for k in range(2))
    return Halves(even, odd, "neighbours")


def _map_parts(names: list[str], change: Callable[[FloatArray], FloatArray], radiance: Radiance) -> Radiance:
    """Return the named parts of a radiance, changed."""
    return Radiance(**{name: change(getattr(radiance, name)) for name in names})


def mark_bad(image: FloatArray) -> FloatArray:
    """Return an image (height, width, 3), NaN in all channels where one is NaN, infinite or negative."""
    (marked,) = run_pointwise(_define_marked, {"image": image}, {})
    return marked


def split_checkerboard(image: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return an image (height, width, 3) at the pixels whose column and row add up to even numbers, and at the others.

    NaN marks the pixels of the other half and, as in `mark_bad`, those without meaning.
    """
    even, odd = run_pointwise(_define_checkerboard, {"image": image}, {})
    return even, odd


def _is_good(colour: Vector) -> hl.Expr:
    """Return whether all channels are finite and not negative."""
    bad = [expressions.is_bad(value) for value in colour]
    return ~(bad[0] | bad[1] | bad[2])


def _define_marked(grid: Grid) -> list[Vector]:
    colour = grid.read("image")
    good = _is_good(colour)
    return [[select_or_nan(good, value) for value in colour]]


def _define_checkerboard(grid: Grid) -> list[Vector]:
    colour = grid.read("image")
    good, even = _is_good(colour), (grid.x + grid.y) % 2 == 0
    return [[select_or_nan(good & here, value) for value in colour] for here in (even, ~even)]
