"""Two images of independent noise: the colours of a checkerboard, and samples without meaning marked as none."""

from __future__ import annotations

import halide as hl

from lobewise.backend import expressions
from lobewise.backend.pointwise import Grid, Vector, run_pointwise, select_or_nan
from lobewise.frame import FloatArray


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
