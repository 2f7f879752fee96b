"""The forms of the cross filter: the passes of each form, and the taps of each pass."""

from __future__ import annotations

from enum import Enum

ATROUS_RADIUS = 2
ATROUS_PROFILE = (1.0, 2.0 / 3.0, 1.0 / 6.0)
"""Cubic B-spline (1, 4, 6, 4, 1)/16 over its peak, so that the centre has weight 1; weights at distance 0, 1, 2."""
ATROUS_LEVELS = 5
ATROUS_REACH = ATROUS_RADIUS * (2**ATROUS_LEVELS - 1)
"""Distance of the farthest pixel that affects a pixel in the form "atrous", rows or columns."""


class Taps(Enum):
    """The taps that one pass sums over."""

    SQUARE = "square"
    """All (2r+1)^2 pixels."""
    HORIZONTAL = "horizontal"
    """2r+1 pixels of the row."""
    VERTICAL = "vertical"
    """2r+1 pixels of the column."""
    ATROUS = "atrous"
    """5x5 pixels, ``step`` pixels apart, with B-spline weights."""


def list_form_passes(form: str, radius: int) -> list[tuple[Taps, int, int]]:
    """Return taps, radius and step of each pass of a form of `lobewise.settings.FORM_NAMES`."""
    if form == "full":
        return [(Taps.SQUARE, radius, 1)]
    if form == "separable":
        return [(Taps.HORIZONTAL, radius, 1), (Taps.VERTICAL, radius, 1)]
    return [(Taps.ATROUS, 0, 2**level) for level in range(ATROUS_LEVELS)]


def count_taps(form: str, radius: int) -> int:
    """Return how many taps all passes of a form have for a pixel."""
    size = 2 * radius + 1
    return {"separable": 2 * size, "atrous": ATROUS_LEVELS * (2 * ATROUS_RADIUS + 1) ** 2}.get(form, size * size)


def describe_form(form: str, radius: int) -> str:
    """Return the form and the size of the kernel."""
    size = 2 * (ATROUS_REACH if form == "atrous" else radius) + 1
    return f"{form} kernel, {size}x{size} pixels"
