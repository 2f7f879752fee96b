"""The forms of the filter: of which passes each is made, and over which taps a pass sums."""

from __future__ import annotations

from enum import Enum

ATROUS_RADIUS = 2
# Cubic B-spline (1, 4, 6, 4, 1)/16 over its peak, so that a matching centre counts 1.
ATROUS_PROFILE = (1.0, 2.0 / 3.0, 1.0 / 6.0)
ATROUS_LEVELS = 5
ATROUS_REACH = ATROUS_RADIUS * (2**ATROUS_LEVELS - 1)
"""Pixels to each side from which the form "atrous" takes, all levels together."""


class Taps(Enum):
    """The neighbours that one pass sums over."""

    SQUARE = "square"
    """All of (2r+1)^2."""
    HORIZONTAL = "horizontal"
    """2r+1 in the row."""
    VERTICAL = "vertical"
    """2r+1 in the column."""
    ATROUS = "atrous"
    """5x5, ``step`` pixels apart, with B-spline weights."""


def find_reach(taps: Taps, radius: int) -> tuple[int, int]:
    """Return how many steps a pass goes to the right and down."""
    across, down = {
        Taps.SQUARE: (radius, radius),
        Taps.HORIZONTAL: (radius, 0),
        Taps.VERTICAL: (0, radius),
        Taps.ATROUS: (ATROUS_RADIUS, ATROUS_RADIUS),
    }[taps]
    return across, down


def can_mirror(taps: Taps, radius: int) -> bool:
    """Return whether a processor's pass weighs the two pixels of a pair once: only rows gain (docs/performance.md)."""
    return taps is Taps.HORIZONTAL and radius > 0


def list_passes(form: str, radius: int) -> list[tuple[Taps, int, int]]:
    """Return taps, radius and step of every pass of a form of `lobewise.settings.FORMS`."""
    if form == "full":
        return [(Taps.SQUARE, radius, 1)]
    if form == "separable":
        return [(Taps.HORIZONTAL, radius, 1), (Taps.VERTICAL, radius, 1)]
    return [(Taps.ATROUS, 0, 2**level) for level in range(ATROUS_LEVELS)]
