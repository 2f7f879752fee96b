"""What is known of a frame's noise: two images of it that are independent."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from lobewise.frame import FloatArray, Frame, Radiance
from lobewise.guides.halves import mark_bad, split_checkerboard

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
