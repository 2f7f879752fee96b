"""Parameters of what is kept over time."""

from __future__ import annotations

import math
from dataclasses import dataclass

from lobewise.errors import InputError, describe_problem


@dataclass(frozen=True)
class TemporalSettings:
    """Parameters of `TemporalFilter` beside those of the filter itself.

    Parameters
    ----------
    memory : float
        Share of a history's weight that the next frame keeps, 0 (none) to 1; with m the history is worth at most
        ``1 / (1 - m)`` frames.
    beta : float
        Exponent of the similarity between a pixel's lobe and what it was a frame ago, > 0.
    plane_sigma : float
        How far a surface point may lie off its plane of a frame ago, standard deviation in pixel footprints, > 0.
    strictness : float
        How the kernel narrows as the history grows, 0 (not) to 1: weights are raised to the power
        ``frames**strictness`` of the frames that a pixel's history is worth.
    cut_share : float
        Share of pixels, 0 to 1, that must find their history within a quarter of the image; where fewer do it is a
        camera cut and all is dropped.
    """

    memory: float = 0.95
    beta: float = 1.0
    plane_sigma: float = 2.0
    strictness: float = 0.5
    cut_share: float = 0.4

    def __post_init__(self) -> None:
        for name in ("memory", "strictness", "cut_share", "beta", "plane_sigma"):
            value = getattr(self, name)
            share = name in ("memory", "strictness", "cut_share")
            if not (0.0 <= value <= 1.0 if share else 0.0 < value < math.inf):
                raise InputError(
                    describe_problem(
                        name,
                        expected="a number from 0 to 1" if share else "a finite number above 0",
                        got=repr(value),
                        action="leave it out if unsure",
                    )
                )
